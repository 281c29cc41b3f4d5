"""The wall as triangles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.grid import Wall


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """points_mm (N, 3), space; triangles (M, 3) of their indices; cell (N,) index into the flattened grid."""

    points_mm: FloatArray
    triangles: NDArray[np.int32]
    cell: NDArray[np.int64]


def triangulate(wall: Wall, centreline: Centreline | None = None) -> Mesh:
    """A vertex in every seen cell, joined with its neighbours.

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
            np.stack([a, c, b], axis=-1)[first | whole],
            np.stack([b, c, d], axis=-1)[second | whole],
            np.stack([a, c, d], axis=-1)[third],
            np.stack([a, d, b], axis=-1)[fourth],
        ]
    ).astype(np.int32)
    t = np.radians(wall.clock_deg)
    radius = wall.radius_mm.astype(np.float64)
    z = np.broadcast_to(wall.z_mm[:, None], radius.shape)
    points = np.stack([radius * np.sin(t), -radius * np.cos(t), z], axis=-1).reshape(-1, 3)[flat]
    return Mesh(points if centreline is None else centreline.to_space(points), triangles, flat)
