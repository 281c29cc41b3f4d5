"""A pose of another place as seed made every reading implausible, and the frame had no pipe in it (ebb19a9). Fails
without the second try, seedless."""

import math

from drawn import calibration, draw

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor


def test_a_seed_of_another_place_costs_no_frame() -> None:
    cal = calibration()
    pose = Pose(math.radians(1.0), math.radians(-2.0), 2.0, 1.0)
    profile = Reconstructor(cal, 360).profile(draw(cal, pose), frame=0, z_mm=0.0, seed=Pose(0.0, 0.0, 60.0, -60.0))
    assert profile.pose is not None
    assert abs(profile.pose.rx - pose.rx) < 3e-4 and abs(profile.pose.tx - pose.tx) < 0.06
