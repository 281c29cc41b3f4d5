"""A frame's profile is its own: what came before it may save time, and changes nothing that a sigma would notice."""

from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.wall.profile import Profile
from tests.unit.rings.drawn import Paint, calibration, draw

POSES = [Pose(0.02, -0.01, 1.5, -2.0), Pose(-0.03, 0.02, -3.0, 1.0), Pose()]


@pytest.fixture(scope="module")
def reconstructor() -> Reconstructor:
    return Reconstructor(calibration(), 360)


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    return [draw(calibration(), pose, paint=Paint(supersample=1, noise=2.0), seed=i) for i, pose in enumerate(POSES)]


def content(profile: Profile) -> dict[str, object]:
    return replace(profile, timing_ms={}).to_dict()


def test_with_one_seed_the_frames_before_leave_no_trace(reconstructor, images) -> None:
    alone = content(Reconstructor(calibration(), 360).profile(images[0], frame=0, z_mm=0.0, seed=POSES[0]))
    for before in images[1:]:
        reconstructor.profile(before, frame=9, z_mm=5.0)
        assert content(reconstructor.profile(images[0], frame=0, z_mm=0.0, seed=POSES[0])) == alone


@pytest.mark.parametrize("seed", POSES)
def test_another_seed_finds_the_same_points_within_a_hundredth_of_their_sigma(reconstructor, images, seed) -> None:
    without = reconstructor.profile(images[0], frame=0, z_mm=0.0)
    seeded = reconstructor.profile(images[0], frame=0, z_mm=0.0, seed=seed)
    assert np.array_equal(seeded.ring, without.ring) and np.array_equal(seeded.direction, without.direction)
    off = np.hypot(*seeded.points_mm[:, :2].T) - np.hypot(*without.points_mm[:, :2].T)
    assert np.abs(off / without.sigma_mm).max() < 0.006
