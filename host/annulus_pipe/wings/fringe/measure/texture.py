"""What a textured wall does to the phase, and taking it out.

A lens blurs albedo times fringe, not each alone. Where albedo rises to one side, the pixel's light comes from that
side: its middle of weight, and with it the phase it shows, lies off by blur^2 grad(A) / A. That is the same phase for
every camera, and heights of the opposite sign for cameras on opposite sides of the projector:

    phase shown = phase + blur^2 (grad A . grad phase) / A          gradients along the wall, blur: its sigma there, mm

The DC says A. The blur follows from the set itself: what height and this slope of texture have in common over all
points is no property of walls. Assumed: height and texture are independent on the scale of a few points.
"""

from dataclasses import replace

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import CAUCHY, cauchy, robust_sigma
from annulus_pipe.wings.fringe.measure.heights import FringeView, Heights, Points

WINDOW = 9  # points: what is smoother than that may be the wall's own shape
ROUNDS = 5
POINTS_MIN = 400  # for a blur known to about a tenth


def untextured(view: FringeView, points: Points, found: Heights) -> tuple[Heights, float]:
    """The heights with the texture's share taken out, and the blur found, mm (sigma, on the wall).

    Points of a grid at least WINDOW wide each way; others, and a wall without texture, come back as they are, and 0.
    """
    if min(points.shape) < WINDOW:
        return found, 0.0
    slope = _slope(view, points, found)
    rate = view.radians_per_mm(points, np.where(np.isfinite(found.height_mm), found.height_mm, 0.0))
    off = found.height_mm * rate
    good = np.isfinite(off) & np.isfinite(slope)
    if good.sum() < POINTS_MIN:
        return found, 0.0
    y, x = (_rough(np.where(good, one, 0.0), good, points.shape)[good] for one in (off, slope))
    w, square = np.ones(len(x)), 0.0
    for _ in range(ROUNDS):
        below = float((w * x * x).sum())
        if below <= 0.0:
            return found, 0.0
        square = float((w * x * y).sum()) / below
        rest = y - square * x
        w = cauchy(rest / max(CAUCHY * robust_sigma(rest), 1e-300))
    if square <= 0.0:
        return found, 0.0
    share = np.where(np.isfinite(slope), square * slope / rate, 0.0)
    return replace(found, height_mm=found.height_mm - share), float(np.sqrt(square))


def _slope(view: FringeView, points: Points, found: Heights) -> FloatArray:
    """(P,) grad A . grad phase / A along the wall, rad / mm^2, in the middle frame; the wall taken as it is without
    heights."""
    shape = points.shape
    middle = len(view.eyes) // 2
    dc = np.where(np.isfinite(found.height_mm), found.dc, np.nan).reshape(shape)
    phase = view.phase(points.base, middle).reshape(shape)
    total = np.zeros(shape)
    for axis in (0, 1):
        step = np.linalg.norm(np.gradient(points.base.reshape(*shape, 3), axis=axis), axis=2)
        total += np.asarray(np.gradient(dc, axis=axis)) * np.asarray(np.gradient(phase, axis=axis)) / step**2
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((total / dc).ravel())


def _rough(values: FloatArray, good: BoolArray, shape: tuple[int, int]) -> FloatArray:
    """What is left of values (0 where not good) when the mean of the good ones around is taken out."""
    share = ndimage.uniform_filter(good.reshape(shape).astype(float), WINDOW)
    mean = ndimage.uniform_filter(values.reshape(shape), WINDOW) / np.maximum(share, 1e-9)
    return np.asarray(values - mean.ravel())
