"""One head from power-up to lamps off: the loop that ties controller, cameras, labels, recorder, workers, sensors and
viewers together.

One thread does everything here but waiting for cameras, and waits for nobody. Frames go

    camera -> capture thread -> a slot of the ring -> label, when both its edges are known -> recorder, worker, viewers

and a slot is free again when the last of those is done with it. What the head may do when is state.py's table; a scan
is what lies between start and stop, and has a recording and an account of its own.
"""

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from typing import Any

import zmq

from annulus.capture.camera import Camera
from annulus.daemon.account import Account, ScanReport
from annulus.daemon.config import HeadConfig, require_size
from annulus.daemon.control import ControlSocket, Do, Request
from annulus.daemon.controller_line import TURN_S, ControllerLine, line_numbers, stage_of
from annulus.daemon.intake import InSlot, Intake
from annulus.daemon.observer import Mark, Observer, Observers
from annulus.daemon.pools import Reconstruction, Recorder, RecordingSetup, default_workers, socket_folder
from annulus.daemon.publishing import Publishing
from annulus.daemon.samples import Samples
from annulus.daemon.state import Event, State, next_state
from annulus.labelling.labelling import CameraMode, Labelling
from annulus.labelling.navigation import Navigation
from annulus.link.head import Phase
from annulus.sensors.sample import Sensor
from annulus.stream.access import Doorkeeper
from annulus.stream.frames import CHANNELS, FrameHeader
from annulus.stream.publish import Publisher
from annulus.stream.ring import FrameRing
from annulus.stream.workers import Shared
from annulus.vocabulary import AnnulusError, Label

START_S = 200.0  # on a fresh machine workers compile first
ARM_S = 5.0
TELEMETRY_S = 1.0
CHORES_S = 0.01  # between two looks at sensors, states and sockets
DRAIN_S = 8.0


class Session:
    """`run` once; it gives everything back, however it ends."""

    def __init__(
        self,
        config: HeadConfig,
        cameras: Sequence[Camera],
        observer: Observer | None = None,
        *,
        sensors: Sequence[Sensor] = (),
        name: str = "",
    ) -> None:
        """`cameras`, in the order of the configuration's, and `sensors` become the session's: they are closed at the
        end. `name` of the recordings: by default their start, UTC.
        """
        if len(cameras) != len(config.cameras):
            raise ValueError(f"{len(cameras)} cameras, but the configuration has {len(config.cameras)}")
        if config.calibration is not None:
            require_size(config.calibration, [(camera.width, camera.height) for camera in cameras])
        self._config, self._cameras, self._sensors, self._name = config, cameras, sensors, name
        self._state = State.OFF
        self._account = Account()
        self._observers = Observers([_Remember(self._account), *([observer] if observer is not None else [])])
        self._navigation = Navigation(config.mm_per_count)
        self._samples = Samples(sensors, self._navigation, self._account, self._observers)
        self._line: ControllerLine | None = None
        self._shared: Shared
        self._doorkeeper: Doorkeeper | None = None
        self._control: ControlSocket | None = None
        self._reconstruction: Reconstruction | None = None
        self._next_telemetry = self._next_chores = 0.0
        # Of the scan under way:
        self._recorder: Recorder | None = None
        self._intakes: list[Intake] = []  # none before the cameras run
        self._start_by = 0.0  # when recorder, or lamps, must be up
        self._armed = False  # the controller has confirmed
        self._report: ScanReport | None = None  # of the last scan
        self._problem = ""  # why the session cannot go on

    # ---- from beginning to end ----

    def run(self, stop: Callable[[], bool]) -> ScanReport:
        """Until `stop()` is true, or, without a control socket, the cameras have no more frames. `stop` is asked often;
        make it cheap. Returns what the last scan was.

        Raises AnnulusError when the head cannot be brought up; without a control socket also when the scan cannot
        begin, or a camera breaks.
        """
        with ExitStack() as stack:
            self._enter(Event.POWER)
            stack.callback(self._enter, Event.ENDED)
            try:
                self._power(stack)
                if self._become_ready(stop):
                    self._enter(Event.READY)
                    if self._config.autostart:
                        self._start()
                while not (stop() or self._problem or self._is_over):
                    self._turn()
            finally:
                self._enter(Event.END)
                self._end_scan()
                with self._whatever_happens("workers"):
                    if self._reconstruction is not None:
                        self._reconstruction.stop(0.0 if self._reconstruction.in_hand else DRAIN_S)
        if self._problem:
            raise AnnulusError(self._problem)
        return self._report or self._account.report(self._account.numbers())

    @property
    def state(self) -> State:
        return self._state

    @property
    def labelled(self) -> int:
        """Frames of this scan with a label that is not unknown."""
        return self._account.labelled

    @property
    def seconds(self) -> float:
        """Since the cameras were started; 0 before."""
        return self._account.seconds

    @property
    def why_unknown(self) -> str:
        """The commonest reason for unknown labels."""
        unknown = self._account.unknown
        return unknown.most_common(1)[0][0] if unknown else "no frame has come"

    @property
    def recorder(self) -> Recorder | None:
        return self._recorder

    @property
    def reconstruction(self) -> Reconstruction | None:
        return self._reconstruction

    @property
    def control_address(self) -> str:
        """Where the control socket really is; empty without one, and before power-up."""
        return self._control.address if self._control is not None else ""

    def telemetry(self) -> dict[str, Any]:
        """Every counter there is, as plain types."""
        labels = [intake.labelling.numbers() for intake in self._intakes]
        pools = {"workers": self._reconstruction, "recorder": self._recorder}
        return {
            "state": self._state.value,
            **self._account.numbers(),
            **line_numbers(self._line),
            "place_gaps": self._navigation.odometer.gaps,
            "z_mm": self._navigation.odometer.here_mm,
            "cameras": labels,
            "sensors": self._samples.numbers(),
            "slots_free": self._shared.ring.free,
            **{name: pool.numbers() if pool is not None else {} for name, pool in pools.items()},
        }

    # ---- power ----

    def _power(self, stack: ExitStack) -> None:
        """Acquire everything; `stack` gives it back in reverse order."""
        config = self._config
        for camera in self._cameras:
            stack.callback(camera.close)
        for sensor in self._sensors:
            stack.callback(sensor.close)
        if config.port is not None:
            self._line = ControllerLine(config.port, stage_of(config), self._account, self._observers)
            stack.callback(self._line.close)
            for event in self._line.identify():
                self._navigation.heard(event)
        folder = socket_folder()
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        stack.callback(context.destroy, linger=0)
        largest = max(camera.width * camera.height * CHANNELS[camera.encoding] for camera in self._cameras)
        ring = FrameRing(config.slots, largest)  # cameras of several sizes share it: slots are as large as the largest
        stack.callback(ring.close)
        self._shared = Shared(ring, context, folder)
        self._doorkeeper = Doorkeeper(context)
        stack.callback(self._doorkeeper.close)
        if config.publish is not None:
            publisher = Publisher(self._doorkeeper, config.publish.address, config.publish.keys)
            stack.callback(publisher.close)
            publishing = Publishing(publisher)
            self._observers.all.append(publishing)
            stack.callback(self._observers.all.remove, publishing)
        if config.control is not None:
            self._control = ControlSocket(self._doorkeeper, config.control.address, config.control.keys)
            stack.callback(self._control.close)
        stack.callback(self._stop_pools)
        if config.autostart:
            self._begin_recording()  # together with the workers: neither has to wait for the other
        if config.calibration is not None:
            self._reconstruction = Reconstruction(
                config.calibration, config.workers or default_workers(), self._shared, self._account,
                self._observers,
            )  # fmt: skip

    def _become_ready(self, stop: Callable[[], bool]) -> bool:
        """Until recorder and workers are up; False when asked to stop before."""
        end = time.monotonic() + START_S
        pools = [pool for pool in (self._recorder, self._reconstruction) if pool is not None]
        while not all(pool.ready for pool in pools):
            if stop():
                return False
            for pool in pools:
                if pool.broken:
                    raise AnnulusError(pool.broken)
            if time.monotonic() > end:
                raise AnnulusError(f"workers are not ready after {START_S:g} s")
            self._turn()
        return True

    def _stop_pools(self) -> None:
        for pool in (self._recorder, self._reconstruction):
            if pool is not None:
                pool.stop(0.0)

    # ---- one scan ----

    def _begin_recording(self) -> None:
        """A new account, and a recorder on its way up."""
        config = self._config
        self._account.restart()
        if config.record_folder is None:
            return
        name = self._name or datetime.now(UTC).strftime("scan-%Y%m%d-%H%M%S")
        calibration = None if config.calibration is None else config.calibration.to_dict()
        setup = RecordingSetup(config.record_folder, name, calibration, config.to_dict())
        self._recorder = Recorder(setup, self._shared, self._account, self._observers)
        self._observers.all.insert(0, self._recorder)

    def _start(self) -> None:
        """Idle to armed; raises AnnulusError when that cannot be. Lamps and cameras follow once the recorder is up."""
        next_state(self._state, Event.START)
        if self._recorder is None:
            self._begin_recording()
        self._enter(Event.START)
        self._start_by = time.monotonic() + START_S

    def _come_up(self) -> None:
        """What is still missing of a scan that was started: recorder, cameras, lamps, in this order."""
        late = time.monotonic() > self._start_by
        if not self._intakes:
            recorder = self._recorder
            if recorder is None or recorder.ready:
                try:
                    self._light_up()
                except AnnulusError as error:
                    self._fail(str(error))
            elif recorder.broken or late:
                self._fail(recorder.broken or f"the recorder is not ready after {START_S:g} s")
        elif self._line is not None:
            head = self._line.head
            self._armed = head.phase is Phase.RUNNING
            if head.phase is Phase.REFUSED or (late and not self._armed):
                why = head.problem or f"still {head.phase.value} after {ARM_S:g} s"
                self._fail(f"{self._line.url}: the lamps cannot be armed: {why}")

    def _light_up(self) -> None:
        """Cameras first, then the lamps: the controller needs the cameras' sync edges."""
        self._start_by = time.monotonic() + ARM_S
        self._armed = self._line is None
        for number, (camera, config) in enumerate(zip(self._cameras, self._config.cameras, strict=True)):
            mode = CameraMode(number, camera.width, camera.height, camera.encoding, round(1e9 / config.timing.fps))
            labelling = Labelling(mode, self._navigation, self._observers.event, alone=self._line is None)
            self._intakes.append(Intake(camera, mode, labelling, self._shared.ring))
            for remark in self._intakes[-1].start(config):
                self._observers.event("camera", remark)
        self._account.begin()
        if self._line is not None:
            self._line.arm()

    def _fail(self, why: str) -> None:
        """The scan cannot go on. A session that can be told to start again does, another ends."""
        if self._control is None:
            self._problem = why
            return
        self._observers.event("scan", why)
        self._stop()

    def _stop(self) -> None:
        """The scan ends, the session does not."""
        self._end_scan()
        self._enter(Event.STOP)

    @property
    def _has_scan(self) -> bool:
        return self._start_by > 0.0

    @property
    def _is_over(self) -> bool:
        return self._control is None and bool(self._intakes) and all(intake.ended for intake in self._intakes)

    def _end_scan(self) -> None:
        """Lamps off first. Then everything in hand goes where it belongs, and the recording is closed."""
        with self._whatever_happens("disarm"):
            if self._line is not None:
                for event in self._line.disarm():
                    self._navigation.heard(event)
        for intake in self._intakes:
            with self._whatever_happens("camera"):
                intake.stop()
                intake.take(self._account)
        self._account.end()
        with self._whatever_happens("labels"):
            for intake in self._intakes:
                for header, frame in intake.labelled(final=True):
                    self._hand_out(header, frame)
        with self._whatever_happens("workers"):
            self._finish_reconstruction()
        if self._recorder is None and not self._intakes:
            return
        telemetry = self.telemetry()
        self._observers.telemetry(telemetry)
        with self._whatever_happens("recorder"):
            if self._recorder is not None:
                self._recorder.stop(DRAIN_S)
                self._observers.all.remove(self._recorder)
        self._report = self._account.report({**telemetry, **self._account.numbers()})
        self._observers.ended(self._report)
        self._recorder, self._intakes, self._start_by, self._armed = None, [], 0.0, False

    def _finish_reconstruction(self) -> None:
        """What waits for a worker still gets one, if they are quick."""
        if self._reconstruction is None:
            return
        end = time.monotonic() + DRAIN_S
        while self._reconstruction.busy and time.monotonic() < end:
            self._listen()
            self._reconstruction.turn()
        self._reconstruction.end_scan()

    @contextmanager
    def _whatever_happens(self, step: str) -> Iterator[None]:
        """A step of the ending that fails does not keep the next ones from being done."""
        try:
            yield
        except Exception as error:
            self._observers.event("ending", f"ending, {step}: {type(error).__name__}: {error}")

    # ---- one turn ----

    def _turn(self) -> None:
        self._listen()
        for intake in self._intakes:
            intake.take(self._account)
            intake.labelling.look_for_offset(time.monotonic())
            for header, frame in intake.labelled():
                self._hand_out(header, frame)
        if self._recorder is not None:
            self._recorder.poll()
        if self._reconstruction is not None:
            self._reconstruction.turn()
        now = time.monotonic()
        if now >= self._next_chores:
            self._next_chores = now + CHORES_S
            self._do_chores(now)

    def _do_chores(self, now: float) -> None:
        """What can wait for some turns."""
        self._samples.poll(time.monotonic_ns())
        self._watch()
        if self._doorkeeper is not None:
            self._doorkeeper.admit()
        if self._control is not None:
            self._account.lose("control_malformed", self._control.poll(self._obey, lambda: self._state))
        if now >= self._next_telemetry:
            self._next_telemetry = now + TELEMETRY_S
            self._observers.telemetry(self.telemetry())

    def _listen(self) -> None:
        """The controller, or the time it would have taken."""
        if self._line is None:
            time.sleep(TURN_S)
            return
        for event in self._line.pump():
            self._navigation.heard(event)
        odometer = self._navigation.odometer
        if odometer.zeroed_mm is not None:
            self._observers.event("odometer", f"odometer zeroed at {odometer.zeroed_mm:.1f} mm; z begins again there")
            odometer.zeroed_mm = None

    def _hand_out(self, header: FrameHeader, frame: InSlot) -> None:
        """Recorder first: what is recorded can be reconstructed later, what is seen cannot be recorded later."""
        self._account.label(header)
        if self._state is State.ARMED and header.label is not Label.UNKNOWN:
            self._enter(Event.LABELLED)
        if self._recorder is not None:
            self._recorder.offer(header, frame.place)
        if (
            header.label is Label.PROJECTOR
            and self._reconstruction is not None
            and header.camera == self._reconstruction.camera
        ):
            self._reconstruction.take(header, frame)
        self._observers.frame(header, self._shared.ring.view(header, frame.place))
        self._shared.ring.release(frame.place)

    # ---- states ----

    def _enter(self, event: Event, why: str = "") -> None:
        self._state = next_state(self._state, event)
        self._observers.state(self._state, why)

    def _watch(self) -> None:
        """From what controller and cameras are like to what state the head is in."""
        if self._has_scan and not self._armed:
            self._come_up()
        trouble = self._line.trouble if self._line is not None else ""
        trouble = trouble or next((intake.trouble for intake in self._intakes if intake.trouble), "")
        if trouble and self._state in (State.IDLE, State.ARMED, State.SCANNING):
            self._enter(Event.FAULT, trouble)
        elif self._state is State.FAULT and not trouble and (self._line is None or self._line.settled):
            self._enter(Event.RUNNING if self._has_scan else Event.CLEARED)
        problem = next((intake.problem for intake in self._intakes if intake.problem), "")
        if problem:
            self._fail(problem)
        elif self._control is not None and self._intakes and all(intake.ended for intake in self._intakes):
            self._stop()

    def _obey(self, request: Request) -> None:
        """A request of the control socket. Raises AnnulusError when it cannot be done now."""
        match request.do:
            case Do.START:
                self._start()
            case Do.STOP:
                self._need_scan()
                self._stop()
            case Do.MARK:
                self._need_scan()
                z_mm = self._navigation.odometer.here_mm
                self._observers.mark(Mark(time.monotonic_ns(), z_mm, request.text, request.clock_deg))
            case Do.ZERO:
                if self._line is None:
                    raise AnnulusError("there is no controller, and so no odometer to zero")
                self._navigation.odometer.zero()
            case Do.STATE:
                pass

    def _need_scan(self) -> None:
        if not self._has_scan:
            raise AnnulusError(f"no scan is under way, the head is {self._state}")


class _Remember(Observer):
    """Keeps the last events for the report."""

    def __init__(self, account: Account) -> None:
        self._account = account

    def event(self, kind: str, text: str) -> None:
        self._account.events.append(text)
