"""What each witness of a label is good for: a soak in which all are asked, and one in which it alone is not.

Each row has faults that happen to real heads and that no other witness sees in time, or that cost most labels without
it: where nobody counts, a frame that came late is unknown. `annulus twin soak --witnesses` prints the rows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from annulus_pipe.capture.proof import Witness
from annulus_pipe.twin.soak import soak

FRAMES = 3000


@dataclass(frozen=True, slots=True)
class Case:
    """A profile of faults that this witness sees."""

    witness: Witness
    faults: str


CASES = (
    Case(Witness.ARRIVAL, "reckoned"),
    Case(Witness.ORDER, "handed-over"),
    Case(Witness.COUNT, "late"),
    Case(Witness.LAMP, "flashes-fail"),
    Case(Witness.TORN, "torn"),
    Case(Witness.REPEATED, "repeated"),
    Case(Witness.PREAMBLE, "kept-five"),
)


def witnesses(
    frames: int = FRAMES, seed: int = 1, progress: Callable[[str, int, int], None] | None = None
) -> list[dict[str, Any]]:
    """Wrong labels and places with and without each witness, one row a witness."""
    return [compared(case, frames, seed, progress) for case in CASES]


def compared(
    case: Case, frames: int = FRAMES, seed: int = 1, progress: Callable[[str, int, int], None] | None = None
) -> dict[str, Any]:
    """One row."""
    asked = soak(frames, seed, faults=case.faults, progress=progress)
    unasked = soak(frames, seed, faults=case.faults, without=(case.witness,), progress=progress)
    return {
        "witness": str(case.witness),
        "faults": case.faults,
        "wrong": asked["wrong"],
        "wrong_without": unasked["wrong"],
        "unknown": asked["unknown"],
        "unknown_without": unasked["unknown"],
    }
