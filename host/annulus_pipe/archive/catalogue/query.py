"""Questions to a catalogue in SQL, each answered by a process of its own that may take so long and so much memory.

DuckDB looks at its interrupt and counts its memory between vectors: one value, `repeat('x', 2000000000)`, is one step
to it. So the process is killed when its time is over, and the system gives it no more memory than it may have
(asking.py). What it may read is bounded by engine.py.
"""

import contextlib
import json
import os
import signal
import struct
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from itertools import count
from pathlib import Path
from typing import IO, Any

import numpy as np

from annulus_pipe.archive.catalogue.engine import Engine, too_much
from annulus_pipe.archive.catalogue.pieces import MEMORY_MB, DamagedFile, Pieces
from annulus_pipe.archive.catalogue.store import require
from annulus_pipe.extras import need
from annulus_pipe.stream.orphan import child
from annulus_pipe.vocabulary import AnnulusError

SECONDS = 60.0
READY_S = 60.0  # for the process to begin and open the catalogue: 1 s for a season's; not the question's time
ASKING = "annulus_pipe.archive.catalogue.asking"
BLOCK_MAX = 64 << 20  # bytes of rows that come at once; one row has no more
READY, DAMAGE, REFUSED, BLOCK, END = b"R", b"D", b"E", b"B", b"Z"  # what a message of the process is
HEAD = struct.Struct("<cQ")  # kind, bytes that follow
_DAYS_MAX = (1 << 31) - 1  # of a date: DuckDB's infinity
_TICKS_MAX = (1 << 63) - 1  # .. and of a moment


class Catalogue:
    """A catalogue to be asked. `damage`: of its files, found so far.

    with open_catalogue(Path("archive")) as catalogue:
        with catalogue.asked("SELECT pipe, count(*) FROM surveys GROUP BY pipe") as answer:
            for row in answer.rows(): ...
    """

    def __init__(self, root: Path, memory_mb: int) -> None:
        self.root, self.memory_mb = root, memory_mb
        self._engine: Engine | None = None
        self._damage: dict[Path, DamagedFile] = {}

    @property
    def engine(self) -> Engine:
        """DuckDB in this process, for questions of our own: they are bounded by what they are."""
        if self._engine is None:
            self._engine = Engine(self.root, self.memory_mb, frozenset())
        return self._engine

    @property
    def connection(self) -> Any:
        return self.engine.connection

    @property
    def pieces(self) -> Pieces:
        return self.engine.pieces

    @property
    def damage(self) -> Sequence[DamagedFile]:
        own = () if self._engine is None else self._engine.damage
        return list({**{one.path: one for one in own}, **self._damage}.values())

    def close(self) -> None:
        if self._engine is not None:
            self._engine.close()

    @contextmanager
    def asked(self, sql: str, seconds: float = SECONDS) -> Iterator["QueryResult"]:
        """The answer to one SELECT, to be read within. AnnulusError, one line, for what is none, fails, or takes longer
        or more memory than it may. A file that turns out to be damaged is left out, and told in `damage`.

        seconds : from when the catalogue is open until the answer is read.
        """
        asking = _Asking(self.root, self.memory_mb, sql, seconds, self._damage)
        try:
            yield QueryResult(asking)
        finally:
            asking.close()


class _Asking:
    """The process that answers one question."""

    def __init__(self, root: Path, memory_mb: int, sql: str, seconds: float, damage: dict[Path, DamagedFile]) -> None:
        self._memory_mb, self._seconds, self._damage = memory_mb, seconds, damage
        need("duckdb")
        need("pyarrow")
        request = json.dumps({"root": str(root.absolute()), "memory_mb": memory_mb, "sql": sql, "seconds": seconds})
        # Memory is what is in use, not what allocators put aside for every thread.
        environment = os.environ | {"ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "2"}
        try:
            self._process = subprocess.Popen(
                [*child(ASKING), json.dumps({"parent": os.getpid()})],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment,
            )
        except OSError as error:
            raise AnnulusError(f"query: cannot be asked ({error.strerror})") from None
        self._late = threading.Event()
        self._timer = self._killed_in(READY_S)
        with contextlib.suppress(BrokenPipeError):
            assert self._process.stdin is not None
            with self._process.stdin as stdin:
                stdin.write(request.encode())
        try:
            kind, _ = self._message()
            assert kind == READY
            self._timer.cancel()
            self._timer = self._killed_in(seconds)
        except BaseException:
            self.close()
            raise

    def _killed_in(self, seconds: float) -> threading.Timer:
        def end() -> None:
            self._late.set()
            self._process.kill()

        timer = threading.Timer(seconds, end)
        timer.daemon = True
        timer.start()
        return timer

    def blocks(self) -> Iterator[bytes]:
        """Streams of Arrow, each whole; the first has the columns."""
        while (message := self._message())[0] == BLOCK:
            yield message[1]

    def _message(self) -> tuple[bytes, bytes]:
        """READY, BLOCK or END. AnnulusError where the answer is none."""
        assert self._process.stdout is not None
        while True:
            kind, content = _read(self._process.stdout)
            if kind == DAMAGE:
                for path, why, lost in json.loads(content):
                    self._damage[Path(path)] = DamagedFile(Path(path), why, lost)
            elif kind == REFUSED:
                raise AnnulusError(content.decode())
            elif kind:
                return kind, content
            else:
                raise AnnulusError(f"query: {self._why_gone()}")

    def _why_gone(self) -> str:
        code = self._process.wait()
        if self._late.is_set():
            return f"took longer than {self._seconds:g} s, expected one that asks for less"
        if code in (-signal.SIGKILL, -signal.SIGABRT, -signal.SIGSEGV, -signal.SIGBUS):
            return too_much(self._memory_mb)  # or DuckDB broke on it, which asking for less mends, too
        return f"no answer, its process ended with status {code}"

    def close(self) -> None:
        self._timer.cancel()
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


def _read(pipe: IO[bytes]) -> tuple[bytes, bytes]:
    """A message's kind and content; nothing where the process is gone."""
    head = pipe.read(HEAD.size)
    if len(head) < HEAD.size:
        return b"", b""
    kind, length = HEAD.unpack(head)
    content = pipe.read(min(length, 2 * BLOCK_MAX))
    return (kind, content) if len(content) == length else (b"", b"")


class QueryResult:
    """What a question gave: `columns`, their names, no two alike, Arrow's `schema`, and the rows, read once."""

    def __init__(self, asking: _Asking) -> None:
        self._batches = _batches(asking)
        first = next(self._batches)
        self.schema = first.schema
        self.columns: Sequence[str] = list(self.schema.names)

    def rows(self) -> Iterator[tuple[Any, ...]]:
        for batch in self._batches:
            yield from zip(*map(_values, batch.columns), strict=True)

    def batches(self) -> Iterator[Any]:
        """The rows as Arrow's record batches."""
        return self._batches


def _batches(asking: _Asking) -> Iterator[Any]:
    pyarrow = need("pyarrow")
    for block in asking.blocks():
        with pyarrow.ipc.open_stream(block) as stream:
            names = _apart(stream.schema.names)
            yield from (batch.rename_columns(names) for batch in stream)


def _apart(names: Sequence[str]) -> list[str]:
    """No two alike, whatever their case, as DuckDB names the columns of a table: a second "a" is "a_1"."""
    out: list[str] = []
    taken: set[str] = set()
    for name in names:
        fresh = next(one for i in count() if (one := f"{name}_{i}" if i else name).lower() not in taken)
        taken.add(fresh.lower())
        out.append(fresh)
    return out


def _values(column: Any) -> list[Any]:
    """As Python has them: maps as dictionaries, whole numbers of any size as int, spans as timedelta; moments that
    Python has none of (before our era, after 9999, infinity) as texts."""
    pyarrow = need("pyarrow")
    kind = column.type
    try:
        if pyarrow.types.is_interval(kind):
            return [None if one is None else _span(one) for one in column.to_pylist()]
        values = column.to_pylist(maps_as_pydicts="strict") if pyarrow.types.is_nested(kind) else column.to_pylist()
    except (OverflowError, ValueError):
        return [_value(pyarrow, one) for one in column]
    if pyarrow.types.is_decimal(kind) and kind.scale == 0:
        return [None if one is None else int(one) for one in values]
    return list(values)


def _span(one: Any) -> timedelta:
    return timedelta(30 * one[0] + one[1], one[2] / 1e9)


def _value(pyarrow: Any, one: Any) -> Any:
    """One of Arrow's scalars as Python's own value, or as text where Python has none for it."""
    if not one.is_valid:
        return None
    kinds = pyarrow.types
    if kinds.is_struct(one.type):
        return {name: _value(pyarrow, one[name]) for name in one}
    if kinds.is_map(one.type):
        return {str(_value(pyarrow, pair["key"])): _value(pyarrow, pair["value"]) for pair in one.values}
    if kinds.is_union(one.type):
        return _value(pyarrow, one.value)
    if kinds.is_nested(one.type):
        return [_value(pyarrow, item) for item in one.values]
    try:
        return _span(one.as_py()) if kinds.is_interval(one.type) else one.as_py()
    except (OverflowError, ValueError):
        if kinds.is_interval(one.type):
            return "{} months {} days {} ns".format(*one.as_py())
        is_date = kinds.is_date32(one.type)
        if (is_date or kinds.is_timestamp(one.type)) and abs(one.value) == (_DAYS_MAX if is_date else _TICKS_MAX):
            return "infinity" if one.value > 0 else "-infinity"  # as DuckDB writes it
        text = str(one.cast(pyarrow.string())).replace(" ", "T", 1)
        return str(np.datetime64(one.value, one.type.unit)) if text.startswith("<") else text  # beyond the year 32767


@contextmanager
def open_catalogue(root: Path, memory_mb: int = MEMORY_MB) -> Iterator[Catalogue]:
    """Raises AnnulusError where there is no catalogue, or one of a newer annulus."""
    catalogue = Catalogue(require(root), memory_mb)
    try:
        yield catalogue
    finally:
        catalogue.close()
