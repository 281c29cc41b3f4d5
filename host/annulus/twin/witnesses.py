"""What each witness of a label is good for: soaks in which it is asked, and in which it is not.

Several witnesses see most faults, so that one alone missing changes little: where others would stand in, they are
silenced in both soaks. `annulus twin soak --witnesses` prints the rows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from annulus.capture.proof import Witness
from annulus.twin.soak import soak

FRAMES = 3000


@dataclass(frozen=True, slots=True)
class Case:
    """A profile of faults that this witness sees, where those do not speak."""

    witness: Witness
    faults: str
    silenced: tuple[Witness, ...] = ()


CASES = (
    Case(Witness.ARRIVAL, "one-stamp-late", (Witness.ORDER, Witness.COUNT)),
    Case(Witness.ORDER, "one-stamp-late", (Witness.ARRIVAL, Witness.COUNT)),
    Case(Witness.COUNT, "one-stamp-late", (Witness.ARRIVAL, Witness.ORDER)),
    Case(Witness.LAMP, "stamp-steps", (Witness.ARRIVAL, Witness.ORDER, Witness.COUNT)),
    Case(Witness.TORN, "torn"),
    Case(Witness.REPEATED, "repeated"),
    Case(Witness.PREAMBLE, "five-steps", (Witness.ARRIVAL, Witness.COUNT)),
)


def witnesses(
    frames: int = FRAMES, seed: int = 1, progress: Callable[[str, int, int], None] | None = None
) -> list[dict[str, Any]]:
    """Wrong labels and places with and without each witness, one row a witness."""
    rows = []
    for case in CASES:
        asked = soak(frames, seed, faults=case.faults, without=case.silenced, progress=progress)
        unasked = soak(frames, seed, faults=case.faults, without=(*case.silenced, case.witness), progress=progress)
        rows.append({
            "witness": str(case.witness), "faults": case.faults, "silenced": ", ".join(case.silenced),
            "wrong": asked["wrong"], "wrong_without": unasked["wrong"],
            "unknown": asked["unknown"], "unknown_without": unasked["unknown"],
        })  # fmt: skip
    return rows
