"""One ring, two rings, half of them hidden: what can be measured is, and what cannot is said."""

import numpy as np
import pytest
from drawn import PIPE_MM, Paint, calibration, draw

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor

POSE = Pose(np.radians(1.2), np.radians(-0.9), 2.0, -1.5)
PAINT = Paint(supersample=1, noise=1.5)
ONE = {"colours": "GG", "theta_deg": (52.8,)}
TWO = {"colours": "RGB", "theta_deg": (42.4, 57.7)}


def half_hidden(image, cal):
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    out = image.copy()
    out[(v - cal.camera.cy) > 0.15 * (u - cal.camera.cx)] = 3
    return out


@pytest.fixture(scope="module")
def one():
    cal = calibration(**ONE)
    return cal, draw(cal, POSE, paint=PAINT, slit_px=5.0)


@pytest.mark.parametrize("hidden", [False, True], ids=["whole", "half hidden"])
def test_one_ring_measures_the_radius_and_owns_up_to_the_lean(one, hidden):
    cal, image = one
    profile = Reconstructor(cal).profile(half_hidden(image, cal) if hidden else image, frame=0, z_mm=0.0)
    radius = np.hypot(*profile.points_mm[:, :2].T)
    assert len(radius) > (300 if hidden else 690)
    assert np.sqrt(np.mean((radius - PIPE_MM) ** 2)) < 0.2
    assert profile.lean_sigma_deg > 1.5
    # The pipe's axis is known where the ring is, and only there.
    ahead = float(np.median(profile.points_mm[:, 2]))
    axis = POSE.to_pipe(profile.pose.to_camera(np.array([[0.0, 0.0, ahead]])))[0]
    assert np.hypot(axis[0], axis[1]) < 0.3


def test_two_rings_are_enough_for_the_pose():
    cal = calibration(**TWO)
    profile = Reconstructor(cal).profile(draw(cal, POSE, paint=PAINT, slit_px=5.0), frame=0, z_mm=0.0)
    assert np.degrees(max(abs(profile.pose.rx - POSE.rx), abs(profile.pose.ry - POSE.ry))) < 0.035
    assert profile.lean_sigma_deg < 0.02
    assert np.sqrt(np.mean((np.hypot(*profile.points_mm[:, :2].T) - PIPE_MM) ** 2)) < 0.15


def test_of_five_rings_half_hidden_the_rest_is_as_good():
    cal = calibration()
    image = half_hidden(draw(cal, POSE, paint=PAINT, slit_px=5.0), cal)
    profile = Reconstructor(cal).profile(image, frame=0, z_mm=0.0)
    assert len(profile.ring) > 0.4 * 5 * 720
    assert np.sqrt(np.mean((np.hypot(*profile.points_mm[:, :2].T) - PIPE_MM) ** 2)) < 0.2
    assert np.degrees(max(abs(profile.pose.rx - POSE.rx), abs(profile.pose.ry - POSE.ry))) < 0.05
