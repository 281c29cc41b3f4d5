"""What the wiring of a head wants of the controller's pins, beside lamps and their times."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from annulus_pipe.controller import (
    PIN_CAMERA_TRIGGER,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_PROJECTOR,
    PIN_SLIDE_2,
    PIN_SLIDE_3,
    PIN_SLIDE_4,
    PIN_TRIGGER,
    SLIDES_MAX,
    TICKS_PER_US,
)
from annulus_pipe.link.messages import CameraTrigger, Polarity, PolarityFlag, Slides, SlidesLitReply, WiringReply
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError

INVERTIBLE = tuple(flag.name.lower() for flag in PolarityFlag if flag.name)
"""By name; no input that watches over anything is among them: a broken wire must say unsafe."""


NONE = PolarityFlag(0)


@dataclass(frozen=True, slots=True)
class Pins:
    """`inverted`: pins whose driver, or source, means the other level. `trigger_ticks`: how long a trigger for cameras
    lasts; 0: cameras run by themselves. `trigger_delay_ticks`: after the edge of the sync input that begins it; 0: one
    a frame period. `slides`: how many are lit in turn, each by a lamp of its own.
    """

    inverted: PolarityFlag = NONE
    trigger_ticks: int = 0
    trigger_delay_ticks: int = 0
    slides: int = 1

    def triggering(self, trigger: str, width_us: float, delay_us: float = 0.0) -> "Pins":
        """With triggers that last so long, for a camera of this kind of daemon.camera_config.Trigger."""
        low = PolarityFlag.CAMERA_TRIGGER if trigger.startswith("xtrig") else NONE  # an inverter on the way says so too
        ticks = (round(width_us * TICKS_PER_US), round(delay_us * TICKS_PER_US))
        return Pins(self.inverted ^ low, *ticks, self.slides)

    def polarity(self, generation: int) -> Polarity:
        """The command that tells the controller so, for the staged configuration."""
        return Polarity(generation, self.inverted)

    def trigger(self, generation: int) -> CameraTrigger:
        return CameraTrigger(generation, self.trigger_ticks, self.trigger_delay_ticks)

    def shared(self, generation: int) -> Slides:
        return Slides(generation, self.slides)

    def slides_problem(self, found: SlidesLitReply, generation: int) -> str:
        """Empty when so many slides are lit in turn with that configuration; else one line."""
        if (found.generation, found.count) == (generation, self.slides):
            return ""
        return (
            f"{found.count} slides are lit in turn with configuration {found.generation}, expected {self.slides} with"
            f" {generation}"
        )

    def problem(self, found: WiringReply, generation: int) -> str:
        """Empty when this is in force with that configuration; else one line."""
        triggers = (found.camera_trigger, found.camera_trigger_delay)
        expected = (self.trigger_ticks, self.trigger_delay_ticks)
        if (found.generation, found.inverted, triggers) == (generation, self.inverted, expected):
            return ""
        if found.inverted == self.inverted:
            return (
                f"the camera trigger with configuration {found.generation} is {_trigger_text(*triggers)}, expected"
                f" {_trigger_text(*expected)} with {generation}"
            )
        return (
            f"the pins inverted with configuration {found.generation} are {pins_text(found.inverted)}, expected"
            f" {pins_text(self.inverted)} with {generation}"
        )

    @property
    def pulled_up(self) -> list[tuple[int, int]]:
        """(pin, 1) of each output that a resistor outside must keep at its dark level while nobody drives it."""
        slides = SLIDE_PINS[1 : self.slides] if PolarityFlag.PROJECTOR in self.inverted else ()
        return [(pin, 1) for pin in (*(pin for flag, pin in OUTPUTS.items() if flag in self.inverted), *slides)]


def _trigger_text(width: int, delay: int) -> str:
    after = f" and {delay / TICKS_PER_US:g} us after the edge" if delay else ""
    return f"{width / TICKS_PER_US:g} us long{after}"


OUTPUTS = {
    PolarityFlag.PROJECTOR: PIN_PROJECTOR,
    PolarityFlag.LED: PIN_LED,
    PolarityFlag.MICROWAVE: PIN_MICROWAVE,
    PolarityFlag.TRIGGER: PIN_TRIGGER,
    PolarityFlag.CAMERA_TRIGGER: PIN_CAMERA_TRIGGER,
}
SLIDE_PINS = (PIN_PROJECTOR, PIN_SLIDE_2, PIN_SLIDE_3, PIN_SLIDE_4)
"""The lamp's output of each slide."""

AS_WIRED = Pins()


def pins_list(pins: PolarityFlag) -> list[str]:
    return [name for name in INVERTIBLE if PolarityFlag[name.upper()] in pins]


def pins_text(pins: PolarityFlag) -> str:
    return " ".join(pins_list(pins)) or "none"


def pins_from(data: Mapping[str, Any]) -> Pins:
    """Of asdict()."""
    ticks = [int(data.get(name, 0)) for name in ("trigger_ticks", "trigger_delay_ticks")]
    return Pins(PolarityFlag(data.get("inverted", 0)), ticks[0], ticks[1], int(data.get("slides", 1)))


def check_slides(slides: int, ratio: int) -> None:
    """ValueError where the cycle cannot light so many slides equally often."""
    if slides > 1 and (slides > ratio or ratio % slides):
        fit = [n for n in range(2, SLIDES_MAX + 1) if ratio and ratio % n == 0]
        one_of = f"1{''.join(f', {n}' for n in fit)}"
        raise ValueError(f"{slides} slides do not share {ratio} projector frames a cycle evenly, expected {one_of}")


def pins_of(text: str) -> Pins:
    """Of names with commas between them, or none. Raises AnnulusError."""
    names = [] if text == "none" else [name.strip() for name in text.split(",")]
    for name in names:
        if name not in INVERTIBLE:
            raise AnnulusError(f"pin {shown(name)} cannot be inverted, expected none or of {', '.join(INVERTIBLE)}")
    if len(set(names)) < len(names):
        raise AnnulusError(f"inverted pins are {shown(text)}, expected each once")
    return Pins(pins_named(names))


def pins_named(names: Iterable[str]) -> PolarityFlag:
    """Of INVERTIBLE."""
    flags = PolarityFlag(0)
    for name in names:
        flags |= PolarityFlag[name.upper()]
    return flags
