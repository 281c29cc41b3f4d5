"""The loop over points: what the frames say along a point's own track through the images.

A point X(h) = base + h * path is carried past the head. In frame n it is seen at one pixel and lit at one phase of the
slide, both following from h, so both move while h is sought:

    I_n = (A + B w(phase_n(h))) (1 + g t_n)           A: DC, B: AC of the point, g: its light's drift along the track

First the source's linear least squares (Eq. 6.9 to 6.14) on the point's own phases: it knows no local minimum within
half a period. Then Gauss-Newton in A, B, h and g, weighted by the noise a grey level has. The step in h is judged
along each frame's ray: a wrong h samples the wall beside the point, and the phase found there is the phase of that
place. The wall there is taken to stand across `normal`, which costs rounds where it does not, and no accuracy: at the
end the samples are the point's own.
"""

from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.native import door

GOOD, TOO_FEW, UNMODULATED, UNDETERMINED, UNSETTLED, AMBIGUOUS = range(6)
ROBUST_FROM = 6  # frames: fewer cannot outvote one that is wrong
TUKEY_SQUARED = 4.685**2
EXCESS = 3.0  # sigma of chi^2: more misfit than that is no chance, and makes the height's sigma larger
MODULATED = 4.0  # sigma of AC: below it phase is noise (its sigma a quarter of a radian, no longer normal)
BLOCK = 64  # points at a time, as fringe_camera.h has it

_follow = door(
    "fringe_follow",
    "f4[n,h,w]? images",
    "f8[n,p]? samples",
    "f8[10] lens",
    "f8[n,3,4] cameras",
    "f8[n,3] eyes",
    "f8[n,3,4] projectors",
    "f8[s] slide",
    "f8[n] drift",
    "f8[p,3] base",
    "f8[q,3] path",
    "f8[r,3] normal",
    "f8[p] start",
    "f8 drift_sigma",
    "f8[3] noise",
    "f8 tolerance",
    "i8 robust_from",
    "f8 tukey",
    "f8 excess",
    "f8 modulated",
    "f8[p]! height",
    "f8[p]! sigma",
    "f8[p]! dc",
    "f8[p]! ac",
    "f8[p]! misfit",
    "f8[p]! used",
    "f8[p]! flag",
    "f4[n,p]!? residual",
    f"f8[2,n,{BLOCK}]! room",
)
_look = door("fringe_look", "f8[10] lens", "f8[3,4] camera", "f8[p,3] points", "f8[p]! u", "f8[p]! v")


def look(lens: FloatArray, camera: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels at which a camera (3, 4) sees (P, 3) world points, (P,) both; NaN behind a pinhole.

    lens: kind (0 pinhole, 1 fisheye), fx, fy, cx, cy, and OpenCV's k1 k2 p1 p2 k3, or k1..k4.
    """
    u, v = np.empty(len(points)), np.empty(len(points))
    _look(lens, np.ascontiguousarray(camera), np.ascontiguousarray(points), u, v)
    return u, v


class TrackFrames(NamedTuple):
    """N frames of one eye, as `follow` takes them."""

    images: Float32Array | None  # (N, H, W) coefficients of splines, or None where there are samples
    samples: FloatArray | None  # (N, P) grey levels where the pixels are the points' own
    lens: FloatArray  # as `look` takes it
    cameras: FloatArray  # (N, 3, 4) world to camera
    eyes: FloatArray  # (N, 3) camera centres, world
    projectors: FloatArray  # (N, 3, 4) world to projector
    slide: FloatArray  # `FringeProjector.numbers`
    drift: FloatArray  # (N,) t_n


class Tracks(NamedTuple):
    """P points, each somewhere on its own line: X(h) = base + h * path."""

    base: FloatArray  # (P, 3)
    path: FloatArray  # (P, 3), or (1, 3) for all
    normal: FloatArray  # (P, 3), or (1, 3) for all; path . normal = 1
    start: FloatArray  # (P,) h that is begun with


class Tracked(NamedTuple):
    """What is written, all (P,)."""

    height: FloatArray  # mm, NaN unless the flag is GOOD
    sigma: FloatArray  # mm, likewise
    dc: FloatArray
    ac: FloatArray
    misfit: FloatArray  # chi^2, each frame's share at most Tukey's
    used: FloatArray  # frames
    flag: FloatArray  # GOOD, or why there is no height

    @staticmethod
    def of(count: int) -> "Tracked":
        return Tracked(*(np.full(count, np.nan) for _ in range(7)))


def follow(
    frames: TrackFrames,
    tracks: Tracks,
    drift_sigma: float,
    noise: tuple[float, float, float],
    tolerance: float,
    residuals: bool = False,
) -> tuple[Tracked, Float32Array]:
    """Every point's height, and of each frame what its grey levels are off, (N, P), or (0, 0).

    drift_sigma : what is believed of g, 0 for none. noise : variance of a grey level I is noise . (1, I, I^2).
    tolerance : of h, where rounds end.
    """
    count, points = len(frames.cameras), len(tracks.base)
    outcome = Tracked.of(points)
    left = np.empty((count, points) if residuals else (0, 0), np.float32)
    _follow(
        *(None if one is None else np.ascontiguousarray(one) for one in (*frames, *tracks)),
        drift_sigma,
        np.array(noise),
        tolerance,
        ROBUST_FROM,
        TUKEY_SQUARED,
        EXCESS,
        MODULATED,
        *outcome,
        left if residuals else None,
        np.empty((2, count, BLOCK)),
    )
    return outcome, left
