"""Narrow grooves across the line of sight, drawn with what their rims hide and shade."""

import numpy as np
import pytest
from bores import LENS, RADIUS_MM, SLIDE, drawn

from annulus_pipe.wings.fringe.measure import Eye, PipeMap, Shots, find_scratches, measure_pipe

pytestmark = pytest.mark.deep(gate="tests/wings/fringe/test_calibration.py::test_the_slide_is_found_within_its_sigma")

Z = np.arange(12) * 1.7
ARC_DEG = 12.0


def seen(groove: tuple[float, float, float, float]) -> tuple[PipeMap, np.ndarray, np.ndarray]:
    """The map, its heights, and which of its cells lie within the groove's arc."""
    poses = np.zeros((len(Z), 6))
    poses[:, 5] = Z
    images = drawn(poses, groove=groove, over=4)
    told = measure_pipe([Eye(LENS, SLIDE)], Shots.single(images), Z, RADIUS_MM, cell_mm=0.6)
    return told, told.radius_mm - RADIUS_MM, np.abs((told.phi_deg + 180) % 360 - 180) < ARC_DEG - 2


@pytest.mark.parametrize(("width", "depth"), [(3.0, 0.5), (2.4, 0.8), (2.0, 0.4)])
def test_a_groove_as_narrow_as_the_blur_has_its_depth(width: float, depth: float) -> None:
    """The cells alone read it at 0.5 to 0.7 of its depth."""
    told, height, arc = seen((60.0, 60.0 + width, ARC_DEG, depth))
    deep = (height > 0.6 * depth) & arc & ((told.z_mm > 59) & (told.z_mm < 61 + width))[:, None]
    assert deep.sum() > 0.5 * arc.sum()
    assert np.median(height[deep]) == pytest.approx(depth, rel=0.06)
    covered = np.abs(height[deep] - depth) < 2 * told.sigma_mm[deep]
    assert covered.mean() > 0.9
    found = find_scratches(told)
    assert [(one.kind.value, one.floor_seen) for one in found] == [("loss", True)]
    assert found[0].depth_mm == pytest.approx(depth, abs=found[0].depth_k2_mm)
    plain = ((told.z_mm < 58.5) | (told.z_mm > 62.5 + width))[:, None] & np.isfinite(height)
    assert np.sqrt(np.mean(height[plain] ** 2)) < 0.05


def test_a_floor_that_no_frame_sees_is_a_lower_limit() -> None:
    """Light comes at 2 mm along for each mm down at the least: a cut 1.8 mm wide and 3 deep has a floor in the dark."""
    told, height, arc = seen((60.0, 61.8, ARC_DEG, 3.0))
    within = arc & ((told.z_mm > 60.2) & (told.z_mm < 61.6))[:, None] & np.isfinite(height)
    assert told.at_least[within].mean() > 0.9
    assert (height[within & told.at_least] < 3.0).all()
    losses = [one for one in find_scratches(told) if one.kind.value == "loss"]
    assert losses
    assert not any(one.floor_seen for one in losses)
