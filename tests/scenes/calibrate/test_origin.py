"""Which corner of the target a corner is: on drawn targets, by where it truly is."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from photographs import DrawnTarget, photograph, poses
from scipy.spatial.transform import Rotation

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.chessboard import TargetView, cropped, find_target
from annulus_pipe.geometry.origin import from_colours, from_markers, read_markers

CAMERA = Camera("pinhole", 640, 480, 530.0, 531.0, 325.0, 236.0, (-0.2, 0.05, 0.001, -0.0005, 0.0))


def pose(target: DrawnTarget, seed: int, spin_deg: float, aside: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    rotation, middle = poses(CAMERA, target, 3, fill=0.75, off=0.1, seed=seed)[1]
    spun = rotation @ Rotation.from_rotvec([0, 0, np.radians(spin_deg)]).as_matrix()
    return spun, middle + spun @ [aside * target.columns * target.square_mm, 0.0, 0.0]


def place_off_px(view: TargetView, target: DrawnTarget, at: tuple[np.ndarray, np.ndarray]) -> float:
    """The farthest corner from where the corner of its number truly is."""
    flat = (view.cells + 1) * target.square_mm
    truth = CAMERA.project((np.c_[flat, 0 * flat[:, 0]] - target.middle_mm) @ at[0].T + at[1])
    return float(np.linalg.norm(view.pixels - truth, axis=1).max())


@pytest.mark.parametrize("spin_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_chessboard_that_has_a_first_corner_is_numbered_from_it_however_it_is_held(spin_deg: float) -> None:
    target = DrawnTarget(8, 5)  # 7x4 corners
    at = pose(target, 1, spin_deg)
    view = find_target(photograph(CAMERA, target, *at))
    assert view is not None
    view = from_colours(cropped(view, 7, 4), 7, 4)
    assert view.own_origin
    assert place_off_px(view, target, at) < 1.0


def test_no_first_corner_is_made_up() -> None:
    target = DrawnTarget(8, 6)  # 7x5 corners: turned by half a turn, the same
    view = find_target(photograph(CAMERA, target, *pose(target, 1, 0.0)))
    assert view is not None and view.size == (7, 5)
    assert not from_colours(view, 7, 5).own_origin
    target = DrawnTarget(8, 5)
    image = photograph(CAMERA, target, *pose(target, 1, 0.0))
    image[:, :320] = 90  # half of it hidden
    view = find_target(image)
    assert view is not None and view.size != (7, 4)
    assert not from_colours(view, 7, 4).own_origin


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("spin_deg", "aside"), [(0.0, 0.0), (90.0, 0.0), (200.0, 0.3), (20.0, -0.4)])
def test_markers_number_the_corners_of_a_target_seen_in_part(spin_deg: float, aside: float) -> None:
    target = DrawnTarget(8, 6, markers="6X6")
    at = pose(target, 1, spin_deg, aside)
    image = photograph(CAMERA, target, *at, blur_px=0.6)
    view = find_target(image)
    assert view is not None
    assert (len(view.cells) < 35) == (aside != 0)
    (view,) = from_markers([view], [read_markers(cv2.merge([image] * 3), "6X6")], 7, 5)
    assert view.own_origin
    assert place_off_px(view, target, at) < 1.0


def test_markers_of_another_target_number_nothing() -> None:
    target = DrawnTarget(8, 6, markers="6X6")
    image = photograph(CAMERA, target, *pose(target, 1, 0.0), blur_px=0.6)
    view = find_target(image)
    assert view is not None
    markers = read_markers(cv2.merge([image] * 3), "6X6")
    shuffled = replace(markers, numbers=np.random.default_rng(0).permutation(markers.numbers))
    (view,) = from_markers([view], [shuffled], 7, 5)
    assert not view.own_origin
