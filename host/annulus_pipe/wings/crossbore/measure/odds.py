"""How often a place that is called so is air, part, water, or soil without a sewer: counted in pipes of two drawers.

They are odds of those drawers' worlds, and of no street. The twin: 250 pipes of 30 m in five sequences of soils,
without and with pose and loss, four sewers and two near misses each. The other: tools/bench/blind/others/bore_logs, by
other physics, its even seeds 2 to 8, ten pipes of 40 m each, whose sewers have walls of clay or plastic and water to
any level. `python -m tools.bench.crossbore.odds` counts both again.

What is said is the mean of the two drawers' shares, however many places each has: a drawer's own pipes are kept by its
own odds to a percent, and the twin's alone said 95 % of a "part" that was one in 11 of 14 by the other. What one drawer
never drew has no odds (a BEAD), nor has what is UNKNOWN, nor a VOID: a sewer's own wall looks like one in wet soil, and
the twin's sewers have no walls. `make bench-crossbore` holds the odds against pipes that nobody counted, of both.
"""

import math
from collections.abc import Mapping

MOST, MIDDLE = 0.7, 0.45  # of soil to air, the strongest sector: bounds of what air is called by
FATES = ("air", "part", "water", "soil")
COUNTED: Mapping[str, tuple[tuple[int, int, int, int], ...]] = {  # by what is said; of each fate, the twin's and the
    # other drawer's
    "air all round": ((525, 0, 0, 0), (53, 0, 0, 1)),
    "air strong": ((454, 46, 0, 0), (63, 3, 0, 0)),
    "air middling": ((33, 27, 0, 0), (1, 0, 0, 1)),
    "part": ((4, 161, 0, 2), (3, 12, 0, 0)),
    "water": ((0, 73, 515, 0), (0, 1, 36, 0)),
    "water by loss": ((1, 3, 89, 0), (0, 3, 7, 0)),
    "coupling": ((6, 0, 0, 1000), (0, 0, 0, 79)),
}


def called(kind: str, part: float, one_side: bool, by_loss: bool) -> str:
    """Its name in the table. part : of soil to air, the strongest sector. one_side : it has a direction."""
    if kind == "air":
        return "air all round" if not one_side else "air strong" if part >= MOST else "air middling"
    return "water by loss" if kind == "water" and by_loss else kind


def odds(kind: str, part: float, one_side: bool, loss_ff: float) -> Mapping[str, float]:
    """Of each fate, 0 to 1, together 1; empty for what nobody counted. Half a count is added to each: never nought."""
    counted = COUNTED.get(called(kind, part, one_side, math.isfinite(loss_ff)))
    if counted is None:
        return {}
    totals = [sum(drawer) + 0.5 * len(FATES) for drawer in counted]
    shares = [[(count + 0.5) / total for count in drawer] for drawer, total in zip(counted, totals, strict=True)]
    return {fate: sum(share) / len(shares) for fate, *share in zip(FATES, *shares, strict=True)}
