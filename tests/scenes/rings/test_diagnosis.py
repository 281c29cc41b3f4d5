"""What is wrong with frames is said in words."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import Paint, calibration, draw

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.colour import learn, stripes
from annulus_pipe.rings.diagnosis import Trouble, diagnose, examine, exposure_findings
from annulus_pipe.rings.reconstructor import Reconstructor


@pytest.fixture(scope="module")
def frame():
    cal = calibration(scale=0.4)
    return cal, draw(cal, Pose(0.02, -0.015, 2.0, -1.5), paint=Paint(supersample=2, noise=1.0), slit_px=4.0)


def troubles(cal, image, colour=None):
    found = examine(Reconstructor(cal), [(7, np.ascontiguousarray(image))], colour)
    assert all("\n" not in finding.text and finding.frames == (7,) for finding in found)
    return {finding.kind: finding.text for finding in found}


def test_a_good_frame_has_no_trouble(frame):
    cal, image = frame
    assert troubles(cal, image) == {}
    assert exposure_findings([(0, diagnose(image))]) == ()


@pytest.mark.parametrize(("columns", "said"), [(1, "mirrored upside"), (-1, "turned upside")])
def test_a_flipped_image_is_recognised_by_what_it_does_to_the_residuals(frame, columns, said):
    cal, image = frame
    found = troubles(cal, image[::-1, ::columns])
    assert said in found[Trouble.FLIPPED]


def test_a_flip_that_the_head_is_too_symmetric_to_show_is_not_guessed(frame):
    cal, image = frame
    assert Trouble.FLIPPED not in troubles(cal, image[:, ::-1])  # this head's vertex and lens centre make up for it


@pytest.mark.parametrize("radius", [70.0, 75.3, 77.1, 80.0])
def test_a_pipe_of_another_radius_is_measured_and_said(frame, radius):
    cal, image = frame
    found = troubles(replace(cal, pipe_radius_mm=radius), image)
    assert set(found) == {Trouble.RADIUS}
    assert "is about 76.1" in found[Trouble.RADIUS] or "is about 76.2" in found[Trouble.RADIUS]


@pytest.mark.parametrize("radius", [75.6, 76.8])
def test_a_radius_within_what_pipes_of_one_size_differ_by_is_not_said(frame, radius):
    cal, image = frame
    assert troubles(replace(cal, pipe_radius_mm=radius), image) == {}


def test_wrong_colours_are_read_out(frame):
    cal, image = frame
    assert "RRGBGR" in troubles(replace(cal, colours="RGBBGR"), image)[Trouble.COLOURS]
    assert "red and blue are exchanged" in troubles(cal, image[..., ::-1])[Trouble.COLOURS]


def test_another_pipe_than_the_profiles_is_said(frame):
    cal, image = frame
    slits, placed = Reconstructor(cal).slits_by_order(image)
    profile = learn([stripes(slits, placed, cal)])
    assert troubles(cal, image, profile) == {}
    yellow = (image * np.array([0.12, 0.7, 1.0])).astype(np.uint8)
    assert set(troubles(cal, yellow, profile)) == {Trouble.PAINT}


def test_a_band_that_is_over_exposed_is_said_with_where(frame):
    _, image = frame
    y, x = np.mgrid[: image.shape[0], : image.shape[1]] - 0.5 * np.array(image.shape[:2])[:, None, None]
    band = np.abs((np.degrees(np.arctan2(x, -y)) - 120.0 + 180.0) % 360.0 - 180.0) < 25.0  # clock 3:10 to 4:50
    glare = np.where(band[..., None], np.clip(image * 3.0, 0, 255), image).astype(np.uint8)
    (said,) = exposure_findings([(i, diagnose(glare)) for i in range(4)])
    assert "clock 3:00 to 5:00" in said.text
    assert exposure_findings([(0, diagnose(glare)), *((i, diagnose(image)) for i in range(1, 5))]) == ()


def test_dark_and_over_exposed_frames_are_named_with_how_much(frame):
    _, image = frame
    cap = np.random.default_rng(1).normal(3, 1.5, image.shape).clip(0, 255).astype(np.uint8)
    glare = np.clip(image * 8.0, 0, 255).astype(np.uint8)
    dark, bright = diagnose(cap), diagnose(glare)
    assert dark.dark and not dark.over_exposed and bright.over_exposed and not bright.dark
    (said,) = exposure_findings([(3, dark), (4, dark)])
    assert said.text.startswith("all dark") and said.frames == (3, 4)
    (said,) = exposure_findings([(3, diagnose(image)), (9, bright)])
    assert "1 of 2" in said.text and "% of the stripes" in said.text and "frame 9" in said.text
