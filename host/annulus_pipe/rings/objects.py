"""What stands in the ring before the wall: a crawler's leg, a stone. It is no wall, and hides the wall behind it.

Assumed: a wall is one line round the pipe. It may be dented, oval or cut off by a level, and goes there by a slope; an
object is a line of its own, farther inwards, and at its ends the light jumps. What carries it: both jumps must be
there, inwards and out again, steeper than any wall's flank; what lies beside them stays, however far it stands off.

When it breaks: an object whose end nobody sees, or that goes over into the wall, is wall here; a hard-edged thing that
grew from the wall (a fin, a tap) is an object, and unseen.
"""

import math

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.robust import TUKEY, biweight, robust_sigma
from annulus_pipe.rings.decode import NONE

# Guarded by the regression leg_taken_for_wall: legs and stones on one side, dents and pockets on the other.
INWARDS_OF_RADIUS = (
    0.04  # of the radius: an object stands farther before the wall; shallower ones may be the wall's own
)
JUMP_OF_RADIUS = 0.02  # of the radius: from a direction to the next, at its ends ..
JUMP_PX = 2.0  # .. and at least so many pixels' worth of it ..
STEEP = 1.5  # .. and so steep: a dent of 15 mm has 1.3 where it is only 16 mm wide ..
GAP = 2  # .. or over more directions than so many, where nobody saw the flank ..
STEEP_UNSEEN = 0.75  # .. half as steep
WIDEST = 1 / 3  # of the round: more is no object in a ring
SEEN_LEAST = 0.5  # of the round: with less an oval is not told from a shift


def without_objects(
    ring: NDArray[np.int64], direction: NDArray[np.int64], radius_mm: FloatArray, mm_per_px: FloatArray, directions: int
) -> int:
    """Set `ring` (N,) to NONE, in place, where a slit lies on an object before the wall; how many did.

    direction : (N,) rising. radius_mm : (N, K) the wall's radius if slit n were ring k. mm_per_px : (K,).
    """
    lost = 0
    for k in range(radius_mm.shape[1]):
        mine = np.flatnonzero(ring == k)
        if len(mine) >= SEEN_LEAST * directions:
            radius = radius_mm[mine, k]
            off = mine[_on_objects(direction[mine], radius, JUMP_PX * float(mm_per_px[k]), directions)]
            ring[off] = NONE
            lost += len(off)
    return lost


def _on_objects(
    direction: NDArray[np.int64], radius: FloatArray, least_mm: float, directions: int
) -> NDArray[np.int64]:
    """Indices of the points of one ring, each direction once, that lie on an object."""
    turn = 2 * math.pi / directions
    outline = _outline(np.asarray(turn * direction, np.float64), radius)
    inwards = outline - radius
    usual = float(np.median(outline))
    jump = max(JUMP_OF_RADIUS * usual, least_mm)
    first = int(np.argmin(np.abs(inwards)))  # from the wall, once round
    inwards, apart = np.roll(inwards, -first), np.roll(np.diff(direction, append=direction[0] + directions), -first)
    rise = np.append(inwards[1:], inwards[0]) - inwards  # from each to the next
    steep = np.where(apart > GAP, STEEP_UNSEEN, STEEP)
    sharp = np.abs(rise) >= np.maximum(jump, steep * turn * usual * apart)
    before = inwards > 0.5 * jump
    edges = np.flatnonzero(np.diff(before, prepend=False, append=False))
    found = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        steps = np.arange(max(start - 1, 0), stop)
        into, out = steps[sharp[steps] & (rise[steps] > 0)], steps[sharp[steps] & (rise[steps] < 0)]
        if not len(into) or not len(out) or out[-1] <= into[0]:
            continue
        piece = np.arange(into[0] + 1, out[-1] + 1)
        wide = apart[piece[:-1]].sum() <= WIDEST * directions
        if wide and inwards[piece].max() > max(INWARDS_OF_RADIUS * usual, jump):
            found.append((piece + first) % len(radius))
    return np.concatenate(found) if found else np.zeros(0, np.int64)


def _outline(angle: FloatArray, radius: FloatArray) -> FloatArray:
    """(N,) the wall's radius as mean, shift and oval, which pieces that are off do not pull."""
    design = np.stack([np.ones_like(angle), *(f(n * angle) for n in (1, 2) for f in (np.cos, np.sin))], axis=1)
    fit = np.full(len(angle), float(np.median(radius)))
    for _ in range(12):
        left = radius - fit
        weight = biweight(left / (TUKEY * max(robust_sigma(left), 1e-3)))[:, None]
        fit = design @ np.linalg.lstsq(design * np.sqrt(weight), radius * np.sqrt(weight[:, 0]), rcond=None)[0]
    return np.asarray(fit)
