"""Worker processes fed through a FrameRing. A frame handed out comes back as done, failed or lost, whoever is killed.

`WorkerPool` is the owner's side, working.py the worker's. Each worker has its own PUSH socket, so the owner knows which
frames died with it; all answer into one PULL socket. Nothing here waits: `poll` reads what is there, `offer` says no
when everybody is busy.

A worker that died, is stopped, or takes far longer over a frame than frames usually take is killed and replaced: by a
spare, where its kind has any, which has done all but what its setup asks for, or that too where its kind is `eager`.

A start costs seconds of processor, so they do not go on for ever: a worker that is never up, dies within YOUNG_S of it,
or over its first frame, died in vain. Who replaces it carries the count, whatever the others do meanwhile; after
STARTS_MAX nobody does until the owner asks (`revive`). Spares that die in vain are started ever more rarely.
"""

import contextlib
import json
import os
import signal
import subprocess
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import msgpack
import zmq

from annulus_pipe import untrusted
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.orphan import NO_MEMORY
from annulus_pipe.stream.pool_events import Died, Done, FrameFailed, FrameLost, PoolEvent, Ready, Report
from annulus_pipe.stream.ring import FrameRing, RingSlot
from annulus_pipe.vocabulary import AnnulusError

MESSAGE_MAX = 1 << 26  # bytes; a profile is below 1 MB
STARTS_MAX = 3  # times in a row a worker may die in vain and be replaced
YOUNG_S = 1.0  # after it was up a worker's death is not in vain; a blow every second is still replaced (bench kills)
HUNG_S = 20.0  # longer on one frame than this and the worker is replaced; also while it waits for a disk
HUNG_TIMES = 20.0  # as long as frames usually take, likewise, ..
HUNG_LEAST_S = 1.0  # .. but not sooner than this: a busy machine is no hang
USUAL_FRAMES = 31  # whose median is what frames usually take
STOPPED_S = 0.25  # between two looks; found stopped twice, a worker is replaced
START_S = 180.0  # of a machine that is busy, and slow to import
WARM_START_S = 5.0  # for a spare that is called up: it has only its setup to do
NOT_HUNG = ("R", "D")  # not let run, or waiting for a disk: the next one would be no better off
LOOK_S = 0.02  # between two looks at who is still there
SPARE_S, SPARE_MOST_S = 1.0, 60.0  # between two starts of spares; twice as long for each that died in vain
KILL_S = 2.0  # the kernel has for ending a killed process
UNREADY_S = 1.0  # to leave, for one that was not ready yet

Socket = zmq.Socket[bytes]


@dataclass(frozen=True, slots=True)
class WorkerKind:
    """What the workers of a pool are: `command` + one JSON argument is run `count` times."""

    name: str
    command: Sequence[str]
    setup: Any  # plain types and bytes; each worker receives it first
    count: int
    depth: int  # frames at most that one worker holds: its share of the ring
    hung_s: float = HUNG_S
    spares: int = 0  # kept beside them, ..
    eager: bool = False  # .. with their setup done; otherwise it is done when they are called up


@dataclass(frozen=True, slots=True)
class Shared:
    """What the pools of one owner share. `folder` is private to this process and holds the sockets."""

    ring: FrameRing
    context: zmq.Context[Socket]
    folder: Path


@dataclass(slots=True)
class _InHand:
    header: FrameHeader
    places: tuple[RingSlot, ...]
    since: float


@dataclass(slots=True)
class _Worker:
    number: int
    process: subprocess.Popen[bytes]
    tasks: Socket
    address: Path
    started: float
    in_vain: int = 0  # who had its place before it and died in vain, in a row
    up: float | None = None  # since when it takes frames, or could be called up
    answered: float = 0.0  # when it last gave a frame back
    waited: float = float("-inf")  # when it was last seen waiting for a disk
    start_s: float = START_S  # until it must be ready
    spare: bool = False
    warm: bool = False  # it is up: all but its setup is done
    set_up: bool = False  # it was sent its setup
    ready: bool = False
    stopped: bool = False  # when last looked at
    looked: float = 0.0
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
        self._next_spare, self._spares_in_vain = 0.0, 0
        self._looked = -LOOK_S, -LOOK_S  # when, by the system's clock and ours
        self._took_s: deque[float] = deque(maxlen=USUAL_FRAMES)  # over the last frames
        self._dying: list[subprocess.Popen[bytes]] = []  # killed, and not gone yet: a disk may hold them
        self._workers: dict[int, _Worker] = {}
        self._called: list[PoolEvent] = []  # spares that were ready when they were called up
        self.results = shared.context.socket(zmq.PULL)
        self.results.setsockopt(zmq.RCVHWM, 1000)
        self.results.setsockopt(zmq.MAXMSGSIZE, MESSAGE_MAX)
        try:
            for _ in range(kind.count):
                self._start()
        except BaseException:
            self.stop(0.0)
            raise

    @property
    def ready(self) -> int:
        """Workers that take frames."""
        return sum(worker.ready for worker in self._active)

    @property
    def alive(self) -> int:
        """Workers, without spares."""
        return len(self._active)

    @property
    def settled(self) -> bool:
        """Whether as many as there should be take frames, and have for a while."""
        return sum(w.up is not None and self._clock() - w.up >= YOUNG_S for w in self._active) == self._kind.count

    @property
    def in_hand(self) -> int:
        """Frames handed out and not yet back."""
        return sum(len(worker.in_hand) for worker in self._active)

    @property
    def room(self) -> bool:
        """Whether some worker would take a frame now."""
        return any(w.ready and len(w.in_hand) < self._kind.depth for w in self._active)

    @property
    def pids(self) -> list[int]:
        """Of the workers, without spares."""
        return [worker.process.pid for worker in self._active]

    @property
    def spare_pids(self) -> list[int]:
        """Of spares that are up."""
        return [worker.process.pid for worker in self._workers.values() if worker.spare and self._is_up(worker)]

    @property
    def hung_s(self) -> float:
        """A worker that takes longer than this over a frame is replaced."""
        return min(self._kind.hung_s, max(HUNG_LEAST_S, HUNG_TIMES * median(self._took_s or [self._kind.hung_s])))

    @property
    def _active(self) -> list[_Worker]:
        return [worker for worker in self._workers.values() if not worker.spare]

    def offer(
        self,
        header: FrameHeader,
        place: RingSlot,
        extra: Any = None,
        beside: Sequence[tuple[FrameHeader, RingSlot]] = (),
    ) -> bool:
        """Hand a frame to the least busy worker, which then holds its slot. False, and counted, when none has room.

        beside : frames that go with it, in the same task; their slots are held too. What comes back is the first one's.
        """
        free = [w for w in self._active if w.ready and len(w.in_hand) < self._kind.depth]
        if not free:
            self.counts["refused"] += 1
            return False
        worker = min(free, key=lambda w: len(w.in_hand))
        others = [[other.to_dict(), at.slot, at.stamp] for other, at in beside]
        task = msgpack.packb([header.to_dict(), place.slot, place.stamp, extra, *others])
        try:
            worker.tasks.send_multipart([b"frame", task], zmq.NOBLOCK)
        except zmq.Again:
            self.counts["refused"] += 1
            return False
        places = (place, *(at for _, at in beside))
        for one in places:
            self._ring.hold(one)
        worker.in_hand[place.stamp] = _InHand(header, places, self._clock())
        self.counts["offered"] += 1
        return True

    def tell(self, kind: str, body: Any) -> None:
        """A note to every worker. Counted under `notes_dropped` when a worker's queue is full."""
        note = msgpack.packb([kind, body])
        for worker in self._active:
            try:
                worker.tasks.send_multipart([b"note", note], zmq.NOBLOCK)
            except zmq.Again:
                self.counts["notes_dropped"] += 1

    def poll(self) -> list[PoolEvent]:
        """All that happened since the last call. Replaces the dead and the hung; never waits."""
        happened = self._receive()
        now, began = self._clock(), time.monotonic()  # real time whatever clock the tests use: processes are real
        if began - self._looked[0] < LOOK_S and now - self._looked[1] < LOOK_S:
            return happened
        self._looked = began, now
        for worker in list(self._workers.values()):
            why = self._failing(worker, now)
            if not why:
                continue
            happened += self._receive()  # what it sent before it died still counts
            in_vain = worker.in_vain + 1 if _died_in_vain(worker, now) else 0
            happened += self._bury(worker, why)
            if worker.spare:
                self.counts["spares_died"] += 1
                self._spares_in_vain = self._spares_in_vain + 1 if in_vain else 0
                if self._spares_in_vain == STARTS_MAX + 1:
                    happened.append(Died(worker.number, worker.broken or why, False, spare=True))
                continue
            replace = not worker.broken and in_vain <= STARTS_MAX
            self.counts["died"] += 1
            try:
                if replace:
                    self._start(in_vain)
            except AnnulusError as error:  # a machine that has no process or descriptor left may have one later
                why, replace = str(error), False
            happened.append(Died(worker.number, worker.broken or why, replace))
        happened += self._called
        self._called = []
        self._keep_spares(now)
        self._dying = [process for process in self._dying if process.poll() is None]
        return happened

    def revive(self) -> None:
        """Start those again that were not replaced. Who dies in vain once more is not replaced at once."""
        for _ in range(self._kind.count - self.alive):
            self._start(STARTS_MAX)

    def _failing(self, worker: _Worker, now: float) -> str:
        """Why this worker cannot stay; empty when it can."""
        code = worker.process.poll()
        if code is not None:
            return how_it_ended(code)
        oldest = min((task.since for task in worker.in_hand.values()), default=now)
        busy_s = now - max(oldest, worker.answered)  # the oldest may have waited behind others that were done
        if busy_s > self.hung_s and self._hangs(worker, busy_s, now):
            return f"hung for {busy_s:.0f} s"
        starting_s = 0.0 if worker.ready or worker.spare else now - worker.started
        if starting_s > worker.start_s and (starting_s > START_S or process_state(worker.process.pid) not in NOT_HUNG):
            return f"not ready after {worker.start_s:.0f} s"
        if now - worker.looked > STOPPED_S:
            before, worker.stopped = worker.stopped, process_state(worker.process.pid) == "T"
            worker.looked = now
            if before and worker.stopped:
                return "stopped by a signal"
        return ""

    def _hangs(self, worker: _Worker, busy_s: float, now: float) -> bool:
        """Who waits for a disk does not, and has its time from when the disk lets go."""
        if process_state(worker.process.pid) == "D":
            worker.waited = now
        return busy_s > self._kind.hung_s or now - worker.waited > self.hung_s

    def stop(self, patience_s: float) -> list[PoolEvent]:
        """Ask every worker to finish what it has and leave; after `patience_s` kill. None is left when this returns."""
        happened: list[PoolEvent] = []
        for spare in [worker for worker in self._workers.values() if worker.spare]:
            self._bury(spare, "not needed")
        for worker in self._workers.values():
            with contextlib.suppress(zmq.ZMQError):
                worker.tasks.send_multipart([b"stop", b""], zmq.NOBLOCK)
        begun = time.monotonic()  # real time whatever clock the tests use: processes are real
        while self._workers and (waited := time.monotonic() - begun) < patience_s:
            ended = [worker for worker in self._workers.values() if worker.process.poll() is not None]
            self.results.poll(20)
            happened += self._receive()
            if waited > UNREADY_S and not self.ready:
                break  # still starting, and with nothing in hand
            for worker in ended:
                happened += self._bury(worker, "ended")
        for worker in list(self._workers.values()):
            self.counts["killed"] += 1
            happened += self._bury(worker, f"still busy {patience_s:.0f} s after being asked to stop")
        for process in self._dying:
            with contextlib.suppress(
                subprocess.TimeoutExpired
            ):  # a disk holds it; the kernel ends it when that lets go
                process.wait(KILL_S)
        if not self.results.closed:
            self.results.close(0)
        return happened

    def _keep_spares(self, now: float) -> None:
        """Once all are ready: until then they need the processors themselves."""
        spares = sum(worker.spare for worker in self._workers.values())
        longer_s = min(SPARE_S * (2 ** min(self._spares_in_vain, 10) - 1), SPARE_MOST_S)
        if spares < self._kind.spares and now >= self._next_spare + longer_s and self.ready == self._kind.count:
            self._next_spare = now + SPARE_S
            try:
                worker = self._spawn()
            except AnnulusError:  # it does without
                self._spares_in_vain += 1
                return
            worker.spare = True
            if self._kind.eager:
                self._set_up(worker)

    def _start(self, in_vain: int = 0) -> None:
        """One more worker: a spare, if there is one that is not stopped itself."""
        spares = sorted(
            (w for w in self._workers.values() if w.spare and not w.stopped),
            key=lambda w: (w.ready, w.warm),
            reverse=True,
        )
        worker = spares[0] if spares else self._spawn()
        worker.spare, worker.started, worker.in_vain = False, self._clock(), in_vain
        worker.up = worker.started if worker.ready else None
        if worker.ready:
            self._called.append(Ready(worker.number))
        if worker.set_up:
            return
        if worker.warm:
            worker.start_s = WARM_START_S
        self._set_up(worker)

    def _set_up(self, worker: _Worker) -> None:
        worker.set_up = True
        worker.tasks.send_multipart([b"setup", msgpack.packb(self._kind.setup)], zmq.NOBLOCK)

    def _is_up(self, spare: _Worker) -> bool:
        return spare.ready if self._kind.eager else spare.warm

    def _spawn(self) -> _Worker:
        number, self._numbers = self._numbers, self._numbers + 1
        address = self._folder / f"{self._kind.name}-{number}"
        try:
            tasks = self._context.socket(zmq.PUSH)
        except zmq.ZMQError as error:
            raise cannot_start(self._kind.command[0], error) from None
        tasks.setsockopt(zmq.SNDHWM, 1000)
        tasks.setsockopt(zmq.LINGER, 0)
        link: dict[str, Any] = {
            "worker": number,
            "parent": os.getpid(),
            "ring_fd": self._ring.fd,
            "frame_bytes": self._ring.frame_bytes,
            "tasks": f"ipc://{address}",
            "results": f"ipc://{address}-results",
        }
        # The worker binds both. A connecting PUSH queues at once, a bound one does not; and libzmq ends a process that
        # has no descriptor left for who connects to it over ipc (4.3.5, ipc_listener.cpp:297).
        tasks.connect(link["tasks"])
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        try:
            process = subprocess.Popen(
                [*self._kind.command, json.dumps(link)],
                stdin=subprocess.DEVNULL,
                pass_fds=(self._ring.fd,),
                process_group=0,  # the terminal's Ctrl-C is for the owner, who ends the workers in order
                env=os.environ | one_thread,
            )
        except (OSError, MemoryError) as error:
            tasks.close(0)
            raise cannot_start(self._kind.command[0], error) from None
        self.results.connect(link["results"])
        worker = self._workers[number] = _Worker(number, process, tasks, address, self._clock())
        return worker

    def _receive(self) -> list[PoolEvent]:
        happened: list[PoolEvent] = []
        while not self.results.closed and int(self.results.getsockopt(zmq.EVENTS)) & zmq.POLLIN:
            try:
                number, kind, body = untrusted.unpack(self.results.recv(), MESSAGE_MAX)
            except ValueError:
                self.counts["malformed"] += 1
                continue
            worker = self._workers.get(number)
            if worker is None:
                self.counts["late"] += 1  # from one already buried; its frames were reported lost
            elif kind == "warm":
                worker.warm = True
                worker.up = self._clock() if worker.spare and not self._kind.eager else None
            elif kind == "ready":
                worker.ready, worker.up = True, self._clock()
                if not worker.spare:
                    happened.append(Ready(number))
            elif kind in ("done", "failed"):
                task = worker.in_hand.pop(body[0], None)
                if task is None:
                    self.counts["late"] += 1
                    continue
                self._let_go(task)
                self.counts[kind] += 1
                now = self._clock()
                self._took_s.append(now - max(task.since, worker.answered))
                worker.answered = now
                happened.append(
                    Done(number, task.header, body[1])
                    if kind == "done"
                    else FrameFailed(number, task.header, str(body[1]))
                )
            elif kind == "broken":
                worker.broken = str(body)
            elif kind in ("report", "bye"):
                happened.append(Report(number, body, kind == "bye"))
            else:
                self.counts["malformed"] += 1
        return happened

    def _let_go(self, task: _InHand) -> None:
        for place in task.places:
            self._ring.release(place)

    def _bury(self, worker: _Worker, why: str) -> list[PoolEvent]:
        if worker.process.poll() is None:
            worker.process.kill()
            self._dying.append(worker.process)
        worker.tasks.close(0)
        self.results.disconnect(f"ipc://{worker.address}-results")
        for path in (worker.address, worker.address.with_name(f"{worker.address.name}-results")):
            path.unlink(missing_ok=True)
        del self._workers[worker.number]
        for task in worker.in_hand.values():
            self._let_go(task)
        self.counts["lost"] += len(worker.in_hand)
        return [FrameLost(worker.number, task.header, why) for task in worker.in_hand.values()]


def _died_in_vain(worker: _Worker, now: float) -> bool:
    return worker.up is None or now - worker.up < YOUNG_S or (bool(worker.in_hand) and not worker.answered)


def cannot_start(command: str, error: BaseException) -> AnnulusError:
    """One line for a system that has no process, no descriptor or no memory left."""
    return AnnulusError(f"cannot start {command}: {getattr(error, 'strerror', None) or 'no memory'}")


def how_it_ended(code: int) -> str:
    """A child, for people."""
    if code == NO_MEMORY:
        return "no memory was left for it"
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def process_state(pid: int) -> str:
    """The kernel's letter: R, S, D (waits for a disk), T (stopped), Z .."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0]
    except (OSError, IndexError):
        return ""
