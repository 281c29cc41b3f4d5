"""How out of round both scans have the pipe, station by station, and by how much that changed (k = 2).

Ovality is that of ASTM F1216 of the pipe's shape: the second wave round it without defects, over the mean radius. Waves
of a station's rows are averaged. A change is as sure as they agree, as two calibrations do, and as a row's place where
ovality runs along the pipe.
"""

from dataclasses import dataclass

import numpy as np

from annulus_pipe.archive.detail import WAVES_MM, calmed
from annulus_pipe.archive.difference import Difference, Laid
from annulus_pipe.numeric.arrays import FloatArray

STATION_MM = 100.0
ALIKE_MM = 30.0  # over which a row's wave is off alike, by texture that two heads see otherwise
SHARED_MM = 0.015  # k = 1: of a wave, by two heads that were calibrated apart; benchmark `growth`
SEEN_MIN = 0.5  # of a station's rows


@dataclass(frozen=True, slots=True)
class Ovality:
    """Of S stations at z_mm of the first, percent: first, second, and what their difference may be off (k = 2); NaN
    where one of the two did not see."""

    z_mm: FloatArray
    first: FloatArray
    second: FloatArray
    change_k2: FloatArray

    @property
    def change(self) -> FloatArray:
        return np.asarray(self.second - self.first)

    @property
    def worst(self) -> int | None:
        """The station that changed most."""
        known = np.isfinite(self.change)
        return int(np.nanargmax(np.abs(self.change))) if known.any() else None

    def at(self, z_mm: float, half_mm: float) -> int | None:
        """Of the stations so near to a place the one that changed most; None where none was seen."""
        near = np.flatnonzero((np.abs(self.z_mm - z_mm) <= max(half_mm, STATION_MM)) & np.isfinite(self.change))
        return int(near[np.argmax(np.abs(self.change[near]))]) if len(near) else None


def ovality(difference: Difference, laid: Laid, parts: tuple[float, float] = (0.0, 0.0)) -> Ovality:
    """Of two scans laid together. parts : of the radius, what each head's optics may draw a circle out by (k = 1)."""
    shared = np.hypot(SHARED_MM, np.hypot(*np.nan_to_num(parts)) * difference.radius_mm)
    rows = max(round(STATION_MM / difference.step_mm), 1)
    begins = np.arange(0, len(difference.z_mm), rows)
    out = np.full((len(begins), 3), np.nan)
    waves = np.where(laid.lost, np.nan, difference.oval)  # (2, Z)
    sizes = np.abs(waves)
    slow = np.stack([calmed(one, WAVES_MM, difference.step_mm) for one in sizes]).real
    steep = np.abs(np.gradient(slow, difference.step_mm, axis=1))
    for k, begin in enumerate(begins):
        part = slice(begin, begin + rows)
        both = np.isfinite(sizes[:, part]).all(axis=0)
        if both.mean() < SEEN_MIN:
            continue
        mean = waves[:, part][:, both].mean(axis=1)
        away = np.diff(waves[:, part][:, both], axis=0)[0]
        alone = max(both.sum() * difference.step_mm / ALIKE_MM, 1.0)
        slope = np.median(steep[:, part][:, both])
        sigma = np.sqrt(away.var() / alone + shared**2 + (slope * np.median(laid.sigma_z[part])) ** 2)
        out[k] = *np.abs(mean), 2 * sigma
    first, second, k2 = (100.0 * out / difference.radius_mm).T
    middle = difference.z_mm[begins] + (np.minimum(rows, len(difference.z_mm) - begins) - 1) * difference.step_mm / 2
    return Ovality(middle, first, second, k2)


@dataclass(frozen=True, slots=True)
class MeanDiameter:
    """Of the rows that both saw, mm: the first, the second, and what their difference may be off (k = 2), NaN where one
    of them does not say how sure its scale is; all NaN where no row was seen by both. Both heads' optics drift, each by
    its own."""

    first: float
    second: float
    change_k2: float

    @property
    def change(self) -> float:
        return self.second - self.first

    @property
    def is_sure(self) -> bool:
        return abs(self.change) > self.change_k2


def mean_diameter(laid: Laid, parts: tuple[float, float]) -> MeanDiameter:
    """Of two scans laid together. parts : of the radius, what all radii of each may be off alike (k = 1)."""
    both = np.isfinite(laid.first) & np.isfinite(laid.second) & ~laid.lost[:, None]
    rows = both.mean(axis=1) >= SEEN_MIN
    if not rows.any():
        return MeanDiameter(np.nan, np.nan, np.nan)
    each = [np.where(both, wall, 0.0)[rows].sum(axis=1) / both[rows].sum(axis=1) for wall in (laid.first, laid.second)]
    first, second = (2.0 * (laid.radius_mm + float(np.median(one))) for one in each)
    alone = max(rows.sum() * laid.step_mm / ALIKE_MM, 1.0)
    sigma = np.sqrt((each[1] - each[0]).var() / alone + SHARED_MM**2 + (np.hypot(*parts) * laid.radius_mm) ** 2)
    return MeanDiameter(first, second, 4.0 * float(sigma))
