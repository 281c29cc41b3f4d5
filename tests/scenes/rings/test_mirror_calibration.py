"""The ball's size is known, so a head with a mirror knows what a millimetre is; one with a lens does not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.observations import Observations, observe
from annulus_pipe.rings.polar import ring_pixels
from annulus_pipe.twin.worlds import World, mirror_world

FRAMES, DIRECTIONS = 8, 90


@pytest.fixture(scope="module")
def world() -> World:
    return replace(mirror_world(), features=(), wobble_deg=4.0, wobble_mm=4.0)


def observations(world: World, camera: Camera, noise_px: float) -> Observations:
    frame, ring, pixels = [], [], []
    rng = np.random.default_rng(3)
    for f, z in enumerate(np.linspace(0.0, 150.0, FRAMES)):
        for k, cone in enumerate(world.projector.cones):
            at = ring_pixels(camera, cone, world.pose(float(z)), world.radius_mm, DIRECTIONS)
            at = at[np.isfinite(at).all(axis=1)]
            frame.append(np.full(len(at), f))
            ring.append(np.full(len(at), k))
            pixels.append(at + rng.normal(0.0, noise_px, at.shape))
    centre = np.array([camera.cx, camera.cy])
    return observe(camera, np.concatenate(frame), np.concatenate(ring), np.concatenate(pixels), centre)


def test_a_head_with_a_mirror_calibrates_itself_in_a_pipe(world: World) -> None:
    found = calibrate(observations(world, world.camera, 0.05), world.radius_mm)
    sigma = np.sqrt(np.diag(found.covariance)).reshape(-1, 6)
    for got, true, own in zip(found.rings, world.projector.cones, sigma, strict=True):
        assert abs(math.degrees(2 * (got.half_angle - true.half_angle))) < 0.05
        assert abs(got.half_angle - true.half_angle) < 4 * own[0]
        assert np.abs(np.subtract(got.vertex_mm, true.vertex_mm)).max() < 0.045


def test_the_ball_tells_that_the_radius_is_wrong_and_by_how_much(world: World) -> None:
    exact = observations(world, world.camera, 0.0)
    right = calibrate(exact, world.radius_mm)
    assert abs(right.off_radius_mm[0]) < 1e-9
    told = 1.03 * world.radius_mm
    off, _ = calibrate(exact, told, start=right).off_radius_mm
    assert off == pytest.approx(world.radius_mm - told, rel=0.1)


def test_a_lens_with_one_centre_cannot_tell_the_radius(world: World) -> None:
    lens = Camera("fisheye", 1664, 1232, 300.0, 300.0, 831.5, 615.5)
    assert math.isinf(calibrate(observations(world, lens, 0.05), world.radius_mm).off_radius_mm[1])
