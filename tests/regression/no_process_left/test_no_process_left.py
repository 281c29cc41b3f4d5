"""On a machine that had no descriptor or process left, the death of one worker or intake ended the daemon and its scan:
internal error, OSError: Too many open files. Fails when what cannot be started now is not tried again later."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import zmq

from annulus_pipe.daemon import camera_feed
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.camera_feed import CameraFeed
from annulus_pipe.daemon.camera_state import CameraState
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.stream.pool_events import Died, PoolEvent
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared, WorkerKind, WorkerPool

IDLE = """
import sys
from annulus_pipe.stream.working import serve

class Idle:
    frame = note = close = idle = staticmethod(lambda *_: None)

serve(sys.argv[-1], lambda setup: Idle())
"""


NO_DESCRIPTOR = """
import resource, sys, zmq
from pathlib import Path
from annulus_pipe.daemon.evidence import versions
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared, WorkerKind, WorkerPool

known = versions()
context, ring = zmq.Context(), FrameRing(2, 1200)
kind = WorkerKind("idle", [sys.executable, "-c", sys.argv[1]], None, count=1, depth=1)
pool = WorkerPool(kind, Shared(ring, context, Path(sys.argv[2])))
usual = resource.getrlimit(resource.RLIMIT_NOFILE)
resource.setrlimit(resource.RLIMIT_NOFILE, (3, usual[1]))
pool.results.poll(500)
assert versions() == known and pool.alive == 1
resource.setrlimit(resource.RLIMIT_NOFILE, usual)
while not pool.ready:
    pool.results.poll(20)
    pool.poll()
pool.stop(5.0)
ring.close()
"""


def refused(number: int) -> Any:
    def fail(*_: Any, **__: Any) -> Any:
        raise OSError(number, os.strerror(number)) if number != errno.ENOMEM else MemoryError

    return fail


@pytest.mark.parametrize("number", [errno.EMFILE, errno.EAGAIN, errno.ENOMEM])
def test_a_worker_that_cannot_be_started_now_is_started_later(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context, ring, seen = zmq.Context(), FrameRing(2, 1200), list[PoolEvent]()
    kind = WorkerKind("idle", [sys.executable, "-c", IDLE], None, count=1, depth=1)
    pool = WorkerPool(kind, Shared(ring, context, tmp_path))
    try:
        with monkeypatch.context() as patched:
            patched.setattr(subprocess, "Popen", refused(number))
            os.kill(pool.pids[0], signal.SIGKILL)
            while not any(isinstance(one, Died) for one in seen):
                pool.results.poll(20)
                seen += pool.poll()
        (died,) = [one for one in seen if isinstance(one, Died)]
        assert not died.replaced and died.why.startswith("cannot start ") and pool.alive == 0
        pool.revive()
        assert pool.alive == 1
    finally:
        pool.stop(0.0)
        context.destroy(linger=0)
        ring.close()


def test_a_worker_that_comes_up_where_no_descriptor_is_left_waits_for_one(tmp_path: Path) -> None:
    """libzmq ends the process that is connected to over ipc and has none left: workers were started, connected, and
    the daemon was gone with SIGABRT. Nor could it look up its own version for the next file of a recording."""
    owner = [sys.executable, "-c", NO_DESCRIPTOR, IDLE, str(tmp_path)]
    assert subprocess.run(owner, timeout=60).returncode == 0


def test_an_intake_that_cannot_be_started_now_is_a_camera_that_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    feed = CameraFeed(0, CameraConfig("remote", "@nobody"), Account(), Observer())
    try:
        feed._wanted = True
        with monkeypatch.context() as patched:
            patched.setattr(camera_feed, "_link", refused(errno.EMFILE))
            assert feed.pid is not None
            os.kill(feed.pid, signal.SIGKILL)
            for _ in range(3000):
                feed.poll()
                if "cannot start" in feed.trouble:
                    break
                signal.sigtimedwait([], 0.01)
        assert feed.state is CameraState.GONE and feed.trouble.endswith("Too many open files")
        assert feed._start_s is not None, "it is tried again"
    finally:
        feed.close()
