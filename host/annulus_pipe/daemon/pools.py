"""The pools of processes that frames go to: here the recorder, and the workers that reconstruct; the publisher's is in
publishing.py. They are fed from the ring and never waited for.

Each holds its share of the slots at most: the recorder half of them, the publisher PUBLISHER_SHARE, a worker
WORKER_DEPTH. A frame over the share is that outlet's loss alone.
"""

import os
import shutil
import tempfile
import time
import uuid
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

import zmq

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.flashes import Flashes, Gathered
from annulus_pipe.daemon.health import HeadHealth
from annulus_pipe.daemon.intake import RESERVE, InSlot
from annulus_pipe.daemon.observer import Commanded, Mark, Observer
from annulus_pipe.daemon.reorder import ReorderBuffer
from annulus_pipe.daemon.rotation import Bounds
from annulus_pipe.daemon.state import State
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.job import JobSheet
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import DEFAULT, Codec
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.orphan import child
from annulus_pipe.stream.pool_events import Died, Done, FrameFailed, FrameLost, PoolEvent, Ready, Report
from annulus_pipe.stream.ring import RingSlot
from annulus_pipe.stream.workers import Shared, WorkerKind, WorkerPool
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.profile import Profile

WORKER_DEPTH = 2
PATIENCE_PERIODS = 6  # a flash waits no longer for the frame of a camera that is silent; a driver keeps four at most
ABSORBS_S = 0.1  # a recorder that has its hands full is waited for, if it gave one back not longer ago
RETRY_S, RETRY_MOST_S = 1.0, 60.0  # until what was given up is tried again; twice as long each time


def default_workers() -> int:
    """One a core, but one for everything else."""
    return max(1, len(os.sched_getaffinity(0)) - 1)


def socket_folder() -> Path:
    """A folder only we can enter, for the sockets to the workers. Sweeps those of daemons that were killed."""
    place = tempfile.gettempdir()
    if len(place) > 60:  # a socket's path has at most 107 characters
        place = "/tmp"
    for old in Path(place).glob("annulus-*-*"):
        pid = old.name.split("-")[1]
        if pid.isdigit() and not Path(f"/proc/{pid}").exists():
            shutil.rmtree(old, ignore_errors=True)
    return Path(tempfile.mkdtemp(prefix=f"annulus-{os.getpid()}-", dir=place))


class Pool:
    """Workers of one kind whose losses are counted and told. One that is given up is tried again: later each time,
    until it has stayed up.
    """

    def __init__(self, kind: WorkerKind, shared: Shared, account: Account, observer: Observer) -> None:
        self._account = account
        self.broken = ""  # why there are no workers any more, one line
        self._who, self._ring, self._observer = kind.name, shared.ring, observer
        self._given_up = ""  # why some are, or were until a moment ago; told once
        self._retry_s, self._retry_at = RETRY_S, 0.0
        self._pool = WorkerPool(kind, shared)

    @property
    def ready(self) -> bool:
        """Whether all are up and take frames."""
        return 0 < self._pool.ready == self._pool.alive

    @property
    def pids(self) -> list[int]:
        return self._pool.pids

    @property
    def spare_pids(self) -> list[int]:
        return self._pool.spare_pids

    @property
    def in_hand(self) -> int:
        """Frames at the workers."""
        return self._pool.in_hand

    @property
    def waitable(self) -> zmq.Socket[bytes]:
        """Readable when there is something to hear."""
        return self._pool.results

    def poll(self) -> None:
        """Hear what happened since the last call. Never waits."""
        self._happened(self._pool.poll())
        if not self._given_up:
            return
        if self._pool.settled:
            self._given_up, self._retry_s = "", RETRY_S
            self._observer.event(f"{self._who}_back", f"the {self._who} is back")
        elif time.monotonic() > self._retry_at:
            self._wait_longer()
            with suppress(AnnulusError):  # as broken as before
                self._pool.revive()

    def stop(self, patience_s: float) -> None:
        """Let them finish, then end them. A second call does nothing."""
        self._happened(self._pool.stop(patience_s))

    def numbers(self) -> dict[str, int]:
        """For the telemetry."""
        pool = self._pool
        return {"alive": pool.alive, "ready": pool.ready, "in_hand": pool.in_hand, **pool.counts}

    def _happened(self, events: list[PoolEvent]) -> None:
        for one in events:
            match one:
                case Ready():
                    self._came_up()
                case Done(header=header, body=body):
                    self._done(header, body)
                case FrameFailed(header=header, why=why):
                    self._lost(header, "failed", why)
                case FrameLost(header=header, why=why):
                    self._lost(header, "died", why)
                case Died(why=why, spare=True):
                    text = f"spares of the {self._who} die as they start: {why}; they are tried ever more rarely"
                    self._observer.event(f"{self._who}_spares", text)
                case Died(why=why, replaced=replaced):
                    self._died(why, replaced)
                case Report(worker, body) if isinstance(body, list):
                    self._reported(worker, body)

    def _lost(self, header: FrameHeader, how: str, why: str) -> None:
        kind = f"{self._who}_{how}"
        self._account.lose(kind)
        self._observer.event(kind, f"frame {header.index}: {why}")

    def _died(self, why: str, replaced: bool) -> None:
        self._account.lose(f"{self._who}s_replaced", replaced)
        nothing_new = not replaced and why == self._given_up
        after = "another takes over"
        if not replaced:
            after = f"it is given up; tried again in {self._retry_s:g} s"
            self._given_up, self._retry_at = why, time.monotonic() + self._retry_s
            if not self._pool.alive:
                self.broken = why if ": " in why else f"the {self._who} process cannot be started: {why}"
        if not nothing_new:
            self._observer.event(f"{self._who}_died", f"{self._who} ended: {why}; {after}")

    def _wait_longer(self) -> None:
        self._retry_s = min(2 * self._retry_s, RETRY_MOST_S)
        self._retry_at = time.monotonic() + self._retry_s

    def _came_up(self) -> None:
        self.broken = ""

    def _done(self, header: FrameHeader, body: Any) -> None:
        raise NotImplementedError

    def _reported(self, worker: int, body: list[Any]) -> None:
        pass


@dataclass(frozen=True, slots=True)
class RecordingSetup:
    """What a recording is begun with."""

    folder: Path
    name: str
    calibration: Mapping[str, Any] | None
    configuration: Mapping[str, Any]
    bounds: Bounds = field(default_factory=Bounds)
    scan: str = field(default_factory=lambda: uuid.uuid4().hex)  # whose parts belong together
    codec: Codec = DEFAULT
    clock: Clock = field(default_factory=Clock.now)  # one for all parts, whoever writes them
    realtime: bool | None = False  # as head.toml says


class Recorder(Pool, Observer):
    """The process that writes one recording; what is observed goes into it. One that dies is replaced by the spare, and
    goes on in a file of its own. It holds half of the slots at most.
    """

    def __init__(self, setup: RecordingSetup, shared: Shared, account: Account, observer: Observer) -> None:
        command = child("annulus_pipe.daemon.recorder")
        plain = {
            "folder": str(setup.folder.absolute()),
            "name": setup.name,
            "calibration": setup.calibration,
            "configuration": setup.configuration,
            "bounds": list(astuple(setup.bounds)),
            "scan": setup.scan,
            "codec": setup.codec.value,
            "clock": setup.clock.to_dict(),
            "realtime": setup.realtime,
        }
        kind = WorkerKind("recorder", command, plain, 1, max(1, len(shared.ring) // 2), spares=1)
        super().__init__(kind, shared, account, observer)
        account.recording = True
        self._share = kind.depth
        self._problem = ""
        self._frames: Counter[Path] = Counter()  # recorded, by file
        self._moved = 0.0  # when it last gave a frame back, or was given one with empty hands
        self._behind = 0  # frames lost since it fell behind
        self._notes_dropped = 0

    def offer(self, header: FrameHeader, place: RingSlot) -> None:
        """A labelled frame; lost, and counted, when there is no room."""
        self._account.to_record += 1
        if not self.in_hand:
            self._moved = time.monotonic()
        if self._pool.offer(header, place):
            if self._behind and not self._behind_still:
                self._observer.event("disk", f"the recorder has caught up; {self._behind} frames are not recorded")
                self._behind = 0
        elif not self._pool.ready:
            self._account.lose("recorder_absent")
        else:
            self._account.lose("recorder_busy")
            self._behind += 1
            if self._behind == 1:
                text = f"the recorder falls behind: it holds {self.in_hand} frames; more are labelled but not recorded"
                self._observer.event("disk", text)

    @property
    def absorbs(self) -> bool:
        """It has its hands full for the moment: frames come in a burst when their camera's offset is found."""
        return self._pool.ready > 0 and not self._pool.room and time.monotonic() - self._moved < ABSORBS_S

    @property
    def _behind_still(self) -> bool:
        """It has not come down to half of its share yet."""
        return self.in_hand > self._share // 2

    def note(self, topic: str, body: Mapping[str, Any], sequence: int = 0) -> None:
        """A small record."""
        if not self._pool.alive:
            self._account.lose("recorder_notes")
            return
        self._pool.tell(topic, [time.monotonic_ns(), dict(body), sequence])
        dropped = self._pool.counts["notes_dropped"]
        self._account.lose("recorder_notes", dropped - self._notes_dropped)
        self._notes_dropped = dropped

    def state(self, state: State, why: str) -> None:
        self.note("/state", {"state": state.value, "why": why})

    def event(self, kind: str, text: str) -> None:
        self.note("/event", {"kind": kind, "text": text})

    def profile(self, profile: Profile) -> None:
        self.note("/profile", profile.to_dict(), profile.frame)

    def sample(self, sample: Sample) -> None:
        self.note(f"/sensor/{sample.sensor}", sample.to_dict())

    def mark(self, mark: Mark) -> None:
        self.note("/mark", mark.to_dict())

    def commanded(self, what: Commanded) -> None:
        self.note("/command", what.to_dict())

    def job(self, sheet: JobSheet) -> None:
        self.note("/job", sheet.to_whole())

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        self.note("/telemetry", numbers)

    def finish(self, patience_s: float) -> None:
        """Let it write what it has in hand, and then what became of all frames; then end it, and look at its files."""
        end = time.monotonic() + patience_s
        while self.in_hand and time.monotonic() < end:
            self.waitable.poll(20)
            self.poll()
        self.note("/summary", self._account.ledger.to_dict())
        self.stop(max(1.0, end - time.monotonic()))
        for path in [path for path in self._account.recordings if not path.exists()]:
            self._observer.event("disk", f"{path}: was removed; the frames in it are lost")
            self._gone(path)

    def health(self, health: HeadHealth) -> None:
        self.note("/health", health.to_dict())

    def _done(self, header: FrameHeader, body: Any) -> None:
        self._moved = time.monotonic()
        if body:
            self._account.recorded += 1
            self._frames[Path(str(body))] += 1
        else:
            self._account.lose("disk")

    def _reported(self, worker: int, body: list[Any]) -> None:
        """Files that were begun, got into trouble, or are gone."""
        recordings = self._account.recordings
        for state in body:
            path, problem = Path(str(state["path"])), str(state["problem"])
            if state["gone"]:
                self._gone(path)
            elif path not in recordings:
                recordings.append(path)
            if problem and problem != self._problem:
                self._observer.event("disk", f"{path}: {problem}")
            self._problem = problem

    def _gone(self, path: Path) -> None:
        self._account.unrecord(self._frames.pop(path, 0))
        if path in self._account.recordings:
            self._account.recordings.remove(path)


class Reconstruction(Pool):
    """The workers that turn projector frames into profiles, which come out in the order of frames."""

    def __init__(
        self,
        calibration: Calibration,
        colour: ColourProfile | None,
        count: int,
        period_us: float,
        shared: Shared,
        account: Account,
        observer: Observer,
    ) -> None:
        """period_us : of the cameras' frames."""
        command = child("annulus_pipe.daemon.worker")
        setup = {"calibration": calibration.to_dict(), "colour": None if colour is None else colour.to_dict()}
        kind = WorkerKind("worker", command, setup, count, WORKER_DEPTH, spares=1, eager=True)
        super().__init__(kind, shared, account, observer)
        patience_ns = round(PATIENCE_PERIODS * period_us * 1000)
        self._flashes: Flashes[InSlot] = Flashes([one.id for one in calibration.cameras], patience_ns)
        self._queue: deque[Gathered[InSlot]] = deque()  # each holds its slots
        self._joined: ReorderBuffer[Profile] = ReorderBuffer()
        self._taken_ns: dict[int, int] = {}  # frame index -> when it came, while a worker has it
        self._seed: list[float] | None = None

    def take(self, header: FrameHeader, frame: InSlot) -> None:
        """A labelled frame of any camera. A projector frame waits in its slot for those of the head's other cameras,
        then for a worker, but never in the way of new ones.
        """
        if header.camera in self._flashes.cameras:
            if header.label is Label.PROJECTOR:
                match self._flashes.take(header, frame, time.monotonic_ns()):
                    case None:
                        self._account.lose("camera_late")
                    case is_first:
                        self._account.to_profile += is_first
                        self._ring.hold(frame.place)
            self._flashes.passed(header)
        self.feed()

    def feed(self) -> None:
        self._gather(all_of_them=self._ring.free < RESERVE)
        while self._queue and self._pool.room:
            flash = self._queue.popleft()
            (header, frame), *beside = flash.frames.values()
            if self._pool.offer(header, frame.place, self._seed, [(other, one.place) for other, one in beside]):
                self._taken_ns[header.index] = min(one.at_ns for _, one in flash.frames.values())
                self._joined.expect(header.index)
                for camera in self._flashes.missing(flash):
                    self._account.lose("camera_missing", camera=camera)
            else:
                self._account.lose("worker_busy")
            self._release(flash)
        while self._queue and self._ring.free < RESERVE:
            self._drop()

    def turn(self) -> None:
        """Hear, feed, and let out what is next."""
        self.poll()
        self.feed()
        self._join()

    def no_more(self) -> None:
        """No frame comes any more: what waits for another camera's goes without it."""
        self._gather(all_of_them=True)
        self.feed()

    @property
    def busy(self) -> bool:
        """Whether frames wait for workers that will come to them, or are at one."""
        return bool((self._queue or self._taken_ns) and self._pool.ready)

    def end_scan(self) -> None:
        """What is not done by now is not done; the workers stay, for the next scan."""
        self._gather(all_of_them=True)
        while self._queue:
            self._drop()
        self._account.lose("worker_late", self._joined.missing)
        self._join(final=True)
        self._seed = None

    def _gather(self, all_of_them: bool) -> None:
        self._queue += self._flashes.ready(time.monotonic_ns(), all_of_them)

    def _release(self, flash: Gathered[InSlot]) -> None:
        for _, frame in flash.frames.values():
            self._ring.release(frame.place)

    def _drop(self) -> None:
        self._release(self._queue.popleft())
        self._account.lose("worker_busy")

    def _done(self, header: FrameHeader, body: Any) -> None:
        if header.index not in self._taken_ns:
            return  # of a scan that has ended: counted there as late
        try:
            profile = Profile.from_dict(body)
        except ValueError as error:
            self._lost(header, "failed", str(error))
            return
        if profile.pose is not None:
            self._seed = [profile.pose.rx, profile.pose.ry, profile.pose.tx, profile.pose.ty]
        self._joined.came(header.index, profile)

    def _lost(self, header: FrameHeader, how: str, why: str) -> None:
        if header.index in self._taken_ns:
            super()._lost(header, how, why)
            self._joined.came(header.index, None)

    def _join(self, final: bool = False) -> None:
        for index, profile in self._joined.ready(final):
            at_ns = self._taken_ns.pop(index)
            if profile is not None:
                self._account.profile((time.monotonic_ns() - at_ns) / 1e6)
                self._observer.profile(profile)
