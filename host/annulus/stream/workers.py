"""Worker processes fed through a FrameRing. A frame handed out comes back as done, failed or lost, whoever is killed.

`WorkerPool` is the owner's side, `serve` the worker's. Each worker has its own PUSH socket, so the owner knows which
frames died with it; all answer into one PULL socket. Nothing here waits: `poll` reads what is there, `offer` says no
when everybody is busy.
"""

import contextlib
import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import msgpack
import zmq

from annulus import untrusted
from annulus.numeric.arrays import Image
from annulus.stream.frames import FrameHeader
from annulus.stream.ring import FrameRing, Overwritten, Place, RingView
from annulus.vocabulary import AnnulusError

MESSAGE_MAX = 1 << 26  # bytes; a profile is below 1 MB
STARTS_MAX = 3  # times in a row a worker may die without having done anything
HUNG_S = 20.0  # longer on one frame than this and the worker is replaced
START_S = 180.0  # compiling for the first time included
UNREADY_S = 1.0  # to leave, for one that was not ready yet
_PR_SET_PDEATHSIG = 1
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3

Socket = zmq.Socket[bytes]


@dataclass(frozen=True, slots=True)
class Ready:
    """A worker has prepared itself and takes frames."""

    worker: int


@dataclass(frozen=True, slots=True)
class Done:
    worker: int
    header: FrameHeader
    body: Any


@dataclass(frozen=True, slots=True)
class Failed:
    """The worker says it cannot do this frame; it lives on."""

    worker: int
    header: FrameHeader
    why: str


@dataclass(frozen=True, slots=True)
class FrameLost:
    """The worker died, or was killed because it hung, with this frame in its hands."""

    worker: int
    header: FrameHeader
    why: str


@dataclass(frozen=True, slots=True)
class Died:
    """A worker ended unasked. `replaced` is False when it said it cannot work, or when its kind dies too often."""

    worker: int
    why: str
    replaced: bool


@dataclass(frozen=True, slots=True)
class Report:
    """A worker's own words: what its job reported, or its last words (`final`)."""

    worker: int
    body: Any
    final: bool


@dataclass(frozen=True, slots=True)
class WorkerKind:
    """What the workers of a pool are: `command` + one JSON argument is run `count` times."""

    name: str
    command: Sequence[str]
    setup: Any  # plain types and bytes; each worker receives it first
    count: int
    depth: int  # frames at most that wait at one worker
    hung_s: float = HUNG_S


@dataclass(frozen=True, slots=True)
class Shared:
    """What the pools of one owner share. `folder` is private to this process and holds the sockets."""

    ring: FrameRing
    context: zmq.Context[Socket]
    folder: Path


PoolEvent = Ready | Done | Failed | FrameLost | Died | Report


@dataclass(slots=True)
class _InHand:
    header: FrameHeader
    place: Place
    since: float


@dataclass(slots=True)
class _Worker:
    number: int
    process: subprocess.Popen[bytes]
    tasks: Socket
    address: Path
    started: float
    answered: float = 0.0  # when it last gave a frame back
    ready: bool = False
    broken: str = ""  # what the user can mend
    in_hand: dict[int, _InHand] = field(default_factory=dict)  # by the stamp of its place: no two frames share one


class WorkerPool:
    """N workers of one kind. All methods belong to one thread, and that thread must outlive the workers: the kernel
    tells them (PR_SET_PDEATHSIG) to end when the thread that started them does.
    """

    def __init__(self, kind: WorkerKind, shared: Shared, clock: Callable[[], float] = time.monotonic) -> None:
        """Starts the workers; `poll` says when they are ready. Raises AnnulusError when the command cannot be run."""
        self.counts: Counter[str] = Counter()
        self._kind, self._ring, self._context, self._folder = kind, shared.ring, shared.context, shared.folder
        self._clock = clock
        self._numbers = 0
        self._barren = 0  # deaths since the last frame that came back
        self._workers: dict[int, _Worker] = {}
        self._results_path = shared.folder / f"{kind.name}-results"
        self.results = shared.context.socket(zmq.PULL)
        self.results.setsockopt(zmq.RCVHWM, 1000)
        self.results.setsockopt(zmq.MAXMSGSIZE, MESSAGE_MAX)
        self.results.bind(f"ipc://{self._results_path}")
        try:
            for _ in range(kind.count):
                self._start()
        except BaseException:
            self.stop(0.0)
            raise

    @property
    def ready(self) -> int:
        """Workers that take frames."""
        return sum(worker.ready for worker in self._workers.values())

    @property
    def alive(self) -> int:
        return len(self._workers)

    @property
    def in_hand(self) -> int:
        """Frames handed out and not yet back."""
        return sum(len(worker.in_hand) for worker in self._workers.values())

    @property
    def room(self) -> bool:
        """Whether some worker would take a frame now."""
        return any(w.ready and len(w.in_hand) < self._kind.depth for w in self._workers.values())

    @property
    def pids(self) -> list[int]:
        return [worker.process.pid for worker in self._workers.values()]

    def offer(self, header: FrameHeader, place: Place, extra: Any = None) -> bool:
        """Hand a frame to the least busy worker, which then holds its slot. False, and counted, when none has room."""
        free = [w for w in self._workers.values() if w.ready and len(w.in_hand) < self._kind.depth]
        if not free:
            self.counts["refused"] += 1
            return False
        worker = min(free, key=lambda w: len(w.in_hand))
        task = msgpack.packb([header.to_dict(), place.slot, place.stamp, extra])
        try:
            worker.tasks.send_multipart([b"frame", task], zmq.NOBLOCK)
        except zmq.Again:
            self.counts["refused"] += 1
            return False
        self._ring.hold(place)
        worker.in_hand[place.stamp] = _InHand(header, place, self._clock())
        self.counts["offered"] += 1
        return True

    def tell(self, kind: str, body: Any) -> None:
        """A note to every worker. Counted under `notes_dropped` when a worker's queue is full."""
        note = msgpack.packb([kind, body])
        for worker in self._workers.values():
            try:
                worker.tasks.send_multipart([b"note", note], zmq.NOBLOCK)
            except zmq.Again:
                self.counts["notes_dropped"] += 1

    def poll(self) -> list[PoolEvent]:
        """All that happened since the last call. Replaces the dead and the hung; never waits."""
        happened = self._receive()
        now = self._clock()
        for worker in list(self._workers.values()):
            code = worker.process.poll()
            oldest = min((task.since for task in worker.in_hand.values()), default=now)
            since = max(oldest, worker.answered)  # the oldest may have waited behind others that were done
            if code is None and now - since > self._kind.hung_s:
                why = f"hung for {now - since:.0f} s"
            elif code is None and not worker.ready and now - worker.started > START_S:
                why = f"not ready after {START_S:.0f} s"
            elif code is not None:
                why = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
            else:
                continue
            happened += self._receive()  # what it sent before it died still counts
            happened += self._bury(worker, why)
            self._barren += 1
            replace = not worker.broken and self._barren <= STARTS_MAX
            self.counts["died"] += 1
            happened.append(Died(worker.number, worker.broken or why, replace))
            if replace:
                self._start()
        return happened

    def stop(self, patience_s: float) -> list[PoolEvent]:
        """Ask every worker to finish what it has and leave; after `patience_s` kill. None is left when this returns."""
        happened: list[PoolEvent] = []
        for worker in self._workers.values():
            with contextlib.suppress(zmq.ZMQError):
                worker.tasks.send_multipart([b"stop", b""], zmq.NOBLOCK)
        begun = time.monotonic()  # real time whatever clock the tests use: processes are real
        while self._workers and (waited := time.monotonic() - begun) < patience_s:
            self.results.poll(20)
            happened += self._receive()
            if waited > UNREADY_S and not self.ready:
                break  # still compiling, and with nothing in hand
            for worker in [w for w in self._workers.values() if w.process.poll() is not None]:
                happened += self._receive()
                happened += self._bury(worker, "ended")
        for worker in list(self._workers.values()):
            self.counts["killed"] += 1
            happened += self._bury(worker, f"still busy {patience_s:.0f} s after being asked to stop")
        if not self.results.closed:
            self.results.close(0)
        self._results_path.unlink(missing_ok=True)
        return happened

    def _start(self) -> None:
        number, self._numbers = self._numbers, self._numbers + 1
        address = self._folder / f"{self._kind.name}-{number}"
        tasks = self._context.socket(zmq.PUSH)
        tasks.setsockopt(zmq.SNDHWM, 1000)
        tasks.setsockopt(zmq.LINGER, 0)
        tasks.connect(f"ipc://{address}")  # the worker binds: a connecting PUSH queues at once, a bound one does not
        link = {
            "worker": number, "parent": os.getpid(), "ring_fd": self._ring.fd, "frame_bytes": self._ring.frame_bytes,
            "tasks": f"ipc://{address}", "results": f"ipc://{self._results_path}",
        }  # fmt: skip
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        try:
            process = subprocess.Popen(
                [*self._kind.command, json.dumps(link)],
                stdin=subprocess.DEVNULL,
                pass_fds=(self._ring.fd,),
                process_group=0,  # the terminal's Ctrl-C is for the owner, who ends the workers in order
                env=os.environ | one_thread,
            )
        except OSError as error:
            tasks.close(0)
            address.unlink(missing_ok=True)
            raise AnnulusError(f"cannot start {self._kind.command[0]}: {error.strerror}") from None
        self._workers[number] = _Worker(number, process, tasks, address, self._clock())
        tasks.send_multipart([b"setup", msgpack.packb(self._kind.setup)], zmq.NOBLOCK)

    def _receive(self) -> list[PoolEvent]:
        happened: list[PoolEvent] = []
        while not self.results.closed and self.results.poll(0):
            try:
                number, kind, body = untrusted.unpack(self.results.recv(), MESSAGE_MAX)
            except ValueError:
                self.counts["malformed"] += 1
                continue
            worker = self._workers.get(number)
            if worker is None:
                self.counts["late"] += 1  # from one already buried; its frames were reported lost
            elif kind == "ready":
                worker.ready = True
                happened.append(Ready(number))
            elif kind in ("done", "failed"):
                task = worker.in_hand.pop(body[0], None)
                if task is None:
                    self.counts["late"] += 1
                    continue
                self._ring.release(task.place)
                self.counts[kind] += 1
                self._barren = 0
                worker.answered = self._clock()
                happened.append(
                    Done(number, task.header, body[1]) if kind == "done" else Failed(number, task.header, str(body[1]))
                )
            elif kind == "broken":
                worker.broken = str(body)
            elif kind in ("report", "bye"):
                happened.append(Report(number, body, kind == "bye"))
            else:
                self.counts["malformed"] += 1
        return happened

    def _bury(self, worker: _Worker, why: str) -> list[PoolEvent]:
        if worker.process.poll() is None:
            worker.process.kill()
        worker.process.wait()
        worker.tasks.close(0)
        worker.address.unlink(missing_ok=True)
        del self._workers[worker.number]
        for task in worker.in_hand.values():
            self._ring.release(task.place)
        self.counts["lost"] += len(worker.in_hand)
        return [FrameLost(worker.number, task.header, why) for task in worker.in_hand.values()]


class Job(Protocol):
    """What a worker does. Exceptions in `frame` cost that frame only."""

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        """Plain types and bytes, sent back. `image` is shared memory: valid during the call, read-only."""

    def note(self, kind: str, body: Any) -> None:
        """Something every worker of the kind is told."""

    def idle(self) -> Any:
        """Called at least every half second. Whatever is not None is sent as a report."""

    def close(self) -> Any:
        """Last words; sent back."""


def serve(argument: str, prepare: Callable[[Any], Job]) -> None:
    """Run one worker: `argument` is what WorkerPool put on the command line, `prepare` makes the job from the setup."""
    link: Mapping[str, Any] = json.loads(argument)
    end_with_parent(link["parent"])
    keep_freed_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # as an exception, so that the job is closed
    ring = RingView(link["ring_fd"], link["frame_bytes"])
    context: zmq.Context[Socket] = zmq.Context()
    tasks, results = context.socket(zmq.PULL), context.socket(zmq.PUSH)
    tasks.setsockopt(zmq.RCVHWM, 1)
    results.setsockopt(zmq.LINGER, 2000)
    tasks.bind(link["tasks"])
    results.connect(link["results"])

    def answer(kind: str, body: Any) -> None:
        results.send(msgpack.packb([link["worker"], kind, body]))

    job: Job | None = None
    try:
        while True:
            if not tasks.poll(500):
                if job is not None and (report := job.idle()) is not None:
                    answer("report", report)
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
                answer("ready", None)
            elif job is not None and kind == b"note":
                job.note(*body)
            elif job is not None and kind == b"frame":
                _one_frame(job, ring, body, answer)
                if (report := job.idle()) is not None:
                    answer("report", report)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        answer("bye", None if job is None else job.close())
        results.close()
        context.destroy(linger=2000)


def _one_frame(job: Job, ring: RingView, body: Any, answer: Callable[[str, Any], None]) -> None:
    raw, slot, stamp, extra = body
    try:
        header = FrameHeader.from_dict(raw)
        with ring.frame(header, Place(slot, stamp)) as image:
            result = job.frame(header, image, extra)
            del image
    except Overwritten as error:
        answer("failed", [stamp, str(error)])
    except Exception as error:  # a frame the method cannot take must not cost the worker
        answer("failed", [stamp, f"{type(error).__name__}: {error}"])
    else:
        answer("done", [stamp, result])


def end_with_parent(parent: int) -> None:
    """Have the kernel send SIGTERM when the parent is gone, even by kill -9."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:  # it died before we asked
        sys.exit(1)


def keep_freed_memory() -> None:
    """Have glibc keep the megabytes of one frame for the next, instead of having the kernel zero new pages each time.

    Writing a 2 MB frame to a recording takes 3.5 ms so, 9.2 ms otherwise. Does nothing under another libc.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        for option, value in ((_M_MMAP_THRESHOLD, 32 << 20), (_M_TRIM_THRESHOLD, 512 << 20), (_M_TOP_PAD, 16 << 20)):
            libc.mallopt(option, value)
