"""One scan: the loop that ties controller, camera, labels, recorder, workers and viewers together.

One thread does everything here but waiting for the camera, and waits for nobody. Frames go

    camera -> capture thread -> a slot of the ring -> label, when both its edges are known -> recorder, worker, viewers

and a slot is free again when the last of those is done with it.
"""

import os
import shutil
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

import zmq

from annulus.capture.camera import Camera, CapturedFrame
from annulus.capture.photometry import measure
from annulus.daemon.cameras import apply_controls
from annulus.daemon.capturing import Capturing
from annulus.daemon.config import HeadConfig, require_size
from annulus.daemon.labelling import FrameSeen, Labelling
from annulus.daemon.reorder import ReorderBuffer
from annulus.link.client import Port
from annulus.link.head import HeadControl, HeadEvent, Phase, PhaseChanged, stage_from_us
from annulus.link.messages import Fault, Stage, SyncFound, SyncLost
from annulus.link.session import EventReceived, EventsLost, Rebooted
from annulus.stream.frames import CHANNELS, FrameHeader
from annulus.stream.publish import Publisher
from annulus.stream.ring import FrameRing, Place
from annulus.stream.workers import Died, Done, Failed, FrameLost, PoolEvent, Report, WorkerPool
from annulus.vocabulary import AnnulusError, CameraSequence, Label
from annulus.wall.profile import Profile

TURN_S = 0.002  # at most between two looks at the line: what comes in is stamped when it is read
RESERVE = 4  # free slots below which workers get no frame, so that recording goes on
WORKER_DEPTH = 2
IDENTIFY_S = 1.0
START_S = 200.0  # on a fresh machine workers compile first
ARM_S = 5.0
REOPEN_S = 1.0
TELEMETRY_S = 1.0
DISARM_S = 0.5
CAMERA_END_S = 2.5
DRAIN_S = 8.0
EVENTS_KEPT = 200


@dataclass(frozen=True, slots=True)
class ScanReport:
    """What a scan was, in numbers."""

    seconds: float
    frames: Mapping[str, int]  # by label
    unknown: Mapping[str, int]  # by reason
    drops: Mapping[str, int]  # by kind, see README.md
    profiles: int
    recordings: tuple[Path, ...]
    latency_ms: float  # median, frame in hand to profile joined; 0 without profiles
    telemetry: Mapping[str, Any]  # the last one
    events: tuple[str, ...]  # the last ones, for people


@dataclass(frozen=True, slots=True)
class Doors:
    """What a scan tells the program around it, as it happens. All are called from the scan's thread: be quick."""

    profile: Callable[[Profile], None] = lambda _: None
    event: Callable[[str], None] = lambda _: None
    telemetry: Callable[[Mapping[str, Any]], None] = lambda _: None


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A frame in its slot that has no label yet."""

    seen: FrameSeen
    place: Place
    at_ns: int


class Scan:
    """One head from power-up to lamps off. `run` once; it gives everything back, however it ends."""

    def __init__(self, config: HeadConfig, camera: Camera, *, doors: Doors | None = None, name: str = "") -> None:
        """`camera` becomes the scan's: it is closed at the end. `name` of the recording: by default its start, UTC."""
        if config.calibration is not None:
            require_size(config.calibration, camera.width, camera.height)
        self._config, self._camera, self._doors = config, camera, doors or Doors()
        self._name = name or datetime.now(UTC).strftime("scan-%Y%m%d-%H%M%S")
        self._period_ns = round(1e9 / config.timing.fps)
        self._labelling = Labelling(config, camera.width, camera.height, camera.encoding, self._tell)
        self._head: HeadControl | None = None
        self._port: Port | None = None
        self._reopen_s = 0.0
        self._waiting: deque[_Waiting] = deque()
        self._for_workers: deque[tuple[FrameHeader, _Waiting]] = deque()  # each holds its slot
        self._next_index = 0
        self._last_frame: tuple[CameraSequence | None, int] | None = None
        self._joined: ReorderBuffer[Profile] = ReorderBuffer()
        self._taken_ns: dict[int, int] = {}  # frame index -> when it came, while a worker has it
        self._latency_ms: deque[float] = deque(maxlen=1000)
        self._seed: list[float] | None = None
        self._frames: Counter[str] = Counter()
        self._unknown: Counter[str] = Counter()
        self._drops: Counter[str] = Counter()
        self._profiles = 0
        self._recorder_says: dict[int, Mapping[str, Any]] = {}  # by worker number, its last report
        self._recording_problem = ""
        self._events: deque[str] = deque(maxlen=EVENTS_KEPT)
        self._started_ns = 0
        self._next_telemetry = 0.0
        self._ring: FrameRing
        self._workers: WorkerPool | None = None
        self._recorder: WorkerPool | None = None
        self._publisher: Publisher | None = None
        self._capturing: Capturing | None = None

    # ---- from beginning to end ----

    def run(self, stop: Callable[[], bool]) -> ScanReport:
        """Scan until `stop()` is true or the camera has no more frames. `stop` is asked often; make it cheap.

        Raises AnnulusError when the scan cannot begin, or the camera breaks.
        """
        with ExitStack() as stack:
            self._open(stack)
            try:
                if self._until(self._crews_ready, stop, START_S, "workers are not ready"):
                    self._begin(stop)
                while not (stop() or self._at_end()):
                    self._turn()
            finally:
                self._end()
            problem = self._capturing.problem if self._capturing is not None else ""
        if problem:
            raise AnnulusError(problem)
        return self.report()

    @property
    def labelled(self) -> int:
        """Frames with a label that is not unknown."""
        return self._frames[Label.PROJECTOR.value] + self._frames[Label.LED.value]

    @property
    def seconds(self) -> float:
        """Since the camera was started; 0 before."""
        return (time.monotonic_ns() - self._started_ns) / 1e9 if self._started_ns else 0.0

    @property
    def why_unknown(self) -> str:
        """The commonest reason for unknown labels."""
        return self._unknown.most_common(1)[0][0] if self._unknown else "no frame has come"

    def report(self) -> ScanReport:
        """Where the scan stands, or ended."""
        recordings = tuple(Path(str(says["path"])) for _, says in sorted(self._recorder_says.items()))
        telemetry = self.telemetry()
        return ScanReport(
            self.seconds, dict(self._frames), dict(self._unknown), telemetry["drops"], self._profiles, recordings,
            median(self._latency_ms) if self._latency_ms else 0.0, telemetry, tuple(self._events),
        )  # fmt: skip

    def telemetry(self) -> dict[str, Any]:
        """Every counter there is, as plain types."""
        head, capturing = self._head, self._capturing
        drops = Counter(self._drops)
        if capturing is not None:
            drops.update({key: capturing.counts[key] for key in ("capture_queue", "camera_silent")})
        for says in self._recorder_says.values():
            drops["disk"] += int(says["lost"].get("/frame", 0))
        if self._recorder is not None:
            drops["recorder_notes"] += self._recorder.counts["notes_dropped"]
        return {
            "frames": {label.value: self._frames[label.value] for label in Label},
            "unknown": dict(self._unknown),
            "drops": {kind: count for kind, count in sorted(drops.items()) if count},
            "profiles": self._profiles,
            "waiting": len(self._waiting),
            "slots_free": self._ring.free,
            "phase": head.phase.value if head is not None else "none",
            "problem": head.problem if head is not None else "",
            "link": head.session.counters.as_dict() if head is not None else {},
            "boot_epochs": head.boot_epoch if head is not None else 0,
            "rearms": head.rearms if head is not None else 0,
            "edges_unplaced": head.edges_unplaced if head is not None else 0,
            "clock_samples_rejected": head.clock.rejected if head is not None else 0,
            **self._labelling.numbers(),
            "workers": _crew_numbers(self._workers),
            "recorder": _crew_numbers(self._recorder),
        }

    def _open(self, stack: ExitStack) -> None:
        """Acquire everything; `stack` gives it back in reverse order."""
        config, camera = self._config, self._camera
        stack.callback(camera.close)
        if config.port is not None:
            self._port = Port(config.port)
            stack.callback(self._close_port)
            self._head = HeadControl(_stage(config), armed=False)
            self._identify(config.port)
        folder = _socket_folder()
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        stack.callback(context.destroy, linger=0)
        self._ring = FrameRing(config.slots, camera.width * camera.height * CHANNELS[camera.encoding])
        stack.callback(self._ring.close)
        if config.publish is not None:
            self._publisher = Publisher(context, config.publish, config.keys)
            stack.callback(self._publisher.close)
        calibration = None if config.calibration is None else config.calibration.to_dict()
        if config.record_folder is not None:
            setup = {
                "folder": str(config.record_folder.absolute()), "name": self._name, "calibration": calibration,
                "configuration": config.to_dict(),
            }  # fmt: skip
            self._recorder = self._crew("recorder", "recording", setup, folder, context, 1, config.slots)
            stack.callback(lambda: self._after(self._recorder, 0.0))
        if calibration is not None:
            count = config.workers or default_workers()
            setup = {"calibration": calibration}
            self._workers = self._crew("worker", "reconstructing", setup, folder, context, count, WORKER_DEPTH)
            stack.callback(lambda: self._after(self._workers, 0.0))

    def _crew(
        self, name: str, module: str, setup: Any, folder: Path, context: zmq.Context[Any], count: int, depth: int
    ) -> WorkerPool:
        command = [sys.executable, "-m", f"annulus.daemon.{module}"]
        return WorkerPool(
            command, setup, ring=self._ring, context=context, folder=folder, name=name, count=count, depth=depth
        )

    def _identify(self, port: str) -> None:
        """Raises AnnulusError when nobody, or somebody else, answers."""
        head = self._head
        assert head is not None and self._port is not None
        end = time.monotonic() + IDENTIFY_S
        while head.identity is None and time.monotonic() < end:
            self._hear(self._port.pump(head, TURN_S))
        if head.identity is None:
            damaged = sum(head.session.counters.corrupt.values())
            heard = f"{damaged} damaged frames and no answer" if damaged else "no answer"
            raise AnnulusError(f"{port}: {heard} to identify within {IDENTIFY_S:g} s. Is this the controller?")
        if head.phase is Phase.MISMATCH:
            raise AnnulusError(f"{port}: {head.problem}")

    def _crews_ready(self) -> bool:
        crews = [crew for crew in (self._recorder, self._workers) if crew is not None]
        return all(crew.ready > 0 and crew.ready == crew.alive for crew in crews)

    def _begin(self, stop: Callable[[], bool]) -> None:
        """Camera first, then the lamps: the controller needs the camera's sync edges."""
        self._camera.start()
        apply_controls(self._camera, self._config)
        self._capturing = Capturing(self._camera)
        self._capturing.start()
        self._started_ns = time.monotonic_ns()
        head = self._head
        if head is None:
            return
        head.arm()
        armed = self._until(lambda: head.phase in (Phase.RUNNING, Phase.REFUSED), stop, ARM_S, "")
        if head.phase is Phase.REFUSED or (not armed and not stop()):
            why = head.problem or f"still {head.phase.value} after {ARM_S:g} s"
            raise AnnulusError(f"{self._config.port}: the lamps cannot be armed: {why}")

    def _until(self, done: Callable[[], bool], stop: Callable[[], bool], seconds: float, why: str) -> bool:
        """Turn until `done`. False when stopped or out of time; `why` not empty: out of time is an AnnulusError."""
        end = time.monotonic() + seconds
        while not done():
            if stop():
                return False
            if time.monotonic() > end:
                if why:
                    raise AnnulusError(f"{why} after {seconds:g} s")
                return False
            self._turn()
        return True

    def _at_end(self) -> bool:
        return self._capturing is not None and self._capturing.ended and not self._waiting

    def _end(self) -> None:
        """Lamps off first. Then everything in hand goes where it belongs, and the recording is closed."""
        with self._whatever_happens("disarm"):
            self._disarm()
        with self._whatever_happens("camera"):
            if self._capturing is not None:
                self._capturing.end(CAMERA_END_S)  # while the camera still runs: its next frame ends the wait
                self._camera.stop()
                self._take_frames()
        with self._whatever_happens("labels"):
            while self._waiting:
                self._label_first()
        with self._whatever_happens("workers"):
            self._until_workers_are_done(DRAIN_S)
            self._after(self._workers, DRAIN_S)
            self._join(final=True)
        with self._whatever_happens("recorder"):
            self._note("/telemetry", self.telemetry())
            self._after(self._recorder, DRAIN_S)

    @contextmanager
    def _whatever_happens(self, step: str) -> Iterator[None]:
        """A step of the ending that fails does not keep the next ones from being done."""
        try:
            yield
        except Exception as error:
            self._tell("ending", f"ending, {step}: {type(error).__name__}: {error}")

    def _until_workers_are_done(self, patience_s: float) -> None:
        """What waits for a worker still gets one, if they are quick."""
        end = time.monotonic() + patience_s
        while self._for_workers and self._workers is not None and self._workers.ready and time.monotonic() < end:
            self._feed_workers()
            self._workers.results.poll(20)
            self._happened(self._workers, self._workers.poll())
            self._join()
        while self._for_workers:
            self._drop_for_workers()

    def _disarm(self) -> None:
        head = self._head
        if head is None or self._port is None:
            return
        head.disarm()
        end = time.monotonic() + DISARM_S
        while head.phase not in (Phase.IDLE, Phase.REFUSED, Phase.MISMATCH) and time.monotonic() < end:
            self._hear(self._port.pump(head, TURN_S))
        if head.phase is not Phase.IDLE:
            self._tell("lamps", f"the controller did not confirm that the lamps are off ({head.phase.value})")

    def _after(self, crew: WorkerPool | None, patience_s: float) -> None:
        """Stop a crew and count what came of it. A second call does nothing."""
        if crew is not None:
            self._happened(crew, crew.stop(patience_s))

    # ---- one turn ----

    def _turn(self) -> None:
        self._listen()
        self._take_frames()
        self._labelling.look_for_offset(time.monotonic())
        while self._waiting and self._settled(self._waiting[0]):
            self._label_first()
        for crew in (self._workers, self._recorder):
            if crew is not None:
                self._happened(crew, crew.poll())
        self._feed_workers()
        self._join()
        if self._publisher is not None:
            self._publisher.admit()
        now = time.monotonic()
        if now >= self._next_telemetry:
            self._next_telemetry = now + TELEMETRY_S
            telemetry = self.telemetry()
            self._doors.telemetry(telemetry)
            self._note("/telemetry", telemetry)
            self._publish("telemetry", telemetry)

    def _listen(self) -> None:
        """The controller's line. One that breaks is opened again, every second; frames meanwhile are unknown."""
        if self._head is None:
            time.sleep(TURN_S)
            return
        if self._port is None:
            time.sleep(TURN_S)
            if time.monotonic() < self._reopen_s:
                return
            self._reopen_s = time.monotonic() + REOPEN_S
            try:
                assert self._config.port is not None
                self._port = Port(self._config.port)
            except AnnulusError:
                return
            self._tell("link", f"{self._config.port}: the line is back")
        try:
            news = self._port.pump(self._head, TURN_S)
        except AnnulusError as error:
            if self._started_ns == 0:
                raise
            self._close_port()
            self._reopen_s = time.monotonic() + REOPEN_S
            self._drops["line_broken"] += 1
            self._tell("link", str(error))
            return
        self._hear(news)

    def _close_port(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def _hear(self, news: list[HeadEvent]) -> None:
        for one in news:
            self._labelling.hear(one)
            match one:
                case Rebooted(boot, previous) if previous is not None:
                    self._tell("reset", f"the controller restarted (boot {previous} -> {boot}); lamps are armed again")
                case EventsLost(first, count):
                    self._drops["edge_events"] += count
                    self._tell("events_lost", f"{count} events of the controller are lost, from number {first}")
                case PhaseChanged(phase, why) if why or phase in (Phase.RUNNING, Phase.IDLE):
                    self._tell("head", f"{phase.value}{': ' if why else ''}{why}")
                case EventReceived(event) if isinstance(event, Fault):
                    self._tell("fault", f"fault {event.fault.name.lower()}, detail {event.detail}")
                case EventReceived(event) if isinstance(event, SyncLost):
                    self._tell("sync", f"no frame-sync edge since edge {event.last_edge}")
                case EventReceived(event) if isinstance(event, SyncFound):
                    self._tell("sync", f"frame-sync is regular from edge {event.edge} on")

    def _take_frames(self) -> None:
        """From the capture thread into the ring."""
        if self._capturing is None:
            return
        for arrived in self._capturing.take():
            self._count_holes(arrived.frame)
            index, self._next_index = self._next_index, self._next_index + 1
            place = self._ring.claim()
            if place is None:  # the frame has no label and never will
                self._drops["no_slot"] += 1
                continue
            self._ring.write(place, arrived.frame.image)
            seen = _seen(index, arrived.frame)
            self._labelling.saw(seen)
            self._waiting.append(_Waiting(seen, place, arrived.at_ns))

    def _count_holes(self, frame: CapturedFrame) -> None:
        """What the driver dropped: holes in its count, or in the timestamps where it does not count."""
        last, self._last_frame = self._last_frame, (frame.sequence, frame.timestamp_ns)
        if last is None:
            return
        if frame.sequence is not None and last[0] is not None:
            missing = frame.sequence - last[0] - 1
        else:
            missing = round((frame.timestamp_ns - last[1]) / self._period_ns) - 1
        self._drops["camera"] += max(0, missing)

    # ---- labels ----

    def _settled(self, frame: _Waiting) -> bool:
        """Whether the first waiting frame is to be labelled now: waiting gains nothing, or there is no room to."""
        crowded = not self._labelling.offset_known and self._ring.free < RESERVE
        return crowded or self._labelling.settled(frame.seen, time.monotonic_ns())

    def _label_first(self) -> None:
        frame = self._waiting.popleft()
        header = self._labelling.header(frame.seen)
        self._frames[header.label.value] += 1
        if header.label is Label.UNKNOWN:
            self._unknown[header.reason] += 1
        self._hand_out(header, frame)
        self._ring.release(frame.place)

    def _hand_out(self, header: FrameHeader, frame: _Waiting) -> None:
        """Recorder first: what is recorded can be reconstructed later, what is seen cannot be recorded later."""
        if self._recorder is not None and not self._recorder.offer(header, frame.place):
            self._drops["recorder_busy"] += 1
        if header.label is Label.PROJECTOR and self._workers is not None:
            self._ring.hold(frame.place)
            self._for_workers.append((header, frame))
            self._feed_workers()
        self._publish("label", header.to_dict())
        if self._publisher is not None:
            self._publisher.send("frame", header.to_dict(), self._ring.view(header, frame.place).data)

    def _feed_workers(self) -> None:
        """Frames wait for a worker in their slots, but never in the way of new ones."""
        while self._for_workers and self._workers is not None and self._workers.room:
            header, frame = self._for_workers.popleft()
            if self._workers.offer(header, frame.place, self._seed):
                self._taken_ns[header.index] = frame.at_ns
                self._joined.expect(header.index)
            else:
                self._drops["worker_busy"] += 1
            self._ring.release(frame.place)
        while self._for_workers and self._ring.free < RESERVE:
            self._drop_for_workers()

    def _drop_for_workers(self) -> None:
        _, frame = self._for_workers.popleft()
        self._ring.release(frame.place)
        self._drops["worker_busy"] += 1

    # ---- what the crews say ----

    def _happened(self, crew: WorkerPool, happenings: list[PoolEvent]) -> None:
        recorder = crew is self._recorder
        for one in happenings:
            match one:
                case Done(body=body) if recorder:
                    pass  # the recorder's reports count what did not get to the disk
                case Done(header=header, body=body):
                    self._profile(header, body)
                case Failed(header=header, why=why):
                    self._lose(header, recorder, "recorder_failed" if recorder else "worker_failed", why)
                case FrameLost(header=header, why=why):
                    self._lose(header, recorder, "recorder_died" if recorder else "worker_died", why)
                case Died(why=why, replaced=replaced):
                    self._died("recorder" if recorder else "worker", why, replaced)
                case Report(worker, body) if recorder and isinstance(body, Mapping):
                    self._recorder_says[worker] = body
                    self._recording_loss(body)

    def _profile(self, header: FrameHeader, body: Any) -> None:
        try:
            profile = Profile.from_dict(body)
        except ValueError as error:
            self._lose(header, False, "worker_failed", str(error))
            return
        if profile.pose is not None:
            self._seed = [profile.pose.rx, profile.pose.ry, profile.pose.tx, profile.pose.ty]
        self._joined.came(header.index, profile)

    def _join(self, final: bool = False) -> None:
        """Profiles that are next in the order of frames go out."""
        for index, profile in self._joined.ready(final):
            at_ns = self._taken_ns.pop(index, None)
            if profile is None:
                continue
            self._profiles += 1
            if at_ns is not None:
                self._latency_ms.append((time.monotonic_ns() - at_ns) / 1e6)
            body = profile.to_dict()
            self._note("/profile", body, index)
            self._publish("profile", body)
            self._doors.profile(profile)

    def _lose(self, header: FrameHeader, recorder: bool, kind: str, why: str) -> None:
        self._drops[kind] += 1
        if not recorder:
            self._joined.came(header.index, None)
        self._tell(kind, f"frame {header.index}: {why}")

    def _died(self, who: str, why: str, replaced: bool) -> None:
        self._drops[f"{who}s_replaced"] += replaced
        self._tell(f"{who}_died", f"{who} ended: {why}; {'another takes over' if replaced else 'it is given up'}")
        if not replaced and self._started_ns == 0:
            raise AnnulusError(why if ": " in why else f"the {who} process cannot be started: {why}")

    def _recording_loss(self, says: Mapping[str, Any]) -> None:
        problem = str(says["problem"])
        if problem and problem != self._recording_problem:
            self._tell("disk", f"{says['path']}: {problem}; frames are labelled but not recorded")
        self._recording_problem = problem

    # ---- outwards ----

    def _tell(self, kind: str, text: str) -> None:
        """Something an operator should know."""
        self._events.append(text)
        self._doors.event(text)
        self._note("/event", {"kind": kind, "text": text})
        self._publish("event", {"kind": kind, "text": text})

    def _note(self, topic: str, body: Mapping[str, Any], sequence: int = 0) -> None:
        if self._recorder is not None and self._recorder.alive:
            self._recorder.tell(topic, [time.monotonic_ns(), dict(body), sequence])

    def _publish(self, topic: str, body: Mapping[str, Any]) -> None:
        if self._publisher is not None:
            self._publisher.send(topic, body)


def _socket_folder() -> Path:
    """A folder only we can enter, for the sockets to the crews. Sweeps those of daemons that were killed."""
    place = tempfile.gettempdir()
    if len(place) > 60:  # a socket's path has at most 107 characters
        place = "/tmp"
    for old in Path(place).glob("annulus-*-*"):
        pid = old.name.split("-")[1]
        if pid.isdigit() and not Path(f"/proc/{pid}").exists():
            shutil.rmtree(old, ignore_errors=True)
    return Path(tempfile.mkdtemp(prefix=f"annulus-{os.getpid()}-", dir=place))


def default_workers() -> int:
    """One a core, but one for everything else."""
    return max(1, len(os.sched_getaffinity(0)) - 1)


def _stage(config: HeadConfig) -> Stage:
    timing, lamps = config.timing, config.lamps
    return stage_from_us(
        ratio=lamps.ratio, period_us=timing.period_us, exposure_us=timing.exposure_us, readout_us=timing.readout_us,
        projector_us=(lamps.projector_delay_us, lamps.projector_width_us),
        led_us=(lamps.led_delay_us, lamps.led_width_us), tolerance_permille=100,
    )  # fmt: skip


def _seen(index: int, frame: CapturedFrame) -> FrameSeen:
    return FrameSeen(index, frame.sequence, frame.timestamp_ns, measure(frame.image).light, frame.metadata)


def _crew_numbers(crew: WorkerPool | None) -> dict[str, int]:
    if crew is None:
        return {}
    return {"alive": crew.alive, "ready": crew.ready, "in_hand": crew.in_hand, **crew.counts}
