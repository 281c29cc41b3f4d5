"""A pipe's wall from rings that it moves through, in mm against one that was drawn."""

from dataclasses import replace

import numpy as np
import pytest
from bores import LENS, RADIUS_MM, SLIDE, drawn

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import Eye, FringeProjector, Shots, calibrate_pipe, find_scratches, measure_pipe
from annulus_pipe.wings.fringe.measure.projector import HARMONICS_MAX, LAW

EYE = Eye(LENS, SLIDE)
UNEVEN = np.array([0.0, 1.1, 3.3, 4.2, 6.9, 8.0, 10.6, 12.1, 13.0, 15.4])
LEAN = np.array([0.004, -0.003, 0.0, 0.9, -0.6, 0.0])
GROOVE = (56.0, 60.0, 25.0, 0.5)
ASIDE = np.array([[0.0, 0, 0], [3.0, 0, 0], [-1.5, 2.6, 0], [-1.5, -2.6, 0]])


def poses(z: FloatArray) -> FloatArray:
    out = np.tile(LEAN, (len(z), 1))
    out[:, 5] = z
    return out


@pytest.mark.deep(gate="tests/wings/fringe/test_pipe.py::test_a_clean_pipe_calibrates_the_projector")
def test_a_pipe_with_a_groove_by_a_leaning_head_and_uneven_steps() -> None:
    images = drawn(poses(UNEVEN), groove=GROOVE)
    seen = measure_pipe([EYE], Shots.single(images), UNEVEN, RADIUS_MM, cell_mm=0.8)
    np.testing.assert_allclose(seen.head.poses[:, :2], LEAN[:2] * np.ones((10, 1)), atol=6e-4)
    np.testing.assert_allclose(seen.head.poses[:, 3:5], LEAN[3:5] * np.ones((10, 1)), atol=0.06)
    phi = (seen.phi_deg + 180) % 360 - 180
    inside = ((seen.z_mm > 57.5) & (seen.z_mm < 58.5))[:, None] & (np.abs(phi) < 20)
    apart = ((seen.z_mm < 53) | (seen.z_mm > 63))[:, None] | (np.abs(phi) > 30)
    off = seen.radius_mm - RADIUS_MM
    wall = apart & np.isfinite(off)
    assert wall.sum() > 0.8 * apart.sum() * np.mean((seen.z_mm > 40) & (seen.z_mm < 110))
    assert np.sqrt(np.mean(off[wall] ** 2)) < 0.06
    assert 0.90 <= np.mean(np.abs(off[wall] - np.median(off[wall])) < 2 * seen.sigma_mm[wall]) <= 0.99
    assert np.nanmedian(off[inside]) == pytest.approx(0.5, abs=0.08)
    found = find_scratches(seen)
    assert [(one.kind.value, round(one.clock_deg / 15)) for one in found] == [("loss", 6)]  # phi 0 is three o'clock
    assert found[0].depth_mm == pytest.approx(0.5, abs=0.1)
    assert found[0].z_mm == pytest.approx(58.0, abs=0.5)


def test_a_clean_pipe_calibrates_the_projector() -> None:
    """From a design that is off by more than a fringe, with a slide that is no sinusoid."""
    slide = replace(SLIDE, harmonics=(0.06, -0.03))
    shifted = np.concatenate([np.zeros((4, 3)), ASIDE], axis=1) + np.array([0.002, 0.001, 0, 0.4, 0.2, 0])
    designed = FringeProjector("rings", (0.0, 0.0, -38.5), ((1, 0, 0), (0, 1, 0), (0, 0, 1)), 7.05, 0, 0, RADIUS_MM)
    shots = Shots.single(drawn(shifted, slide=slide, texture=0.0, blur_px=0.3))
    told = calibrate_pipe([LENS], designed, shots, ASIDE, RADIUS_MM)
    assert len(told.sigma) == LAW + len(told.projector.harmonics) <= LAW + 2 * HARMONICS_MAX
    assert told.projector.distortion == () and abs(told.barrel) < 4 * told.barrel_sigma < 0.04
    off = np.array(told.projector.centre_mm) - SLIDE.centre_mm
    assert (np.abs(off) < 4 * told.sigma[:3] + 0.02).all()
    assert (told.sigma[:3] < 0.2).all()
    assert told.projector.period == pytest.approx(7.0, abs=0.01)
    np.testing.assert_allclose(told.projector.harmonics[:2], slide.harmonics, atol=0.015)  # the blur takes most of them
    assert not told.reversed
    shots = Shots.single(drawn(shifted, texture=0.0))
    assert calibrate_pipe([LENS], designed, shots, -ASIDE, RADIUS_MM).reversed


def test_what_cannot_be_measured_is_said_in_a_line() -> None:
    images = np.full((4, 360, 360), 1.0, np.float32)
    z = np.arange(4.0)
    with pytest.raises(AnnulusError, match="3 positions"):
        measure_pipe([EYE], Shots.single(images), z[:3], RADIUS_MM)
    with pytest.raises(AnnulusError, match="need at least 3"):
        measure_pipe([EYE], Shots.single(images[:2]), z[:2], RADIUS_MM)
    with pytest.raises(AnnulusError, match="did not move"):
        measure_pipe([EYE], Shots.single(images), 0 * z, RADIUS_MM)
    with pytest.raises(AnnulusError, match="100x90, but the camera is 360x360"):
        measure_pipe([EYE], Shots.single(images[:, :90, :100]), z, RADIUS_MM)
    with pytest.raises(AnnulusError, match="lit"):
        measure_pipe([EYE], Shots.single(0 * images), z, RADIUS_MM)
    with pytest.raises(AnnulusError, match="saturated"):
        measure_pipe([EYE], Shots.single(np.nan * images), z, RADIUS_MM)
    with pytest.raises(AnnulusError, match="not in a line"):
        calibrate_pipe([LENS], SLIDE, Shots.single(images), z[:, None] * [1.0, 0.0, 0.0], RADIUS_MM)
