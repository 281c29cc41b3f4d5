"""Half of the pipe as a shaded picture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.wall.grid import Wall, smooth

BACKGROUND = (222, 229, 235)
EXAGGERATION = 3.0  # of the deviation in the picture; the caption says so
HALF_DEG = 90.0  # each side of the middle
VIEW_ROLL_DEG, VIEW_YAW_DEG = -14.0, 27.0  # from where one looks at a half: rolled about the pipe, turned along it


@dataclass(frozen=True, slots=True)
class View:
    """A shaded picture, (H, W, 3) uint8 RGB, and how pipe-frame points fall into it (orthographic)."""

    image: Image
    right: FloatArray
    down: FloatArray
    origin: FloatArray  # the pipe-frame point in the middle of the picture, mm
    px_per_mm: float

    def project(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm in the pipe frame -> (N, 2) pixels."""
        height, width = self.image.shape[:2]
        flat = (points - self.origin) @ np.stack([self.right, self.down], axis=1)
        return np.asarray(flat * self.px_per_mm + [(width - 1) / 2, (height - 1) / 2])


def half_view(wall: Wall, colour: Image, rows: slice, clock_deg: float, *, width: int = 840, height: int = 540) -> View:
    """The half of the pipe around a clock angle, from inside and a little ahead; distance runs to the right.

    Parameters
    ----------
    colour : (Z, A, 3) uint8 RGB of every cell; unseen cells are drawn as holes.
    rows : the stretch to show.

    Notes
    -----
    The grid is resampled finer than the picture and splatted, far first, at twice the size, then averaged down. Shaded
    by the slope of the wall; deviations are drawn `EXAGGERATION` times their size.
    """
    radius = wall.mean_radius_mm
    z = wall.z_mm[rows]
    look = np.radians(clock_deg + VIEW_ROLL_DEG)
    outward = np.array([np.sin(look), -np.cos(look), 0.0])
    along = np.array([0.0, 0.0, 1.0])
    yaw = np.radians(VIEW_YAW_DEG)
    forward = np.cos(yaw) * outward + np.sin(yaw) * along
    right = np.cos(yaw) * along - np.sin(yaw) * outward
    down = np.cross(forward, right)
    # What will be in the picture, to fit it: the rims of the half, both ends.
    rim = np.radians(np.arange(clock_deg - HALF_DEG, clock_deg + HALF_DEG + 1, 5.0))
    ring = np.stack([radius * np.sin(rim), -radius * np.cos(rim), np.zeros_like(rim)], axis=1)
    corners = np.concatenate([ring + along * z[0], ring + along * z[-1]]) @ np.stack([right, down, forward], axis=1)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = np.array([0.84, 1.0 - 90.0 / height])
    fine = 2
    height = int(min(height, width * (high - low)[1] / (high - low)[0] + 110))  # no empty paper under a long stretch
    size = np.array([width, height]) * fine
    scale = float((size * margin / (high - low)[:2]).min())
    origin = (low + high) / 2 @ np.stack([right, down, forward])

    steps = max(int(np.pi * radius * scale * 1.2), 180)
    j = (clock_deg - HALF_DEG + (np.arange(steps) + 0.5) / steps * 2 * HALF_DEG) / wall.clock_step_deg - 0.5
    n_rows = int(np.clip((z[-1] - z[0]) * scale * 1.2, 2, 4000))
    i = np.linspace(0, len(z) - 1, n_rows)
    deviation, seen = _resample(smooth(wall.deviation_mm()[rows]), i, j)
    t = np.radians((j + 0.5) * wall.clock_step_deg)[None].astype(np.float32)
    r = radius + EXAGGERATION * deviation
    zz = np.broadcast_to((z[0] + i * wall.z_step_mm).astype(np.float32)[:, None], r.shape)
    slope_t = np.clip(np.gradient(r, np.radians(2 * HALF_DEG / steps), axis=1) / r, -3, 3)
    slope_z = np.clip(np.gradient(r, (z[-1] - z[0]) / (n_rows - 1), axis=0), -3, 3)
    sin, cos = np.sin(t), np.cos(t)
    seen &= -sin * forward[0] + cos * forward[1] < 0.0  # what turns its back is the outside of the near rim
    inward = np.stack([-sin + slope_t * cos, cos + slope_t * sin, slope_z], axis=-1)[seen]
    inward /= np.sqrt(np.einsum("ij,ij->i", inward, inward))[:, None]
    points = np.stack([r * sin, -r * cos, zz], axis=-1)[seen] - origin.astype(np.float32)
    lamp = -(0.75 * forward - 0.5 * down - 0.45 * right)
    shade = 0.50 + 0.49 * np.clip(inward @ (lamp / np.linalg.norm(lamp)), 0.0, 1.0)
    near_row, near_column = np.rint(i).astype(int), np.rint(j).astype(int) % colour.shape[1]
    paint = np.clip(colour[rows][near_row][:, near_column][seen] * shade[:, None], 0, 255).astype(np.uint8)
    u = np.rint(points @ right * scale + (size[0] - 1) / 2).astype(np.int64)
    v = np.rint(points @ down * scale + (size[1] - 1) / 2).astype(np.int64)
    inside = (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
    order = np.argsort(-(points @ forward)[inside], kind="stable")  # far first, the near ones overwrite
    canvas = np.full((size[1], size[0], 3), BACKGROUND, dtype=np.uint8)
    canvas[v[inside][order], u[inside][order]] = paint[inside][order]
    image = canvas.reshape(height, fine, width, fine, 3).mean(axis=(1, 3)).astype(np.uint8)
    return View(image, right, down, origin, scale / fine)


def _resample(field: NDArray[np.float32], i: FloatArray, j: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Bilinear between seen cells, nearest at their edges; around the clock it closes. Values and where seen."""
    n, m = field.shape
    i0 = np.clip(np.floor(i).astype(int), 0, n - 1)
    i1 = np.minimum(i0 + 1, n - 1)
    j0 = np.floor(j).astype(int)
    fi, fj = (i - i0)[:, None], (j - j0)[None]
    total, weight = np.zeros((len(i), len(j))), np.zeros((len(i), len(j)))
    for rows, wi in ((i0, 1 - fi), (i1, fi)):
        for columns, wj in ((j0 % m, 1 - fj), ((j0 + 1) % m, fj)):
            value = field[rows][:, columns]
            ok = np.isfinite(value)
            total += np.where(ok, value, 0.0) * wi * wj * ok
            weight += wi * wj * ok
    return (total / np.maximum(weight, 1e-9)).astype(np.float32), weight >= 0.5
