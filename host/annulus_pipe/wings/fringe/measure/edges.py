"""What is not known beside a step of the wall: the lens's blur mixes both sides.

A height beside a step is off by up to the blur times the slope; where the slope is the wall's own all around (a tilt,
a curve) both sides of a place cancel. So sigma gets blur times the part of the slope that its surroundings do not have,
and that is more than noise. Deconvolving the heights themselves was tried and left out: to the first order it brings a
scratch 0.8 mm wide from 0.40 to 0.41 of 0.5 mm, and makes edges and noise worse.
"""

from dataclasses import replace

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.wings.fringe.measure.heights import Heights, Points

AROUND = 9  # points: the wall's own slope
NOISE = 4.0  # variances of a slope that are noise


def edged(points: Points, found: Heights, blur_mm: float) -> Heights:
    """The heights, sigma larger beside steps. Points of a grid at least AROUND wide each way; others come back as they
    are."""
    if min(points.shape) < AROUND or not blur_mm > 0:
        return found
    h, sigma = (one.reshape(points.shape) for one in (found.height_mm, found.sigma_mm))
    base = points.base.reshape(*points.shape, 3)
    slope, noise = np.zeros(points.shape), np.zeros(points.shape)
    for axis in (0, 1):
        step = float(np.median(np.linalg.norm(np.diff(base, axis=axis), axis=2)))
        rise = (_beside(h, axis, -1) - _beside(h, axis, 1)) / (2 * step)
        rise = np.where(np.isfinite(rise), rise, 0.0)
        slope += (rise - ndimage.median_filter(rise, AROUND)) ** 2
        noise += np.nan_to_num(sum(_beside(sigma, axis, way) ** 2 for way in (1, -1))) / (4 * step**2)
    beside = blur_mm**2 * np.maximum(slope - NOISE * noise, 0.0)
    return replace(found, sigma_mm=np.sqrt(sigma**2 + beside).ravel())


def _beside(values: FloatArray, axis: int, way: int) -> FloatArray:
    """The neighbour's value; NaN beyond the edge."""
    out = np.roll(values, way, axis=axis)
    edge: list[slice | int] = [slice(None), slice(None)]
    edge[axis] = 0 if way > 0 else -1
    out[tuple(edge)] = np.nan
    return out
