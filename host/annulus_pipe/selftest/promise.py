"""One line of the result: what was promised, what was measured, and whether that keeps it."""

from dataclasses import dataclass
from enum import StrEnum


class PromiseVerdict(StrEnum):
    KEPT = "kept"
    BROKEN = "broken"
    NOT_WIRED = "not wired"
    NOT_TESTED = "not tested"
    INFORMS = "measured"  # nothing was promised


@dataclass(frozen=True, slots=True)
class Row:
    what: str
    promise: str
    measured: str
    verdict: PromiseVerdict
    values: tuple[float, ...] = ()  # the numbers in `measured`
    unit: str = ""
    why: str = ""  # of a verdict that is neither kept nor broken, or what the number says


def judged(
    what: str, promise: str, measured: str, kept: bool, *values: float, unit: str = "ticks", why: str = ""
) -> Row:
    return Row(what, promise, measured, PromiseVerdict.KEPT if kept else PromiseVerdict.BROKEN, values, unit, why)


def not_wired(what: str, promise: str, wire: str) -> Row:
    return Row(what, promise, "-", PromiseVerdict.NOT_WIRED, why=f"needs {wire}")


BEYOND_A_BOARDS_OWN_REACH = (
    Row(
        "Processor stands still: microwave and trigger low",
        "4 ms at most, and through the reset",
        "-",
        PromiseVerdict.NOT_TESTED,
        why="a processor that measures cannot stand still; proven on the emulator (-k stuck)",
    ),
    Row(
        "USB plug pulled while armed: all gates low",
        "3.1 ms",
        "-",
        PromiseVerdict.NOT_TESTED,
        why="the measurement goes over that plug; pull it by hand, First power-up, step 8",
    ),
    Row(
        "Outputs through power-on and reset",
        "low",
        "-",
        PromiseVerdict.NOT_TESTED,
        why="nothing measures during a reset; oscilloscope, First power-up, steps 1 and 9",
    ),
    Row(
        "Voltages, edges, drivers, lamps",
        "see Wiring",
        "-",
        PromiseVerdict.NOT_TESTED,
        why="levels are read back at the controller's own pads; oscilloscope, steps 6, 10 and 11",
    ),
)
