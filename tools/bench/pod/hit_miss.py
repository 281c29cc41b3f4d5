"""a90/95 by hits and misses against known curves."""

import numpy as np

from annulus_pipe.numeric.late import special, stats
from annulus_pipe.qualification.hit_miss import CONFIDENCE, POD, Logistic, SizeAxis, fit_hit_miss
from tools.bench.pod.coverage import STUDIES, row
from tools.bench.table import Row

SEED = 2862
A50_MM = 1.0
CASES = (  # what POD's logit is linear in, a90, the largest laid, targets
    (SizeAxis.LINEAR, 1.6, 2.6, 60),
    (SizeAxis.LINEAR, 1.6, 2.6, 120),
    (SizeAxis.LINEAR, 1.25, 2.0, 60),
    (SizeAxis.LINEAR, 1.25, 2.0, 120),
    (SizeAxis.LOG, 2.0, 4.5, 60),
    (SizeAxis.LOG, 2.0, 4.5, 120),
    (SizeAxis.LOG, 1.4, 2.5, 60),
    (SizeAxis.LOG, 1.4, 2.5, 120),
)
NOTE = f"""
{STUDIES} studies of each curve, sizes drawn evenly from 0.2 mm on, a50 {A50_MM:g} mm. "stated": as `annulus pod fit`
does, the axis chosen by the data; "own axis": the axis fixed beforehand; "uncorrected": the same by the likelihood
ratio alone, without r*. A bound beyond the largest laid is not stated, and not wrong; where hits and misses do not
overlap, 1 to 2 % of the steep curves' studies, none is stated either.
"""


def rows() -> list[Row]:
    out = []
    for number, (axis, a90, largest, targets) in enumerate(CASES):
        rng = np.random.default_rng([SEED, number])
        slope = float(special.logit(POD)) / np.diff(axis.of(np.array([A50_MM, a90])))[0]
        plain: list[float | None] = []
        own: list[float | None] = []
        stated: list[float | None] = []
        for _ in range(STUDIES):
            size = rng.uniform(0.2, largest, targets)
            pod = special.expit(slope * (axis.of(size) - axis.of(np.array(A50_MM))))
            hit = rng.random(targets) < pod
            fixed = fit_hit_miss(size.tolist(), hit.tolist(), axis, curve=False)
            own.append(fixed.a9095_mm)
            stated.append(fit_hit_miss(size.tolist(), hit.tolist(), curve=False).a9095_mm)
            plain.append(_plain(axis, size, hit, largest) if fixed.a50_mm is not None or fixed.axis else None)
        name = f"{targets} targets, logit in {axis}, a90 {a90:g} mm"
        out += [
            row(f"{name}: stated", stated, a90),
            row(f"{name}: own axis", own, a90),
            row(f"{name}: uncorrected", plain, a90, asked=False),
        ]
    return out


def _plain(axis: SizeAxis, size: np.ndarray, hit: np.ndarray, largest: float) -> float | None:
    fit = Logistic(axis.of(size), hit.astype(float))
    z = float(stats.norm.ppf(CONFIDENCE))
    found = fit.bound(POD, z, float(axis.of(np.array(largest))), corrected=False)
    return None if found is None else axis.back(found)
