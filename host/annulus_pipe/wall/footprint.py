"""Where the middle of a slit's light is on a wall that is neither straight nor even.

A slit lies between two edges, and its place is halfway between their images, mended for a straight pipe about the head
(`rings.triangulate`). What has to be mended is how the light's angle bends along a line of the image, and that is the
wall's doing: where it curves or leans, the same slit's middle is elsewhere. Every ring of a bend is then off one way
outside and the other way inside, which looks like a wider bend: 0.1 % of its radius on slits of 5 pixels, and as the
square of their width.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wall.adjustment import BIAS, AdjustmentState, Sightings, locate
from annulus_pipe.wall.profile import Profile

PROBE = 0.02  # of a ray's slope: step of the differences along a line, about half a slit
STEPS = 5  # of the secant that finds the wall on a ray
FARTHEST = 0.2  # of the way to it: a ray along the wall meets it nowhere near
MOST = 0.25  # of a slit's width: a middle that would be farther off is at an edge of the wall, and stays


def slit_angles(profiles: Sequence[Profile], rings: int) -> FloatArray:
    """(K,) half of the angle between the edges of each ring's slit, radians, the median over the frames; 0 where
    nobody said."""
    angles = [profile.slit_rad[:rings] for profile in profiles if len(profile.slit_rad) >= rings]
    if not angles:
        return np.zeros(rings)
    of = np.where(np.array(angles) > 0, np.array(angles, dtype=np.float64), np.nan)
    return np.array([np.nanmedian(row) if np.isfinite(row).any() else 0.0 for row in of.T])


def centred(
    seen: Sightings,
    state: AdjustmentState,
    cones: Sequence[Cone],
    points_mm: FloatArray,
    frame: NDArray[np.intp],
    ring: NDArray[np.intp],
    slit_rad: FloatArray,
) -> FloatArray:
    """(N, 3) points of the camera's frame, mm, moved along their cones to where their slits' middles are on this wall.

    frame, ring : (N,) each point's; heads are those of `seen` and `state`. slit_rad : (N,) half of the angle between a
    slit's edges, 0 where nobody said. Points whose slit lies across two pieces stay as they are.

    With t(q) the light's angle where the ray of slope q meets the wall, the middle of two edges is off by
    t''/t' w^2 / 8 (w = 2 slit_rad / t'); what a straight pipe has of it is in the points already.
    """
    vertex = np.array([cone.vertex_mm for cone in cones])[ring]
    axis = np.array([cone.axis for cone in cones])[ring]
    along = points_mm - vertex
    along /= np.linalg.norm(along, axis=1)[:, None]
    far = np.hypot(points_mm[:, 0], points_mm[:, 1])
    outward, slope = points_mm[:, :2] / far[:, None], far / points_mm[:, 2]

    def rays(slopes: FloatArray) -> FloatArray:
        """(3 N, 3) of slopes a little less, as given, a little more; 1 mm ahead."""
        each = np.concatenate([slopes * (1.0 + part * PROBE) for part in (-1, 0, 1)])
        return np.column_stack([np.tile(outward, (3, 1)) * each[:, None], np.ones(len(each))])

    def bend(ways: FloatArray, ahead: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """t' and t''/t'."""
        v = ways * ahead[:, None] - np.tile(vertex, (3, 1))
        by = np.tile(axis, (3, 1))
        angle = np.arctan2(np.linalg.norm(np.cross(v, by), axis=1), (v * by).sum(axis=1)).reshape(3, -1)
        first = (angle[2] - angle[0]) / (2 * PROBE * slopes)
        return first, (angle[2] - 2 * angle[1] + angle[0]) / (PROBE * slopes) ** 2 / first

    ways = rays(slope)
    ahead, chainage = _on_wall(seen, state, ways, np.tile(points_mm[:, 2], 3), np.tile(frame, 3))
    piece = state.centreline().piece_of(np.nan_to_num(chainage)).reshape(3, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, here = bend(ways, ahead, slope)
        # the same generator of the cone, on a straight pipe about the head
        a, b = (along[:, :2] ** 2).sum(axis=1), (along[:, :2] * vertex[:, :2]).sum(axis=1)
        c = (vertex[:, :2] ** 2).sum(axis=1) - seen.radius_mm**2
        usual = seen.radius_mm / (vertex[:, 2] + (np.sqrt(b * b - a * c) - b) / a * along[:, 2])
        straight = rays(usual)
        _, there = bend(
            straight, np.tile(seen.radius_mm / usual, 3) / np.repeat([1 - PROBE, 1.0, 1 + PROBE], len(far)), usual
        )
        width = 2 * slit_rad / np.abs(first)
        off = (here - there) * width**2 / 8
        by_way = ((outward * along[:, :2]).sum(axis=1) - slope * along[:, 2]) / points_mm[:, 2]
        move = off / by_way
    good = np.isfinite(move) & (np.abs(off) < MOST * width) & (piece == piece[1]).all(axis=0)
    return np.asarray(points_mm + np.where(good, move, 0.0)[:, None] * along)


def _on_wall(
    seen: Sightings, state: AdjustmentState, ways: FloatArray, ahead_mm: FloatArray, frame: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """(M,) mm ahead at which rays (M, 3) from the camera meet the wall, about where they are guessed to, and the
    chainage there; NaN where they do not."""
    nothing = np.zeros((len(ways), 3))
    at = replace(
        seen, frame=frame, ring=np.zeros(len(ways), np.intp), slide_mm=nothing, ways=np.zeros((len(ways), BIAS))
    )
    before, now = ahead_mm * 0.99, ahead_mm.copy()
    was = locate(replace(at, points_mm=ways * before[:, None]), state).residual_mm
    for _ in range(STEPS):
        where = locate(replace(at, points_mm=ways * now[:, None]), state)
        rise = (where.residual_mm - was) / np.where(now == before, 1.0, now - before)
        step = np.where(rise > 0, -where.residual_mm / np.maximum(rise, 1e-6), 0.0)
        before, was = now, where.residual_mm
        now = np.clip(now + step, (1 - FARTHEST) * ahead_mm, (1 + FARTHEST) * ahead_mm)
    where = locate(replace(at, points_mm=ways * now[:, None]), state)
    met = np.abs(where.residual_mm) < 1e-3
    return np.where(met, now, np.nan), np.where(met, where.chainage_mm, np.nan)
