"""Heights by the phase that two cameras agree on, in mm against a plate whose height is known."""

from dataclasses import replace

import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, RIGHT, SLIDE, drawn

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import FringeProjector, Heights, Points, spline, stereo_heights
from annulus_pipe.wings.fringe.measure.track import GOOD

MOVED = np.array([0.0, 0.46, 1.16, 2.62, 3.79, 4.27, 5.23, 6.25])
AHEAD = np.array([1.0, 0.0, 0.0])
GRID = Points.plate(np.arange(10.0, 40.0, 0.5), np.arange(-12.0, 12.0, 0.5), DISTANCE_MM)


def found(slide: FringeProjector = SLIDE, texture: float = 0.3, blur_px: float = 0.0, height: float = 1.5) -> Heights:
    frames = tuple(
        spline(drawn(MOVED, height, noise=1.0, texture=texture, blur_px=blur_px, head=head, seed=seed))
        for seed, head in enumerate((LEFT, RIGHT))
    )
    return stereo_heights(
        (LEFT, RIGHT), slide, MOVED[:, None] * AHEAD, (frames[0], frames[1]), GRID, (-4.0, 4.0), noise=(1.0, 0.0, 0.0)
    )


def test_a_textured_plate_is_where_it_is_and_sigma_is_the_scatter() -> None:
    told = found()
    good = told.flag == GOOD
    assert good.mean() > 0.9
    off = told.height_mm[good] - 1.5
    assert np.sqrt(np.mean(off**2)) < 0.06
    assert 0.9 <= (np.abs(off) < 2 * told.sigma_mm[good]).mean() <= 0.99


def test_what_the_slide_is_wrong_by_is_not_in_the_height() -> None:
    """Off by a sixteenth of a wave, a percent in period, and with a harmonic that nobody was told of."""
    told = found(replace(SLIDE, phase0=SLIDE.phase0 + 0.4, period=SLIDE.period * 1.01))
    assert (told.flag == GOOD).mean() > 0.9
    assert abs(float(np.nanmedian(told.height_mm)) - 1.5) < 0.02


def test_a_wall_without_texture_has_no_rough_height() -> None:
    assert (found(texture=0.0).flag == GOOD).mean() < 0.05


def test_what_cannot_be_matched_is_refused_in_one_line() -> None:
    images = (spline(drawn(MOVED[:3])),) * 2
    with pytest.raises(AnnulusError, match="stand at one place"):
        stereo_heights((LEFT, LEFT), SLIDE, MOVED[:3, None] * AHEAD, images, GRID, (-4.0, 4.0))
    with pytest.raises(AnnulusError, match="the lower comes first"):
        stereo_heights((LEFT, RIGHT), SLIDE, MOVED[:3, None] * AHEAD, images, GRID, (4.0, -4.0))
