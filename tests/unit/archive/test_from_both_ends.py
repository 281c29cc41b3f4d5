"""Two scans, there and back, each with its own cable: the rows of the second are found on the first one by one."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from annulus_pipe.archive.there_and_back import placed
from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.survey import Survey
from tests.unit.archive.pairs import Scene, draw

SCENE = Scene(length_mm=3000.0, grown=0, new=0, slips_mm=())
HOLDS = 0.9  # share of rows within k = 2 of what is stated


def as_survey(wall: WallMap) -> Survey:
    """As much of one as is asked."""
    columns = wall.first_deg + wall.column_deg * np.arange(wall.deviation_mm.shape[1])
    radius = wall.deviation_mm + np.float32(wall.radius_mm)
    grid = SimpleNamespace(radius_mm=radius, z_mm=wall.z_mm, z_step_mm=wall.step_mm, clock_deg=columns)
    return cast(Any, SimpleNamespace(wall=grid, nominal_diameter_mm=2 * wall.radius_mm, roll_range_deg=None))


def test_a_scan_from_the_other_end_is_laid_on_the_first() -> None:
    pair = draw(3, SCENE)
    fore, aft = as_survey(pair.first), as_survey(pair.second.turned_about())
    where = placed(fore, aft, None, ("there", "back"))
    off = np.abs(where.z_mm[::-1] - pair.z_of_second)
    known = np.isfinite(off)
    assert (off[known] <= 2 * where.sigma_z_mm[::-1][known]).mean() >= HOLDS
    turned = np.abs((where.roll_deg[::-1] - pair.roll_of_second + 180.0) % 360.0 - 180.0)
    assert np.percentile(off[known], 95) <= 1.5
    assert np.percentile(turned[known], 95) <= 1.0
    with pytest.raises(AnnulusError, match="looks the same way"):
        placed(fore, as_survey(pair.second), None, ("there", "back"))
