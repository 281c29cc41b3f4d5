"""The twin's backward head: the same pipe turned about, and the carrier's odometer."""

import numpy as np
import pytest

from annulus_pipe.cli.back import back_view
from annulus_pipe.twin.back_to_back import looking_back
from annulus_pipe.twin.worlds import demo_world, stereo_world
from annulus_pipe.vocabulary import AnnulusError


def test_the_backward_head_has_the_same_wall() -> None:
    """What it has at a station and clock is what the forward one has there, by the odometer of the carrier."""
    world = demo_world(5)
    back, counted = looking_back(world, 180.0)
    own = np.linspace(60.0, 500.0, 45)[None]
    clock = np.linspace(0.0, 350.0, 36)[:, None]
    place = np.array([counted(z) - 180.0 for z in own[0]])[None]
    assert np.abs(back.deviation(clock, own)).max() > 3.0
    assert back.deviation(clock, own) == pytest.approx(world.deviation(-clock, place), abs=1e-9)
    assert back.calibration().camera.fx != world.calibration().camera.fx


def test_without_a_carrier_it_counts_by_itself() -> None:
    _, counted = looking_back(demo_world(5))
    assert counted(12.0) == 12.0


def test_a_head_of_two_cameras_is_refused() -> None:
    with pytest.raises(AnnulusError, match="one camera that projects rings"):
        looking_back(stereo_world(1))


def test_options_of_the_second_view_go_with_it() -> None:
    with pytest.raises(AnnulusError, match="--apart-mm goes with --back"):
        back_view(None, None, 180.0, None)
    assert back_view(None, None, None, None) is None
