"""A butt-fusion joint of our own, voxel by voxel: two pipes that lean and do not quite meet, beads, zone, flaws."""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter

from annulus_pipe.numeric.arrays import Float32Array, FloatArray

VOXEL = (0.34, 0.3, 0.3)  # z, y, x, mm
AIR, PLASTIC = 150.0, 1900.0


@dataclass(frozen=True)
class Scene:
    radius: float = 15.0
    wall: float = 4.0
    lean: tuple[float, float] = (0.02, -0.03)
    centre: tuple[float, float] = (19.6, 18.2)  # mm, where the axis meets the fusion plane
    plane: float = 16.0
    hilo: float = 0.4  # the second pipe's axis stands so far towards +x
    width: float = 4.4  # of the zone
    drop: float = 0.03
    bead: tuple[float, float] = (6.0, 1.6)  # width, height
    notch: float = 0.45
    oval: float = 0.08
    drift: float = 0.01  # along z, and as much along y
    scatter: float = 60.0  # grey by which a slice sinks under the beads
    noise: float = 40.0
    void: tuple[float, float, float] | None = (60.0, 13.0, 0.5)  # angle, distance from the axis, along it
    grain: tuple[float, float, float] | None = (200.0, 12.6, -1.2)
    shape: tuple[int, int, int] = field(default=(96, 128, 128))
    sawn: float | None = None  # mm: only a strip so wide is left, at angle 0

    def width_at(self, phi: FloatArray) -> FloatArray:
        return self.width + 0.5 * np.cos(phi - 1.0)

    def outer_at(self, phi: FloatArray) -> FloatArray:
        return self.radius + self.oval * np.cos(2 * phi - 0.5)


def roll(z: FloatArray, width: float, height: float, notch: float) -> FloatArray:
    """A bead's height along z: two half ellipses side by side, a groove between."""
    half = 0.25 * width
    ellipse = height * np.sqrt(np.clip(1 - ((np.abs(z) - half) / half) ** 2, 0, None))
    return np.where((np.abs(z) < half) & (ellipse < (1 - notch) * height), (1 - notch) * height, ellipse)


def volume(scene: Scene, seed: int = 1, voxel: tuple[float, float, float] = VOXEL) -> Float32Array:
    """(z, y, x) grey values."""
    nz, ny, nx = scene.shape
    z, y, x = (np.arange(n) * v for n, v in zip((nz, ny, nx), voxel, strict=True))
    z3, y3, x3 = z[:, None, None] - scene.plane, y[None, :, None], x[None, None, :]
    along = np.array([*scene.lean, 1.0]) / np.sqrt(1 + scene.lean[0] ** 2 + scene.lean[1] ** 2)
    dx, dy = x3 - scene.centre[0], y3 - scene.centre[1]
    s = dx * along[0] + dy * along[1] + z3 * along[2]
    px, py = dx - s * along[0] + 0.5 * scene.hilo * -np.sign(s), dy - s * along[1]
    rho, phi = np.hypot(px, py), np.arctan2(py, px)
    bead = roll(s, *scene.bead, scene.notch)
    outer = scene.outer_at(phi)
    inner = outer - scene.wall
    edge = 0.15
    solid = _step((outer + bead - rho) / edge) * _step((rho - inner + 0.8 * bead) / edge)
    if scene.sawn is not None:
        solid = solid * _step((0.5 * scene.sawn - np.abs(py)) / edge) * (px > 0)
    zone = _step((0.5 * scene.width_at(phi) - np.abs(s)) / 0.2)
    density = solid * (1 - scene.drop * zone)
    for place, value in ((scene.void, 0.0), (scene.grain, 2.2)):
        if place is not None:
            a, r, t = np.radians(place[0]), place[1], place[2]
            away = np.sqrt(
                (rho * np.cos(phi) - r * np.cos(a)) ** 2 + (rho * np.sin(phi) - r * np.sin(a)) ** 2 + (s - t) ** 2
            )
            density = np.where(away < 0.5, value, density)
    shade = scene.scatter * gaussian_filter((bead[:, ny // 2, nx // 2] > 0).astype(float), 2.0)
    grey = AIR + (PLASTIC - AIR) * density * (1 + scene.drift * z3 / 16) * (1 + scene.drift * dy / 16)
    grey = gaussian_filter(grey, 0.6) - shade[:, None, None]
    return (grey + np.random.default_rng(seed).normal(0, scene.noise, grey.shape)).astype(np.float32)


def _step(t: FloatArray) -> FloatArray:
    return np.asarray(np.clip(0.5 + 0.5 * t, 0, 1))
