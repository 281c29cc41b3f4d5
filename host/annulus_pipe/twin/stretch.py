"""How a row of a frame is worked on: in stretches of pixels, every intermediate value of which lies in one flat array.

One base and constant distances between the values are what lets LLVM prove that the loops over a stretch may run as
vectors; a kernel reads `scratch[WX + u]` for pixel u. Rays, walls and lights are kernels over a `PixelRun`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.jit import Options, jit_with

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Real = Any  # float32 inside compiled code

OPTIONS: Options = {"nogil": True, "fastmath": True, "error_model": "numpy"}
jit = jit_with(OPTIONS)
PIXELS = 512  # of a stretch at most
_PITCH = PIXELS + 8  # eight to spare, for loops that write in fours
# Ray in the pipe frame (unit), range, place and normal where it meets the wall, range to the plain cylinder, start of a
# ray of its own; 1 or 0 where light is let through, map column, 1 where there is paint; cosine of the angle to the
# projector's axis, what its light would give a facing wall, and all light that comes from there.
(WX, WY, WZ, S, X, Y, Z, NX, NY, NZ, OPEN, COLUMN, PAINT, LIT, LEVEL, PLAIN, CX, CY, CZ, AT) = range(
    0, 20 * _PITCH, _PITCH
)
SCRATCH = 20 * _PITCH


class PixelRun(NamedTuple):
    """Pixels u0 .. u0 + n of row v. A place for values is written by one kernel and read by the next."""

    scratch: F32  # (SCRATCH,)
    marks: NDArray[np.int32]  # (PIXELS,) of whatever the kernel in hand looks up
    spread: F32  # (n,) see `rays.ray_table`
    n: int
    v: int
    odd: int  # u0 & 1, which of the mosaic's columns comes first


@jit
def atan2(y: Real, x: Real) -> Real:
    """atan2 within 2e-6 rad, float32."""
    ax, ay = abs(x), abs(y)
    big, small = max(ax, ay), min(ax, ay)
    q = small / (big + np.float32(1e-20))
    s = q * q
    r = np.float32(0.0078254829)
    r = r * s + np.float32(-0.0368986292)
    r = r * s + np.float32(0.0837415565)
    r = r * s + np.float32(-0.1348040561)
    r = r * s + np.float32(0.1987987216)
    r = r * s + np.float32(-0.3332637452)
    r = r * s * q + q
    if ay > ax:
        r = np.float32(1.5707963) - r
    if x < 0:
        r = np.float32(3.1415927) - r
    return -r if y < 0 else r


@jit
def step_up(x: Real) -> Real:
    """Standard normal distribution function within 3e-4 (Abramowitz & Stegun 7.1.27); branch-free."""
    t = min(abs(x) * np.float32(0.70710678), np.float32(6.0))  # p ** 4 must not overflow
    p = np.float32(1.0) + t * (
        np.float32(0.278393) + t * (np.float32(0.230389) + t * (np.float32(0.000972) + t * np.float32(0.078108)))
    )
    p = p * p
    tail = np.float32(0.5) / (p * p)
    return tail if x < 0 else np.float32(1.0) - tail
