"""From distances along the projector's generators to points of the wall: places, sigma of the radius, colour.

Each verb is one pass over what it needs, compiled: as a chain of numpy's the same sums took four times as long.
"""

import math

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import around, jit
from annulus_pipe.rings.slits import Slits
from annulus_pipe.stereo.merge import Merged


def to_pipe(vertices: FloatArray, pose: Pose, ways: FloatArray, radius_mm: float) -> FloatArray:
    """(K, P) mm along each generator, (K, P, 3) from (K, 3), to a clean pipe; NaN where it leads to none."""
    out = np.empty(ways.shape[:2])
    _to_pipe(vertices, ways, pose.rotation, pose.translation, radius_mm, out)
    return out


def known(merged: Merged, vertices: FloatArray, ways: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Where the wall is known: (2, N) ring and generator, (N, 3) mm, the head's frame."""
    at = np.empty((2, merged.distance_mm.size), np.int64)
    points = np.empty((merged.distance_mm.size, 3))
    size = _known(merged.distance_mm, vertices, ways, at, points)
    return at[:, :size], points[:size]


def outwards(points: FloatArray, at: NDArray[np.int64], ways: FloatArray, pose: Pose) -> FloatArray:
    """(N,) how much of a step along its generator takes a point away from the pipe's axis."""
    out = np.empty(len(points))
    at = np.ascontiguousarray(at)  # of one layout, so that one loop is compiled and not four
    _radial(points, at, ways, pose.rotation, pose.translation, np.zeros((4, 4)), np.zeros(0), out)
    return out


def radius_sigma(
    points: FloatArray,
    at: NDArray[np.int64],
    along_mm: FloatArray,
    ways: FloatArray,
    pose: Pose,
    covariance: FloatArray,
) -> FloatArray:
    """(N,) mm of each point's radius: `along_mm` (N,) along its generator, and the pose by its covariance (4, 4)."""
    out = np.empty(len(points))
    at, covariance = np.ascontiguousarray(at), np.ascontiguousarray(covariance)
    _radial(points, at, ways, pose.rotation, pose.translation, covariance, along_mm, out)
    return out


def beside(
    at: NDArray[np.int64], merged: Merged, camera: int, which: NDArray[np.int64], slits: Slits, light: NDArray[np.uint8]
) -> None:
    """Writes into `light` (N, 3) RGB what this camera's stripes show where it is the one that knows the point best.

    which : (K, J) its slit on each of its lines, -1 for none; a neighbouring line's will do.
    """
    _beside(np.ascontiguousarray(at), merged.heaviest, merged.line, camera, which, slits.inside, slits.outside, light)


@jit
def _to_pipe(vertices, ways, rotation, shift, radius, out):  # type: ignore[no-untyped-def]
    for k in range(out.shape[0]):
        x, y, z = vertices[k, 0] - shift[0], vertices[k, 1] - shift[1], vertices[k, 2] - shift[2]
        u = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]
        v = x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]
        c = u * u + v * v - radius * radius
        for p in range(out.shape[1]):
            x, y, z = ways[k, p, 0], ways[k, p, 1], ways[k, p, 2]
            wu = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]
            wv = x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]
            a, b = wu * wu + wv * wv, u * wu + v * wv
            out[k, p] = (math.sqrt(b * b - a * c) - b) / a if b * b >= a * c else np.nan


@jit
def _known(distance, vertices, ways, at, points):  # type: ignore[no-untyped-def]
    size = 0
    for k in range(distance.shape[0]):
        for p in range(distance.shape[1]):
            s = distance[k, p]
            if s == s:
                at[0, size], at[1, size] = k, p
                for i in range(3):
                    points[size, i] = vertices[k, i] + s * ways[k, p, i]
                size += 1
    return size


@jit
def _radial(points, at, ways, rotation, shift, covariance, along, out):  # type: ignore[no-untyped-def]
    """Writes (N,) the part of each generator that leads away from the pipe's axis; where `along` has its points' sigma,
    what that and the pose leave open of the radius."""
    pull = np.empty(4)
    for n in range(len(out)):
        k, p = at[0, n], at[1, n]
        x, y, z = points[n, 0] - shift[0], points[n, 1] - shift[1], points[n, 2] - shift[2]
        u = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]
        v = x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]
        ahead = x * rotation[0, 2] + y * rotation[1, 2] + z * rotation[2, 2]
        x, y, z = ways[k, p, 0], ways[k, p, 1], ways[k, p, 2]
        wu = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]
        wv = x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]
        r = math.sqrt(u * u + v * v)
        out[n] = (u * wu + v * wv) / r
        if len(along) == 0:
            continue
        pull[0], pull[1], pull[2], pull[3] = ahead * v / r, -ahead * u / r, -u / r, -v / r
        by_pose = 0.0
        for a in range(4):
            for b in range(4):
                by_pose += pull[a] * covariance[a, b] * pull[b]
        out[n] = math.sqrt((along[n] * out[n]) ** 2 + by_pose)


@jit
def _beside(at, heaviest, line, camera, which, inside, outside, light):  # type: ignore[no-untyped-def]
    lines = which.shape[1]
    for n in range(at.shape[1]):
        k, p = at[0, n], at[1, n]
        if heaviest[k, p] != camera:
            continue
        j = around(line[k, p], lines)
        slit = which[k, j]
        for step in (1, -1):
            if slit < 0:
                slit = which[k, around(j + step, lines)]
        if slit >= 0:
            for c in range(3):
                both = 0.5 * (inside[slit, 2 - c] + outside[slit, 2 - c])
                light[n, c] = np.uint8(min(max(both, 0.0), 255.0))
