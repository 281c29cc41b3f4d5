"""Frames with known truth through the whole method."""

import cv2
import numpy as np
import pytest
from drawn import PIPE_MM, Paint, calibration, draw

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.vocabulary import AnnulusError

POSE = Pose(np.radians(1.7), np.radians(-1.2), 2.0, -1.5)
ELEVEN = {"colours": "RRGBRBBGGRGB", "theta_deg": tuple(np.linspace(37.0, 60.0, 11))}


def oval_with_dent(phi, z):
    return PIPE_MM + 1.2 * np.cos(2 * phi) - 2.5 * np.exp(-(((z - 105) / 14) ** 2) - ((phi - 1.0) / 0.3) ** 2)


def errors(profile, radius=None):
    x, y, z = profile.points_mm.T.astype(float)
    truth = radius(np.arctan2(y, x), z) if radius else PIPE_MM
    return np.hypot(x, y) - truth


@pytest.fixture(scope="module")
def plain():
    cal = calibration()
    return cal, draw(cal, POSE, paint=Paint(supersample=2, noise=1.5), slit_px=5.0)


def test_a_clean_pipe_is_found_and_measured(plain):
    cal, image = plain
    profile = Reconstructor(cal).profile(image, frame=3, z_mm=100.0)
    assert profile.pose is not None and profile.frame == 3
    assert np.degrees(abs(profile.pose.rx - POSE.rx)) < 0.025 and np.degrees(abs(profile.pose.ry - POSE.ry)) < 0.025
    assert abs(profile.pose.tx - POSE.tx) < 0.05 and abs(profile.pose.ty - POSE.ty) < 0.05
    error = errors(profile)
    assert len(error) > 0.97 * 5 * 720
    assert np.sqrt(np.mean(error**2)) < 0.15 and np.abs(error).max() < 0.9  # 1 px is 2 mm on the innermost ring here
    assert abs(error.mean()) < 0.03
    # z is the station plus the way ahead, and each ring stands where its cone meets the wall
    for k, cone in enumerate(cal.rings):
        z = profile.points_mm[profile.ring == k, 2].mean() - 100.0
        assert abs(z - (PIPE_MM / np.tan(cone.half_angle) + cone.vertex_mm[2])) < 2.0


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("model", "pattern", "slit_px"),
    [("fisheye", {}, 5.0), ("barrel", ELEVEN, 3.5)],
    ids=["fisheye", "distorted, eleven slits"],
)
def test_an_oval_dented_pipe_is_measured_through_any_lens(model, pattern, slit_px):
    cal = calibration(model, scale=0.5, **pattern)
    image = draw(cal, POSE, oval_with_dent, Paint(supersample=2, noise=2.0, bayer=True), slit_px)
    profile = Reconstructor(cal).profile(image, frame=0, z_mm=0.0)
    error = errors(profile, oval_with_dent)
    assert len(error) > 0.95 * len(cal.rings) * 720
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert (np.abs(error) > 2.0).sum() == 0


@pytest.mark.deep(gate="tests/scenes/rings/test_reconstructor.py::test_a_clean_pipe_is_found_and_measured")
def test_a_yellow_pipe_that_swallows_blue_is_measured():
    cal = calibration(scale=0.5)
    yellow = Paint(light=((200, 12, 1), (14, 160, 6), (2, 14, 36)), supersample=2, noise=1.5, bayer=True)
    error = errors(Reconstructor(cal).profile(draw(cal, POSE, None, yellow, 5.0), frame=0, z_mm=0.0))
    assert len(error) > 0.9 * 5 * 720
    assert np.sqrt(np.mean(error**2)) < 0.2 and (np.abs(error) > 2.0).sum() == 0


def test_behind_a_rod_there_is_nothing(plain):
    cal, image = plain
    grid_x, grid_y = np.meshgrid(np.arange(image.shape[1]), np.arange(image.shape[0]))
    angle = np.arctan2(grid_y - cal.camera.cy, grid_x - cal.camera.cx)
    shaded = image.copy()
    shaded[np.abs(angle - 1.0) < 0.12] = 3
    profile = Reconstructor(cal).profile(shaded, frame=0, z_mm=0.0)
    seen = np.arctan2(profile.points_mm[:, 1], profile.points_mm[:, 0])
    assert not (np.abs(seen - 1.0) < 0.08).any()
    assert np.abs(errors(profile)).max() < 0.9
    assert len(profile.ring) > 0.93 * 5 * 720 * (1 - 0.24 / (2 * np.pi))


def test_a_wrong_seed_changes_nothing(plain):
    cal, image = plain
    reconstructor = Reconstructor(cal)
    first = reconstructor.profile(image, frame=0, z_mm=0.0)
    for seed in (Pose(-0.06, 0.06, -6.0, 6.0), Pose(0.6, -0.6, 50.0, 50.0)):
        again = reconstructor.profile(image, frame=0, z_mm=0.0, seed=seed)
        assert again.pose is not None and first.pose is not None
        assert abs(again.pose.rx - first.pose.rx) < 8e-6 and abs(again.pose.tx - first.pose.tx) < 0.004
        assert abs(len(again.ring) - len(first.ring)) < 20


def test_frames_without_rings_have_no_pose_and_no_points(plain):
    cal, image = plain
    rng = np.random.default_rng(8)
    dark = rng.normal(4, 2, image.shape).clip(0, 255).astype(np.uint8)
    led = np.clip(120 + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, image.shape), (0, 0), 3)
    texture = np.clip((texture - texture.mean()) * 12 + 120, 0, 255).astype(np.uint8)
    for frame in (dark, led, texture, np.zeros_like(image), np.full_like(image, 255)):
        profile = Reconstructor(cal).profile(frame, frame=0, z_mm=0.0)
        assert profile.pose is None and len(profile.points_mm) == 0 and "no pipe" in profile.rejected


def test_an_image_of_another_size_is_refused_in_one_line(plain):
    cal, _ = plain
    with pytest.raises(AnnulusError, match="800x600, 3 of uint8, but the calibration's camera is 832x616"):
        Reconstructor(cal).profile(np.zeros((600, 800, 3), np.uint8), frame=0, z_mm=0.0)
    with pytest.raises(AnnulusError, match="directions"):
        Reconstructor(cal, directions=2)


def test_the_same_frame_gives_the_same_profile(plain):
    cal, image = plain
    a, b = (Reconstructor(cal).profile(image, frame=0, z_mm=0.0) for _ in range(2))
    assert (a.points_mm == b.points_mm).all() and a.pose == b.pose
