"""Rays of a slide through a clear tube about the projector, by Snell's law at both its faces."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tools.light.effects import Tube

Array = NDArray[np.float64]
AZIMUTHS = 181


def behind_mm(tube: Tube, half_angle: float) -> float:
    """How far a tube puts the source of a ring back along its axis, mm, if that is the tube's own."""
    into = math.pi / 2 - half_angle
    within = math.asin(math.sin(into) / tube.index)
    return tube.wall_mm * (math.tan(into) - math.tan(within))


def on_wall(tube: Tube, half_angles: Array, azimuths: Array, radius_mm: float) -> Array:
    """(.., 3) where rays that leave the origin about +z meet a pipe of `radius_mm` about it."""
    theta, phi = np.broadcast_arrays(half_angles, azimuths)
    way = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    turned = Rotation.from_euler("xy", [-tube.lean_deg[1], tube.lean_deg[0]], degrees=True).as_matrix()
    way = way @ turned  # into the tube's own axes
    at = np.zeros_like(way)
    for radius, ratio in ((tube.inner_mm, 1.0 / tube.index), (tube.inner_mm + tube.wall_mm, tube.index)):
        at = _to_cylinder(at, way, radius)
        outwards = at * np.array([1.0, 1.0, 0.0]) / radius
        way = _refracted(way, outwards, ratio)
    return _to_cylinder(at @ turned.T, way @ turned.T, radius_mm)


def _to_cylinder(at: Array, way: Array, radius: float) -> Array:
    """From inside a cylinder about z to its wall."""
    a = (way[..., :2] ** 2).sum(-1)
    b = (at[..., :2] * way[..., :2]).sum(-1)
    c = (at[..., :2] ** 2).sum(-1) - radius**2
    return np.asarray(at + ((-b + np.sqrt(b * b - a * c)) / a)[..., None] * way)


def _refracted(way: Array, outwards: Array, ratio: float) -> Array:
    """`way` through a face whose normal points along the light; ratio : index before over index behind."""
    cos_in = (way * outwards).sum(-1, keepdims=True)
    cos_out = np.sqrt(1.0 - ratio**2 * (1.0 - cos_in**2))
    return np.asarray(ratio * way + (cos_out - ratio * cos_in) * outwards)


def came(tube: Tube, back_mm: float, angles: Array, radius_mm: float) -> Callable[[Array, Array], Array]:
    """A function (half-angle, azimuth) -> half-angle at the slide, as seen from a source `back_mm` behind it along the
    axis, of what meets a pipe of `radius_mm`."""
    slide = np.linspace(max(angles[0], 0.03), angles[-1], 400)
    azimuth = np.linspace(-math.pi, math.pi, AZIMUTHS)
    hits = on_wall(tube, slide[:, None], azimuth[None, :], radius_mm)
    seen = np.arctan2(np.hypot(hits[..., 0], hits[..., 1]), hits[..., 2] + back_mm)
    turned = np.unwrap(np.arctan2(hits[..., 1], hits[..., 0]), axis=1)
    grid = np.stack([np.interp(slide, seen[:, k], slide) for k in range(AZIMUTHS)], 1)  # by seen angle, slide's azimuth
    off = np.mean(turned - azimuth[None, :], axis=0)  # an azimuth hardly moves

    def function(theta: Array, phi: Array) -> Array:
        j = np.interp(phi, azimuth + off, np.arange(AZIMUTHS))
        i = np.interp(theta, slide, np.arange(len(slide)))
        i0, j0 = np.minimum(i.astype(int), len(slide) - 2), np.minimum(j.astype(int), AZIMUTHS - 2)
        u, v = i - i0, j - j0
        upper = grid[i0, j0] * (1 - v) + grid[i0, j0 + 1] * v
        lower = grid[i0 + 1, j0] * (1 - v) + grid[i0 + 1, j0 + 1] * v
        inside = (theta >= slide[0]) & (theta <= slide[-1])
        return np.where(inside, upper * (1 - u) + lower * u, theta)

    return function
