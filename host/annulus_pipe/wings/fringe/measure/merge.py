"""The same points from several cameras of one head: each camera's height by its weight, where they agree.

Where two disagree by more than chance one of them looks past an edge or into a shadow: the one whose frames fit worse
is left out, and half the disagreement goes into sigma, for the better one may not be right.
"""

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wings.fringe.measure.heights import Heights
from annulus_pipe.wings.fringe.measure.track import GOOD

AGREE = 4.0  # sigma of their difference


def merged(views: list[Heights]) -> Heights:
    """One height a point; DC and AC are the first camera's that tells it. Residuals are left out."""
    out = views[0]
    for other in views[1:]:
        out = _two(out, other)
    return out


def _two(a: Heights, b: Heights) -> Heights:
    with np.errstate(invalid="ignore", divide="ignore"):
        wa, wb = np.nan_to_num(a.sigma_mm**-2.0), np.nan_to_num(b.sigma_mm**-2.0)
        gap = np.abs(a.height_mm - b.height_mm)
        apart = gap > AGREE * np.hypot(a.sigma_mm, b.sigma_mm)
        worse = (1 + a.misfit) / np.maximum(a.used - 3, 1) > (1 + b.misfit) / np.maximum(b.used - 3, 1)
        wa, wb = np.where(apart & worse, 0.0, wa), np.where(apart & ~worse, 0.0, wb)
        weight = wa + wb
        height = (np.where(wa > 0, wa * a.height_mm, 0.0) + np.where(wb > 0, wb * b.height_mm, 0.0)) / weight
        sigma = np.where(apart, np.hypot(weight**-0.5, gap / 2), weight**-0.5)
    known, first = weight > 0, wa > 0

    def of(one: FloatArray, other: FloatArray) -> FloatArray:
        return np.where(first, one, other)

    return Heights(
        np.where(known, height, np.nan),
        np.where(known, sigma, np.nan),
        of(a.dc, b.dc),
        of(a.ac, b.ac),
        of(a.misfit, b.misfit),
        a.used * (wa > 0) + b.used * (wb > 0),
        np.where(known, GOOD, np.minimum(a.flag, b.flag)),
        np.empty((0, 0), np.float32),
    )
