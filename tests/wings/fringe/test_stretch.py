"""A motion told wrongly as a whole, by the wall's texture alone."""

import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, SLIDE, drawn

from annulus_pipe.numeric.arrays import Float32Array
from annulus_pipe.wings.fringe.measure import FringeView, Points, spline
from annulus_pipe.wings.fringe.measure.stretch import _shift, stretch

AHEAD = np.array([1.0, 0.0, 0.0])
TRUE = np.arange(0.0, 13.0, 1.3)
GRID = Points.plate(np.arange(0.0, 30.0, 1.0), np.arange(-14.0, 14.0, 1.0), DISTANCE_MM)
FLAT = np.zeros(len(GRID.base))


def drawn_with(specks: float) -> Float32Array:
    return spline(drawn(TRUE, noise=0.5, specks=specks))


@pytest.fixture(scope="module")
def images() -> Float32Array:
    return drawn_with(0.2)


def found(images: Float32Array, factor: float) -> tuple[float, float]:
    place = TRUE / factor
    return stretch(FringeView.of(LEFT, SLIDE, place[:, None] * AHEAD), images, GRID, FLAT, place, AHEAD)


@pytest.mark.parametrize("factor", [1.0, 1.03, 0.97, 1 / 1.05])
def test_the_texture_tells_the_true_motion(images: Float32Array, factor: float) -> None:
    scale, sigma = found(images, factor)
    assert scale == pytest.approx(factor, abs=min(3 * sigma, 0.005))
    assert sigma < 0.006


def test_shifts_are_not_drawn_to_whole_pixels() -> None:
    """Even steps of 3.9 px: every shift a fraction short of whole pixels, all pulled one way if they are."""
    quiet = spline(drawn(TRUE, noise=0.01, specks=0.2))
    assert found(quiet, 1 / 1.05)[0] == pytest.approx(1 / 1.05, abs=0.004)  # 0.967 if they are
    texture = np.log(drawn(np.array([0.0, 1.3]), noise=0.5, specks=0.2) / drawn(np.zeros(1)))
    shift = _shift(texture[0], texture[1], np.array([-4, 0]))
    assert shift is not None
    assert shift == pytest.approx([-3.9, 0.0], abs=0.05)


@pytest.mark.parametrize("texture", [0.0, 0.3])
def test_a_plain_wall_or_one_wave_tells_nothing(texture: float) -> None:
    """Noise has a highest peak too: one such scan in six read 3.9 +- 0.6."""
    for seed in range(100, 106):
        images = spline(drawn(TRUE, noise=1.0, texture=texture, seed=seed))
        assert found(images, 1.0) == (1.0, np.inf)


def test_a_motion_too_short_to_be_seen_tells_nothing(images: Float32Array) -> None:
    assert stretch(FringeView.of(LEFT, SLIDE, TRUE[:3, None] * AHEAD), images[:3], GRID, FLAT, TRUE[:3], AHEAD) == (
        1.0,
        np.inf,
    )


def test_a_wall_without_heights_tells_nothing(images: Float32Array) -> None:
    view = FringeView.of(LEFT, SLIDE, TRUE[:, None] * AHEAD)
    assert stretch(view, images, GRID, FLAT * np.nan, TRUE, AHEAD) == (1.0, np.inf)
