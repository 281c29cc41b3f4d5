"""Points of the wall as a pipe has them: their radius, their angle, and how far along they are."""

from collections.abc import Sequence

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.wall.profile import Profile

_round_axis = door("round_axis", "f4[n,3] points", "b1 clock", "f8[3,n]! out")


def round_axis(points_mm: Float32Array) -> FloatArray:
    """(3, N) radius, angle from x towards y in radians, -pi to pi, and z."""
    return _about(points_mm, clock=False)


def round_clock(points_mm: Float32Array) -> FloatArray:
    """(3, N) radius, clock angle in degrees, 0 to 360, and z."""
    return _about(points_mm, clock=True)


def points_of(profiles: Sequence[Profile]) -> Float32Array:
    """(N, 3) of all of them, one after the other."""
    return np.concatenate([one.points_mm for one in profiles])


def _about(points_mm: Float32Array, *, clock: bool) -> FloatArray:
    out = np.empty((3, len(points_mm)))
    _round_axis(np.ascontiguousarray(points_mm, np.float32), clock, out)
    return out
