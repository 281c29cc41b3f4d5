"""DuckDB over a catalogue's files, which reads them and can do nothing else.

Three walls: a question is one statement whose parsed tree has only SELECTs in it (DuckDB runs a COPY inside a WITH, and
a function `query` runs any text), the engine may open only the catalogue's own files, and its configuration is locked.
Nothing is spilled to disk. DuckDB's own bounds hold between its vectors only: whoever asks for others does so in a
process of its own (asking.py).
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from annulus_pipe.archive.catalogue.columns import JOINT_KINDS, JOINT_MEASURES, SUPERSEDED, SURVEYS, TABLES
from annulus_pipe.archive.catalogue.pieces import DamagedFile, Pieces, broken, find, quoted, session
from annulus_pipe.extras import need
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

SQL_MAX = 100_000  # characters
_NODES = {"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"}
_FUNCTIONS = {"range", "generate_series", "unnest", "repeat"}  # in place of a table; of the rest some read files


class Engine:
    """A catalogue opened in this process. `damage`: of its files, found so far."""

    def __init__(self, root: Path, memory_mb: int, without: frozenset[Path]) -> None:
        self.root, self.memory_mb = root, memory_mb
        self.connection = session(memory_mb)
        self.pieces = self._opened(without)
        self.damage: Sequence[DamagedFile] = self.pieces.damage
        self._lock()

    def close(self) -> None:
        self.connection.close()

    def _opened(self, without: frozenset[Path]) -> Pieces:
        """The pieces, and table and views of them."""
        for _ in range(3):
            pieces = find(self.connection, self.root, without)
            try:
                self._load(pieces)
                self._views(pieces)
                return pieces
            except need("duckdb").Error as error:
                more = frozenset(broken(self.connection, pieces)) - without
                if not more:
                    raise AnnulusError(f"{self.root}: cannot be read: {_first_line(error)}") from None
                without |= more
        raise AnnulusError(f"{self.root}: its surveys cannot be read, expected a catalogue that is not being changed")

    def _load(self, pieces: Pieces) -> None:
        """One row a survey; of one scan the one made last counts, the one added last among those."""
        self.connection.execute(
            f"CREATE OR REPLACE TABLE all_surveys AS SELECT *, nullif(last_value(survey) OVER (PARTITION BY scan ORDER "
            f"BY created_utc NULLS FIRST, added_utc, survey ROWS BETWEEN UNBOUNDED PRECEDING AND UNBOUNDED FOLLOWING), "
            f"survey) AS {SUPERSEDED.name} FROM ({pieces.relation('surveys')}) ORDER BY pipe, date, survey"
        )

    def _views(self, pieces: Pieces) -> None:
        run = self.connection.execute
        counts = f"FROM all_surveys WHERE {SUPERSEDED.name} IS NULL"
        run(f"CREATE OR REPLACE VIEW surveys AS SELECT {_names(SURVEYS)} {counts}")
        old = run(f"SELECT survey FROM all_surveys WHERE {SUPERSEDED.name} IS NOT NULL").fetchall()
        superseded = [str(row[0]) for row in old]
        for table in ("stations", "defects", "features"):
            run(f"CREATE OR REPLACE VIEW all_{table} AS {pieces.relation(table)}")
            whole = "features" if table == "features" else f"current_{table}" if table == "defects" else table
            run(f"CREATE OR REPLACE VIEW {whole} AS {pieces.relation(table, superseded)}")
        places = ", ".join(one.name for one in TABLES["defects"] if one.name != "sure")
        run(f"CREATE OR REPLACE VIEW defects AS SELECT {places} FROM current_defects WHERE sure")
        run(f"CREATE OR REPLACE VIEW undecided AS SELECT {places} FROM current_defects WHERE NOT sure")
        own = ", ".join(one.name for one in TABLES["features"] if one.kind != "measures")
        sizes = ", ".join(f"measures[{quoted(name)}] AS {name}" for name in JOINT_MEASURES)
        kinds = ", ".join(map(quoted, JOINT_KINDS))
        run(f"CREATE OR REPLACE VIEW joints AS SELECT {own}, {sizes} FROM features WHERE kind IN ({kinds})")

    def _lock(self) -> None:
        files = [quoted(str(path)) for table in TABLES for path in self.pieces.files(table)]
        for setting in (
            f"allowed_paths = [{', '.join(files)}]",
            "enable_external_access = false",
            "lock_configuration = true",
        ):
            self.connection.execute(f"SET {setting}")

    def ask(self, sql: str) -> Any:
        """DuckDB's result of one SELECT. AnnulusError for what is none, DuckDB's errors for what fails
        (`explained`). A file that turns out to be damaged is left out, and told in `damage`."""
        require_select(self.connection, sql)
        duckdb = need("duckdb")
        not_of_files = (
            duckdb.ParserException,
            duckdb.BinderException,
            duckdb.CatalogException,
            duckdb.ConversionException,
            duckdb.PermissionException,
            duckdb.OutOfMemoryException,
            duckdb.InterruptException,
        )
        try:
            return self.connection.execute(sql)
        except not_of_files:
            raise
        except duckdb.Error as error:
            if not self._mended():
                raise error from None
        return self.connection.execute(sql)

    def _mended(self) -> bool:
        """Whether there are damaged files after all; this catalogue is then opened anew without them."""
        with session(self.memory_mb) as other:
            found = broken(other, self.pieces)
        if not found:
            return False
        again = Engine(self.root, self.memory_mb, self.pieces.left_out | frozenset(found))
        self.connection.close()
        self.connection, self.pieces = again.connection, again.pieces
        by_path = {one.path: one for one in self.damage}
        for one in again.damage:
            why = found.get(one.path, one.why)
            by_path.setdefault(one.path, DamagedFile(one.path, why, one.lost))
        self.damage = list(by_path.values())
        return True

    def explained(self, error: Exception) -> str:
        """What one of DuckDB's errors says, one line."""
        duckdb = need("duckdb")
        if isinstance(error, duckdb.OutOfMemoryException | MemoryError):
            return too_much(self.memory_mb)
        if isinstance(error, duckdb.PermissionException):
            return "asks for a file, expected only the tables of the catalogue"
        return _first_line(error)


def too_much(memory_mb: int) -> str:
    return f"needs more than {memory_mb} MB of memory, expected one that asks for less"


def require_select(connection: Any, sql: str) -> None:
    """AnnulusError unless the text is one statement of SELECTs, whatever it has inside."""
    if not sql.strip() or len(sql) > SQL_MAX:
        raise AnnulusError(f"query: {len(sql)} characters of SQL, expected 1 to {SQL_MAX}")
    duckdb = need("duckdb")
    try:
        sql.encode()
        serialized = connection.execute("SELECT json_serialize_sql(?::VARCHAR)", [sql]).fetchone()[0]
        tree = json.loads(serialized)
    except (duckdb.Error, UnicodeEncodeError, RecursionError) as error:
        raise AnnulusError(f"query: {_first_line(error)}") from None
    if tree.get("error"):
        why = _first(str(tree.get("error_message")))
        if why.startswith("Only SELECT"):
            raise AnnulusError("query: would do something else than read, expected a SELECT")
        raise AnnulusError(f"query: {one_line(why)}")
    if len(tree["statements"]) != 1:
        raise AnnulusError(f"query: {len(tree['statements'])} statements, expected one SELECT")
    waiting: list[Any] = [tree["statements"]]
    while waiting:
        one = waiting.pop()
        if isinstance(one, Mapping):
            kind = str(one.get("type", ""))
            if "info_type" in one or (kind.endswith("_NODE") and kind not in _NODES):
                raise AnnulusError("query: would write, expected a SELECT that only reads")
            if kind == "TABLE_FUNCTION" and (name := _function(one)) not in _FUNCTIONS:
                raise AnnulusError(f"query: asks the function {name}, expected a table of the catalogue")
            waiting.extend(one.values())
        elif isinstance(one, list):
            waiting.extend(one)


def _function(table: Mapping[str, Any]) -> str:
    function = table.get("function")
    return one_line(str(function.get("function_name"))) if isinstance(function, Mapping) else "of no name"


def _names(columns: Sequence[Any]) -> str:
    return ", ".join(one.name for one in columns)


def _first_line(error: Exception) -> str:
    return one_line(_first(str(error))) or type(error).__name__


def _first(message: str) -> str:
    """Without the lines in which DuckDB points at the place."""
    return message.partition("\n\nLINE ")[0].strip().rstrip(".")
