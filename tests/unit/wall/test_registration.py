from dataclasses import replace

import numpy as np
from synthetic_pipe import RADIUS_MM, pocket, round_pipe, scan

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.registration import register

FALSE = Pose(0.004, -0.003, 0.3, -0.2)  # as if a groove had pulled the fit: half a millimetre at the wall


def leaning(profile: Profile) -> Profile:
    moved = FALSE.to_pipe(profile.points_mm.astype(float) - [0, 0, profile.z_mm], profile.z_mm)
    return replace(profile, pose=FALSE, points_mm=moved.astype(np.float32))


def errors_mm(profile: Profile) -> np.ndarray:
    return np.hypot(profile.points_mm[:, 0], profile.points_mm[:, 1]) - RADIUS_MM


def test_a_leaning_frame_is_set_right_by_its_neighbours() -> None:
    profiles = scan(round_pipe)
    profiles[20] = leaning(profiles[20])
    before = np.sqrt(np.mean(errors_mm(profiles[20]) ** 2))
    after = register(profiles)[20]
    assert before > 0.25
    assert np.sqrt(np.mean(errors_mm(after) ** 2)) < 0.08
    assert after.pose is not None and abs(after.pose.rx) < 2e-4 and abs(after.pose.tx) < 0.01


def test_points_move_rigidly_with_their_frame() -> None:
    profiles = scan(pocket(round_pipe, 90, 12, 130, 165, 5.0))
    profiles[20] = leaning(profiles[20])
    before, after = profiles[20], register(profiles)[20]
    assert before.pose is not None and after.pose is not None
    camera = before.pose.to_camera(before.points_mm.astype(float), before.z_mm)
    assert np.allclose(after.pose.to_camera(after.points_mm.astype(float), after.z_mm), camera, rtol=0, atol=2e-5)


def test_a_frame_without_a_pose_comes_back_unchanged() -> None:
    profiles = scan(round_pipe, z_mm=[3.0 * i for i in range(10)])
    none = np.zeros(0, np.uint8)
    lost = Profile(99, 31.0, None, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), none, none.astype("u2"))
    assert register([*profiles, lost])[-1] is lost
