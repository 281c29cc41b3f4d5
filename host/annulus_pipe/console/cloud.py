"""The points so far, for who comes later: at most one a voxel, and never more than there is room for.

Voxels are found by a table of hashes; two that fall on one place of it are one point less, which a picture of
half a million does not show. When the room is full the voxels double, so that a scan of any length is shown as a whole,
and memory stays what it was at the beginning.
"""

import numpy as np
from numpy.typing import NDArray

POINTS_MAX = 500_000
VOXEL_MM = 2.0
_PLACES_BITS = 20
_EMPTY = -1
_SPREAD = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
_HALF = np.uint64(32)


class Cloud:
    """Points and their colours, oldest first. `generation` changes when they are not the same ones and more."""

    def __init__(self, points_max: int = POINTS_MAX) -> None:
        self.generation = 0
        self.voxel_mm = VOXEL_MM
        self._count = 0
        self._xyz = np.zeros((points_max, 3), np.float32)
        self._rgb = np.zeros((points_max, 3), np.uint8)
        self._place = np.zeros(points_max, np.int32)
        self._table = np.full(1 << _PLACES_BITS, _EMPTY, np.int32)
        for array in (self._xyz, self._rgb, self._place):
            array.fill(1)  # the memory is ours now, not when it is first needed in the fifth hour

    def __len__(self) -> int:
        return self._count

    def add(self, xyz_mm: NDArray[np.float32], rgb: NDArray[np.uint8]) -> None:
        """xyz_mm, rgb : (N, 3); N at most a quarter of the room."""
        places = self._places_of(xyz_mm)
        new = np.flatnonzero(self._table[places] == _EMPTY)
        first = new[np.unique(places[new], return_index=True)[1]]
        while self._count + len(first) > len(self._xyz):
            self._coarsen()
            places = self._places_of(xyz_mm)
            new = np.flatnonzero(self._table[places] == _EMPTY)
            first = new[np.unique(places[new], return_index=True)[1]]
        begin, end = self._count, self._count + len(first)
        self._xyz[begin:end], self._rgb[begin:end], self._place[begin:end] = xyz_mm[first], rgb[first], places[first]
        self._table[places[first]] = np.arange(begin, end, dtype=np.int32)
        self._count = end

    def block(self, first: int, count: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Views of at most `count` points from the first-th on."""
        end = min(self._count, first + count)
        return self._xyz[first:end], self._rgb[first:end]

    def clear(self) -> None:
        self.generation += 1
        self.voxel_mm = VOXEL_MM
        self._count = 0
        self._table.fill(_EMPTY)

    def _coarsen(self) -> None:
        self.generation += 1
        self.voxel_mm *= 2.0
        xyz, rgb = self._xyz[: self._count].copy(), self._rgb[: self._count].copy()
        places = self._places_of(xyz)
        first = np.sort(np.unique(places, return_index=True)[1])
        self._count = len(first)
        self._xyz[: self._count], self._rgb[: self._count] = xyz[first], rgb[first]
        self._place[: self._count] = places[first]
        self._table.fill(_EMPTY)
        self._table[places[first]] = np.arange(self._count, dtype=np.int32)

    def _places_of(self, xyz_mm: NDArray[np.float32]) -> NDArray[np.int64]:
        """(N,) of the table."""
        cell = np.floor(np.clip(xyz_mm, -1e9, 1e9) / np.float32(self.voxel_mm)).astype(np.int64).astype(np.uint64)
        mixed = (cell * _SPREAD).sum(axis=1)
        mixed = (mixed ^ (mixed >> _HALF)) * _SPREAD[0]
        return np.asarray(mixed >> np.uint64(64 - _PLACES_BITS), np.int64)
