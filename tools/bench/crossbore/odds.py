"""What becomes of places called so, in pipes the twin draws: the counts of crossbore/odds.py.

python -m tools.bench.crossbore.odds
"""

import math
from collections import Counter

from annulus.crossbore import Indication, detect, on_grid
from annulus.crossbore.odds import COUNTED, FATES, called
from annulus.twin.capacitance import Drawn, log, some_ground

SOILS = ((15.0, 4.0, 22.0), (20.0,), (4.0,), (9.0, 25.0), (25.0, 6.0, 12.0))
SEEDS = range(5000, 5250)


def fate(drawn: Drawn, one: Indication) -> str:
    """What is really there."""
    for bore in drawn.truth()["bores"]:
        if abs(0.5 * (bore["odo0_mm"] + bore["odo1_mm"]) - one.odometer_mm) < 150:
            return str(bore["kind"])
    return "soil"


def name(one: Indication) -> str:
    return called(str(one.kind), one.part, math.isfinite(one.phi_deg), math.isfinite(one.loss_ff))


def main() -> None:
    counts: Counter[tuple[str, str]] = Counter()
    for seed in SEEDS:
        for both in (False, True):
            drawn = log(some_ground(30_000.0, seed, SOILS[seed % 5], bores=4, near=2, pose=both, loss=both), seed)
            counts.update((name(one), fate(drawn, one)) for one in detect(on_grid(drawn.rows())).indications)
    for kind in sorted({said for said, _ in counts} | COUNTED.keys()):
        here = tuple(counts[kind, one] for one in FATES)
        print(f"{kind:<16} {here} {'' if here == COUNTED.get(kind) else f'in the table {COUNTED.get(kind)}'}")


if __name__ == "__main__":
    main()
