"""The process that answers one question to a catalogue. Run as `python -m annulus_pipe.archive.catalogue.asking`.

A question comes as JSON on stdin; what goes to stdout is said in query.py. Of memory it gets what the
question may use and a quarter more, over what it has once the catalogue is open (RLIMIT_DATA: what is written to, not
what is put aside). It also ends by itself, should nobody be left to end it.
"""

import io
import json
import os
import resource
import signal
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from annulus_pipe.archive.catalogue.engine import Engine
from annulus_pipe.archive.catalogue.query import BLOCK, BLOCK_MAX, DAMAGE, END, HEAD, READY, REFUSED
from annulus_pipe.extras import need
from annulus_pipe.vocabulary import AnnulusError

ROWS_AT_ONCE = 10_000
OVER = (
    1.25  # times the memory that the question may use: what DuckDB does not count. It was 1.1 in a season's questions
)
OVER_MB = 32  # .. and the stacks of its threads, rows on their way out
LEFT_ALONE_S = 5.0  # after its time is over


def main() -> None:
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries may print
    asked = json.load(sys.stdin)
    try:
        _answer(asked, out)
    except BrokenPipeError:
        os._exit(1)
    out.flush()
    os._exit(0)  # DuckDB takes its time to let go of what nobody reads


def _answer(asked: Any, out: IO[bytes]) -> None:
    engine = None
    duckdb = need("duckdb")
    try:
        engine = Engine(Path(asked["root"]), asked["memory_mb"], frozenset())
        _bound_memory(asked["memory_mb"])
        _send(out, READY)
        signal.setitimer(signal.ITIMER_REAL, asked["seconds"] + LEFT_ALONE_S)  # SIGALRM ends it, whatever it is at
        result = engine.ask(asked["sql"])
        _tell_damage(engine, out)
        for block in _blocks(result):
            _send(out, BLOCK, block)
        _send(out, END)
    except AnnulusError as error:
        _refuse(out, str(error), engine)
    except (duckdb.Error, MemoryError, ArithmeticError, ValueError, NotImplementedError, OSError) as error:
        if isinstance(error, BrokenPipeError) or engine is None:
            raise
        _refuse(out, f"query: {engine.explained(error)}", engine)


def _bound_memory(memory_mb: int) -> None:
    own = next(line.split() for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmData"))
    allowed = int(own[1]) * 1024 + int((memory_mb * OVER + OVER_MB) * (1 << 20))
    resource.setrlimit(resource.RLIMIT_DATA, (allowed, allowed))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _blocks(result: Any) -> Iterator[bytes]:
    """The rows as whole streams of Arrow; the first has no rows. ValueError for a row that is too large."""
    pyarrow = need("pyarrow")
    named = "to_arrow_reader" if hasattr(result, "to_arrow_reader") else "fetch_record_batch"  # DuckDB 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that rows are copied once more
        reader = getattr(result, named)(ROWS_AT_ONCE)
    yield _stream(
        pyarrow, reader.schema.empty_table().to_batches() or [pyarrow.RecordBatch.from_pylist([], schema=reader.schema)]
    )
    for batch in reader:
        waiting = [batch]
        while waiting:
            one = waiting.pop()
            if one.nbytes <= BLOCK_MAX:
                yield _stream(pyarrow, [one])
            elif one.num_rows < 2:
                raise ValueError(f"a row of {one.nbytes} bytes, expected at most {BLOCK_MAX}")
            else:
                half = one.num_rows // 2
                waiting += [one.slice(half), one.slice(0, half)]


def _stream(pyarrow: Any, batches: list[Any]) -> bytes:
    kept = io.BytesIO()
    with pyarrow.ipc.new_stream(kept, batches[0].schema) as stream:
        for one in batches:
            stream.write_batch(one)
    return kept.getvalue()


def _send(out: IO[bytes], kind: bytes, content: bytes = b"") -> None:
    out.write(HEAD.pack(kind, len(content)))
    out.write(content)
    out.flush()


def _refuse(out: IO[bytes], line: str, engine: Engine | None) -> None:
    if engine is not None:
        _tell_damage(engine, out)
    _send(out, REFUSED, line.encode("utf-8", "backslashreplace"))


def _tell_damage(engine: Engine, out: IO[bytes]) -> None:
    _send(out, DAMAGE, json.dumps([[str(one.path), one.why, one.lost] for one in engine.damage]).encode())


if __name__ == "__main__":
    main()
