"""One head from power-up to lamps off: the loop that ties controller, cameras, labels, recorder, workers, sensors and
viewers together.

One thread does everything here but wait for cameras and copy pictures. It waits for nobody: it sleeps until something
has come, or is due. Frames go

    camera -> intake process -> a slot of the ring -> label, when both its edges are known -> recorder, worker, viewers

and a slot is free again when the last of those is done with it. What the head may do when is state.py's table; a scan
is what lies between start and stop, and has a recording and an account of its own.
"""

import math
import secrets
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import zmq

from annulus_pipe.capture.camera import CameraDriver
from annulus_pipe.daemon.account import Account, ScanReport
from annulus_pipe.daemon.camera_feed import CameraFeed
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.controller_line import REST_S, ControllerLine, line_numbers
from annulus_pipe.daemon.intake import RESERVE, InSlot
from annulus_pipe.daemon.ledger import ExitStatus
from annulus_pipe.daemon.observer import Observer, Observers, Remember, whatever_happens
from annulus_pipe.daemon.operating import Operating
from annulus_pipe.daemon.pools import Reconstruction, Recorder, default_workers
from annulus_pipe.daemon.power import Power, power_up
from annulus_pipe.daemon.publishing import Publishing
from annulus_pipe.daemon.samples import SensorSamples, place_numbers, tell_place
from annulus_pipe.daemon.scanning import DRAIN_S, START_S, RunningScan
from annulus_pipe.daemon.state import State, StateEvent, next_state
from annulus_pipe.daemon.vitals import Turns, Vitals
from annulus_pipe.hooks import watch
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.sensors.sample import Sensor
from annulus_pipe.storage.calibration_file import require_size
from annulus_pipe.stream.frames import CHANNELS, FrameHeader
from annulus_pipe.vocabulary import AnnulusError, Label

TELEMETRY_S = 1.0
CHORES_S = 0.02  # between two looks at sensors, states and sockets


class Session:
    """`run` once; it gives everything back, however it ends."""

    def __init__(
        self,
        config: HeadConfig,
        cameras: Sequence[CameraDriver] | None = None,
        observer: Observer | None = None,
        *,
        sensors: Sequence[Sensor] = (),
        name: str = "",
    ) -> None:
        """`cameras`: by default those of the configuration, each in a process of its own; the caller's own are waited
        for in threads. They, in the order of the configuration's, and `sensors` become the session's: they are closed
        at the end. `name` of the recordings: by default their start, UTC.
        """
        if cameras is not None and len(cameras) != len(config.cameras):
            raise ValueError(f"{len(cameras)} cameras, but the configuration has {len(config.cameras)}")
        if config.calibration is not None:
            require_size(config.calibration, [(one.width, one.height) for one in cameras or config.cameras])
        self.config, self._cameras, self._sensors, self._name = config, cameras, sensors, name
        self._state = State.OFF
        self._account = Account()
        self.observers = Observers([Remember(self._account), *([observer] if observer is not None else [])])
        self._operating = Operating(self)
        watch(config, self.observers)
        self.navigation = Navigation(config.mm_per_count, config.max_speed_mm_s)
        self._samples = SensorSamples(sensors, self.navigation, self._account, self.observers)
        self._vitals: Vitals | None = None
        self._trouble = ""  # why the head is in fault
        self._power: Power | None = None
        self._scan: RunningScan | None = None  # the one under way, or being made ready
        self._reconstruction: Reconstruction | None = None
        self._next_telemetry = self._next_chores = 0.0
        self._turns = Turns()
        self._labelled: deque[tuple[FrameHeader, InSlot]] = deque()  # each in its slot, and not handed out yet
        self._report: ScanReport | None = None  # of the last scan
        self._number = 0  # of the scan under way, or the last
        self.newest_led: int | None = None  # index, of camera 0: what an operator saw when he marked a place
        self._problem = ""  # why the session cannot go on
        self.status = ExitStatus.FINE  # how the worst scan so far ended

    # ---- from beginning to end ----

    def run(self, stop: Callable[[], bool]) -> ScanReport:
        """Until `stop()` is true, or, without a control socket, the cameras have no more frames. `stop` is asked often;
        make it cheap. Returns what the last scan was.

        Raises AnnulusError when the head cannot be brought up; without a control socket also when the scan cannot
        begin, or a camera breaks.
        """
        with ExitStack() as stack:
            self._enter(StateEvent.POWER)
            stack.callback(self._enter, StateEvent.ENDED)
            try:
                self._power_up(stack)
                if self._become_ready(stop):
                    self._enter(StateEvent.READY)
                    if self.config.autostart:
                        self.start()
                while not (stop() or self._problem or self._is_over):
                    self._turn()
            finally:
                self._enter(StateEvent.END)
                self._end_scan()
                with whatever_happens(self.observers, "workers"):
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
        return self._scan.recorder if self._scan is not None else None

    @property
    def reconstruction(self) -> Reconstruction | None:
        return self._reconstruction

    @property
    def processes(self) -> dict[str, list[int]]:
        """Process ids of those that are up, by what they do."""
        pools = {
            "recorder": self.recorder,
            "worker": self._reconstruction,
            **(self._power.pools if self._power else {}),
        }
        up = {name: pool.pids for name, pool in pools.items() if pool is not None and pool.ready}
        spares = {f"{name} spare": pool.spare_pids for name, pool in pools.items() if pool is not None}
        spares["camera spare"] = [feed.spare_pid for feed in self._feeds if feed.spare_pid is not None]
        return {**up, **spares, "camera": [feed.pid for feed in self._feeds if feed.pid is not None]}

    def telemetry(self) -> dict[str, Any]:
        """Every counter there is, as plain types."""
        power = self._power
        intakes = self._scan.intakes if self._scan is not None else []
        cameras = [{**one.labelling.numbers(), **self._account.of_camera(i)} for i, one in enumerate(intakes)]
        pools = {"workers": self._reconstruction, "recorder": self.recorder, **(power.pools if power else {})}
        return {
            "state": self._state.value,
            **self._operating.numbers(),
            "scan": self._number,
            "seconds": round(self.seconds, 1),
            "recording": str(self._account.recordings[-1]) if self.has_scan and self._account.recordings else "",
            **self._turns.numbers(),
            **self._account.numbers(),
            **line_numbers(self.line),
            "place_gaps": self.navigation.odometer.gaps,
            **place_numbers(self.navigation.odometer),
            "cameras": cameras,
            "intakes": [feed.numbers() for feed in self._feeds],
            "sensors": self._samples.numbers(),
            "slots_free": power.shared.ring.free if power is not None else 0,
            "disk": self._vitals.numbers() if self._vitals is not None else {},
            **{name: pool.numbers() if pool is not None else {} for name, pool in pools.items()},
        }

    # ---- power ----

    def _power_up(self, stack: ExitStack) -> None:
        """Acquire everything; `stack` gives it back in reverse order."""
        config = self.config
        self._power = power = power_up(
            config, self._cameras, self._sensors, self._account, self.observers, self.navigation, stack
        )
        frames = sum(mode.width * mode.height * CHANNELS[mode.encoding] for mode in power.modes)
        self._vitals = Vitals(config, frames * config.timing.fps, self.observers)
        stack.callback(self._vitals.close)
        stack.callback(self._stop_pools)
        if config.autostart:
            self._prepare_scan(power)  # together with the workers: neither has to wait for the other
        if config.calibration is not None and config.calibration.frame_by_frame:
            self._reconstruction = Reconstruction(
                config.calibration,
                config.colour,
                config.workers or default_workers(),
                config.timing.period_us,
                power.shared,
                self._account,
                self.observers,
            )

    def _become_ready(self, stop: Callable[[], bool]) -> bool:
        """Until recorder and workers are up; False when asked to stop before."""
        end = time.monotonic() + START_S
        pools = [pool for pool in (self.recorder, self._reconstruction, self._publishing) if pool is not None]
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
        for pool in (self.recorder, self._reconstruction):
            if pool is not None:
                pool.stop(0.0)

    # ---- one scan ----

    def _prepare_scan(self, power: Power, record: bool = True) -> RunningScan:
        """Raises AnnulusError when there is no room for a recording."""
        if self._vitals is not None and record:
            self._vitals.require_space()
        config = self.config if record else replace(self.config, record_folder=None)
        self._scan = RunningScan(config, power, self._account, self.observers, self.navigation, self._name)
        return self._scan

    def start(self, record: bool = True) -> None:
        """Idle to armed; raises AnnulusError when that cannot be. Lamps and cameras follow once the recorder is up."""
        next_state(self._state, StateEvent.START)
        assert self._power is not None  # no state but off and powering is without
        scan = self._scan or self._prepare_scan(self._power, record)
        self._number, self.newest_led = secrets.randbits(32), None
        self.observers.begun(self._number)
        self._enter(StateEvent.START)
        scan.start()

    def pause(self) -> None:
        """Lamps off, then the cameras; the recording stays open. Raises AnnulusError when no scan is under way."""
        next_state(self._state, StateEvent.PAUSE)
        scan = self._scan
        assert scan is not None
        self._go_dark()
        scan.pause()
        for header, frame in scan.labelled(final=True):
            self._tell(header, frame)
        self._enter(StateEvent.PAUSE)

    def resume(self) -> None:
        """Cameras and lamps again. Raises AnnulusError when the scan is not paused."""
        next_state(self._state, StateEvent.RESUME)
        assert self._scan is not None
        self._enter(StateEvent.RESUME)
        self._scan.resume()

    def _fail(self, why: str) -> None:
        """The scan cannot go on. A session that can be told to start again does, another ends."""
        if self.config.control is None:
            self._problem = why
            return
        self.observers.event("scan", why)
        self.stop()

    def stop(self) -> None:
        """The scan ends, the session does not."""
        self._end_scan()
        self._enter(StateEvent.STOP)
        self._operating.ended()

    @property
    def _is_bursting(self) -> bool:
        """More frames than the recorder may hold have their labels at once, and there is room to let some wait."""
        has_room = self._power is not None and self._power.shared.ring.free >= RESERVE
        return self.recorder is not None and self.recorder.absorbs and has_room

    @property
    def _publishing(self) -> Publishing | None:
        return self._power.publishing if self._power is not None else None

    @property
    def line(self) -> ControllerLine | None:
        return self._power.line if self._power is not None else None

    @property
    def _feeds(self) -> Sequence[CameraFeed]:
        return self._power.feeds if self._power is not None else ()

    @property
    def has_scan(self) -> bool:
        """Whether one, or a trial, is under way."""
        return self._scan is not None and self._scan.started

    @property
    def scan(self) -> int | None:
        """The number of the one, or the trial, under way."""
        return self._number if self.has_scan else None

    @property
    def _is_over(self) -> bool:
        return self.config.control is None and self._scan is not None and self._scan.ended

    def _end_scan(self) -> None:
        """Lamps off first. Then everything in hand goes where it belongs, and the recording is closed."""
        scan = self._scan
        with whatever_happens(self.observers, "disarm"):
            self._go_dark()
        if not self._account.dark:
            self.status = ExitStatus.NOT_DARK
        for intake in scan.intakes if scan is not None else []:
            with whatever_happens(self.observers, "camera"):
                intake.stop()
                intake.take(self._account)
        self._account.end()
        with whatever_happens(self.observers, "labels"):
            for header, frame in scan.labelled(final=True) if scan is not None else ():
                self._tell(header, frame)
            while self._labelled:
                if scan is not None and scan.recorder is not None:
                    scan.recorder.poll()  # also what it gave back while cameras were stopped
                    if scan.recorder.absorbs:
                        scan.recorder.waitable.poll(10)
                        continue
                self._hand_out(*self._labelled.popleft())
        with whatever_happens(self.observers, "workers"):
            self._finish_reconstruction()
        self._scan = None if scan is None or (scan.recorder is None and not scan.intakes) else scan
        if self._scan is None:
            return
        self.observers.ending()
        telemetry = self.telemetry()
        self.observers.telemetry(telemetry)
        with whatever_happens(self.observers, "recorder"):
            self._scan.close_recording()
        self._report = self._account.report({**telemetry, **self._account.numbers()})
        for finding in self._report.findings:
            self.status = max(self.status, finding.status)
            if finding.status is ExitStatus.UNBALANCED:
                self.observers.event("ledger", finding.text)
        self.observers.ended(self._report)
        self._scan = None

    def _go_dark(self) -> None:
        """Lamps off; whether that is certain stands in the account."""
        if self.line is not None:
            self._account.dark = False
            for event in self.line.disarm():
                self.navigation.heard(event)
            self._account.dark = self.line.dark

    def _finish_reconstruction(self) -> None:
        """What waits for a worker still gets one, if they are quick."""
        if self._reconstruction is None:
            return
        self._reconstruction.no_more()
        end = time.monotonic() + DRAIN_S
        while self._reconstruction.busy and time.monotonic() < end:
            self._sleep()
            self._listen()
            self._reconstruction.turn()
        self._reconstruction.end_scan()

    # ---- one turn ----

    def _turn(self) -> None:
        self._sleep()
        began = time.monotonic()
        self._listen()
        if self._scan is None or not self._scan.intakes:
            for feed in self._feeds:
                feed.poll()
        if self._scan is not None:
            self._scan.take_in()
            for header, frame in self._scan.labelled():
                self._tell(header, frame)
            while self._labelled and not self._is_bursting:
                self._hand_out(*self._labelled.popleft())
        if self.recorder is not None:
            self.recorder.poll()
        if self._reconstruction is not None:
            self._reconstruction.turn()
        if self._publishing is not None:
            self._publishing.poll()
        now = time.monotonic()
        if now >= self._next_chores:
            self._next_chores = now + CHORES_S
            self._do_chores(now)
        self._turns.took(time.monotonic() - began)

    def _do_chores(self, now: float) -> None:
        """What can wait for some turns."""
        self._samples.poll(time.monotonic_ns(), lit=self.line is not None and self._state is State.SCANNING)
        self._watch()
        self._operating.turn()
        power = self._power
        if power is not None:
            power.doorkeeper.admit()
            if power.control is not None:
                self._account.lose(
                    "control_malformed", power.control.poll(self._operating.obey, lambda: self._state, self._how_it_is)
                )
        if now >= self._next_telemetry:
            self._next_telemetry = now + TELEMETRY_S
            telemetry = self.telemetry()
            self.observers.telemetry(telemetry)
            self._turns.restart()
            if self._vitals is not None and (why := self._vitals.look(telemetry, self._trouble, self.has_scan)):
                self._fail(why)

    def _sleep(self) -> None:
        """Until something has come, a frame, a word of the controller, a profile; or a chore is due. What recorder and
        publisher answer only frees slots: the next turn will do.
        """
        wait_s = min(REST_S, max(0.0, self._next_chores - time.monotonic()))
        sources: list[Any] = [feed.waitable for feed in self._feeds if feed.waitable is not None]
        if self.line is not None:
            wait_s = min(wait_s, self.line.patience_s)
            sources += [] if self.line.waitable is None else [self.line.waitable]
        sources += [] if self._reconstruction is None else [self._reconstruction.waitable]
        zmq.zmq_poll([(source, zmq.POLLIN) for source in sources], math.ceil(wait_s * 1000))

    def _listen(self) -> None:
        """What the controller has said."""
        line = self.line
        if line is None:
            return
        for event in line.pump():
            self.navigation.heard(event)
        tell_place(self.navigation.odometer, self.observers)

    def _tell(self, header: FrameHeader, frame: InSlot) -> None:
        """Its label goes to viewers at once: that takes no slot from anybody."""
        self._account.label(header)
        if header.label is Label.LED and header.camera == 0:
            self.newest_led = header.index
        if self._state is State.ARMED and header.label is not Label.UNKNOWN:
            self._enter(StateEvent.LABELLED)
        if self._publishing is not None:
            self._publishing.label(header)
        self._labelled.append((header, frame))

    def _hand_out(self, header: FrameHeader, frame: InSlot) -> None:
        """Recorder first: what is recorded can be reconstructed later, what is seen cannot be recorded later."""
        if self.recorder is not None:
            self.recorder.offer(header, frame.place)
        if self._publishing is not None:
            self._publishing.offer(header, frame.place)
        if self._reconstruction is not None:
            self._reconstruction.take(header, frame)
        assert self._power is not None  # frames lie in its ring
        ring = self._power.shared.ring
        self.observers.frame(header, ring.view(header, frame.place))
        ring.release(frame.place)

    # ---- states ----

    def _enter(self, event: StateEvent, why: str = "") -> None:
        self._state = next_state(self._state, event)
        self.observers.state(self._state, why)

    def _watch(self) -> None:
        """From what controller and cameras are like to what state the head is in."""
        scan = self._scan
        if scan is not None and scan.started and not (scan.armed or scan.paused) and (why := scan.come_up()):
            self._fail(why)
            scan = self._scan
        trouble = (self.line.trouble if self.line is not None else "") or (scan.trouble if scan is not None else "")
        self._trouble = trouble
        if trouble and self._state in (State.IDLE, State.ARMED, State.SCANNING):
            self._enter(StateEvent.FAULT, trouble)
        elif self._state is State.FAULT and not trouble and (self.line is None or self.line.settled):
            self._enter(StateEvent.RUNNING if self.has_scan else StateEvent.CLEARED)
        stopped = self.line.stopped if self.line is not None and scan is not None and scan.armed else ""
        if problem := stopped or (scan.problem if scan is not None else ""):
            self._fail(problem)
        elif self.config.control is not None and scan is not None and scan.ended and not scan.paused:
            self.stop()

    def _how_it_is(self) -> str:
        return str(self._vitals.health) if self._vitals is not None else ""

    def require_scan(self) -> None:
        """Raises AnnulusError when there is none."""
        if not self.has_scan:
            raise AnnulusError(f"no scan is under way, the head is {self._state}")
