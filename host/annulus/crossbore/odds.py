"""How often a place that is called so is air, part, water, or soil without a sewer: counted in pipes the twin draws.

250 pipes of 30 m in five sequences of soils, without and with pose and loss (`python -m tools.bench.crossbore.odds`
counts them again). They are odds of that world: four sewers and two near misses in 30 m, and nothing that the twin
does not know. What is UNKNOWN has none. Nor has a VOID: a sewer's own wall of clay or plastic looks like one in wet
soil, where its water does not show, and the twin's sewers have no walls. It counted 97 % without a sewer; in pipes of a
second drawer, even seeds, there was none in 11 of 15. `make bench-crossbore` holds the odds against other pipes of the
twin.
"""

import math
from collections.abc import Mapping

MOST, MIDDLE = 0.7, 0.45  # of soil to air, the strongest sector: bounds of what air is called by
FATES = ("air", "part", "water", "soil")
COUNTED: Mapping[str, tuple[int, int, int, int]] = {  # by what is said; of each fate
    "air all round": (525, 0, 0, 0),
    "air strong": (454, 46, 0, 0),
    "air middling": (33, 27, 0, 0),
    "air weak": (0, 11, 0, 0),
    "part": (4, 150, 0, 2),
    "water": (0, 73, 515, 0),
    "water by loss": (1, 3, 89, 0),
    "coupling": (6, 0, 0, 1000),
    "bead": (0, 0, 0, 986),
}


def called(kind: str, part: float, one_side: bool, by_loss: bool) -> str:
    """Its name in the table. part : of soil to air, the strongest sector. one_side : it has a direction."""
    if kind == "air":
        if not one_side:
            return "air all round"
        return "air strong" if part >= MOST else "air middling" if part >= MIDDLE else "air weak"
    return "water by loss" if kind == "water" and by_loss else kind


def odds(kind: str, part: float, one_side: bool, loss_ff: float) -> Mapping[str, float]:
    """Of each fate, 0 to 1, together 1; empty for what nobody counted. Half a count is added to each: never nought."""
    counted = COUNTED.get(called(kind, part, one_side, math.isfinite(loss_ff)))
    if counted is None:
        return {}
    total = sum(counted) + 0.5 * len(FATES)
    return {fate: (count + 0.5) / total for fate, count in zip(FATES, counted, strict=True)}
