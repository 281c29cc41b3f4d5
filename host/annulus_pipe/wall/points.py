"""Every point of a wall with what is asked of it where a cell of the grid is too coarse: at beads, gaps and grooves."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wall.cylinder import points_of, round_clock
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.shadow import SLIT_OF_RADIUS
from annulus_pipe.wall.shape import harmonics

ROW_MM = 1.0  # finer than the grid's
SECTORS = 36  # round the clock
POINTS = 6  # of a row, for it to say anything
SOUND = 0.8  # part of what is seen of a row that lies on the pipe's shape: no joint there


@dataclass(frozen=True, slots=True, eq=False)
class WallPoints:
    """Every point: chainage, sector round the clock, how far it stands inwards of the pipe's shape and what it may be
    off, mm; its ring's length hidden behind a step over its height, and half of its slit's width on the wall, mm; its
    radius, mm, and clock angle; the number of its look (one ring in one frame)."""

    z_mm: FloatArray
    sector: NDArray[np.intp]
    height_mm: FloatArray
    stated_mm: FloatArray
    shadow_ratio: FloatArray
    slit_mm: FloatArray
    radius_mm: FloatArray
    clock_deg: FloatArray
    look: NDArray[np.intp]

    @classmethod
    def of(cls, wall: Wall, profiles: Sequence[Profile], shadow_ratios: FloatArray) -> "WallPoints":
        radius, clock, z = round_clock(points_of(profiles))
        row = np.clip(np.searchsorted(wall.z_mm, z), 0, len(wall.z_mm) - 1)
        shape = (wall.shape_mm[row] * harmonics(clock)).sum(axis=1)
        sigma = np.concatenate([profile.sigma_mm for profile in profiles]).astype(np.float64)
        ring = np.concatenate([profile.ring for profile in profiles]).astype(np.intp)
        ratio = shadow_ratios[ring]
        frame = np.repeat(np.arange(len(profiles)), [len(profile.ring) for profile in profiles])
        half = np.concatenate([p.slit_rad[p.ring] if len(p.slit_rad) else np.zeros(len(p.ring)) for p in profiles])
        slit = np.where(half > 0, half * (1.0 + ratio**2), SLIT_OF_RADIUS / 2) * wall.mean_radius_mm
        sector = (clock * SECTORS / 360.0).astype(np.intp)
        look = frame * len(shadow_ratios) + ring
        return cls(z, sector, shape - radius, sigma, ratio, slit, radius, clock, look)

    def between(self, first_mm: float, last_mm: float) -> "WallPoints":
        """Those of a stretch; a long scan has ten millions."""
        near = (self.z_mm >= first_mm) & (self.z_mm < last_mm)
        return WallPoints(*(getattr(self, one.name)[near] for one in fields(self)))

    def over(self, wall: Wall, at_mm: float) -> FloatArray:
        """How far each point stands inwards of the pipe's shape at one chainage, mm."""
        row = int(np.clip(np.searchsorted(wall.z_mm, at_mm), 0, len(wall.z_mm) - 1))
        return np.asarray(harmonics(self.clock_deg) @ wall.shape_mm[row] - self.radius_mm)

    def trimmed(self, zone: tuple[float, float], limit: float) -> tuple[float, float]:
        """A zone without what is sound wall at its ends; the grid's rows may be coarser than points are."""
        inside = (self.z_mm >= zone[0]) & (self.z_mm <= zone[1])
        row = np.floor((self.z_mm[inside] - zone[0]) / ROW_MM).astype(np.intp)
        count = np.bincount(row)
        near = np.bincount(row, weights=np.abs(self.height_mm[inside]) < limit)
        unsound = np.flatnonzero((count < POINTS) | (near < SOUND * count))
        if not len(unsound):
            return zone
        return zone[0] + float(unsound[0]) * ROW_MM, min(zone[0] + float(unsound[-1] + 1) * ROW_MM, zone[1])
