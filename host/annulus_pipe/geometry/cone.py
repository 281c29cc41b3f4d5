"""Rays against the two surfaces of this instrument: a projected ring's cone and the pipe's cylinder."""

from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray

AHEAD = 1e-9  # of the distance to the vertex: nearer to it than this a point is the vertex
FLAT = 1e-16  # squared cosine of the half-angle: 1e-6 mm at 100 mm from a plane, which it then is


@dataclass(frozen=True, slots=True)
class Cone:
    """One slit's surface. Half-angle in radians (pi / 2: the plane across the axis), unit axis (nearly +z), vertex in
    mm, camera frame."""

    half_angle: float
    axis: tuple[float, float, float]
    vertex_mm: tuple[float, float, float]


def intersect_cone(rays: FloatArray, cone: Cone, origin: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Points where camera rays meet one projected ring's cone.

    Parameters
    ----------
    rays : (N, 3) unit vectors. origin : (3,) mm, the rays' common start; the camera centre when not given.

    Returns
    -------
    points : (N, 3) mm, NaN where the ray misses or meets only the backward nappe.
    delta : (N,) square root of the discriminant; near zero the ray is tangent and the point ill-conditioned.

    Notes
    -----
    Alzuhiri 2022, App. A.2 (with Eq. .15's misprint mended); of two forward roots the farther, §5.2.
    """
    start = np.zeros(3) if origin is None else np.asarray(origin, dtype=float)
    axis, vertex = np.asarray(cone.axis), np.asarray(cone.vertex_mm)
    cos2 = np.cos(cone.half_angle) ** 2
    vc = start - vertex
    along, wv = rays @ axis, rays @ vc
    va, vv = vc @ axis, vc @ vc
    a = along**2 - cos2
    b = 2.0 * (along * va - wv * cos2)
    c = va**2 - vv * cos2
    with np.errstate(divide="ignore", invalid="ignore"):
        # b b - 4 a c with what cancels taken out, for a cone that is nearly flat
        delta = 2.0 * np.sqrt(cos2 * (along**2 * vv - 2.0 * along * va * wv + va**2 + cos2 * (wv**2 - vv)))
        if cos2 < FLAT:  # one sheet, which all of its light is on
            roots = np.stack([-va / along, np.full(along.shape, -np.inf)])
            forward = roots > 0
        else:
            q = -0.5 * (b + np.copysign(delta, b))  # the form that does not cancel
            roots = np.stack([q / a, c / q])
            forward = (roots > 0) & (va + roots * along > AHEAD * np.sqrt(vv))
        s = np.where(forward, roots, -np.inf).max(axis=0)
        s = np.where(np.isfinite(s), s, np.nan)
    return start + s[:, None] * rays, delta


def cone_distance(points: FloatArray, cone: Cone) -> FloatArray:
    """Signed distance (mm) of (N, 3) points from the cone, Alzuhiri 2022, Eq. 3.14/4.3; positive inside."""
    v = points - np.asarray(cone.vertex_mm)
    length = np.linalg.norm(v, axis=1)
    theta = np.arctan2(np.linalg.norm(np.cross(v, np.asarray(cone.axis)), axis=1), v @ np.asarray(cone.axis))
    return np.asarray(length * np.sin(cone.half_angle - theta))


def intersect_cylinder(
    rays: FloatArray, through: FloatArray, axis: FloatArray, radius_mm: float, origin: FloatArray | None = None
) -> FloatArray:
    """(N, 3) points where rays leave a cylinder, NaN for none. Alzuhiri 2022, App. A.1.

    rays : (N, 3) unit vectors. origin : (3,) or (N, 3) mm, where they start; the camera centre when not given.
    """
    start = np.zeros((1, 3)) if origin is None else np.atleast_2d(origin)
    x = np.cross(start - through, axis)
    y = np.cross(rays, axis)
    a, b = np.einsum("ij,ij->i", y, y), 2.0 * (y * x).sum(axis=1)
    c = (x * x).sum(axis=1) - radius_mm**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    return np.asarray(start + np.where(s > 0, s, np.nan)[:, None] * rays)
