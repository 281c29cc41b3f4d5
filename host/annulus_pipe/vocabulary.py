"""The words every room speaks. Types, and one phrase; the names follow the glossary in README.md."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag, StrEnum
from typing import NewType

from annulus_pipe.untrusted import one_line

EdgeIndex = NewType("EdgeIndex", int)  # counts accepted sync edges since boot; never compare with CameraSequence
CameraSequence = NewType("CameraSequence", int)  # the driver's frame counter; has holes where the driver dropped
Slot = NewType("Slot", int)  # 0..R, place in the projector/LED cycle; with EdgeFlag.PREAMBLE 0..62, place in a preamble
Tick = NewType("Tick", int)  # controller time since boot, extended to 64 bits


class Lamp(IntEnum):
    """What the controller lit after an edge. DARK: armed but nothing fired (see the edge's flags)."""

    DARK = 0
    PROJECTOR = 1
    LED = 2


class Label(StrEnum):
    """What lit a frame. UNKNOWN is a legal answer; a wrong one is not."""

    PROJECTOR = "projector"
    LED = "led"
    UNKNOWN = "unknown"


class EdgeFlag(IntFlag):
    """What is special about an edge (protocol/messages.toml, EDGE.flags): why it may not be trusted for labelling."""

    LATE_LOAD = 1  # the flash was not loaded in time: dark frame
    IRREGULAR = 2  # interval to the previous edge outside the tolerance
    FIRST = 4  # no previous edge to qualify against
    DISARMED = 8  # lamps not armed: dark frame on purpose
    PREAMBLE = 16  # no doubt: of an optical preamble, in which any lamp may follow any other; the slot counts its edges
    ODOMETER_FROZEN = 32  # it stood still for a measurement, here or since the edge before: counts are missing


@dataclass(frozen=True, slots=True)
class Flash:
    """What the controller did at one accepted edge."""

    edge: EdgeIndex
    tick: Tick  # of the falling edge
    slot: Slot
    lamp: Lamp
    delay_ticks: int
    width_ticks: int
    odometer: int  # quadrature counts since boot
    generation: int  # of the committed configuration
    boot: int  # boot byte: changes with every reset, but for one in 256 losses of power
    flags: EdgeFlag
    epoch: int = 0  # which boot of the controller, as the host counts those it has met


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with a scan's frames: its kind for programs, one line for people, the frames it is in."""

    kind: str
    text: str
    frames: tuple[int, ...] = ()


class AnnulusError(Exception):
    """Anything a user can mend. The text is one line: what, where, what was expected.

    Texts from outside are in it (names, what a device said): here they lose what a terminal would obey.
    """

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


def first_few(indices: Sequence[int]) -> str:
    """The first five of them in words, and ".." where there are more."""
    return ", ".join(map(str, indices[:5])) + (", .." if len(indices) > 5 else "")
