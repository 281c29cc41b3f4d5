"""What positions found from the frames are said to be known to, against how far they are off, over several scans."""

import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, SLIDE, drawn

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wings.fringe.measure import Points, find_steps, spline

TRUE = np.array([0.0, 0.46, 1.16, 2.62, 3.79, 4.27, 5.23, 6.25])
GRID = Points.plate(np.arange(0.0, 30.0, 0.5), np.arange(-14.0, 14.0, 0.5), DISTANCE_MM)
AHEAD, ODOMETER_MM, SCANS = np.array([1.0, 0.0, 0.0]), 0.1, 8


def found(texture: float, drift: float) -> tuple[FloatArray, FloatArray]:
    """How far positions are off, and their sigma, mm, of an odometer that is off by its own sigma."""
    off, sigma = [], []
    for k in range(SCANS):
        images = spline(drawn(TRUE, 1.0, noise=1.0, texture=texture, seed=100 + k))
        said = TRUE + np.random.default_rng(k).normal(0, ODOMETER_MM, len(TRUE)) * (TRUE > 0)
        steps = find_steps(LEFT, SLIDE, said, AHEAD, images, GRID, odometer_sigma_mm=ODOMETER_MM, drift_sigma=drift)
        off.append((steps.place_mm - TRUE)[1:])
        sigma.append(steps.sigma_mm[1:])
    return np.concatenate(off), np.concatenate(sigma)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("drift", [0.0, 0.1])
@pytest.mark.parametrize("texture", [0.0, 0.01, 0.3])
def test_sigma_is_how_far_positions_are_off(texture: float, drift: float) -> None:
    off, sigma = found(texture, drift)
    assert 0.6 < np.sqrt(np.mean((off / sigma) ** 2)) < 1.3
    if texture == 0.0:  # nothing but the odometer says where a plain wall is
        assert np.median(sigma) == pytest.approx(ODOMETER_MM, rel=0.1)
    elif texture == 0.3 and drift == 0.0:
        assert np.sqrt(np.mean(off**2)) < 0.005
