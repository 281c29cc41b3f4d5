"""Positions from the frames themselves, in mm against where the plate really was."""

import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, SLIDE, drawn

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import Points, Steps, find_steps, spline

TRUE = np.array([0.0, 0.46, 1.16, 2.62, 3.79, 4.27, 5.23, 6.25])
GRID = Points.plate(np.arange(0.0, 30.0, 0.5), np.arange(-14.0, 14.0, 0.5), DISTANCE_MM)


def found(odometer: FloatArray, texture: float = 0.3, sigma_mm: float = 0.1) -> Steps:
    images = spline(drawn(TRUE, 1.0, noise=1.0, texture=texture))
    ahead = np.array([1.0, 0.0, 0.0])
    return find_steps(LEFT, SLIDE, odometer, ahead, images, GRID, odometer_sigma_mm=sigma_mm)


@pytest.mark.deep(gate="tests/wings/fringe/test_steps.py::test_a_slip_is_said_where_it_was")
def test_a_coarse_odometer_is_mended() -> None:
    steps = found(np.round(TRUE / 0.2) * 0.2)
    np.testing.assert_allclose(steps.place_mm, TRUE, atol=0.01)
    assert (steps.sigma_mm < 0.01).all()


def test_a_slip_is_said_where_it_was() -> None:
    odometer = TRUE + np.where(np.arange(8) == 5, 0.5, 0.0)
    steps = found(odometer, sigma_mm=0.05)
    assert steps.wrong
    assert list(np.flatnonzero(steps.slipped)) == [5]
    assert steps.place_mm[5] == pytest.approx(TRUE[5], abs=0.02)


def test_a_plain_wall_leaves_the_odometer_its_say() -> None:
    steps = found(np.round(TRUE / 0.2) * 0.2, texture=0.0)
    assert (steps.sigma_mm[1:] > 0.09).all()  # the odometer's 0.1, no better
    assert (np.abs(steps.place_mm - TRUE) < 4 * steps.sigma_mm + 1e-6).all()
    assert not steps.slipped.any()


def test_frames_that_share_no_point_are_refused() -> None:
    away = Points.plate(np.arange(200.0, 210.0), np.arange(0.0, 5.0), DISTANCE_MM)
    with pytest.raises(AnnulusError, match="0 points are seen in all 8 frames"):
        find_steps(LEFT, SLIDE, TRUE, np.array([1.0, 0, 0]), spline(drawn(TRUE)), away, odometer_sigma_mm=0.1)
