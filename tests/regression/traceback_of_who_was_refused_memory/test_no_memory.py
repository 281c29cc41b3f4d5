"""A process of the daemon that was refused memory said so in a traceback of 26 lines. Fails when a child's MemoryError
is the interpreter's to tell."""

import sys
import time
from pathlib import Path

import pytest
import zmq

from annulus_pipe.stream.orphan import child
from annulus_pipe.stream.pool_events import Died, PoolEvent
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared, WorkerKind, WorkerPool

HUNGRY = """
import sys
from annulus_pipe.stream.working import serve

class Hungry:
    frame = close = idle = staticmethod(lambda *_: None)

    def note(self, kind, body):
        raise MemoryError

serve(sys.argv[-1], lambda setup: Hungry())
"""


def test_who_is_refused_memory_ends_in_one_line_of_its_owners(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "hungry.py").write_text(HUNGRY)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (sockets := tmp_path / "sockets").mkdir()
    context, ring, seen, end = zmq.Context(), FrameRing(2, 1200), list[PoolEvent](), time.monotonic() + 60.0
    pool = WorkerPool(WorkerKind("worker", child("hungry"), None, 1, 1), Shared(ring, context, sockets))
    try:
        while not pool.ready:
            pool.results.poll(20)
            seen += pool.poll()
        pool.tell("anything", None)
        while not any(isinstance(one, Died) for one in seen):
            assert time.monotonic() < end
            pool.results.poll(20)
            seen += pool.poll()
    finally:
        pool.stop(0.0)
        context.destroy(linger=0)
        ring.close()
    assert [one.why for one in seen if isinstance(one, Died)] == ["no memory was left for it"]
    assert capfd.readouterr().err == ""
