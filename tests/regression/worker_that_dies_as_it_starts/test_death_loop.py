"""A worker that died as it started was started again 50 times a second, as long as another one worked; spares once a
second for ever; and of two workers the one that was given up never came back, though it was announced. Fails when a
pool counts deaths since any frame came back, and when only a pool without any worker tries again."""

import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import zmq

from annulus_pipe.daemon import pools
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.pools import Pool
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import STARTS_MAX, Shared, WorkerKind
from annulus_pipe.vocabulary import Label

QUICK = """
import sys
from annulus_pipe.stream.working import serve

class Quick:
    frame = staticmethod(lambda header, image, extra: None)
    note = close = idle = staticmethod(lambda *_: None)

serve(sys.argv[-1], lambda setup: Quick())
"""
LOOP_S = 1.0  # at 50 starts a second it was 50 of them
FRAME_S = 0.03  # between two frames


class Told(Observer):
    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []

    def event(self, kind: str, text: str) -> None:
        self.events.append((kind, text))


class Quicks(Pool):
    def _done(self, header: FrameHeader, body: object) -> None:
        pass

    @property
    def spares(self) -> list[int]:
        return [worker.process.pid for worker in self._pool._workers.values() if worker.spare]


def test_one_that_dies_as_it_starts_is_given_up_told_once_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pools, "RETRY_S", 2.0 * LOOP_S)
    context, ring, told = zmq.Context(), FrameRing(4, 1200), Told()
    kind = WorkerKind("worker", [sys.executable, "-c", QUICK], None, count=2, depth=2, spares=1)
    pool = Quicks(kind, Shared(ring, context, tmp_path), Account(), told)
    end, due_s = time.monotonic() + 60.0, 0.0

    def turn() -> None:
        nonlocal due_s
        assert time.monotonic() < end, told.events
        pool.waitable.poll(20)
        pool.poll()
        if time.monotonic() > due_s and pool._pool.room and (place := ring.claim()) is not None:
            due_s = time.monotonic() + FRAME_S
            header = FrameHeader(0, None, 0, Label.LED, "", None, None, None, 0.0, "mono8", 40, 30)
            ring.write(place, np.zeros((30, 40), np.uint8))
            pool._pool.offer(header, place)
            ring.release(place)

    try:
        while not pool.ready:
            turn()
        works, victims = pool.pids[0], set[int]()
        until_s = time.monotonic() + LOOP_S
        while time.monotonic() < until_s:
            for pid in {*pool.pids, *pool.spares} - {works}:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                victims.add(pid)
            turn()
        assert len(victims) <= 2 * (STARTS_MAX + 1), "starts, spares with them"
        assert pool.pids == [works] and pool.numbers()["done"] > 0, "the other one works on"
        given_up = [text for _, text in told.events if "given up" in text]
        assert given_up == [f"worker ended: killed by SIGKILL; it is given up; tried again in {2.0 * LOOP_S:g} s"]
        while not any(kind == "worker_back" for kind, _ in told.events):
            turn()
        assert pool.ready and len(pool.pids) == 2
    finally:
        pool.stop(0.0)
        context.destroy(linger=0)
        ring.close()
