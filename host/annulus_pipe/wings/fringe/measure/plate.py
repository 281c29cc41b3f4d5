"""The heights of a flat wall on a grid, as a method found them: a value, for reports and files."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.vocabulary import Finding


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """x_mm (X,) along the motion, y_mm (Y,): the first camera's frame at position 0. Maps (Y, X), NaN where nothing is
    told: height_mm, towards the head from the plane at distance_mm; sigma_mm, k = 1; light, grey levels linear in light
    (the wall's own, fringes out); modulation.

    lit : where the slide's light was seen and moved at all. untold : (reason, cells) among those. places_mm,
    places_sigma_mm : (N,) where the frames were taken, as found. findings : what a reader must know. by : what
    told the heights: the phase of a calibrated "slide", or where the phases of two "cameras" agree.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    height_mm: FloatArray
    sigma_mm: FloatArray
    light: FloatArray
    modulation: FloatArray
    lit: BoolArray
    distance_mm: float
    untold: Mapping[str, int]
    frames: tuple[int, ...]
    places_mm: FloatArray
    places_sigma_mm: FloatArray
    odometer_mm: FloatArray
    findings: tuple[Finding, ...]
    timing_ms: Mapping[str, float]
    by: str = "slide"
    windows: int = 1  # of the scan, measured one after the other ..
    made: int = 1  # .. and how many of those now

    @property
    def points(self) -> int:
        """Cells with a height."""
        return int(np.isfinite(self.height_mm).sum())

    @property
    def completeness(self) -> float:
        """Share of the lit cells that have a height."""
        return self.points / max(int(self.lit.sum()), 1)

    def cloud(self) -> FloatArray:
        """(points, 3) mm: x, y, and z = distance ahead of the first camera."""
        x, y = np.meshgrid(self.x_mm, self.y_mm)
        known = np.isfinite(self.height_mm)
        return np.stack([x[known], y[known], self.distance_mm - self.height_mm[known]], axis=1)
