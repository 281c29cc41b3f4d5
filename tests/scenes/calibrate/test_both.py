"""A target before both cameras of a head says where the second stands."""

import json
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from photographs import DrawnTarget, corners, photograph, poses, read
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from annulus_pipe.calibrate.both import TargetPlacement, disagreement, pair_files, placement_from_dict
from annulus_pipe.cli.calibrate import app
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.chessboard import cropped, find_target
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.intrinsics import Intrinsics, TargetObservation, fit_intrinsics
from annulus_pipe.geometry.origin import from_colours
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.geometry.seen_by_both import Moment, PlacedCamera, place_second
from annulus_pipe.rings.calibration.bundle import Solution
from annulus_pipe.rings.calibration.observations import Placement
from annulus_pipe.scans.scan import read_image
from annulus_pipe.storage.calibration_file import load_sections, update_calibration
from annulus_pipe.vocabulary import AnnulusError

STEREO = Path(__file__).parents[2] / "data" / "opencv-stereo"
FIRST = Camera("fisheye", 480, 360, 152.0, 151.0, 242.0, 178.0, (0.02, -0.008, 0.001, 0.0))
SECOND = Camera("fisheye", 480, 360, 154.0, 153.0, 238.0, 181.0, (0.018, -0.007, 0.001, 0.0))
TURN = Rotation.from_euler("zyx", (-88.2, 0.9, -0.4), degrees=True).as_matrix()  # x = TURN x_own + CENTRE
CENTRE = np.array([-16.2, -15.2, 1.4])
TARGET = DrawnTarget(7, 6)  # 6x5 corners: its own first one is told
COUNT = 12


def from_second(rotation: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return TURN.T @ rotation, TURN.T @ (shift - CENTRE)


@lru_cache(maxsize=8)
def fitted(seed: int, noise_px: float = 0.05) -> tuple[Intrinsics, Intrinsics]:
    """Both cameras from corners, read with errors, of targets that both see; a few more that one of them sees."""
    rng = np.random.default_rng(seed)
    flat = np.stack(np.meshgrid(np.arange(1, 7), np.arange(1, 6)), axis=2).reshape(-1, 2) * 25.0
    own: tuple[list[TargetObservation], list[TargetObservation]] = ([], [])
    for rotation, middle in poses(FIRST, TARGET, COUNT, fill=0.5, off=0.45, seed=seed):
        there = from_second(rotation, middle)
        for views, camera, (turn, shift) in ((own[0], FIRST, (rotation, middle)), (own[1], SECOND, there)):
            at = camera.project((np.c_[flat, 0 * flat[:, 0]] - TARGET.middle_mm) @ turn.T + shift)
            views.append(read(TargetObservation(flat - 25.0, at), rng, noise_px, 0.5 * noise_px))
    for views, camera in zip(own, (FIRST, SECOND), strict=True):
        views += [read(one, rng, noise_px, 0.5 * noise_px) for one in corners(camera, 4, seed + 5, target=TARGET)]
    fits = [fit_intrinsics(v, 480, 360, "fisheye", camera) for v, camera in zip(own, (FIRST, SECOND), strict=True)]
    return fits[0], fits[1]


def off(placed: PlacedCamera) -> np.ndarray:
    """(6,) turn in rad, centre in mm."""
    return np.concatenate([Rotation.from_matrix(placed.rotation @ TURN.T).as_rotvec(), placed.centre_mm - CENTRE])


@pytest.mark.deep(
    gate="tests/scenes/calibrate/test_both.py::test_it_makes_no_difference_from_which_corner_a_target_is_counted"
)
def test_the_second_camera_is_found_as_well_as_it_says() -> None:
    found = [place_second(*fitted(seed), [Moment(i, i, True) for i in range(COUNT)]) for seed in range(5)]
    assert all(np.linalg.norm(off(one)[3:]) < 0.3 and np.degrees(np.linalg.norm(off(one)[:3])) < 0.15 for one in found)
    sigmas = np.array([off(one) / np.sqrt(np.diag(one.covariance)) for one in found])
    assert np.mean(np.abs(sigmas) < 2) > 0.85
    assert np.median(np.abs(sigmas)) > 0.2  # nor are they so large that they say nothing
    exact = place_second(*fitted(9, 0.0), [Moment(i, i, True) for i in range(COUNT)])
    assert np.abs(off(exact)).max() < 1e-6


def test_it_makes_no_difference_from_which_corner_a_target_is_counted() -> None:
    first, second = fitted(1)
    plain = place_second(first, second, [Moment(i, i, True) for i in range(COUNT)])
    turned = place_second(first, other_way_round(second), [Moment(i, i, False) for i in range(COUNT)])
    assert np.abs(turned.rotation - plain.rotation).max() < 1e-9
    assert np.abs(turned.centre_mm - plain.centre_mm).max() < 1e-6


def other_way_round(fit: Intrinsics) -> Intrinsics:
    """Every second target counted from its last corner."""
    views = [
        TargetObservation([125.0, 100.0] - v.target_mm if i % 2 else v.target_mm, v.pixels)
        for i, v in enumerate(fit.views)
    ]
    return fit_intrinsics(views, 480, 360, "fisheye", fit.camera)


def test_photographs_of_different_moments_are_left_out_or_refused() -> None:
    swapped = [0, 1, 3, 2, *range(4, COUNT)]
    placed = place_second(*fitted(2), [Moment(i, j, True) for i, j in enumerate(swapped)])
    assert [i for i, used in enumerate(placed.used) if not used] == [2, 3]
    assert np.linalg.norm(off(placed)[3:]) < 0.5
    with pytest.raises(AnnulusError, match="same moments, in the same order"):
        place_second(*fitted(2), [Moment(i, (i + 1) % COUNT, True) for i in range(COUNT)])
    with pytest.raises(AnnulusError, match="2 moments"):
        place_second(*fitted(2), [Moment(0, 0, True), Moment(1, 1, True)])


@pytest.mark.deep(
    gate="tests/scenes/calibrate/test_both.py::test_it_makes_no_difference_from_which_corner_a_target_is_counted"
)
def test_real_pairs_give_what_opencv_finds() -> None:
    """Same corners, same lenses; which way each target is counted is not told."""
    start = Camera("pinhole", 640, 480, 535.0, 535.0, 335.0, 240.0, (-0.28, 0.0, 0.0, 0.0, 0.0))
    files = [sorted(STEREO.glob(f"{name}0[1-6].jpg")) for name in ("left", "right")]
    found = [[view for file in each if (view := find_target(read_image(file)))] for each in files]
    views = [
        [TargetObservation(25.0 * v.cells, v.pixels) for v in (from_colours(cropped(v, 9, 6), 9, 6) for v in one)]
        for one in found
    ]
    left, right = (fit_intrinsics(each, 640, 480, "pinhole", start) for each in views)
    placed = place_second(left, right, [Moment(i, i, False) for i in range(6)])
    target = [np.c_[v.target_mm, 0 * v.target_mm[:, 0]].astype(np.float32) for v in left.views]
    order = [
        np.lexsort(b.target_mm.T)[np.argsort(np.lexsort(a.target_mm.T))]
        for a, b in zip(left.views, right.views, strict=True)
    ]
    pixels = [v.pixels.astype(np.float32) for v in left.views]
    others = [v.pixels[i].astype(np.float32) for v, i in zip(right.views, order, strict=True)]
    lenses = [
        (np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]]), np.array(c.distortion))
        for c in (left.camera, right.camera)
    ]
    *_, turn, shift, _, _ = cv2.stereoCalibrate(
        target, pixels, others, *lenses[0], *lenses[1], (640, 480), flags=cv2.CALIB_FIX_INTRINSIC
    )
    assert np.abs(placed.rotation.T - turn).max() < 1e-5
    assert np.abs(placed.centre_mm + (turn.T @ shift)[:, 0]).max() < 1e-3


@pytest.mark.deep(
    gate="tests/scenes/calibrate/test_both.py::test_how_the_rings_agree_with_the_target_is_said_in_sigmas"
)
def test_both_folders_become_one_file_with_both_cameras(tmp_path: Path) -> None:
    for i, (rotation, middle) in enumerate(poses(FIRST, TARGET, 4, fill=0.6, off=0.3, seed=4)):
        for name, camera, pose in (("a", FIRST, (rotation, middle)), ("b", SECOND, from_second(rotation, middle))):
            (tmp_path / name).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), photograph(camera, TARGET, *pose, seed=i))
    file = tmp_path / "head.json"
    update_calibration(file, {"pattern": {"kind": "slits", "colours": "RGB"}})
    folders = [str(tmp_path / "a"), "--second", str(tmp_path / "b")]
    told = CliRunner().invoke(app, ["camera", *folders, "--model", "fisheye", "-o", str(file), "--json"])
    assert told.exit_code == 0, told.output
    said = json.loads(told.stdout)
    assert [one["used"] for one in said["moments"]] == [True] * 4
    assert np.abs(np.array(said["centre_mm"]) - CENTRE).max() < max(3 * max(said["centre_sigma_mm"]), 0.5)
    written = load_sections(file)
    assert written["format"] == "annulus-calibration/2" and written["pattern"]["colours"] == "RGB"
    assert len(written["cameras"]) == 2
    target = placement_from_dict(written)
    assert target is not None and target.camera == 1
    assert np.allclose(target.centre_mm, said["centre_mm"], atol=1e-9)


def test_photographs_are_paired_by_name_or_else_by_order(tmp_path: Path) -> None:
    def files(*names: str) -> list[Path]:
        return [tmp_path / name for name in names]

    assert pair_files(files("l/1.png", "l/2.png", "l/4.png"), files("r/2.png", "r/4.png")) == [(1, 0), (2, 1)]
    assert pair_files(files("l/left1.png", "l/left2.png"), files("r/right1.png", "r/right2.png")) == [(0, 0), (1, 1)]
    with pytest.raises(AnnulusError, match="2 photographs by the first camera and 1 by the second"):
        pair_files(files("l/a.png", "l/b.png"), files("r/c.png"))
    with pytest.raises(AnnulusError, match="the same photographs"):
        pair_files(files("l/a.png"), files("l/a.png"))


def test_how_the_rings_agree_with_the_target_is_said_in_sigmas() -> None:
    placed = place_second(*fitted(1), [Moment(i, i, True) for i in range(COUNT)])
    target = TargetPlacement(1, placed.rotation, placed.centre_mm, placed.covariance)

    def rings(turn_deg: float, moved_mm: float) -> Solution:
        turn = Rotation.from_rotvec([np.radians(turn_deg), 0, 0]).as_matrix() @ placed.rotation
        where = Placement(turn, placed.centre_mm + np.array([0.0, moved_mm, 0.0]))
        cones, stands = (Cone(0.5, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),), (Pose(0, 0, 0, 0),)
        none, cover = np.zeros(0), 1e-12 * np.eye(6)
        return Solution(cones, stands, 76.2, *[none] * 8, 1.0, (0.0, 1.0), (), (where,), cover)

    same = disagreement(target, 1, 0, rings(0.0, 0.0))
    assert same is not None and same.sigmas < 1e-6
    moved = disagreement(target, 1, 0, rings(0.0, 0.4))
    assert moved is not None and moved.moved_mm == pytest.approx(0.4)
    assert moved.sigmas == pytest.approx(0.4 / np.sqrt(placed.covariance[4, 4]), rel=1e-3)
    turned = disagreement(target, 1, 0, rings(0.5, 0.0))
    assert turned is not None and turned.turned_deg == pytest.approx(0.5)
    assert turned.sigmas == pytest.approx(np.radians(0.5) / np.sqrt(placed.covariance[0, 0]), rel=1e-3)
    assert disagreement(target, 2, 0, rings(0.0, 0.0)) is None


def test_where_a_target_put_the_second_camera_is_read_again_and_what_is_no_place_is_refused() -> None:
    turn, moved = Rotation.from_rotvec([0.0, 0.3, 0.1]).as_matrix(), np.array([62.0, 0.5, -1.0])
    cover = np.diag([1e-8, 1e-8, 1e-8, 1e-4, 1e-4, 1e-4])
    good = {"camera": 1, "rotation": turn.tolist(), "translation_mm": moved.tolist(), "covariance": cover.tolist()}
    placed = placement_from_dict({"target_placement": good})
    assert placed is not None and placed.camera == 1
    np.testing.assert_allclose(turn @ placed.centre_mm + moved, 0.0, atol=1e-12)
    np.testing.assert_array_equal(placed.covariance, cover)
    skew = cover + 1e-6 * np.eye(6, k=1)
    wrong = {"rotation": [2 * turn, -turn, turn[:2]], "covariance": [skew, 0 * cover, -cover], "camera": [256]}
    for key, values in wrong.items():
        for value in values:
            with pytest.raises(ValueError, match=f"target_placement.{key}"):
                placement_from_dict({"target_placement": good | {key: np.asarray(value).tolist()}})
    assert placement_from_dict({}) is None
