"""a90/95 by reported depths against known lines, censored at both ends."""

import numpy as np

from annulus_pipe.numeric.late import special, stats
from annulus_pipe.qualification.hit_miss import CONFIDENCE, POD, SizeAxis
from annulus_pipe.qualification.signal_response import (
    LEFT,
    MEASURED,
    RIGHT,
    Regression,
    ResponseData,
    fit_signal_response,
)
from tools.bench.pod.coverage import STUDIES, row
from tools.bench.table import Row

SEED = 3023
LIMIT_MM, LARGEST_MM = 1.0, 3.5
INTERCEPT, SLOPE = 0.05, 1.02
SHADOWED = 0.15  # of all: depths of which less was seen, a lower limit where more is there
CASES = ((SizeAxis.LINEAR, 0.2, 40), (SizeAxis.LINEAR, 0.2, 80), (SizeAxis.LOG, 0.2, 40), (SizeAxis.LOG, 0.2, 80))
NOTE = f"""
{STUDIES} studies of each line: reported = {INTERCEPT:g} + {SLOPE:g} true, in mm or in their logarithms, 0.2 off,
listed from {LIMIT_MM:g} mm on, sizes drawn evenly from 0.2 to {LARGEST_MM:g} mm; of {100 * SHADOWED:.0f} % no more
than 0.7 to 1.1 of the depth was to be seen. "stated": as `annulus pod fit` does, which refuses where hits and misses
do not follow from depths, by its test in 5 % of studies in which they do.
"""


def rows() -> list[Row]:
    out = []
    z = float(stats.norm.ppf(CONFIDENCE))
    for number, (axis, spread, targets) in enumerate(CASES):
        rng = np.random.default_rng([SEED, number])
        limit = float(axis.of(np.array(LIMIT_MM)))
        a90 = axis.back((limit - INTERCEPT + float(special.ndtri(POD)) * spread) / SLOPE)
        plain: list[float | None] = []
        own: list[float | None] = []
        stated: list[float | None] = []
        for _ in range(STUDIES):
            true = rng.uniform(0.2, LARGEST_MM, targets)
            reported = INTERCEPT + SLOPE * axis.of(true) + spread * rng.standard_normal(targets)
            shadowed = rng.random(targets) < SHADOWED
            seen = np.where(shadowed, axis.of(np.maximum(true * rng.uniform(0.7, 1.1, targets), LIMIT_MM)), np.inf)
            side = np.where(reported < limit, LEFT, np.where(reported > seen, RIGHT, MEASURED))
            y = np.where(side == LEFT, limit, np.minimum(reported, seen))
            data = ResponseData(axis.of(true), y, side, np.full(targets, limit), np.arange(targets))
            fit = Regression(data, limit)
            farthest = float(axis.of(np.array(true.max())))
            for bounds, corrected in ((plain, False), (own, True)):
                found = fit.bound(POD, z, farthest, corrected=corrected)
                bounds.append(None if found is None else axis.back(found))
            depth = np.exp(y) if axis is SizeAxis.LOG else np.maximum(y, 1e-3)
            limits = [LIMIT_MM] * targets
            stated.append(
                fit_signal_response(true.tolist(), depth.tolist(), side.tolist(), limits, curve=False)[0].a9095_mm
            )
        name = f"{targets} targets, line in {axis}, spread {spread:g}"
        out += [
            row(f"{name}: stated", stated, a90),
            row(f"{name}: own axes", own, a90),
            row(f"{name}: uncorrected", plain, a90, asked=False),
        ]
    return out
