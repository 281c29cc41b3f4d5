"""Silt and water that were not told as such lay flat across the bottom and were listed as bumps, sure of themselves."""

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from annulus_pipe.wall.defects import Defect, Kind, _may_be_level

RADIUS = 76.2
WALL = cast(Any, SimpleNamespace(mean_radius_mm=RADIUS))


def bump(depth_mm: float, part_of_chord: float, length_mm: float = 90.0, clock_deg: float = 180.0) -> Defect:
    arc_deg = 2.0 * math.degrees(math.acos(1.0 - depth_mm / RADIUS)) * part_of_chord
    return Defect(Kind.BUMP, 200.0, clock_deg, length_mm, arc_deg, depth_mm, 0.0)


@pytest.mark.parametrize("depth_mm", [3.0, 6.3, 9.3, 16.8])
def test_what_is_as_wide_as_a_chord_may_be_a_level(depth_mm: float) -> None:
    for part in (0.88, 0.92, 0.96):  # of nine drawn ones, their corners lost
        assert _may_be_level(bump(depth_mm, part), WALL)


@pytest.mark.parametrize(
    "one",
    [
        bump(2.4, 0.6),  # domes
        bump(1.0, 0.79),
        bump(3.0, 1.3),  # a dent
        bump(6.0, 0.92, length_mm=8.0),  # a lump
        bump(6.0, 0.92, clock_deg=120.0),
        bump(0.0, 0.92),
        Defect(Kind.LOSS, 200.0, 180.0, 90.0, 45.0, 6.0, 0.0),
    ],
)
def test_what_is_otherwise_is_what_it_was(one: Defect) -> None:
    assert not _may_be_level(one, WALL)
