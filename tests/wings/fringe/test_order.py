"""A plate that stands a fringe from where it was told: two cameras must see one texture on it."""

import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, RIGHT, SLIDE, drawn

from annulus_pipe.wings.fringe.measure import FringeView, Points, spline, told_elsewhere

MOVED = np.array([0.0, 0.9, 2.1, 3.2])
GRID = Points.plate(np.arange(-8.0, 38.0, 0.6), np.arange(-14.0, 14.0, 0.6), DISTANCE_MM)
FRINGE_MM = DISTANCE_MM * (1 - 1 / 1.2)  # of height: 20 mm / (0.04 (100 - h)) is one more than 5


def told(height_mm: float, specks: float) -> tuple[float, float, float] | None:
    motion = MOVED[:, None] * np.array([1.0, 0.0, 0.0])
    views = [
        (FringeView.of(head, SLIDE, motion), spline(drawn(MOVED, height_mm, noise=0.5, specks=specks, head=head)))
        for head in (LEFT, RIGHT)
    ]
    return told_elsewhere(views, GRID, drift_sigma=0.1)


def test_a_plate_near_where_it_was_told_is_left_alone() -> None:
    assert told(2.0, 0.2) is None


def test_a_plate_a_fringe_off_is_found() -> None:
    found = told(FRINGE_MM, 0.2)
    assert found is not None
    height, there, here = found
    assert height == pytest.approx(FRINGE_MM, abs=0.3)
    assert there > 0.8 > 0.5 > here


@pytest.mark.parametrize("order", [-2, -1, 1, 2])
def test_a_plate_some_fringes_off_is_found(order: int) -> None:
    height = DISTANCE_MM * (1 - 5 / (5 + order))  # 20 mm / (0.04 (100 - h)) is 5 and the order
    found = told(height, 0.2)
    assert found is not None
    assert found[0] == pytest.approx(height, abs=0.4)
    assert found[1] > 0.8 > 0.5 > found[2]


def test_without_texture_nothing_is_told() -> None:
    assert told(FRINGE_MM, 0.0) is None
