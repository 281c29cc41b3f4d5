"""What a grey level's noise is, from how the frames of one set disagree with their own fit.

Every point was seen n times and its fit has three unknowns: its misfit over n - 3 is the noise's variance at its level.
Points at edges disagree for other reasons, so each level has a say with the median of its points only. A camera's
light is shot noise over a floor; undoing a transfer curve and JPEG add a part that grows with the square.
"""

from itertools import pairwise

import numpy as np

from annulus_pipe.numeric.late import optimize, special
from annulus_pipe.wings.fringe.measure.heights import Heights
from annulus_pipe.wings.fringe.measure.track import GOOD

BINS = 24  # of grey levels, each with as many points
BIN_POINTS = 30  # fewer have no say
UNKNOWNS = 3  # of a point's fit: DC, AC, height
FLOOR = 1.0 / 12.0  # of the variance: a grey level is rounded


def noise_of(found: Heights, before: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> tuple[float, float, float]:
    """(a, b, c) of the variance a + b I + c I^2 of a grey level I; found with (1, 0, 0). Unchanged where no point has
    frames to spare: three frames agree with any fit."""
    free = found.used - UNKNOWNS
    good = (found.flag == GOOD) & (free > 0)
    if good.sum() < BIN_POINTS:
        return before
    free, level = free[good], found.dc[good]
    variance = found.misfit[good] / special.chdtri(free, 0.5)
    square = level**2 + found.ac[good] ** 2 / 2  # mean of I^2 along the wave
    edges = np.quantile(level, np.linspace(0, 1, BINS + 1))
    rows, values = [], []
    for low, high in pairwise(edges):
        inside = (level >= low) & (level <= high)
        if inside.sum() >= BIN_POINTS:
            middle = max(float(np.median(variance[inside])), FLOOR)
            rows.append(np.array([1.0, level[inside].mean(), square[inside].mean()]) / middle)
            values.append(1.0)
    if not rows:
        return before
    a, b, c = optimize.nnls(np.array(rows), np.array(values))[0]
    return max(float(a), FLOOR), float(b), float(c)
