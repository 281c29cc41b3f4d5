"""One scan, from start to stop: its recorder, its cameras, the lamps, in this order up.

scan = RunningScan(config, power, account, observers, navigation, name)   # its recorder is on its way up
scan.start()                                      # now cameras and lamps may follow
while not scan.armed:
    why = scan.come_up()                          # not empty: it cannot go on
scan.take_in()                                    # each turn: frames into the ring
for header, frame in scan.labelled():
    ..
"""

import time
from collections.abc import Iterator
from datetime import UTC, datetime

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.disk import GB
from annulus_pipe.daemon.evidence import Evidence
from annulus_pipe.daemon.intake import InSlot, Intake
from annulus_pipe.daemon.observer import Observers
from annulus_pipe.daemon.pools import Recorder, RecordingSetup
from annulus_pipe.daemon.power import Power
from annulus_pipe.daemon.rotation import Bounds
from annulus_pipe.labelling.labelling import Labelling
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.phase import Phase
from annulus_pipe.stream.frames import FrameHeader

START_S = 200.0  # on a fresh machine workers compile first
ARM_S = 5.0
OPEN_S = 20.0  # for the cameras to stream
DRAIN_S = 8.0
NO_PREAMBLE = (
    "[lamps] preamble_frames = 0: after a camera that began anew or fell silent nothing tells which flash lit which"
    " frame, and frames may stay unknown for the rest of the scan. 15 is usual"
)


class RunningScan:
    """What a scan has of its own. The account is restarted for it."""

    def __init__(
        self,
        config: HeadConfig,
        power: Power,
        account: Account,
        observers: Observers,
        navigation: Navigation,
        name: str,
    ) -> None:
        """`name` of the recording; empty: its start, UTC."""
        self.recorder: Recorder | None = None
        self.intakes: list[Intake] = []  # none before the cameras run
        self.armed = False  # the controller has confirmed
        self.paused = False
        self._evidence: Evidence | None = None
        self._power, self._account = power, account
        self._blind = config.lamps.preamble_frames == 0
        self._observers, self._navigation = observers, navigation
        self._start_by = 0.0  # when recorder, cameras, or lamps, must be up
        self._lit = False  # lamps were asked for
        account.restart()
        if config.record_folder is not None:
            name = name or datetime.now(UTC).strftime("scan-%Y%m%d-%H%M%S")
            calibration = None if config.calibration is None else config.calibration.to_dict()
            record = config.record
            bounds = Bounds(60.0 * record.part_minutes, GB * record.part_gb, record.sync_s)
            setup = RecordingSetup(
                config.record_folder,
                name,
                calibration,
                config.to_dict(),
                bounds,
                codec=record.codec,
                realtime=config.realtime,
            )
            self.recorder = Recorder(setup, power.shared, account, observers)
            observers.all.insert(0, self.recorder)
            head = power.line.head if power.line is not None else None
            self._evidence = Evidence(self.recorder.note, navigation, account, config, power.modes, head)

    @property
    def started(self) -> bool:
        return self._start_by > 0.0

    @property
    def ended(self) -> bool:
        """The cameras have no more frames, and none waits."""
        return bool(self.intakes) and all(intake.ended for intake in self.intakes)

    @property
    def trouble(self) -> str:
        """What a camera lacks that may come back."""
        return next((intake.trouble for intake in self.intakes if intake.trouble), "")

    @property
    def problem(self) -> str:
        """Why a camera gave up."""
        return next((intake.problem for intake in self.intakes if intake.problem), "")

    def start(self) -> None:
        """Lamps and cameras follow once the recorder is up."""
        if self._power.line is not None and self._blind:
            self._observers.event("labels", NO_PREAMBLE)
        self._start_by = time.monotonic() + START_S

    def come_up(self) -> str:
        """What is still missing of a scan that was started: recorder, cameras, lamps, in this order. Returns why it
        cannot go on, one line.
        """
        late = time.monotonic() > self._start_by
        if not self.intakes:
            recorder = self.recorder
            if recorder is None or recorder.ready:
                self._open_cameras()
            elif recorder.broken or late:
                return recorder.broken or f"the recorder is not ready after {START_S:g} s"
        elif not self._lit:
            if late:
                return f"the cameras do not stream after {OPEN_S:g} s"
            if all(intake.is_open for intake in self.intakes):
                self._light_up()
        elif self._power.line is not None:
            line = self._power.line
            self.armed = line.head.phase is Phase.RUNNING
            if line.head.phase is Phase.REFUSED or (late and not self.armed):
                why = line.head.problem or f"still {line.head.phase.value} after {ARM_S:g} s"
                return f"{line.url}: the lamps cannot be armed: {why}"
        return ""

    def pause(self) -> None:
        """Cameras rest; lamps are off already. What they brought is still to be labelled."""
        for intake in self.intakes:
            intake.stop()
            intake.take(self._account)
        self.armed = self._lit = False
        self.paused = True

    def resume(self) -> None:
        """Cameras, then lamps, as at the start."""
        self.paused = False
        self._start_by = time.monotonic() + (OPEN_S if self.intakes else START_S)  # paused before the recorder was up
        for intake in self.intakes:
            intake.go_on()

    def take_in(self) -> None:
        """What the cameras brought, into the ring."""
        for intake in self.intakes:
            intake.take(self._account)
            intake.labelling.look_for_offset(time.monotonic())
            if intake.labelling.wants_preamble and self._power.line is not None:
                self._power.line.order_preamble()
        if self._evidence is not None:
            self._evidence.turn(time.monotonic())

    def labelled(self, final: bool = False) -> Iterator[tuple[FrameHeader, InSlot]]:
        """Frames whose label is settled; all of them when `final`."""
        for intake in self.intakes:
            yield from intake.labelled(final)

    def close_recording(self) -> None:
        """What the recorder has in hand is written, and its file ended."""
        if self._evidence is not None:
            self._evidence.close()
        if self.recorder is not None:
            self.recorder.finish(DRAIN_S)
            self._observers.all.remove(self.recorder)

    def _open_cameras(self) -> None:
        """Cameras first, then the lamps: the controller needs the cameras' sync edges."""
        self._start_by = time.monotonic() + OPEN_S
        for feed, mode in zip(self._power.feeds, self._power.modes, strict=True):
            alone = self._power.line is None
            labelling = Labelling(
                mode, self._navigation, self._observers.event, alone, preambles=not (alone or self._blind)
            )
            self.intakes.append(Intake(feed, mode, labelling, self._power.shared.ring))
            self.intakes[-1].start()
        self._account.begin()

    def _light_up(self) -> None:
        self._lit = True
        self._start_by = time.monotonic() + ARM_S
        self.armed = self._power.line is None
        if self._power.line is not None:
            self._power.line.arm()
