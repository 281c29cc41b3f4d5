"""Where a frame, a pipe or a pose becomes worth a word: each limit from both sides, a few percent apart."""

import math

import numpy as np
import pytest

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.calibration.reference import Reference
from annulus_pipe.rings.colour import Stripes, differs, learn
from annulus_pipe.rings.diagnosis import FrameLighting, reference_findings


@pytest.mark.parametrize(("bright", "dark"), [(13.5, True), (14.5, False)])
def test_a_frame_is_dark_below_what_any_stripe_has(bright: float, dark: bool) -> None:
    assert FrameLighting(bright, 0.0, 0.0, 0.35).dark is dark


@pytest.mark.parametrize(
    ("clipped", "lost", "over"), [(0.24, 0.0, False), (0.26, 0.0, True), (0.2, 0.048, False), (0.2, 0.052, True)]
)
def test_a_frame_is_over_exposed_where_colours_go(clipped: float, lost: float, over: bool) -> None:
    assert FrameLighting(255.0, clipped, lost, 0.35).over_exposed is over


@pytest.mark.parametrize(("lean_deg", "shift_mm", "far"), [(2.4, 3.6, False), (2.6, 0.0, True), (0.0, 4.0, True)])
def test_a_reference_vouches_for_poses_near_its_own(lean_deg: float, shift_mm: float, far: bool) -> None:
    reference = Reference(((0.0,) * 36,), 76.2, (Pose(),), 1.0, 0.1)
    found = reference_findings(reference, [Pose(), Pose(math.radians(lean_deg), 0.0, 0.0, shift_mm)])
    assert bool(found) is far


@pytest.mark.parametrize(("blue", "other"), [(0.53, False), (0.38, True)])
def test_a_channel_that_brings_little_more_than_half_its_share_is_another_paint(blue: float, other: bool) -> None:
    """Blue's share of the light changes by 1.6 and by 2.1."""
    colour = np.tile([0, 1, 2], 100)

    def seen(level: float) -> Stripes:
        light = 100.0 * np.eye(3)[colour] * [1.0, 1.0, level] + 1.0
        return Stripes(light, colour, np.zeros(300, bool))

    assert (differs(learn([seen(1.0)]), [seen(blue)]) is not None) is other
