"""A volume seen from its pipe's axis: planes at right angles to it, each unrolled into angle and distance.

The axis is a line, so a plane at right angles to it cuts a few neighbouring slices: as many are read at a time, and the
next planes go on with those that they share. Assumed: the axis leans little (under 10 degrees) from the volume's z.
"""

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.jit import jit
from annulus_pipe.wings.joints.measure.axis import VolumeAxis

PLANES_AT_ONCE = 16
VOXELS_AT_ONCE = 1 << 26  # of slices held: 256 MB of float32


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


@jit
def trilinear(slab, x, y, s):  # type: ignore[no-untyped-def]
    """Grey at column x, row y, slice s of slab[slice, row, column], within it."""
    depth, rows, columns = slab.shape
    i0 = min(int(x), columns - 2)
    j0 = min(int(y), rows - 2)
    k0 = min(max(int(s), 0), depth - 2)
    fx, fy, fz = x - i0, y - j0, s - k0
    low = (slab[k0, j0, i0] * (1 - fx) + slab[k0, j0, i0 + 1] * fx) * (1 - fy) + (
        slab[k0, j0 + 1, i0] * (1 - fx) + slab[k0, j0 + 1, i0 + 1] * fx
    ) * fy
    high = (slab[k0 + 1, j0, i0] * (1 - fx) + slab[k0 + 1, j0, i0 + 1] * fx) * (1 - fy) + (
        slab[k0 + 1, j0 + 1, i0] * (1 - fx) + slab[k0 + 1, j0 + 1, i0 + 1] * fx
    ) * fy
    return low * (1 - fz) + high * fz


@jit
def _sample(slab, first, voxel, origin, across, down, along, cos, sin, rho, z, out):  # type: ignore[no-untyped-def]
    """out[plane, phi, rho] trilinear; NaN outside the slab. voxel, origin and directions in x, y, z; origin in mm."""
    depth, rows, columns = slab.shape
    for p in range(len(z)):
        ax = origin[0] + z[p] * along[0]
        ay = origin[1] + z[p] * along[1]
        az = origin[2] + z[p] * along[2]
        for j in range(len(cos)):
            ux = cos[j] * across[0] + sin[j] * down[0]
            uy = cos[j] * across[1] + sin[j] * down[1]
            uz = cos[j] * across[2] + sin[j] * down[2]
            for k in range(len(rho)):
                x = (ax + rho[k] * ux) / voxel[0]
                y = (ay + rho[k] * uy) / voxel[1]
                s = (az + rho[k] * uz) / voxel[2] - first
                # A hair outside by rounding is inside: the first and last slice count.
                if not (0 <= x <= columns - 1 and 0 <= y <= rows - 1 and -1e-6 <= s <= depth - 1 + 1e-6):
                    out[p, j, k] = np.nan
                    continue
                out[p, j, k] = trilinear(slab, x, y, s)


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
    dz, dy, dx = volume.voxel_mm
    voxel = np.array([dx, dy, dz])
    across, down, along = axis.frame()
    origin = np.array([axis.x_mm, axis.y_mm, 0.0])
    reach = abs(rho_mm).max() * np.hypot(across[2], down[2])
    cos, sin = np.cos(phi), np.sin(phi)
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
        out = np.empty((len(z), len(phi), len(rho_mm)), np.float32)
        _sample(held, first, voxel, origin, across, down, along, cos, sin, rho_mm, z, out)
        yield start, out
