"""A station half of whose rows lay on a bead was 4.0 mm off with k = 2 of 1.2: which rows were its middle was taken as
known. Fails without `_mixed_mm`."""

from dataclasses import replace

import numpy as np
import pytest
from even_wall import RADIUS_MM, even_wall

from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.stations import Stations, measure_stations

HEIGHT_MM, FIRST_ROW, LAST_ROW = 3.0, 12, 15  # of a bead


def wall(moved: int, unseen: slice = slice(0, 0)) -> Wall:
    """A bead that seems to lie so many rows from where it is."""
    plain = even_wall()
    radius = plain.radius_mm.copy()
    radius[FIRST_ROW + moved : LAST_ROW + moved] -= np.float32(HEIGHT_MM)
    radius[unseen] = np.nan
    return replace(plain, radius_mm=radius)


def stations(there: Wall) -> Stations:
    return measure_stations(there, station_mm=8.0)


@pytest.mark.parametrize("moved", [-1, 1])
def test_its_k2_knows_that_a_row_may_be_its_neighbour(moved: int) -> None:
    true, found = stations(wall(0)), stations(wall(moved))
    for name in ("diameter_min_mm", "diameter_max_mm", "diameter_mean_mm", "diameter_x_mm"):
        off = np.abs(getattr(found, name) - getattr(true, name))
        assert (off <= found.diameter_k2_mm).all(), name
    assert (np.abs(found.circumference_mm - true.circumference_mm) <= found.circumference_k2_mm).all()
    assert (np.abs(found.area_mm2 - true.area_mm2) <= found.area_k2_mm2).all()


def test_nor_does_it_know_a_row_that_nobody_saw() -> None:
    true, found = stations(wall(0)), stations(wall(0, slice(LAST_ROW - 1, LAST_ROW)))
    assert (np.abs(found.diameter_mean_mm - true.diameter_mean_mm) <= found.diameter_k2_mm).all()


def test_plain_wall_is_as_well_known_as_ever() -> None:
    away = np.abs(stations(wall(0)).z_mm - even_wall().z_mm[FIRST_ROW]) > 20.0
    plain = stations(replace(even_wall(), radius_mm=np.full_like(even_wall().radius_mm, RADIUS_MM)))
    assert stations(wall(0)).diameter_k2_mm[away] == pytest.approx(plain.diameter_k2_mm[away])
