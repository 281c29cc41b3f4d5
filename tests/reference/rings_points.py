"""From named slits to points, to be read: host/native/rings_points.c, and rings_keep and rings_for_fit of
rings_sigma.c. Equations are Alzuhiri's (2022)."""

import math

import numpy as np

from annulus_pipe.geometry.cone import FLAT
from annulus_pipe.rings.decode import NONE
from annulus_pipe.rings.polar import RAY_STEP_PX
from annulus_pipe.rings.triangulate import GRAZING, WIDEST


def meet(start, way, cone):
    """How far along its unit way a ray meets a cone (7,), NaN if nowhere: App. A.2; of two forward roots the farther,
    section 5.2."""
    vertex, axis, cos2 = cone[:3] - start, cone[3:6], math.cos(cone[6]) ** 2
    along, va, wv, vv = way @ axis, -(vertex @ axis), -(way @ vertex), vertex @ vertex
    if cos2 < FLAT:  # a plane
        return -va / along if abs(along) > GRAZING and -va / along > 0.0 else math.nan
    a = along * along - cos2  # Eq. 5.3
    b = 2.0 * (along * va - wv * cos2)  # Eq. 5.4
    c = va * va - vv * cos2  # Eq. 5.5
    # delta^2, Eq. 5.7: b b - 4 a c with what cancels taken out, for a cone that is nearly flat
    delta2 = 4.0 * cos2 * (along * along * vv - 2.0 * along * va * wv + va * va + cos2 * (wv * wv - vv))
    if not delta2 > 0.0:
        return math.nan
    q = -0.5 * (b + math.copysign(math.sqrt(delta2), b))
    roots = [one / other for one, other in ((q, a), (c, q)) if other != 0.0]  # of Eq. 5.6
    far = max((root for root in roots if root > 0.0 and va + root * along > 0.0), default=math.nan)
    # delta over the length of the cone's gradient there is the sine of the angle between ray and cone
    away2 = vv + 2.0 * far * wv + far * far
    return far if delta2 > GRAZING**2 * 4.0 * cos2 * (1.0 - cos2) * away2 else math.nan


def point(start, way, cone, correction):
    """(3,) mm. correction (n, 2) of the cone's half-angle and vertex over the azimuth, or None."""
    met = start + meet(start, way, cone) * way
    if correction is None:
        return met
    there = corrected(met, cone, correction)
    return start + meet(start, way, there) * way


def corrected(met, cone, correction):
    """The cone as it is at the azimuth of a point."""
    axis = cone[3:6]
    first = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    first /= np.linalg.norm(first)
    away = met - cone[:3]
    turn = math.atan2(away @ np.cross(axis, first), away @ first) / (2.0 * math.pi) % 1.0
    turn = 0.0 if math.isnan(turn) else turn
    at = np.arange(len(correction) + 1) / len(correction)
    angle, shift = (np.interp(turn, at, np.append(column, column[0])) for column in correction.T)
    return np.array([*(cone[:3] + shift * axis), *axis, cone[6] + angle])  # Eq. 4.12


def ray(grid, line, place):
    """Start (3,) and unit way (3,) of a place along a line, between the grid's nodes."""
    at = place / RAY_STEP_PX
    node = min(max(int(at), 0), grid.rays.shape[1] - 2)
    start, way = (
        np.zeros(3) if table is None else table[line, node] + (at - node) * (table[line, node + 1] - table[line, node])
        for table in (grid.origins, grid.rays)
    )
    return start, way / np.linalg.norm(way)


def points(direction, position, width, slit, name, grid, optics):
    """(3, C): where slit `slit` lies if it is ring `name`, of C candidates; NaN where ray and cone do not meet."""
    out = np.empty((3, len(slit)))
    widest = WIDEST * np.sort(width)[len(width) // 2]
    for n, (s, k) in enumerate(zip(slit, name, strict=True)):
        line = direction[s]
        place = position[s] + optics.bend[k, line] * min(width[s], widest) ** 2 / 8.0
        correction = None if optics.corrections is None else optics.corrections[k]
        with np.errstate(invalid="ignore"):
            out[:, n] = point(*ray(grid, line, place), optics.cones[k], correction)
    return out


def across(points, rotation, shift):
    """(3, N) q = R^T (p - T): along the pipe its third row."""
    return rotation.T @ (points - shift[:, None])  # Eq. 4.6


def deviations(points, rotation, shift, radius):
    """(N,) distance from the pipe's axis over its radius, less one."""
    return np.hypot(*across(points, rotation, np.append(shift[:2], 0.0))[:2]) / radius - 1.0


def keep(ring, chosen, light, points, rotation, shift, z, full):
    """Of slits with a ring: which, the wall (N, 3) mm, its colour (N, 3) RGB, whether a stripe is brighter than
    `full`. light (2, 3, S): blue, green, red inside and outside."""
    kept = np.flatnonzero(ring != NONE)
    wall = across(points[:, chosen[kept]], rotation, shift) + np.array([[0.0], [0.0], [z]])
    beside = light[:, ::-1, kept]
    colour = np.minimum(beside.mean(axis=0), 255.0).astype(np.uint8)
    return kept, wall.T.astype(np.float32), colour.T, (beside > full).any(axis=(0, 1))


def for_fit(ring, chosen, points, worth, most, ring_points):
    """What a pose is fitted to: points (3, N), their weights, how many rings have enough of them."""
    kept = np.flatnonzero(ring != NONE)
    if most:
        kept = kept[:: max(len(kept) // most, 1)]
    rings = np.bincount(ring[kept], minlength=len(worth))
    return points[:, chosen[kept]], worth[ring[kept]], int((rings > ring_points).sum())
