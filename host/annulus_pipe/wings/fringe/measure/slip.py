"""Where a head in a pipe was told to be and was not: what its frames say of it, by the wall's own texture and form.

Fringes go with the head, so in a pipe they say nothing of where it is along it. But a frame taken d farther on than was
told sees, wherever it looks, the wall d farther on, under the same light: its grey levels change by d times the slope
of albedo and radius along the pipe. Those slopes are the map's, of many frames, and are asked only where they stand out
of its noise: a frame's own noise would vouch for any place. The places are found together with the rest of the poses,
each point's own light and height projected out (`placement`). Carried by: the wall has texture or form, and does not
move; a plain one says nothing, and the told places stay. Each flash must see the pipe all around: a quarter of it, as
with slides in turn, read places 0.5 mm wrong with a sigma of 0.07.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.wings.fringe.measure.heights import Heights, Points
from annulus_pipe.wings.fringe.measure.placement import Freedom, PlacedHead, refined
from annulus_pipe.wings.fringe.measure.track import GOOD, ROBUST_FROM

CLEAR = 5.0  # sigma by which a slope must stand out: what noise adds to its square is then 4 %
POINTS_MAX = 4000
POINTS_MIN = 200
STEEP_MAX = 1.0  # of the radius along the pipe: a rim hides what it should show
TOLD_SIGMA = 0.01  # of the radius: what is believed of a told place
SAID = 5.0  # sigma by which frames and odometer must differ before it is said ..
LEAST = 2e-3  # .. and of the radius: 0.2 mm in an 8-inch pipe, twice what right ones seemed off at most (test_slip)
OWN_SIGMA = 5e-4  # of the radius: what blur and shading leave in a place, beside the frames' noise
ROUNDS = 4


@dataclass(frozen=True, slots=True)
class FlashSlips:
    """(F,) mm along the pipe: how much farther each flash was than told, by the frames, its sigma, infinite where they
    do not say; slipped : where that is beyond chance."""

    off_mm: FloatArray
    sigma_mm: FloatArray
    slipped: BoolArray


def find_places(
    head: PlacedHead,
    images: Float32Array,
    points: Points,
    found: Heights,
    texture: FloatArray,
    freedom: Freedom,
    noise: tuple[float, float, float],
    step_mm: float,
    follow: Callable[[PlacedHead, Points, FloatArray, FloatArray], Heights],
) -> FlashSlips:
    """points : the grid that `found` and texture (P,) are of. freedom : of the poses, with the places as told. follow :
    what the points are by another head, from their heights and textures."""
    flashes = len(head.poses)
    light, form = _slopes(points, found, noise, step_mm)
    usable = np.isfinite(light + form) & (found.flag == GOOD) & (found.used >= ROBUST_FROM)
    strength = np.where(usable, np.abs(np.nan_to_num(light)) + np.abs(np.nan_to_num(form)) / step_mm, 0.0)
    which = np.sort(np.argsort(-strength)[: min(POINTS_MAX, int((strength > 0).sum()))])
    nothing = FlashSlips(np.zeros(flashes), np.full(flashes, np.inf), np.zeros(flashes, bool))
    if len(which) < POINTS_MIN:
        return nothing
    some, slope = points.some(which), texture[which]
    along = (light[which], form[which])
    believed = TOLD_SIGMA * head.radius_mm
    poses = freedom.poses.copy()
    poses[:, 5] = believed
    freedom = replace(freedom, poses=poses)
    h = found.height_mm[which]
    sigma = np.full(flashes, np.inf)
    for _ in range(ROUNDS):
        here = follow(head, some, h, slope)
        head, covariance = refined(head, images, some, freedom, noise, here, np.nan_to_num(slope), along)
        sigma = np.sqrt(np.diag(covariance)[5 : 6 * flashes : 6])
        h = np.where(here.flag == GOOD, here.height_mm, h)
    off = head.poses[:, 5] - freedom.prior[:, 5]
    off = off - np.median(off[: (flashes + 1) // 2])  # the first half is where it was told: windows share it
    sure = sigma < 0.5 * believed  # else it is what was believed before
    sigma = np.hypot(sigma, OWN_SIGMA * head.radius_mm)
    beyond = sure & (np.abs(off) > np.maximum(SAID * sigma, LEAST * head.radius_mm))
    return FlashSlips(np.where(sure, off, 0.0), np.where(sure, sigma, np.inf), beyond)


def _slopes(
    points: Points, found: Heights, noise: tuple[float, float, float], step_mm: float
) -> tuple[FloatArray, FloatArray]:
    """(P,) slope along the pipe of the albedo's logarithm, 1 / mm, and of the radius; 0 where it is noise."""
    shape = points.shape
    good = (found.flag == GOOD) & (found.dc > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        dc, height = (np.where(good, one, np.nan).reshape(shape) for one in (np.log(found.dc), found.height_mm))
        level = np.maximum(found.dc, 0.0)
        own = np.sqrt((noise[0] + level * (noise[1] + level * noise[2])) / np.maximum(found.used, 1)) / level
    out = []
    for value, sigma in ((dc, own), (height, found.sigma_mm)):
        slope = np.full(shape, np.nan)
        slope[1:-1] = (value[2:] - value[:-2]) / (2 * step_mm)
        flat = slope.ravel()
        with np.errstate(invalid="ignore"):
            clear = np.abs(flat) * np.sqrt(2.0) * step_mm > CLEAR * sigma
            out.append(np.where(clear & (np.abs(flat) < STEEP_MAX), flat, np.where(np.isfinite(flat), 0.0, np.nan)))
    return out[0], out[1]
