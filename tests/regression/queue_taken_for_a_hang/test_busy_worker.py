"""A worker with two frames in hand was killed as hung because the second had waited for the first (b3c258a). Fails when
a worker's silence is counted from its oldest frame alone and not from its last answer."""

import sys
from pathlib import Path

import numpy as np
import zmq

from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.pool_events import Died, Done, PoolEvent
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared, WorkerKind, WorkerPool
from annulus_pipe.vocabulary import Label

SLEEPER = """
import sys, time
from annulus_pipe.stream.working import serve

class Sleeper:
    frame = staticmethod(lambda header, image, seconds: time.sleep(seconds))
    note = close = idle = staticmethod(lambda *_: None)

serve(sys.argv[-1], lambda setup: Sleeper())
"""


def test_a_frame_that_waited_behind_another_is_not_a_hang(tmp_path: Path) -> None:
    now, context, ring = [0.0], zmq.Context(), FrameRing(4, 1200)
    kind = WorkerKind("w", [sys.executable, "-c", SLEEPER], None, count=1, depth=2, hung_s=10.0)
    workers = WorkerPool(kind, Shared(ring, context, tmp_path), clock=lambda: now[0])
    seen: list[PoolEvent] = []

    def wait_for(what: type) -> None:
        while not any(isinstance(news, what) for news in seen):
            workers.results.poll(20)
            seen.extend(workers.poll())

    while not workers.ready:
        workers.results.poll(20)
        workers.poll()
    for index, seconds in enumerate((0, 1000)):
        place = ring.claim()
        assert place is not None
        ring.write(place, np.zeros((30, 40), np.uint8))
        header = FrameHeader(index, 0, 0, Label.PROJECTOR, "", None, None, None, 0.0, "mono8", 40, 30)  # type: ignore[arg-type]
        assert workers.offer(header, place, seconds)
        ring.release(place)
    now[0] = 9.0
    wait_for(Done)
    now[0] = 12.0  # of the second frame's age; it is 3 s in work
    assert workers.poll() == []
    now[0] = 20.0
    wait_for(Died)
    workers.stop(0.0)
    context.destroy(linger=0)
    ring.close()
