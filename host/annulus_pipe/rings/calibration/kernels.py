"""The loops over observations: what an error is, how it moves with every unknown, and the normal equations.

An error is found along the observation's line, in pixels: Newton's method finds where the line crosses the image of the
ring on the wall; nothing is linearised about the place where the slit was seen. Loops and formulas are in
host/native/calibration_bundle.c.
"""

from typing import NamedTuple

from annulus_pipe.numeric.arrays import FloatArray, IntArray
from annulus_pipe.numeric.native import door
from annulus_pipe.rings.calibration.observations import RAY_STEP_PX

PROBE_PX = 4.0  # topic calibrate_scene: step of the finite differences for a slit's middle, as in triangulate
REACH_PX = 60.0  # a ring farther from a slit than this pulls no harder; topic autocalibration, cold starts


class Lines(NamedTuple):
    """N observations, each on its line, as `errors` takes them."""

    frame: IntArray  # (N,)
    ring: IntArray  # (N,)
    rays: FloatArray  # (N, 3, 3) of the slit and RAY_STEP_PX to either side of it, as `Observations` has them
    origins: FloatArray  # (N, 3, 3) mm, likewise
    width: FloatArray | None  # (N,) px of each slit, or None where its middle is not to be found again


class Guess(NamedTuple):
    """What is tried: the unknowns, and what is held."""

    cones: FloatArray  # (K, 6) half-angle, axis x y, vertex x y z
    poses: FloatArray  # (F, 4) rx, ry, tx, ty
    turns: FloatArray  # (F, 4) cosine and sine of rx, of ry
    radius: float  # mm
    correction: FloatArray  # (K, 2, n) offset and shift by sector


class Residuals(NamedTuple):
    """What is written."""

    places: FloatArray  # (N,) px, where the ring's image crosses the line; kept from call to call
    middles: FloatArray  # (N,) px, how far beyond its slit's middle that is; kept likewise
    error: FloatArray  # (N,) px, seen less expected place along the line, NaN where ray, wall and cone do not meet
    rows: FloatArray  # (N, 17 ..) how the expected place moves with half-angle, axis x y, vertex x y z, rx, ry, tx, ty,
    # radius, and with the camera: its turn about its centre and its centre, x y z each


_bundle_errors = door(
    "bundle_errors",
    "i8[n] frame",
    "i8[n] ring",
    "f8[n,3,3] rays",
    "f8[n,3,3] origins",
    "f8[n]? width",
    "f8[k,6] cones",
    "f8[f,4] poses",
    "f8[f,4] turns",
    "f8 radius",
    "f8[k,2,s] correction",
    "f8 step_px",
    "f8 probe_px",
    "f8 reach_px",
    "f8[n]! places",
    "f8[n]! middles",
    "f8[n]! error",
    "f8[n,l]! rows",
)
# weight (N,) and error of observations, rows as of `Residuals`, added to blocks (C, K, F, l, l) and right (C, K, F, l)
gather = door(
    "gather_blocks",
    "i8[n] frame",
    "i8[n] ring",
    "i8[n] camera",
    "f8[n] weight",
    "f8[n] error",
    "f8[n,l] rows",
    "f8[c,k,f,l,l]! blocks",
    "f8[c,k,f,l]! right",
)
# the same to shared (K n, 6 + 4 F + 1): each sector's angle against its ring, all poses and the radius
gather_sectors = door(
    "gather_sectors", "i8[n] frame", "i8[n] sector", "f8[n] weight", "f8[n,l] rows", "f8[s,w]! shared"
)
# What several cameras and their colours add to `errors`: of the rows no camera's for the first, from which all is
# measured, and of the others the turn as their rotation vector's, by turns (C, 3, 3); colours' shifts (T,) px.
of_head = door(
    "head_rows", "i8[n] camera", "f8[c,3,3] turns", "f8[n,t] tint", "f8[t] shift", "f8[n]! error", "f8[n,l]! rows"
)


def errors(lines: Lines, guess: Guess, residuals: Residuals) -> None:
    """`Lines` and `Guess` in, `Residuals` out."""
    _bundle_errors(*lines, *guess, RAY_STEP_PX, PROBE_PX, REACH_PX, *residuals)
