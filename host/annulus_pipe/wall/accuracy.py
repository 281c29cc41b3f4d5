"""How accurate a survey is, as far as the survey itself knows: tolerances at a certainty of 95 %.

Each tolerance is an expanded uncertainty (k = 2) of what this scan measured: from what its points say they may be off,
the noise of its map, and how well its shape is known. A tolerance that these do not give is NaN.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.survey import Survey


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A quantity's expanded uncertainty (k = 2): the usual one, and the one that 19 of 20 places keep; in `unit`.
    `n` : of so many places, stations or defects."""

    what: str
    unit: str
    usual: float
    most: float
    n: int


def tolerances(survey: Survey) -> Iterator[Tolerance]:
    """Of a point of the wall, a departure on the map, the depths that are listed, and a station's sizes."""
    wall, stations = survey.wall, survey.stations
    sigma = np.hypot(wall.sigma_mm[np.isfinite(wall.sigma_mm)], wall.scale_part * wall.mean_radius_mm)
    yield _of("radius of one point of the wall", "mm", 2.0 * sigma)
    stated = np.isfinite(wall.sigma_mm)
    parts = (wall.sigma_mm, wall.cell_noise_mm, wall.shape_sigma_mm())
    cells = 2.0 * np.sqrt(sum(np.square(part[stated], dtype=np.float64) for part in parts))
    yield _of("departure from the pipe's shape, one place of the map", "mm", np.asarray(cells))
    for kind, words in ((Kind.LOSS, "depth of the listed losses"), (Kind.BUMP, "height of the listed bumps")):
        listed = np.array([one.depth_k2_mm for one in survey.defects if one.kind is kind], dtype=np.float64)
        if len(listed):
            yield _of(words, "mm", listed)
    yield _of("diameter of a station, any direction", "mm", stations.any_diameter_k2_mm)
    yield _of("inner circumference of a station", "mm", stations.circumference_k2_mm)
    yield _of("inner area of a station", "mm²", stations.area_k2_mm2)


def _of(what: str, unit: str, k2: FloatArray) -> Tolerance:
    known = k2[np.isfinite(k2)]
    if not len(known):
        return Tolerance(what, unit, math.nan, math.nan, 0)
    usual, most = (float(value) for value in np.percentile(known, (50, 95)))
    return Tolerance(what, unit, usual, most, len(known))
