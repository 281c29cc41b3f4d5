"""A slide found from drawn frames of a plate, against the slide they were drawn with."""

from dataclasses import replace

import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, RIGHT, SLIDE, drawn

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import (
    FringeHead,
    FringeProjector,
    ReferencePlate,
    Transfer,
    calibrate_plate,
    projector_to_dict,
)

HEIGHTS = (-4.0, 0.0, 3.0, 8.0)


def plates(
    heads: tuple[HeadCamera, ...] = (LEFT, RIGHT), told_mm: float = DISTANCE_MM, slide: FringeProjector = SLIDE
) -> list[ReferencePlate]:
    out = []
    for k, height in enumerate(HEIGHTS):
        for one in heads:
            light = drawn(np.zeros(1), height, noise=1.0, head=one, seed=10 * k + one.id, slide=slide)[0]
            out.append(ReferencePlate(light, one, told_mm - height, f"frame {k} camera {one.id}"))
    return out


def test_the_slide_is_found_within_its_sigma() -> None:
    found = calibrate_plate(plates())
    true = np.array([20.0, 0.0, 0.0, 0.0, 2 * np.pi / SLIDE.period, 0.0, SLIDE.phase0])
    assert (np.abs(found.values - true) < 4 * found.sigma + 1e-6).all()
    assert found.sigma[0] < 0.05  # mm across the stripes
    x = np.array([[x, y, DISTANCE_MM - h] for x in (0.0, 20.0) for y in (-10.0, 10.0) for h in (-3.0, 0.0, 6.0)])
    off = found.projector.phase(x) - SLIDE.phase(x)
    np.testing.assert_allclose(off - 2 * np.pi * np.round(off[0] / (2 * np.pi)), 0.0, atol=0.01)
    assert found.modulation == pytest.approx(0.8, abs=0.01)
    assert found.camera_rad < 0.01
    assert not found.projector.distortion and abs(found.barrel) < 4 * found.barrel_sigma < 0.02


def test_a_lens_that_distorts_is_found_within_its_sigma() -> None:
    """A barrel of 3 % where the light ends, and what it is worth: without it the phase is off by a radian."""
    edge = 0.75
    bent = replace(SLIDE, distortion=(-0.03 / edge**2, 0.0, 0.0, 0.0, 0.0))
    found = calibrate_plate(plates(slide=bent))
    assert -found.barrel == pytest.approx(0.03 * found.edge**2 / edge**2, abs=4 * found.barrel_sigma + 1e-4)
    assert found.barrel_sigma < 0.003
    x = np.array([[x, y, DISTANCE_MM - h] for x in (-20.0, 60.0) for y in (-10.0, 10.0) for h in (-3.0, 0.0, 6.0)])
    off = found.projector.phase(x) - bent.phase(x)
    np.testing.assert_allclose(off - 2 * np.pi * np.round(off[0] / (2 * np.pi)), 0.0, atol=0.02)


@pytest.mark.deep(gate="tests/wings/fringe/test_calibration.py::test_a_curve_is_undone_and_saturation_is_not_told")
def test_harmonics_are_found_and_a_gamma_is_named() -> None:
    bent = [replace(one, light=np.float32(255 * (np.maximum(one.light, 0) / 255) ** 1.1)) for one in plates((LEFT,))]
    found = calibrate_plate(bent)
    assert found.gamma == pytest.approx(1.1, abs=0.03)
    c2, s2 = found.projector.harmonics[:2]
    assert c2 == pytest.approx(0.1 * 0.8 / 4, abs=0.005)
    assert abs(s2) < 0.003


def test_a_plate_that_stands_elsewhere_shows_between_the_cameras() -> None:
    assert calibrate_plate(plates(told_mm=DISTANCE_MM + 1.0)).camera_rad > 0.1


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        (plates((LEFT,))[:1], "expected a plate at 2 or more"),
        ([replace(one, light=np.full_like(one.light, 90.0)) for one in plates((LEFT,))], "shows no fringes"),
    ],
)
def test_what_cannot_be_calibrated_is_said(frames: list[ReferencePlate], text: str) -> None:
    with pytest.raises(AnnulusError, match=text):
        calibrate_plate(frames)


def test_a_slide_is_read_as_it_was_written() -> None:
    slide = replace(SLIDE, harmonics=(0.01, -0.02), turn_deg=3.0)
    assert FringeProjector.from_dict(projector_to_dict(slide)) == slide


def test_curves_are_one_a_head_or_one_a_scan() -> None:
    camera = {"id": 0, "model": "pinhole", "width": 80, "height": 80, "fx": 90, "fy": 90, "cx": 40, "cy": 40}
    data = {"format": "annulus-calibration/2", "cameras": [{**camera, "distortion": []}], "pattern": {"kind": "fringe"}}
    one = FringeHead.from_dict({**data, "transfer": {"sensor": "srgb", "black": 4}})
    assert one.curve("any") == Transfer("srgb", 4.0)
    many = FringeHead.from_dict({**data, "transfer": {"a": {"black": 4}, "b": {}}})
    assert many.curve("a") == Transfer("linear", 4.0)
    assert many.curve("c") is None
    with pytest.raises(ValueError, match=r"transfer\.a\.sensor"):
        FringeHead.from_dict({**data, "transfer": {"a": {"sensor": "log"}}})


def test_a_curve_is_undone_and_saturation_is_not_told() -> None:
    grey = np.array([[0, 4, 129, 254]], np.uint8)
    light = Transfer("linear", 4.0).light(grey)
    np.testing.assert_allclose(light[0, :3], [-4 * 255 / 251, 0.0, 125 * 255 / 251], atol=1e-4)
    assert np.isnan(light[0, 3])
    srgb = Transfer("srgb").light(np.array([[188]], np.uint8))[0, 0]
    assert srgb == pytest.approx(127.5, rel=0.02)  # half the light is written as 188
