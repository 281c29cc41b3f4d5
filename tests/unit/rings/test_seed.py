"""A frame's profile is its own: what came before it may save time, and changes nothing that a sigma would notice."""

import math
from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.mosaic import Mosaic
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.vocabulary import AnnulusError
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


@pytest.mark.parametrize("seed", [Pose(math.nan), Pose(ty=math.inf)])
def test_a_seed_that_is_not_finite_is_none(reconstructor, images, seed) -> None:
    without = content(reconstructor.profile(images[0], frame=0, z_mm=0.0))
    assert content(reconstructor.profile(images[0], frame=0, z_mm=0.0, seed=seed)) == without


@pytest.mark.parametrize("z_mm", [math.nan, -math.inf])
def test_a_station_that_is_not_finite_is_refused(reconstructor, images, z_mm) -> None:
    with pytest.raises(AnnulusError, match=r"frame 7: its station is (nan|-inf) mm, expected a finite number"):
        reconstructor.profile(images[0], frame=7, z_mm=z_mm)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (lambda image: image.astype(float), "832x616, 3 of float64"),
        (lambda image: image[..., 0], "832x616, 1 of uint8"),
        (lambda image: image[:-1], "832x615, 3 of uint8"),
        (lambda image: Mosaic(image[..., 0].astype(np.uint16), "rggb"), "832x616, 3 of uint16"),
    ],
)
def test_a_picture_of_another_kind_is_refused_by_its_kind(reconstructor, images, kind, words) -> None:
    with pytest.raises(AnnulusError, match=f"image is {words}, but the calibration's camera is 832x616, 3 of uint8"):
        reconstructor.profile(kind(images[0]), frame=0, z_mm=0.0)
