"""Which ring each slit is without a look at its colours: by its order on lines that show every ring, then by place.

Slower and less sure than reading colours, and blind to a pattern half hidden; for learning colours and for finding out
what is wrong with frames whose colours do not fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.decode import NONE
from annulus_pipe.rings.polar import PolarGrid
from annulus_pipe.rings.slits import Slits
from annulus_pipe.rings.triangulate import RingOptics, deviations, triangulate
from annulus_pipe.wall.pose import Fit, fit_pose

# By topic colour (what is learnt from) and test_diagnosis (pipes of other radii, flips); a factor of two either way
# moves neither.
WHOLE_LINES = 0.1  # of the lines must show every ring and nothing else
PLACE = 0.4  # of the way to the next ring: how far from its place a slit is still taken for a ring
SIZES = 3  # the pipe's own radius is taken for the nominal one so often, and slits ..
ROUNDS = 2  # .. named anew where the wall then is


@dataclass(frozen=True, slots=True, eq=False)
class PlacedSlits:
    """ring (N,): of every slit, or NONE. points (M, 3) mm, camera frame, of the named slits in their order. `fit` the
    head's pose, `radius_mm` the pipe's own radius, both from these points."""

    ring: NDArray[np.int64]
    points: FloatArray
    fit: Fit
    radius_mm: float


def by_order(
    slits: Slits, grid: PolarGrid, optics: RingOptics, expected_mm: FloatArray, radius_mm: float
) -> PlacedSlits | None:
    """Name a frame's slits from their order alone; None where too few lines show every ring, or there is no pipe.

    expected_mm : (K,) radial error of a point of each ring. radius_mm : of the pipe, roughly; the answer's is the
    points' own.
    """
    rings = len(optics.cones)
    every = triangulate(slits, grid, optics, np.ones((len(slits.direction), rings), bool))
    apart = PLACE * grid.spacing_px * optics.mm_per_px.min()
    _, first, count = np.unique(slits.direction, return_index=True, return_counts=True)
    whole = first[count == rings]
    if len(whole) >= WHOLE_LINES * len(grid.cosine):
        ring = np.full(len(slits.direction), NONE, np.int64)
        for k in range(rings):
            ring[whole + k] = k
    else:  # noise between the slits, or rods: the head is not far from the middle
        ring = _nearest(every, Pose(), radius_mm, apart)
    found = _fit(every, ring, radius_mm, expected_mm)
    for _ in range(ROUNDS):
        if found is None:
            return None
        ring = _nearest(every, found[0].pose, found[1], apart)
        found = _fit(every, ring, found[1], expected_mm)
    if found is None:
        return None
    named = np.flatnonzero(ring != NONE)
    return PlacedSlits(ring, every[named, ring[named]], *found)


def _nearest(every: FloatArray, pose: Pose, radius_mm: float, apart_mm: float) -> NDArray[np.int64]:
    off = np.abs(np.nan_to_num(deviations(every, pose, radius_mm), nan=np.inf))
    return np.where(off.min(axis=1, initial=np.inf) * radius_mm < apart_mm, off.argmin(axis=1), NONE)


def _fit(
    every: FloatArray, ring: NDArray[np.int64], radius_mm: float, expected_mm: FloatArray
) -> tuple[Fit, float] | None:
    named = np.flatnonzero(ring != NONE)
    points = every[named, ring[named]]
    known = np.isfinite(points[:, 0])
    points, sigma = points[known], expected_mm[ring[named][known]]
    if len(points) < 3:
        return None
    radius, fit = radius_mm, None
    for _ in range(SIZES):
        fit = fit_pose(points, radius, sigma, fit.pose if fit is not None else None)
        if fit is None:
            return None
        flat = fit.pose.to_pipe(points)[:, :2]
        radius = float(np.median(np.hypot(flat[:, 0], flat[:, 1])))
    assert fit is not None
    return fit, radius
