"""What the loops over a pipe's wall see: light, phase and place of wall points in every frame of a head in a pipe.

Light in a pipe is no constant along a track: it falls off with distance and angle, and fringes that the lens sees
aslant are blurred more the farther ahead. Both belong to the head and are smooth there, so for each of its eyes a
polynomial in the point's place in the head's frame says both, a level and a modulation relative to their middle
(`shading`):

    I_n = gain_n (A + B depth_n w(phase_n(h) + texture q_n blur^2)) (1 + g t_n)

The blur is of the lens, px, and grows on the wall with the distance ahead. q_n is what a slope of albedo along the pipe
does to the phase (see `texture`), in each frame by its own blur.
"""

from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.native import door
from annulus_pipe.wings.fringe.measure.track import BLOCK, MODULATED, ROBUST_FROM, TUKEY_SQUARED, Tracked

DEGREE = 3  # of the shading along the pipe; times 1, cos, sin of the direction
TERMS = 3 * (DEGREE + 1)
SUMS = 13  # of an eye's frames, by point: room that fringe_bore.c asks for
FRAMES = ("f4[n,h,w] images", "f8[n,10] lens", "f8[n,3,4] cameras", "f8[n,3,4] heads")
_follow_wall = door(
    "fringe_follow_wall",
    *FRAMES,
    "f8[n,3] eyes",
    "f8[n,3,4] projectors",
    "f8[n,s] slide",
    "f8[n] drift",
    "i8[n] eye",
    "f8[e,3,t] shading",
    "f8 blur_squared",
    "f8 drift_sigma",
    "f8[3] noise",
    "f8[p,3] base",
    "f8[p,3] path",
    "f8[p] texture",
    "f8[p] start",
    "f8 tolerance",
    "i8 robust_from",
    "f8 tukey",
    "f8 modulated",
    "f8[p]! height",
    "f8[p]! sigma",
    "f8[p]! dc",
    "f8[p]! ac",
    "f8[p]! misfit",
    "f8[p]! used",
    "f8[p]! flag",
    "i8[p]! who",
    f"f8[2,n,{BLOCK}]! rows",
    f"f8[e,{SUMS},{BLOCK}]! by_eyes",
)
_look_around = door(
    "fringe_look_around",
    *FRAMES,
    "f8[n,3] eyes",
    "f8[n,3,4] projectors",
    "f8[n,s] slide",
    "f8[p,3] points",
    "f8[p,3] normal",
    "f8[n,p]! grey",
    "f8[n,p]! phase",
    "f8[n,p]! slope",
    "f8[n,p]! pull",
    "f8[n,p,3]! seen",
)


class HeadFrames(NamedTuple):
    """N frames of a head of several eyes, as the loops here and in `groove` take them."""

    images: Float32Array  # (N, H, W) coefficients of splines
    lens: FloatArray  # (N, 10) as `look` takes it
    cameras: FloatArray  # (N, 3, 4) world to camera
    heads: FloatArray  # (N, 3, 4) world to head
    eyes: FloatArray  # (N, 3) camera centres, world
    projectors: FloatArray  # (N, 3, 4) world to projector
    slide: FloatArray  # (N, S) `FringeProjector.numbers`
    drift: FloatArray  # (N,) t_n
    eye: IntArray  # (N,) whose frame each is


class HeadLight(NamedTuple):
    """What is known of a head's light and lens. Extent: middle and half-length of the wall that an eye sees, mm along
    z, and the least cosine of what it sees to its camera's axis."""

    shading: FloatArray  # (E, 3, TERMS) by eye: extent, logarithm of gain, logarithm of modulation
    blur_squared: float  # px^2; 0: none is reckoned with
    drift_sigma: float  # what is believed of g, 0: none
    noise: tuple[float, float, float]  # variance of a grey level I is noise . (1, I, I^2)


class BorePoints(NamedTuple):
    """P points of the wall."""

    base: FloatArray  # (P, 3)
    path: FloatArray  # (P, 3) outwards
    texture: FloatArray  # (P,) slope of the albedo along the pipe over itself, 1 / mm
    start: FloatArray  # (P,) height that is begun with


def look_around(
    frames: HeadFrames, points: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """(P, 3) points of a wall that stands across normal (P, 3), in every frame: grey level, phase, its slope along the
    frame's ray per mm of height, and q, each (N, P), and where the points stand in the head's frame, (N, P, 3); NaN
    where not seen."""
    shape = (len(frames.cameras), len(points))
    out = (np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape), np.empty((*shape, 3)))
    ordered = map(np.ascontiguousarray, (*frames[:7], points, normal))
    _look_around(*ordered, *out)
    return out


def follow_wall(frames: HeadFrames, light: HeadLight, points: BorePoints, tolerance: float) -> tuple[Tracked, IntArray]:
    """Every wall point's height outwards, in a pipe's light (module docstring), and (P,) who told it: an eye's number,
    the number of eyes where several did, -1 where none.

    tolerance : of the height, where rounds end.

    A height is begun by one eye alone, for two on either side of a lamp see its light move in opposite ways.
    """
    count = len(points.base)
    outcome, who = Tracked.of(count), np.full(count, -1)
    _follow_wall(
        *map(np.ascontiguousarray, (*frames, light.shading)),
        light.blur_squared,
        light.drift_sigma,
        np.array(light.noise),
        *map(np.ascontiguousarray, points),
        tolerance,
        ROBUST_FROM,
        TUKEY_SQUARED,
        MODULATED,
        *outcome,
        who,
        np.empty((2, len(frames.cameras), BLOCK)),
        np.empty((len(light.shading), SUMS, BLOCK)),
    )
    return outcome, who
