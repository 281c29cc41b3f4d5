"""Two cameras, one projector: every direction is measured, by the one that can; nothing is said that is not known."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_head import RADIUS_MM, draw, head
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.stereo import TWO_WALLS, StereoReconstructor, swapped
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile

POSE = Pose(0.02, -0.03, -6.9, -9.1)
Images = dict[int, NDArray[np.uint8]]


@pytest.fixture(scope="module")
def images() -> Images:
    calibration = head()
    return {one.id: draw(calibration, one, POSE, seed=one.id) for one in calibration.cameras}


@pytest.fixture(scope="module")
def stereo() -> StereoReconstructor:
    return StereoReconstructor(head())


@pytest.fixture(scope="module")
def both(stereo: StereoReconstructor, images: Images) -> Profile:
    return stereo.profile(images, frame=0, z_mm=0.0)


def errors_mm(profile: Profile) -> NDArray[np.float64]:
    return np.hypot(*profile.points_mm[:, :2].T.astype(float)) - RADIUS_MM


@pytest.mark.deep(gate="tests/unit/stereo/test_stereo.py::test_no_threshold_is_needed_where_one_camera_is_tangent")
def test_every_direction_of_a_clean_pipe_is_measured(both: Profile, stereo: StereoReconstructor) -> None:
    assert len(both.ring) == 7 * stereo.directions
    error = errors_mm(both)
    assert np.sqrt(np.mean(error**2)) < 0.1  # half size; 0.05 measured
    assert np.abs(error).max() < 0.6


def test_sigma_holds_at_the_tangents_as_elsewhere(both: Profile) -> None:
    inside = np.abs(errors_mm(both)) < 2 * both.sigma_mm
    assert 0.9 < inside.mean() <= 0.995
    for camera in (0, 1):  # one alone said where the wall is: the other's rays are tangent
        alone = both.seen_by == camera
        assert alone.mean() > 0.05
        assert inside[alone].mean() > 0.88


def test_no_threshold_is_needed_where_one_camera_is_tangent(both: Profile, images: Images) -> None:
    gated = StereoReconstructor(head(), delta_gate=0.4).profile(images, frame=0, z_mm=0.0)
    ours, theirs = (np.sqrt(np.mean(errors_mm(p) ** 2)) for p in (both, gated))
    assert ours < 0.9 * theirs


def test_a_lost_frame_costs_directions_and_never_a_wrong_point(stereo: StereoReconstructor, images: Images) -> None:
    for kept in (0, 1):
        one = stereo.profile({kept: images[kept]}, frame=0, z_mm=0.0)
        assert one.rejected["camera missing"] == 1
        assert one.rejected["tangent"] > 100
        assert (one.seen_by == kept).all()
        assert len(one.ring) > 0.6 * 7 * stereo.directions
        far = np.abs(errors_mm(one)) / one.sigma_mm
        assert (far > 5).mean() < 0.002
        assert np.abs(errors_mm(one)).max() < 2.0


def test_cameras_exchanged_are_told(stereo: StereoReconstructor, images: Images) -> None:
    assert not list(swapped(stereo, [(0, images)]))
    found = list(swapped(stereo, [(0, {0: images[1], 1: images[0]})]))
    assert len(found) == 1
    assert "exchanged" in found[0].text


@pytest.mark.deep(gate="tests/unit/stereo/test_stereo.py::test_no_threshold_is_needed_where_one_camera_is_tangent")
def test_frames_of_two_flashes_contradict_each_other(stereo: StereoReconstructor, images: Images) -> None:
    calibration = stereo.calibration
    other = draw(calibration, calibration.cameras[1], replace(POSE, tx=POSE.tx + 3.0), seed=9)
    mixed = stereo.profile({0: images[0], 1: other}, frame=0, z_mm=0.0)
    assert mixed.rejected["contradicted"] > 1000
    assert mixed.rejected[TWO_WALLS] > 0
    assert not len(mixed.ring) and mixed.pose is None


def test_bad_images_are_one_line(stereo: StereoReconstructor, images: Images) -> None:
    with pytest.raises(AnnulusError, match="camera 1's image is 100x50"):
        stereo.profile({0: images[0], 1: np.zeros((50, 100, 3), np.uint8)}, frame=3, z_mm=0.0)
    with pytest.raises(AnnulusError, match="is of camera 7, but the calibration has cameras 0, 1"):
        stereo.profile({7: images[0]}, frame=3, z_mm=0.0)
    with pytest.raises(AnnulusError, match="one camera, expected two"):
        StereoReconstructor(replace(head(), others=()))


def test_darkness_has_no_pose(stereo: StereoReconstructor, images: Images) -> None:
    dark = stereo.profile({n: np.zeros_like(image) for n, image in images.items()}, frame=0, z_mm=0.0)
    assert dark.pose is None
    assert not len(dark.ring)


def test_a_profile_says_which_camera_saw_a_point_also_on_the_wire(both: Profile) -> None:
    again = Profile.from_dict(both.to_dict())
    assert (again.seen_by == both.seen_by).all()
    assert (both.without(both.seen_by == 2, "tried").seen_by != 2).all()
