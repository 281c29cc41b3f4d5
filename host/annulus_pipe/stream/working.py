"""The worker's side of a WorkerPool: one process that takes frames from the ring and answers for each.

workers.py imports it not, and it not workers.py: what runs in a worker should be up quickly.
"""

import ctypes
import gc
import json
import shutil
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import msgpack
import zmq

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.orphan import end_with_parent, is_dead
from annulus_pipe.stream.ring import Overwritten, RingSlot, RingView
from annulus_pipe.vocabulary import AnnulusError

REST_MS = 500
_ENDS = (signal.SIGTERM, signal.SIGHUP)  # the kernel hangs up on stopped ones whose owner is gone
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3

Socket = zmq.Socket[bytes]


class WorkerJob(Protocol):
    """What a worker does. Exceptions in `frame` cost that frame only."""

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        """Plain types and bytes, sent back. `image` is shared memory: valid during the call, read-only."""

    def note(self, kind: str, body: Any) -> None:
        """Something every worker of the kind is told."""

    def idle(self) -> Any:
        """Called after each frame, and every `rest_ms`, frames or none. Whatever is not None is sent as a report."""

    def close(self) -> Any:
        """Last words; sent back."""


@runtime_checkable
class FlashJob(WorkerJob, Protocol):
    """A job that takes frames of several cameras at once."""

    def flash(self, frames: Sequence[tuple[FrameHeader, Image]], extra: Any) -> Any:
        """As `frame`, for all the frames of one flash that are in one task."""


def serve(argument: str, prepare: Callable[[Any], WorkerJob], rest_ms: int = REST_MS) -> None:
    """Run one worker: `argument` is what WorkerPool put on the command line, `prepare` makes the job from the setup."""
    link: Mapping[str, Any] = json.loads(argument)
    end_with_parent(link["parent"], signal.SIGKILL)  # until there is a job to close
    keep_freed_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in _ENDS:
        signal.signal(number, _end)
    ring = RingView(link["ring_fd"], link["frame_bytes"])
    context: zmq.Context[Socket] = zmq.Context()
    tasks, results = context.socket(zmq.PULL), context.socket(zmq.PUSH)
    tasks.setsockopt(zmq.RCVHWM, 1)
    results.setsockopt(zmq.LINGER, 2000)
    tasks.bind(link["tasks"])
    results.bind(link["results"])

    def answer(kind: str, body: Any) -> None:
        results.send(msgpack.packb([link["worker"], kind, body]))

    job: WorkerJob | None = None
    idle_by = 0.0
    leave_uncollected()
    answer("warm", None)
    try:
        while True:
            come = tasks.poll(rest_ms)
            now = time.monotonic()
            if job is not None and (not come or now >= idle_by):
                idle_by = now + rest_ms / 1e3
                if (report := job.idle()) is not None:
                    answer("report", report)
            if not come:
                continue
            kind, payload = tasks.recv_multipart()
            if kind == b"stop":
                break
            body = msgpack.unpackb(payload)
            if kind == b"setup":
                try:
                    job = prepare(body)
                except AnnulusError as error:
                    answer("broken", str(error))
                    break
                end_with_parent(link["parent"])
                answer("ready", None)
            elif job is not None and kind == b"note":
                job.note(*body)
            elif job is not None and kind == b"frame":
                _one_frame(job, ring, body, answer)
                if (report := job.idle()) is not None:
                    answer("report", report)
    finally:
        _ignore_ends()
        last = None if job is None else job.close()
        alone = is_dead(link["parent"])  # it was killed: nobody reads the answers, or removes the sockets
        if not alone:
            answer("bye", last)
        results.close(0 if alone else 2000)
        context.destroy(linger=0 if alone else 2000)
        if alone:
            shutil.rmtree(Path(link["results"].removeprefix("ipc://")).parent, ignore_errors=True)


def _one_frame(job: WorkerJob, ring: RingView, body: Any, answer: Callable[[str, Any], None]) -> None:
    raw, slot, stamp, extra, *beside = body
    try:
        header = FrameHeader.from_dict(raw)
        with ExitStack() as held:
            image = held.enter_context(ring.frame(header, RingSlot(slot, stamp)))
            frames = [(header, image)]
            for other, its_slot, its_stamp in beside:
                its = FrameHeader.from_dict(other)
                frames.append((its, held.enter_context(ring.frame(its, RingSlot(its_slot, its_stamp)))))
            if isinstance(job, FlashJob):
                result = job.flash(frames, extra)
            elif not beside:
                result = job.frame(header, image, extra)
            else:
                raise ValueError(f"{len(frames)} frames at once, for a job that takes one")
            del image, frames
    except Overwritten as error:
        answer("failed", [stamp, str(error)])
    except Exception as error:  # a frame the method cannot take must not cost the worker
        answer("failed", [stamp, f"{type(error).__name__}: {error}"])
    else:
        answer("done", [stamp, result])


def _end(*_: object) -> None:
    """As an exception, so that the job is closed; once, so that it is."""
    _ignore_ends()
    sys.exit(0)


def _ignore_ends() -> None:
    for number in _ENDS:
        signal.signal(number, signal.SIG_IGN)


def leave_uncollected() -> None:
    """What there is now, all modules above all, is never looked through for garbage again: that would stop the process
    for 40 ms, at any moment.
    """
    gc.collect()
    gc.freeze()


def keep_freed_memory() -> None:
    """Have glibc keep the megabytes of one frame for the next, instead of having the kernel zero new pages each time.

    Writing a 2 MB frame to a recording takes 3.5 ms so, 9.2 ms otherwise. Does nothing under another libc.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        for option, value in ((_M_MMAP_THRESHOLD, 32 << 20), (_M_TRIM_THRESHOLD, 512 << 20), (_M_TOP_PAD, 16 << 20)):
            libc.mallopt(option, value)
