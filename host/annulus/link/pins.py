"""What the wiring of a head wants of the controller's pins, beside lamps and their times."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from annulus.controller import PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_TRIGGER
from annulus.link.messages import Polarity, PolarityFlag, WiringReply
from annulus.untrusted import shown
from annulus.vocabulary import AnnulusError

INVERTIBLE = tuple(flag.name.lower() for flag in PolarityFlag if flag.name)
"""By name; no input that watches over anything is among them: a broken wire must say unsafe."""


NONE = PolarityFlag(0)


@dataclass(frozen=True, slots=True)
class Pins:
    """`inverted`: pins whose driver, or source, means the other level."""

    inverted: PolarityFlag = NONE

    def polarity(self, generation: int) -> Polarity:
        """What says so, of the configuration that is staged."""
        return Polarity(generation, self.inverted)

    def problem(self, found: WiringReply, generation: int) -> str:
        """Empty when this is in force with that configuration; else one line."""
        if (found.generation, found.inverted) == (generation, self.inverted):
            return ""
        return (
            f"the pins inverted with configuration {found.generation} are {pins_text(found.inverted)}, expected"
            f" {pins_text(self.inverted)} with {generation}"
        )

    @property
    def pulled_up(self) -> list[tuple[int, int]]:
        """(pin, 1) of each output that a resistor outside must keep at its dark level while nobody drives it."""
        return [(pin, 1) for flag, pin in OUTPUTS.items() if flag in self.inverted]


OUTPUTS = {
    PolarityFlag.PROJECTOR: PIN_PROJECTOR,
    PolarityFlag.LED: PIN_LED,
    PolarityFlag.MICROWAVE: PIN_MICROWAVE,
    PolarityFlag.TRIGGER: PIN_TRIGGER,
}
AS_WIRED = Pins()


def pins_list(pins: PolarityFlag) -> list[str]:
    return [name for name in INVERTIBLE if PolarityFlag[name.upper()] in pins]


def pins_text(pins: PolarityFlag) -> str:
    return " ".join(pins_list(pins)) or "none"


def pins_from(data: Mapping[str, Any]) -> Pins:
    """Of asdict()."""
    return Pins(PolarityFlag(data.get("inverted", 0)))


def pins_of(text: str) -> Pins:
    """Of names with commas between them, or none. Raises AnnulusError."""
    names = [] if text == "none" else [name.strip() for name in text.split(",")]
    for name in names:
        if name not in INVERTIBLE:
            raise AnnulusError(f"pin {shown(name)} cannot be inverted, expected none or of {', '.join(INVERTIBLE)}")
    return Pins(pins_named(names))


def pins_named(names: Iterable[str]) -> PolarityFlag:
    """Of INVERTIBLE."""
    flags = PolarityFlag(0)
    for name in names:
        flags |= PolarityFlag[name.upper()]
    return flags
