"""What both topics print: in how many of so many studies the stated a90/95 is at least the true a90.

A row is met where the 95 % interval of what so many studies show reaches into what is asked.
"""

from collections.abc import Sequence

from annulus_pipe.qualification.validation import proportion
from tools.bench.table import Row

STUDIES = 1000  # 95 % of so many is known to 1.4
LEAST, MOST = 0.93, 0.97


def row(what: str, bounds: Sequence[float | None], a90_mm: float, *, asked: bool = True) -> Row:
    """bounds : of each study; None where it was not stated, which is no wrong statement."""
    right = sum(one is None or one >= a90_mm for one in bounds) / len(bounds)
    stated = sum(one is not None for one in bounds)
    stated_as = f"{100 * right:.1f} %" + ("" if stated == len(bounds) else f", stated in {stated} of {len(bounds)}")
    if not asked:
        return Row(what, "-", "-", stated_as)
    known = proportion(round(right * len(bounds)), len(bounds))
    asked_for = f"{100 * LEAST:.0f} to {100 * MOST:.0f} %"
    return Row(what, "-", asked_for, stated_as, known.lower <= MOST and known.upper >= LEAST)
