"""What a session tells the program around it, as it happens: recorder, publisher, console, demo and tests all listen
through this one protocol.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from annulus_pipe.daemon.account import Account, ScanReport
from annulus_pipe.daemon.health import HeadHealth
from annulus_pipe.daemon.state import State
from annulus_pipe.job import JobSheet
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.wall.profile import Profile


@dataclass(frozen=True, slots=True)
class Commanded:
    """What an operator asked for that changes something, and what became of it."""

    host_ns: int
    name: str  # as he says; empty where nobody said who asks
    id: str  # by which the daemon tells two of one name apart; not his own, which is secret
    peer: str  # the address that asked
    address: str  # where he says he sits, behind a console
    asked: Mapping[str, Any]
    outcome: str  # "done", or why not
    left_out: int = 0  # requests before it that came too fast to be written down

    def __str__(self) -> str:
        details = ", ".join(f"{key} {value}" for key, value in self.asked.items() if key != "do")
        who = f"{self.name} ({self.id})" if self.name else "somebody"
        where = f"{self.address} by {self.peer}" if self.address else self.peer
        more = f"; {self.left_out} before it left out" if self.left_out else ""
        return f"{self.asked['do']}{f' ({details})' if details else ''}, {who} from {where}: {self.outcome}{more}"

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Mark:
    """What the operator wants to find again."""

    host_ns: int
    z_mm: float | None  # of the head; None before an edge was heard
    text: str
    clock_deg: float | None  # around the pipe, 0 = 12 o'clock, clockwise looking forward; None: all around
    photo: bytes = b""  # a JPEG of the operator's
    frame: int | None = None  # the newest one lit by the LED ring when it was made, ..
    camera: int = 0  # .. of this camera

    def to_dict(self) -> dict[str, Any]:
        """Plain types; without a photo where there is none."""
        return {name: value for name, value in asdict(self).items() if name != "photo" or value}


class Observer:
    """Override what is of interest. All is called from the session's thread: be quick, and do not raise."""

    def begun(self, scan: int) -> None:
        """A scan, or a trial, begins; a number drawn for it, 32 bits."""

    def state(self, state: State, why: str) -> None:
        """The head is now in this state."""

    def event(self, kind: str, text: str) -> None:
        """Something an operator should know."""

    def frame(self, header: FrameHeader, image: Image) -> None:
        """A frame got its label. `image` is shared memory, valid during the call."""

    def profile(self, profile: Profile) -> None:
        """A frame was reconstructed; in the order of frames."""

    def sample(self, sample: Sample) -> None:
        """A sensor was read."""

    def mark(self, mark: Mark) -> None:
        """The operator marked a place."""

    def commanded(self, what: Commanded) -> None:
        """Somebody asked for something. Never published: who looks on need not know from where."""

    def job(self, sheet: JobSheet) -> None:
        """What is known of the job from now on."""

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        """Once a second: every counter there is, as plain types."""

    def health(self, health: HeadHealth) -> None:
        """Once a second: how the head is, in one word."""

    def ending(self) -> None:
        """A scan's last frame and profile were handed out; its recording still takes what is said now."""

    def ended(self, report: ScanReport) -> None:
        """A scan is over and its recording closed."""


class Observers(Observer):
    """Tells several, in their order."""

    def __init__(self, observers: Sequence[Observer]) -> None:
        self.all = list(observers)

    def begun(self, scan: int) -> None:
        for one in self.all:
            one.begun(scan)

    def state(self, state: State, why: str) -> None:
        for one in self.all:
            one.state(state, why)

    def event(self, kind: str, text: str) -> None:
        for one in self.all:
            one.event(kind, text)

    def frame(self, header: FrameHeader, image: Image) -> None:
        for one in self.all:
            one.frame(header, image)

    def profile(self, profile: Profile) -> None:
        for one in self.all:
            one.profile(profile)

    def sample(self, sample: Sample) -> None:
        for one in self.all:
            one.sample(sample)

    def mark(self, mark: Mark) -> None:
        for one in self.all:
            one.mark(mark)

    def commanded(self, what: Commanded) -> None:
        for one in self.all:
            one.commanded(what)

    def job(self, sheet: JobSheet) -> None:
        for one in self.all:
            one.job(sheet)

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        for one in self.all:
            one.telemetry(numbers)

    def health(self, health: HeadHealth) -> None:
        for one in self.all:
            one.health(health)

    def ending(self) -> None:
        for one in self.all:
            one.ending()

    def ended(self, report: ScanReport) -> None:
        for one in self.all:
            one.ended(report)


class Remember(Observer):
    """Keeps the last events for the report."""

    def __init__(self, account: Account) -> None:
        self._account = account

    def event(self, kind: str, text: str) -> None:
        self._account.events.append(text)


@contextmanager
def whatever_happens(observer: Observer, step: str) -> Iterator[None]:
    """A step of the ending that fails does not keep the next ones from being done."""
    try:
        yield
    except Exception as error:
        observer.event("ending", f"ending, {step}: {type(error).__name__}: {error}")
