"""Whether the fringes' order is the one the wall was told by: two cameras must see one texture on it.

A plate that stands a whole fringe from where it was told fits its frames as well as the right one, and both cameras
agree on it; but where a wall is not, two cameras look at different spots of it. The DC along the tracks is the wall's
own texture, without fringes: at the right order both cameras' are alike, at another they are strangers. Carried by: the
wall has texture, and two cameras see it from different sides; elsewhere nothing is told.
"""

from collections.abc import Sequence

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.wings.fringe.measure.heights import FringeView, Points, heights
from annulus_pipe.wings.fringe.measure.track import GOOD

FINE_CELLS = 4.0  # sigma: wider is lamp and lens, and alike at every order
CLIPPED = (2.0, 98.0)  # percentiles: a box's edge is no texture
SAME = 0.5  # correlation: one texture is alike by more than that, strangers by less
SEEN_MIN = 200  # points both cameras see
ORDERS = (-2, -1, 1, 2)  # 0.3 s at fringe-a, once a scan
NEAR = 0.5  # of a period: what came back to the first order is no other


def told_elsewhere(
    views: Sequence[tuple[FringeView, Float32Array]], points: Points, *, drift_sigma: float
) -> tuple[float, float, float] | None:
    """(height, mm, median; correlation there; correlation where it was told) of the order at which two cameras see one
    texture; None where that is the order nearest to height 0, or nothing is told.

    views : two cameras, each with its images as `heights` takes them. points : a grid both see.
    """
    found = []
    for view, images in views:
        first = heights(view, images, points, drift_sigma=drift_sigma)
        h = np.nan_to_num(first.height_mm)
        one = {0: (first.height_mm, _dc(first.dc, first.flag == GOOD, points))}
        for order in ORDERS:
            start = _there(view, points, h, order)
            other = heights(view, images, points, start, drift_sigma=drift_sigma)
            with np.errstate(divide="ignore", invalid="ignore"):
                spacing = 2 * np.pi / np.abs(view.radians_per_mm(points, start))
                there = (other.flag == GOOD) & (np.abs(other.height_mm - start) < NEAR * spacing)
            one[order] = (other.height_mm, _dc(other.dc, there, points))
        found.append(one)
    alike = {order: _alike(*(one[order][1] for one in found)) for order in found[0]}
    best = max(alike, key=lambda order: alike[order])
    if best == 0 or not alike[best] > SAME > alike[0]:
        return None
    seen = np.isfinite(found[0][best][1].ravel())
    return float(np.median(found[0][best][0][seen])), alike[best], alike[0]


def _there(view: FringeView, points: Points, h: FloatArray, order: int) -> FloatArray:
    """(P,) mm: heights that lie whole fringes from h, found a fringe at a time, for their spacing is not even."""
    way = 1 if order > 0 else -1
    for _ in range(abs(order)):
        with np.errstate(divide="ignore", invalid="ignore"):  # there may be no such order before the head
            middle = h + way * np.pi / np.abs(view.radians_per_mm(points, h))
            h = h + way * 2 * np.pi / np.abs(view.radians_per_mm(points, middle))
    return h


def _dc(dc: FloatArray, known: BoolArray, points: Points) -> FloatArray:
    """(Y, X) logarithm of the DC, NaN where not told."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.log(np.where(known & (dc > 1), dc, np.nan)).reshape(points.shape))


def _alike(one: FloatArray, other: FloatArray) -> float:
    """Correlation of the fine texture of two (Y, X); 0 where too few points tell."""
    both = np.isfinite(one + other)
    if both.sum() < SEEN_MIN:
        return 0.0
    share = np.maximum(ndimage.gaussian_filter(both.astype(float), FINE_CELLS), 1e-3)
    fine = []
    for texture in (one, other):
        whole = np.where(both, texture, 0.0)
        rest = (whole - ndimage.gaussian_filter(whole, FINE_CELLS) / share)[both]
        fine.append(np.clip(rest, *np.percentile(rest, CLIPPED)))
    spread = float(np.std(fine[0]) * np.std(fine[1]))
    return float(np.mean((fine[0] - fine[0].mean()) * (fine[1] - fine[1].mean()))) / spread if spread > 0 else 0.0
