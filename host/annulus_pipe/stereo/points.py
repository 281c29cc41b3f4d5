"""From distances along the projector's generators to points of the wall: places, sigma of the radius, colour.

Each verb is one pass over what it needs, in host/native/stereo_points.c: as a chain of numpy's the same sums took four
times as long.
"""

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.rings.slits import Slits
from annulus_pipe.stereo.merge import Merged

_to_pipe = door(
    "stereo_to_pipe",
    "f8[k,3] vertices",
    "f8[k,p,3] ways",
    "f8[3,3] rotation",
    "f8[3] shift",
    "f8 radius",
    "f8[k,p]! out",
)
_known = door(
    "stereo_known",
    "f8[k,p] distance",
    "f8[k,3] vertices",
    "f8[k,p,3] ways",
    "i8[2,n]! at",
    "f8[n,3]! points",
    returns="i8",
)
_radial = door(
    "stereo_radial",
    "f8[n,3] points",
    "i8[2,n] at",
    "f8[k,p,3] ways",
    "f8[3,3] rotation",
    "f8[3] shift",
    "f8[4,4] covariance",
    "f8[n]? along",
    "f8[n]! out",
)
_beside = door(
    "stereo_beside",
    "i8[2,n] at",
    "i8[k,p] heaviest",
    "i8[k,p] line",
    "i8 camera",
    "i8[k,j] which",
    "f8[s,3] inside",
    "f8[s,3] outside",
    "u1[n,3]! light",
)


def to_pipe(vertices: FloatArray, pose: Pose, ways: FloatArray, radius_mm: float) -> FloatArray:
    """(K, P) mm along each generator, (K, P, 3) from (K, 3), to a clean pipe; NaN where it leads to none."""
    out = np.empty(ways.shape[:2])
    _to_pipe(_whole(vertices), _whole(ways), _whole(pose.rotation), _whole(pose.translation), radius_mm, out)
    return out


def known(merged: Merged, vertices: FloatArray, ways: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Where the wall is known: (2, N) ring and generator, (N, 3) mm, the head's frame."""
    at = np.empty((2, merged.distance_mm.size), np.int64)
    points = np.empty((merged.distance_mm.size, 3))
    size = _known(merged.distance_mm, _whole(vertices), _whole(ways), at, points)
    return at[:, :size], points[:size]


def outwards(points: FloatArray, at: NDArray[np.int64], ways: FloatArray, pose: Pose) -> FloatArray:
    """(N,) how much of a step along its generator takes a point away from the pipe's axis."""
    return _radially(points, at, None, ways, pose, np.zeros((4, 4)))


def radius_sigma(
    points: FloatArray,
    at: NDArray[np.int64],
    along_mm: FloatArray,
    ways: FloatArray,
    pose: Pose,
    covariance: FloatArray,
) -> FloatArray:
    """(N,) mm of each point's radius: `along_mm` (N,) along its generator, and the pose by its covariance (4, 4)."""
    return _radially(points, at, along_mm, ways, pose, covariance)


def _radially(
    points: FloatArray,
    at: NDArray[np.int64],
    along_mm: FloatArray | None,
    ways: FloatArray,
    pose: Pose,
    covariance: FloatArray,
) -> FloatArray:
    out = np.empty(len(points))
    along = None if along_mm is None else _whole(along_mm)
    where = np.ascontiguousarray(at, np.int64)
    turn, shift = _whole(pose.rotation), _whole(pose.translation)
    _radial(_whole(points), where, _whole(ways), turn, shift, _whole(covariance), along, out)
    return out


def beside(
    at: NDArray[np.int64], merged: Merged, camera: int, which: NDArray[np.int64], slits: Slits, light: NDArray[np.uint8]
) -> None:
    """Writes into `light` (N, 3) RGB what this camera's stripes show where it is the one that knows the point best.

    which : (K, J) its slit on each of its lines, -1 for none; a neighbouring line's will do.
    """
    where, inside, outside = np.ascontiguousarray(at), _whole(slits.inside), _whole(slits.outside)
    _beside(where, merged.heaviest, merged.line, camera, np.ascontiguousarray(which), inside, outside, light)


def _whole(values: FloatArray) -> FloatArray:
    """In order of memory, as loops in C take it."""
    return np.ascontiguousarray(values, np.float64)
