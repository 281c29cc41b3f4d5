"""The ball before the camera: reflection, its inverse, and what a file may say of it."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import camera_from_dict, camera_to_dict
from annulus_pipe.geometry.camera import Camera, Mirror

BALL = Mirror((0.3, -0.2, 45.0), 10.0)
CAMERA = Camera("mirror", 1664, 1232, 2460.0, 2455.0, 831.5, 615.5, (-0.05, 0.01, 1e-4, -1e-4), BALL)
AHEAD = replace(CAMERA, mirror=replace(BALL, looks="ahead"))


def inside(camera: Camera) -> np.ndarray:
    """Pixels all over the ball, to its very rim."""
    pixels = np.random.default_rng(1).uniform([0, 0], [camera.width - 1, camera.height - 1], (4000, 2))
    return pixels[np.isfinite(camera.lines(pixels)[1]).all(axis=1)]


@pytest.mark.parametrize("camera", [CAMERA, AHEAD], ids=["back", "ahead"])
@pytest.mark.parametrize("distance", [1e-3, 5.0, 38.0, 500.0])
def test_a_pixel_goes_out_by_the_mirror_and_comes_back(camera: Camera, distance: float) -> None:
    pixels = inside(camera)
    start, way = camera.lines(pixels)
    assert len(pixels) > 1500 and np.allclose(np.linalg.norm(way, axis=1), 1.0, rtol=0, atol=1e-13)
    assert np.abs(camera.project(start + distance * way) - pixels).max() < 3e-11


def test_light_leaves_the_ball_as_steeply_as_it_came() -> None:
    start, way = CAMERA.lines(inside(CAMERA))
    normal = start / BALL.radius_mm
    came = start - BALL.eye_mm
    came /= np.linalg.norm(came, axis=1, keepdims=True)
    assert np.allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=1e-13)
    assert np.allclose((came * normal).sum(axis=1), -(way * normal).sum(axis=1), rtol=0, atol=1e-13)
    assert np.abs(np.linalg.det(np.stack([came, normal, way], axis=1))).max() < 1e-14  # all three in one plane


def test_the_farther_wall_stands_nearer_the_middle_and_left_is_right() -> None:
    wall = np.array([[38.1, 0.0, z] for z in (60.0, 30.0, 0.0, -20.0)])
    at = CAMERA.project(wall) - CAMERA.project(np.array([[0.0, 0.0, 40.0]]))
    assert (at[:, 0] < 0).all() and (np.diff(np.hypot(*at.T)) > 40).all()
    at = AHEAD.project(wall) - AHEAD.project(np.array([[0.0, 0.0, -40.0]]))
    assert (at[:, 0] > 0).all() and (np.diff(np.hypot(*at.T)) < -10).all()


def test_what_the_ball_hides_or_misses_is_not_a_number() -> None:
    assert np.isnan(CAMERA.lines(np.array([[5.0, 5.0]]))[1]).all()
    assert np.isnan(CAMERA.project(np.array([[0.0, 0.0, -30.0], [np.nan, 0.0, 0.0]]))).all()


def test_a_small_ball_far_off_is_a_camera_with_one_centre() -> None:
    """Reflection by a ball of no size: the way's angle from the axis is twice the normal's."""
    tiny = Camera("mirror", 1664, 1232, 2e6, 2e6, 831.5, 615.5, mirror=Mirror((0.0, 0.0, 1e3), 0.2))
    theta = np.linspace(0.1, 2.0, 12)
    points = 30.0 * np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    expected = 2e6 / 1e3 * 0.2 * np.sin(theta / 2)
    assert np.allclose(831.5 - tiny.project(points)[:, 0], expected, rtol=0.009)


def test_only_a_mirror_camera_has_lines_that_start_apart() -> None:
    plain = Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)
    start, way = plain.lines(np.array([[100.0, 200.0]]))
    assert plain.central and not start.any() and np.array_equal(way, plain.rays(np.array([[100.0, 200.0]])))
    assert not CAMERA.central
    with pytest.raises(ValueError, match="lines"):
        CAMERA.rays(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="mirror"):
        replace(plain, mirror=BALL)


@pytest.mark.parametrize("camera", [CAMERA, AHEAD], ids=["back", "ahead"])
def test_a_mirror_survives_its_own_dictionary(camera: Camera) -> None:
    assert camera_from_dict(json.loads(json.dumps(camera_to_dict(camera)))) == camera


@pytest.mark.parametrize(
    ("key", "value"),
    [("centre_mm", [0, 0, -45]), ("centre_mm", [0, 0, 9]), ("centre_mm", [0, 0]), ("radius_mm", 0), ("looks", "up")],
)
def test_a_wrong_mirror_is_named(key: str, value: Any) -> None:
    data = camera_to_dict(CAMERA)
    data["mirror"] = {**data["mirror"], key: value}
    with pytest.raises(ValueError, match=rf"camera\.mirror\.{key}"):
        camera_from_dict(data)
    del data["mirror"]
    with pytest.raises(ValueError, match=r"camera\.mirror"):
        camera_from_dict(data)
    assert math.isclose(camera_from_dict(camera_to_dict(CAMERA)).fx, 2460.0)
