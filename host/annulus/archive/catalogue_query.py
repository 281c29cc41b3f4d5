"""Questions to a catalogue in SQL: DuckDB over its files, which reads them and can do nothing else.

Three walls: a question is one statement whose parsed tree has only SELECTs in it (DuckDB runs a COPY inside a WITH, and
a function `query` runs any text), the engine may open only the catalogue's own files, and its configuration is locked.
Memory and time are bounded; nothing is spilled to disk.
"""

import json
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from annulus.archive.catalogue_columns import JOINT_KINDS, JOINT_MEASURES, SUPERSEDED, SURVEYS, TABLES
from annulus.archive.catalogue_pieces import MEMORY_MB, Damage, Pieces, broken, find, quoted, session
from annulus.archive.catalogue_store import require
from annulus.extras import need
from annulus.untrusted import one_line
from annulus.vocabulary import AnnulusError

SQL_MAX = 100_000  # characters
SECONDS = 60.0
ROWS_AT_ONCE = 10_000
_NODES = {"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"}
_FUNCTIONS = {"range", "generate_series", "unnest", "repeat"}  # in place of a table; of the rest some read files


class Catalogue:
    """A catalogue opened to be asked. `damage`: of its files, found so far.

    with open_catalogue(Path("archive")) as catalogue:
        with catalogue.asked("SELECT pipe, count(*) FROM surveys GROUP BY pipe") as answer:
            for row in answer.rows(): ...
    """

    def __init__(self, root: Path, memory_mb: int, without: frozenset[Path]) -> None:
        self.root, self.memory_mb = root, memory_mb
        self.connection = session(memory_mb)
        self.pieces = self._opened(without)
        self.damage: Sequence[Damage] = self.pieces.damage
        self._lock()

    def close(self) -> None:
        self.connection.close()

    def __enter__(self) -> "Catalogue":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

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
                    raise AnnulusError(f"{self.root}: cannot be read: {_said(error)}") from None
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
            f"allowed_paths = [{', '.join(files)}]", "enable_external_access = false", "lock_configuration = true",
        ):  # fmt: skip
            self.connection.execute(f"SET {setting}")

    @contextmanager
    def asked(self, sql: str, seconds: float = SECONDS) -> Iterator["Answer"]:
        """The answer to one SELECT, to be read within. AnnulusError, one line, for what is none, fails, or takes longer
        or more memory than it may. A file that turns out to be damaged is left out, and told in `damage`."""
        require_select(self.connection, sql)
        late = threading.Event()

        def end() -> None:
            late.set()
            self.connection.interrupt()

        timer = threading.Timer(seconds, end)
        timer.daemon = True
        timer.start()
        try:
            yield self._answer(sql)
        except need("duckdb").Error as error:
            if late.is_set():
                raise AnnulusError(f"query: took longer than {seconds:g} s, expected one that asks for less") from None
            raise AnnulusError(f"query: {self._told(error)}") from None
        finally:
            timer.cancel()

    def _answer(self, sql: str) -> "Answer":
        duckdb = need("duckdb")
        not_of_files = (
            duckdb.ParserException, duckdb.BinderException, duckdb.CatalogException, duckdb.ConversionException,
            duckdb.PermissionException, duckdb.OutOfMemoryException, duckdb.InterruptException,
        )  # fmt: skip
        try:
            return Answer(self.connection.execute(sql))
        except not_of_files:
            raise
        except duckdb.Error as error:
            if not self._mended():
                raise error from None
        return Answer(self.connection.execute(sql))

    def _mended(self) -> bool:
        """Whether there are damaged files after all; this catalogue is then opened anew without them."""
        with session(self.memory_mb) as other:
            found = broken(other, self.pieces)
        if not found:
            return False
        again = Catalogue(self.root, self.memory_mb, self.pieces.left_out | frozenset(found))
        self.connection.close()
        self.connection, self.pieces = again.connection, again.pieces
        told = {one.path: one for one in self.damage}
        for one in again.damage:
            why = found.get(one.path, one.why)
            told.setdefault(one.path, Damage(one.path, why, one.lost))
        self.damage = list(told.values())
        return True

    def _told(self, error: Exception) -> str:
        duckdb = need("duckdb")
        if isinstance(error, duckdb.OutOfMemoryException):
            return f"needs more than {self.memory_mb} MB of memory, expected one that asks for less"
        if isinstance(error, duckdb.PermissionException):
            return "asks for a file, expected only the tables of the catalogue"
        return _said(error)


class Answer:
    """What a question gave: `columns`, their names, and the rows, read once, a few thousand at a time."""

    def __init__(self, result: Any) -> None:
        self.result = result
        self.columns: Sequence[str] = [str(one[0]) for one in result.description]

    def rows(self) -> Iterator[tuple[Any, ...]]:
        while some := self.result.fetchmany(ROWS_AT_ONCE):
            yield from some

    def batches(self) -> Any:
        """The rows as Arrow's reader of record batches."""
        named = "to_arrow_reader" if hasattr(self.result, "to_arrow_reader") else "fetch_record_batch"  # DuckDB 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that rows are copied once more
            return getattr(self.result, named)(ROWS_AT_ONCE)


@contextmanager
def open_catalogue(root: Path, memory_mb: int = MEMORY_MB) -> Iterator[Catalogue]:
    """Raises AnnulusError where there is no catalogue, or one of a newer annulus."""
    catalogue = Catalogue(require(root), memory_mb, frozenset())
    try:
        yield catalogue
    finally:
        catalogue.close()


def require_select(connection: Any, sql: str) -> None:
    """AnnulusError unless the text is one statement of SELECTs, whatever it has inside."""
    if not sql.strip() or len(sql) > SQL_MAX:
        raise AnnulusError(f"query: {len(sql)} characters of SQL, expected 1 to {SQL_MAX}")
    duckdb = need("duckdb")
    try:
        sql.encode()
        told = connection.execute("SELECT json_serialize_sql(?::VARCHAR)", [sql]).fetchone()[0]
        tree = json.loads(told)
    except (duckdb.Error, UnicodeEncodeError, RecursionError) as error:
        raise AnnulusError(f"query: {_said(error)}") from None
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


def _said(error: Exception) -> str:
    return one_line(_first(str(error))) or type(error).__name__


def _first(message: str) -> str:
    """Without the lines in which DuckDB points at the place."""
    return message.partition("\n\nLINE ")[0].strip().rstrip(".")
