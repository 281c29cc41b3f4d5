"""The wall as triangles and as a shaded picture."""

import numpy as np
from numpy.typing import NDArray

from annulus.geometry.pose import FloatArray
from annulus.rings.wall import Wall

Image = NDArray[np.uint8]

EXAGGERATION = 3.0  # of the deviation in the picture; the caption says so
BACKGROUND = (255, 255, 255)


def triangulate(wall: Wall) -> tuple[FloatArray, NDArray[np.int32], NDArray[np.int64]]:
    """Vertices (N, 3) mm of the seen cells, triangles (M, 3), and each vertex's flat index into the grid.

    A face joins cells only where all its corners were seen; around the clock the grid closes. Triangles are wound so
    that their normals point into the pipe.
    """
    seen = wall.seen
    rows, columns = seen.shape
    index = np.full((rows, columns), -1, dtype=np.int32)
    flat = np.flatnonzero(seen)
    index.flat[flat] = np.arange(len(flat), dtype=np.int32)
    a, b = index[:-1], np.roll(index, -1, axis=1)[:-1]
    c, d = index[1:], np.roll(index, -1, axis=1)[1:]
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    first = (a >= 0) & (b >= 0) & (c >= 0)
    second = (b >= 0) & (d >= 0) & (c >= 0)
    third = (a >= 0) & (d >= 0) & (c >= 0) & (b < 0)  # the diagonal the other way when one corner is missing
    fourth = (a >= 0) & (b >= 0) & (d >= 0) & (c < 0)
    triangles = np.concatenate(
        [
            np.stack([a, b, c], axis=-1)[first | whole],
            np.stack([b, d, c], axis=-1)[second | whole],
            np.stack([a, d, c], axis=-1)[third],
            np.stack([a, b, d], axis=-1)[fourth],
        ]
    ).astype(np.int32)  # fmt: skip
    t = np.radians(wall.clock_deg)
    radius = wall.radius_mm.astype(np.float64)
    z = np.broadcast_to(wall.z_mm[:, None], radius.shape)
    points = np.stack([radius * np.sin(t), -radius * np.cos(t), z], axis=-1).reshape(-1, 3)[flat]
    return points, triangles, flat


def picture(
    wall: Wall, colour: Image, rows: slice, *, side: int, width: int = 1500, height: int = 620
) -> Image:  # fmt: skip
    """One half of the pipe cut open, seen from outside the other half; (height, width, 3) uint8 RGB.

    Parameters
    ----------
    colour : (Z, A, 3) uint8 RGB of every cell; unseen cells are drawn as holes.
    rows : the stretch to show. side : +1 shows the wall around 3 o'clock, -1 around 9 o'clock.

    Notes
    -----
    Orthographic. The grid is resampled finer than the picture's pixels and splatted front to back, shaded by the slope
    of the wall; deviations are drawn `EXAGGERATION` times their size.
    """
    radius = wall.mean_radius_mm
    z = wall.z_mm[rows]
    span = float(z[-1] - z[0] + wall.z_step_mm)
    # Camera: turned about the vertical, so that the far half opens to the viewer and distance runs left to right.
    yaw, pitch = np.radians(28.0), np.radians(16.0)
    across = span * np.cos(yaw) + 2 * radius * np.sin(yaw)
    scale = min(0.94 * width / across, 0.94 * height / (2.3 * radius))
    n_columns = min(int(2 * np.pi * radius * scale * 1.6), 3600)
    n_rows = min(int(span * scale * 1.6), 4000)
    i = np.clip((np.arange(n_rows) + 0.5) / n_rows * len(z) - 0.5, 0, len(z) - 1)
    j = (np.arange(n_columns) + 0.5) / n_columns * len(wall.clock_deg) - 0.5
    deviation = wall.deviation_mm()[rows]
    fine, seen = _resample(deviation, i, j)
    t = np.radians((j + 0.5) * wall.clock_step_deg)[None]
    zz = (z[0] + i * wall.z_step_mm)[:, None]
    r = radius + EXAGGERATION * fine
    around, along = _slopes(r, float(np.diff(zz[:, 0]).mean()), 2 * np.pi / n_columns)
    sin, cos = np.sin(t), np.cos(t)
    keep = seen & (side * sin > -0.16)
    p = np.stack([r * sin, -r * cos, np.broadcast_to(zz, r.shape) - (z[0] + span / 2)], axis=-1)[keep]
    # Inward normal of r(t, z).
    scale_n = 1.0 / np.sqrt(1 + around**2 + along**2)
    normal = np.stack([(-sin + around * cos) * scale_n, (cos + around * sin) * scale_n, along * scale_n], axis=-1)[keep]
    right = np.array([-side * np.sin(yaw), 0.0, np.cos(yaw)]) * side
    forward = np.array([side * np.cos(yaw) * np.cos(pitch), np.sin(pitch), np.sin(yaw) * np.cos(pitch)])
    right = np.array([-np.sin(yaw) * side, 0.0, np.cos(yaw)])
    right *= 1.0
    down = np.cross(forward, right)
    down = down if down[1] > 0 else -down
    u = p @ right * scale + width / 2
    v = p @ down * scale + height / 2
    depth = p @ forward
    facing = -(normal @ forward)
    light = np.array([-side * 0.35, -0.75, -0.55])
    shade = 0.42 + 0.5 * np.clip(normal @ (light / np.linalg.norm(light)), -0.3, 1) + 0.12 * np.clip(facing, 0, 1)
    ii, jj = np.rint(i).astype(int), np.rint(j).astype(int) % colour.shape[1]
    paint = colour[rows][ii][:, jj][keep].astype(np.float32) * np.clip(shade, 0.25, 1.12)[:, None]
    pixel_u, pixel_v = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
    ok = (pixel_u >= 0) & (pixel_u < width - 1) & (pixel_v >= 0) & (pixel_v < height - 1)
    order = np.argsort(-depth[ok], kind="stable")  # far first: the near ones overwrite
    out = np.full((height, width, 3), BACKGROUND, dtype=np.uint8)
    out[pixel_v[ok][order], pixel_u[ok][order]] = np.clip(paint[ok][order], 0, 255).astype(np.uint8)
    return out


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
    return total / np.maximum(weight, 1e-9), weight >= 0.5


def _slopes(r: FloatArray, dz: float, dt: float) -> tuple[FloatArray, FloatArray]:
    around = (np.roll(r, -2, axis=1) - np.roll(r, 2, axis=1)) / (4 * dt) / r
    along = np.gradient(r, dz, axis=0) if len(r) > 1 else np.zeros_like(r)
    return np.clip(around, -3, 3), np.clip(along, -3, 3)
