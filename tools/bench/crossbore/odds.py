"""What becomes of places called so, in pipes of two drawers: the counts of crossbore/odds.py.

python -m tools.bench.crossbore.odds
"""

import math
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from annulus_pipe.wings.crossbore.ground import Drawn, log, some_ground
from annulus_pipe.wings.crossbore.measure import BORES, BoreIndication, detect, likely, on_grid
from annulus_pipe.wings.crossbore.measure.odds import COUNTED, FATES, called
from tools.bench.blind.others.crossbore import drawn_log, surveyed

SOILS = ((15.0, 4.0, 22.0), (20.0,), (4.0,), (9.0, 25.0), (25.0, 6.0, 12.0))
SEEDS = range(5000, 5250)
OTHER_SEEDS = [1000 * seed + i for seed in (2, 4, 6, 8) for i in range(10)]  # even: for setting constants by
NEAR_MM = 150.0  # from a sewer's middle: what is called so there is of it


def fate(drawn: Drawn, one: BoreIndication) -> str:
    """What is really there."""
    for bore in drawn.truth()["bores"]:
        if abs(0.5 * (bore["odo0_mm"] + bore["odo1_mm"]) - one.odometer_mm) < NEAR_MM:
            return str(bore["kind"])
    return "soil"


def name(one: BoreIndication) -> str:
    return called(str(one.kind), one.part, math.isfinite(one.phi_deg), math.isfinite(one.loss_ff))


def twins(seeds: Iterable[int]) -> Iterator[tuple[BoreIndication, str]]:
    """What is said along the twin's pipes, and what is really there."""
    for seed in seeds:
        for both in (False, True):
            drawn = log(some_ground(30_000.0, seed, SOILS[seed % 5], bores=4, near=2, pose=both, loss=both), seed)
            for one in detect(on_grid(drawn.rows())).indications:
                yield one, fate(drawn, one)


def others(seeds: Iterable[int]) -> Iterator[tuple[BoreIndication, str]]:
    """The same along the other drawer's."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            drawn = drawn_log(seed)
            _, account = surveyed(drawn, Path(folder))
            crossed = [(drawn.odometer_mm(0.5 * sum(one.span_mm)), one.kind) for one in drawn.sewers if one.kind]
            for one in account.indications:
                near = [kind for at, kind in crossed if abs(one.odometer_mm - at) < NEAR_MM]
                yield one, near[0] if near else "soil"


def promised(one: BoreIndication, real: str) -> tuple[float, bool]:
    """How probable what it is called was said to be, and whether it was so."""
    return likely(one), real == (str(one.kind) if one.kind in BORES else "soil")


def main() -> None:
    drawers = [Counter((name(one), real) for one, real in said) for said in (twins(SEEDS), others(OTHER_SEEDS))]
    for kind in sorted({said for counts in drawers for said, _ in counts} | COUNTED.keys()):
        here = tuple(tuple(counts[kind, one] for one in FATES) for counts in drawers)
        print(f"{kind:<16} {here} {'' if here == COUNTED.get(kind) else f'in the table {COUNTED.get(kind)}'}")


if __name__ == "__main__":
    main()
