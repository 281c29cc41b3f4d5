"""The controller and its line, in service: identified, opened again when it breaks, and what it says told to people."""

import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from annulus_pipe.controller import LAMP_DUTY_MAX_PERMILLE, LAMP_WIDTH_MAX_TICKS, TICKS_PER_US
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import HeadConfig, LampConfig
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.request import LAMP_KEYS
from annulus_pipe.link.head import HeadControl, HeadEvent, PhaseChanged
from annulus_pipe.link.messages import (
    Fault,
    Interlock,
    InterlockFlag,
    Preamble,
    Stage,
    StateFlag,
    SyncFound,
    SyncLost,
    TurntableStopped,
)
from annulus_pipe.link.operate import why_it_stopped
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.pins import AS_WIRED, Pins, pins_named
from annulus_pipe.link.port import Port, PortOpening
from annulus_pipe.link.preamble import preamble_of
from annulus_pipe.link.problems import too_old
from annulus_pipe.link.session import EventReceived, EventsLost, Rebooted
from annulus_pipe.link.stage import stage_from_us
from annulus_pipe.vocabulary import AnnulusError

TURN_S = 0.002  # at most between two looks at a line that cannot wake us: what comes in is stamped when it is read
REST_S = 0.02  # at most between two looks at one that can: pings, repeats and keep-alives are due in 50 ms or more
IDENTIFY_S = 1.0
REOPEN_S = 1.0
DISARM_S = 0.5
CONFIGURE_S = 1.0
TOLERANCE_PERMILLE = 100  # of the frame period, in which an edge is taken for one
CONFIRMED = (Phase.IDLE, Phase.STOPPED)  # that it is dark
DARK = (*CONFIRMED, Phase.REFUSED, Phase.MISMATCH)
TROUBLED = (Phase.SEARCHING, Phase.CLEARING, Phase.REFUSED, Phase.MISMATCH)


class ControllerLine:
    """One controller behind one port. Nothing here waits but `identify` and `disarm`."""

    def __init__(
        self,
        url: str,
        stage: Stage,
        account: Account,
        observer: Observer,
        preamble: Preamble | None = None,
        pins: Pins = AS_WIRED,
        interlock: Interlock | None = None,
    ) -> None:
        """Raises AnnulusError when the port cannot be opened."""
        self.url, self._account, self._observer = url, account, observer
        self.head = HeadControl(stage, armed=False, preamble=preamble, pins=pins, interlock=interlock)
        self._port: Port | None = Port(url)
        self._opening: PortOpening | None = None
        self._reopen_s = 0.0
        self._why_shut = ""
        self._armed = False
        self._told_of_preambles = False

    def identify(self) -> list[HeadEvent]:
        """What was heard meanwhile. Raises AnnulusError when nobody, or somebody else, answers."""
        assert self._port is not None
        heard: list[HeadEvent] = []
        end = time.monotonic() + IDENTIFY_S
        while self.head.identity is None and time.monotonic() < end:
            heard += self._announced(self._port.pump(self.head, TURN_S))
        if self.head.identity is None:
            damaged = sum(self.head.session.counters.corrupt.values())
            answer = f"{damaged} damaged frames and no answer" if damaged else "no answer"
            raise AnnulusError(f"{self.url}: {answer} to identify within {IDENTIFY_S:g} s. Is this the controller?")
        if self.head.phase is Phase.MISMATCH:
            raise AnnulusError(f"{self.url}: {self.head.problem}")
        return heard

    @property
    def waitable(self) -> int | None:
        """Readable when the controller has said something; None where nothing tells."""
        return self._port.waitable if self._port is not None else None

    @property
    def patience_s(self) -> float:
        """`pump` again after so long at the latest, even when `waitable` has nothing."""
        return REST_S if self._port is None or (self.waitable is not None and self.settled) else TURN_S

    def pump(self, wait_s: float = 0.0) -> list[HeadEvent]:
        """One turn. A line that breaks is opened again, every second; frames meanwhile are unknown."""
        if self._port is None:
            self._port = self._reopened()
            if self._port is None:
                return []
            self.head.reopened()
            self._observer.event("link", f"{self.url}: the line is back")
        try:
            return self._announced(self._port.pump(self.head, wait_s))
        except AnnulusError as error:
            self.close()
            self._reopen_s = time.monotonic() + REOPEN_S
            self._account.lose("line_broken")
            self._observer.event("link", str(error))
            return []

    def _reopened(self) -> Port | None:
        """The port, once it is open again; tried every REOPEN_S, by a thread that waits so that nobody else does."""
        if self._opening is None:
            if time.monotonic() < self._reopen_s:
                return None
            self._opening = PortOpening(self.url)
        try:
            port = self._opening.poll()
        except AnnulusError as error:
            port, self._why_shut = None, str(error)
            self._reopen_s = time.monotonic() + REOPEN_S
            self._opening = None
        if port is not None:
            self._opening, self._why_shut = None, ""
        return port

    def arm(self) -> None:
        """Lamps on, and kept on across restarts and faults. `pump` sees to it."""
        self._armed = True
        self.head.arm()

    def order_preamble(self) -> None:
        """A camera doubts which frame is which: an optical preamble soon. Ask as often as you like."""
        self.head.order_preamble()

    @property
    def stopped(self) -> str:
        """Who made it dark, when it was not us: it stays so until `arm`. Empty else."""
        return f"{self.url}: {self.head.problem}" if self.head.phase is Phase.STOPPED else ""

    def configure(self, stage: Stage, preamble: Preamble | None) -> list[HeadEvent]:
        """Other lamps, read back, and armed again where they were; what was heard until then. `refusal` says whether
        the controller took them. Not for a scan under way: it waits, and it is dark in between.
        """
        self.head.preambles.wanted = preamble
        self.head.configure(stage)
        heard: list[HeadEvent] = []
        end = time.monotonic() + CONFIGURE_S
        while not self.settled and not self.refusal and self._port is not None and time.monotonic() < end:
            heard += self.pump(TURN_S)
        return heard

    @property
    def refusal(self) -> str:
        """Why the controller does not take the lamps asked for, one line; empty when it does, or was not asked yet."""
        return self.head.problem or self.head.phase.value if self.head.phase in (Phase.REFUSED, Phase.MISMATCH) else ""

    @property
    def interlock(self) -> str:
        """ "closed", "open", or "unknown" where the controller has not been heard."""
        status = self.head.status
        if self._port is None or status is None:
            return "unknown"
        return "open" if status.state & StateFlag.INTERLOCK_OPEN else "closed"

    def disarm(self) -> list[HeadEvent]:
        """Lamps off, and kept off; what was heard until the controller said so. Tells when it does not."""
        self._armed = False
        if self.head.identity is None:
            return []
        self.head.disarm()
        heard: list[HeadEvent] = []
        end = time.monotonic() + DISARM_S
        while self._port is not None and self.head.phase not in DARK and time.monotonic() < end:
            heard += self.pump(TURN_S)
        if self.head.phase not in CONFIRMED:
            why = self.head.phase.value if self._port is not None else "the line is broken"
            self._observer.event("lamps", f"the controller did not confirm that the lamps are off ({why})")
        return heard

    @property
    def trouble(self) -> str:
        """What is wrong with the line, one line of text; empty when nothing is, or while it is coming up."""
        if self._port is None:
            return self._why_shut or f"{self.url}: the line is broken"
        if self.head.phase in TROUBLED:
            return f"{self.url}: {self.head.problem or self.head.phase.value}"
        return ""

    @property
    def dark(self) -> bool:
        """Whether the lamps are off for certain: the controller has said so, or there never was one."""
        return self.head.identity is None or (self._port is not None and self.head.phase is Phase.IDLE)

    @property
    def settled(self) -> bool:
        """Whether it is as wanted: lamps armed, or dark."""
        return self._port is not None and self.head.phase in ((Phase.RUNNING,) if self._armed else CONFIRMED)

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None
        if self._opening is not None:
            self._opening.abandon()
            self._opening = None

    def _announced(self, heard: list[HeadEvent]) -> list[HeadEvent]:
        """Tell people what concerns them."""
        tell = self._observer.event
        for one in heard:
            match one:
                case Rebooted(boot, previous, why) if previous is not None:
                    armed = "; lamps are armed again" if self._armed else ""
                    boots = f"boot {previous} -> {boot}" if boot != previous else f"boot {boot} again, told by: {why}"
                    tell("reset", f"the controller restarted ({boots}){armed}")
                case EventsLost(first, count):
                    self._account.lose("edge_events", count)
                    tell("events_lost", f"{count} events of the controller are lost, from number {first}")
                case PhaseChanged(phase, why) if why or phase in (Phase.RUNNING, Phase.IDLE):
                    tell("head", f"{phase.value}{': ' if why else ''}{why}")
                case EventReceived(event) if isinstance(event, Fault):
                    tell("fault", f"fault {event.fault.name.lower()}, detail {event.detail}")
                case EventReceived(event) if isinstance(event, SyncLost):
                    tell("sync", f"no frame-sync edge since edge {event.last_edge}")
                case EventReceived(event) if isinstance(event, SyncFound):
                    tell("sync", f"frame-sync is regular from edge {event.edge} on")
                case EventReceived(event) if isinstance(event, TurntableStopped):
                    tell("turntable", why_it_stopped(event))
        if self.head.lacks_preamble and not self._told_of_preambles:
            self._told_of_preambles = True
            tell("preamble", too_old(Preamble))
        return heard


def with_lamps(lamps: LampConfig, asked: Mapping[str, float]) -> LampConfig:
    """A configuration with some of its times another."""
    values: dict[str, Any] = dict(asdict(lamps))
    values.update({name: int(value) if name == "ratio" else value for name, value in asked.items()})
    return LampConfig(**values)


def lamp_numbers(lamps: LampConfig) -> dict[str, float]:
    """What of it a request may change."""
    return {name: getattr(lamps, name) for name in LAMP_KEYS}


def check_lamps(config: HeadConfig, *, window: bool) -> None:
    """What head.toml, or somebody who tries lamps out, asks for. Raises AnnulusError when a flash leaves the window in
    which all rows expose (`window`), or what the controller lets a lamp do at all.
    """
    lamps, timing = config.lamps, config.timing
    if window:
        lamps.check(timing)
    longest = min(LAMP_WIDTH_MAX_TICKS / TICKS_PER_US, LAMP_DUTY_MAX_PERMILLE / 1e3 * _shortest_us(config))
    for lamp, delay, width in (
        ("projector flash", lamps.projector_delay_us, lamps.projector_width_us),
        ("LED flash", lamps.led_delay_us, lamps.led_width_us),
    ):
        if width > longest:
            raise AnnulusError(f"{lamp} of {width:g} us: the controller fires no longer than {longest:g} us")
        if delay + width > _shortest_us(config):
            raise AnnulusError(f"{lamp} {delay:g}..{delay + width:g} us reaches into the next frame")


def tolerance_permille(config: HeadConfig) -> int:
    camera = config.cameras[0]
    return (
        TOLERANCE_PERMILLE if camera.trigger == "none" else camera.timing.triggered(camera.trigger).tolerance_permille
    )


def _shortest_us(config: HeadConfig) -> float:
    """From one edge to the next that the controller takes for one."""
    return config.timing.period_us * (1 - tolerance_permille(config) / 1000)


def stage_of(config: HeadConfig, *, window: bool = True) -> Stage:
    """The lamp configuration that head.toml asks for. Without `window` flashes may lie where not all rows expose, as
    they must to find out where all do: then the controller is told of a camera whose rows are open all the time. Its
    limits of width and duty hold as ever.
    """
    timing, lamps = config.timing, config.lamps
    stage = stage_from_us(
        ratio=lamps.ratio,
        period_us=timing.period_us,
        exposure_us=timing.exposure_us if window else timing.period_us,
        readout_us=timing.readout_us if window else 0.0,
        projector_us=(lamps.projector_delay_us, lamps.projector_width_us),
        led_us=(lamps.led_delay_us, lamps.led_width_us),
        tolerance_permille=tolerance_permille(config),
    )
    return replace(stage, host_timeout=lamps.host_timeout_ms)


def preamble_for(config: HeadConfig) -> Preamble | None:
    """The optical preambles that head.toml asks for."""
    lamps = config.lamps
    if lamps.preamble_frames == 0:
        return None
    return preamble_of(stage_of(config), lamps.preamble_frames, lamps.preamble_interval_s)


def interlock_for(config: HeadConfig) -> Interlock | None:
    """The interlock's inputs that head.toml names."""
    return Interlock(InterlockFlag.ANTIVALENT) if config.interlock_antivalent else None


def pins_for(config: HeadConfig) -> Pins:
    """What head.toml says of the wiring."""
    pins, trigger = Pins(pins_named(config.inverted), slides=config.lamps.slides), config.cameras[0].trigger
    if trigger == "none":
        return pins
    triggers = config.cameras[0].timing.triggered(trigger)
    return pins.triggering(trigger, triggers.width_us, triggers.delay_us)


def line_numbers(line: ControllerLine | None) -> dict[str, object]:
    """For the telemetry; also of a head without a controller."""
    head = line.head if line is not None else None
    return {
        "interlock": line.interlock if line is not None else "unknown",
        "phase": head.phase.value if head is not None else "none",
        "problem": head.problem if head is not None else "",
        "link": head.session.counters.as_dict() if head is not None else {},
        "boot_epochs": head.boot_epoch if head is not None else 0,
        "rearms": head.rearms if head is not None else 0,
        "preambles_ordered": head.preambles.count if head is not None else 0,
        "edges_unplaced": head.edges_unplaced if head is not None else 0,
        "clock_samples_rejected": head.clock.rejected if head is not None else 0,
    }
