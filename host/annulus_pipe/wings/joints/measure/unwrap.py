"""A volume seen from its pipe's axis: planes at right angles to it, each unrolled into angle and distance.

The axis is a line, so a plane at right angles to it cuts a few neighbouring slices: as many are read at a time, and the
next planes go on with those that they share. Assumed: the axis leans little (under 10 degrees) from the volume's z.
"""

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.wings.joints.measure.axis import VolumeAxis

PLANES_AT_ONCE = 16
VOXELS_AT_ONCE = 1 << 26  # of slices held: 256 MB of float32

_sampled = door(
    "joints_sampled",
    "f4[d,r,c] slab",
    "i8 first",
    "f8[3] voxel",
    "f8[3] origin",
    "f8[3] along",
    "f8[p] z",
    "f8[j,3] beside",
    "f8[j,3] way",
    "f8[k] rho",
    "b1 to_edge",
    "f4[p,j,k]! out",
)


class Volume(Protocol):
    """A CT volume that is read as it is needed: `record.volume.open_volume`, or an array in `ArrayVolume`."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Slices, rows, columns."""

    @property
    def voxel_mm(self) -> tuple[float, float, float]:
        """Size of a voxel along z, y, x, mm."""

    def slices(self, start: int, stop: int) -> Float32Array:
        """(stop - start, rows, columns) grey values of slices start .. stop - 1."""


class ArrayVolume:
    """A volume that is an array: (z, y, x) grey values, voxel size in mm along z, y, x."""

    def __init__(self, grey: np.ndarray, voxel_mm: tuple[float, float, float]) -> None:
        self.grey, self.voxel_mm = grey, voxel_mm
        self.shape: tuple[int, int, int] = grey.shape

    def slices(self, start: int, stop: int) -> Float32Array:
        return np.ascontiguousarray(self.grey[start:stop], dtype=np.float32)


def sampled(
    slab: Float32Array,
    first: int,
    voxel_mm: tuple[float, float, float],
    origin: FloatArray,
    along: FloatArray,
    z: FloatArray,
    rays: tuple[FloatArray, FloatArray],
    rho: FloatArray,
    to_edge: bool = False,
) -> Float32Array:
    """(Z, J, R) grey between voxels, at origin + z along + beside + rho way: of slices from `first` on.

    origin, along (3,), rays: beside and way, (J, 3) both, in x, y, z, mm. Outside the slab NaN, or the edge's grey.
    """
    dz, dy, dx = voxel_mm
    beside, way = rays
    out = np.empty((len(z), len(beside), len(rho)), np.float32)
    _sampled(
        np.ascontiguousarray(slab), first, np.array([dx, dy, dz]), origin, along, z, beside, way, rho, to_edge, out
    )
    return out


def planes(
    volume: Volume, axis: VolumeAxis, z_mm: FloatArray, phi: FloatArray, rho_mm: FloatArray
) -> Iterator[tuple[int, Float32Array]]:
    """The volume plane by plane, a few at a time: index of the first, and (planes, phi, rho) grey values.

    Parameters
    ----------
    z_mm : (Z,) evenly spaced along the axis, 0 where it crosses the volume's z = 0.
    phi : (P,) rad, from the volume's x towards its y.
    rho_mm : (R,) from the axis, mm.

    NaN where the volume does not reach.
    """
    dz = volume.voxel_mm[0]
    across, down, along = axis.frame()
    origin = np.array([axis.x_mm, axis.y_mm, 0.0])
    reach = abs(rho_mm).max() * np.hypot(across[2], down[2])
    way = np.cos(phi)[:, None] * across + np.sin(phi)[:, None] * down
    rays = (np.zeros_like(way), way)
    held, first = np.empty((0, *volume.shape[1:]), np.float32), 0
    at_once = int(
        np.clip(VOXELS_AT_ONCE // (volume.shape[1] * volume.shape[2]) - 2 * reach / dz - 2, 1, PLANES_AT_ONCE)
    )
    for start in range(0, len(z_mm), at_once):
        z = z_mm[start : start + at_once]
        low = int(np.clip(np.floor((z[0] * along[2] - reach) / dz), 0, volume.shape[0] - 2))
        high = int(np.clip(np.ceil((z[-1] * along[2] + reach) / dz) + 1, low + 2, volume.shape[0]))
        kept = held[max(low - first, 0) :]
        known = low + len(kept)
        held = kept if high <= known else np.concatenate([kept, volume.slices(known, high)])
        first = low
        yield start, sampled(held, first, volume.voxel_mm, origin, along, z, rays, rho_mm)
