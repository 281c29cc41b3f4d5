from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest
from photographs import DrawnTarget, photograph, poses
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from annulus_pipe.calibrate.camera import CameraCalibration, calibrate_camera, image_files, parse_target, save_camera
from annulus_pipe.cli.calibrate import app
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.chessboard import find_target
from annulus_pipe.storage.calibration_file import load_camera, update_calibration
from annulus_pipe.vocabulary import AnnulusError

STEREO = Path(__file__).parents[2] / "data" / "opencv-stereo"
PINHOLE = Camera("pinhole", 480, 360, 400.0, 401.0, 245.0, 176.0, (-0.2, 0.05, 0.001, -0.0005, 0.0))
FISHEYE = Camera("fisheye", 480, 360, 152.0, 151.0, 242.0, 178.0, (0.02, -0.008, 0.001, 0.0))
PLAIN = DrawnTarget(8, 6)


@lru_cache(maxsize=4)
def album(camera: Camera, target: DrawnTarget, count: int = 7) -> tuple[np.ndarray, ...]:
    out = 0.9 if camera.model == "fisheye" else 0.6
    where = poses(camera, target, count, fill=0.6, off=out, seed=2)
    return tuple(photograph(camera, target, *pose, seed=i) for i, pose in enumerate(where))


@lru_cache(maxsize=2)
def calibrated(camera: Camera) -> CameraCalibration:
    with TemporaryDirectory() as folder:
        return calibrate_camera(write(Path(folder), album(camera, PLAIN)), model=camera.model)


def write(folder: Path, images: tuple[np.ndarray, ...]) -> list[Path]:
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / f"{i:02d}.png"), image)
    return image_files([folder])


@pytest.mark.deep(
    gate="tests/scenes/calibrate/test_camera.py::test_how_well_a_ray_is_known_is_said_where_targets_were_and_nowhere_else"
)
def test_real_photographs_calibrate_cold_and_none_is_thrown_away_to_look_good() -> None:
    result = calibrate_camera(sorted(STEREO.glob("left*.jpg"))[:6], model="pinhole")  # the bench takes all 13 pairs
    assert len(result.intrinsics.residuals) == 6
    assert result.intrinsics.rms_px < 0.19
    assert result.rms_everything_px == result.intrinsics.rms_px
    assert (result.target.columns, result.target.rows) == (9, 6)
    assert not result.target_was_given


@pytest.mark.deep(gate="tests/scenes/calibrate/test_camera.py::test_the_camera_joins_what_the_file_already_has")
@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_the_lens_is_measured_from_nothing_but_photographs(camera: Camera) -> None:
    result = calibrated(camera)
    fitted = result.camera
    assert (result.target.columns, result.target.rows) == (7, 5)
    assert result.intrinsics.rms_px < 0.08
    seen = np.concatenate(result.intrinsics.seen)
    # a turn of the whole camera is the poses' affair
    rays, truth_rays = fitted.rays(seen), camera.rays(seen)
    rays = Rotation.align_vectors(truth_rays, rays)[0].apply(rays)
    off = np.arccos(np.clip((rays * truth_rays).sum(axis=1), -1, 1)) * camera.fx
    assert np.sqrt(np.mean(off**2)) < 0.1
    sigma = np.sqrt(np.diag(result.intrinsics.covariance))
    truth = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    assert np.all(np.abs(truth - [fitted.fx, fitted.fy, fitted.cx, fitted.cy]) < 4 * sigma[:4])


@pytest.mark.deep(gate="tests/scenes/calibrate/test_camera.py::test_a_target_miscounted_by_its_owner_is_pointed_out")
def test_which_lens_it_is_is_found_out(tmp_path: Path) -> None:
    assert calibrate_camera(write(tmp_path, album(FISHEYE, PLAIN)[::2])).camera.model == "fisheye"


def test_markers_between_the_corners_do_not_move_them(tmp_path: Path) -> None:
    target = DrawnTarget(7, 5, markers="5X5")
    image = photograph(PINHOLE, target, *poses(PINHOLE, target, 3, fill=0.8, off=0.2)[1])
    view = find_target(image)
    assert view is not None and view.markers
    rotation, middle = poses(PINHOLE, target, 3, fill=0.8, off=0.2)[1]
    flat = np.stack(np.meshgrid(np.arange(1, 7), np.arange(1, 5)), axis=2).reshape(-1, 2) * target.square_mm
    truth = PINHOLE.project((np.c_[flat, 0 * flat[:, 0]] - target.middle_mm) @ rotation.T + middle)
    nearest = np.linalg.norm(view.pixels[:, None] - truth, axis=2).min(axis=1)
    assert len(view.pixels) >= 20
    assert np.sqrt(np.mean(nearest**2)) < 0.12


@pytest.mark.deep(gate="tests/scenes/calibrate/test_camera.py::test_a_target_miscounted_by_its_owner_is_pointed_out")
def test_a_bad_photograph_is_left_out_and_named(tmp_path: Path) -> None:
    images = list(album(PINHOLE, PLAIN))
    images[1] = cv2.GaussianBlur(images[1], (0, 0), 4.0)
    images[2] = np.full_like(images[2], 90)
    bent = np.indices(images[5].shape, np.float32)[::-1]
    bent[1] += 3 * np.sin(bent[0] / 40)
    images[5] = cv2.remap(images[5], bent[0], bent[1], cv2.INTER_LINEAR)
    files = write(tmp_path, tuple(images))
    (tmp_path / "07.png").write_bytes(files[0].read_bytes()[:5000])
    result = calibrate_camera(image_files([tmp_path]), model="pinhole")
    why = {p.file: p.rejected for p in result.photographs if p.rejected}
    assert why.keys() == {"01.png", "02.png", "05.png", "07.png"}
    assert "blurred" in why["01.png"]
    assert "no target" in why["02.png"]
    assert "does not fit the others" in why["05.png"]
    assert "truncated" in why["07.png"]
    assert result.intrinsics.rms_px < 0.08 < result.rms_everything_px


def test_the_camera_joins_what_the_file_already_has(tmp_path: Path) -> None:
    path = tmp_path / "head.json"
    update_calibration(path, {"pipe": {"radius_mm": 76.2}, "rings": []})
    result = calibrated(PINHOLE)
    assert save_camera(result, path)  # rings measured with another camera are pointed out
    assert load_camera(path) == result.camera
    assert '"radius_mm": 76.2' in path.read_text()
    assert '"rms_px"' in path.read_text()


def test_how_well_a_ray_is_known_is_said_where_targets_were_and_nowhere_else() -> None:
    result = calibrated(PINHOLE)
    middle, corner = result.intrinsics.ray_sigma_px(np.array([[240.0, 180.0], [0.0, 0.0]]))
    assert middle < 0.02 and np.isnan(corner)
    told = result.to_dict()["ray_sigma_px"]
    assert middle < told["median"] < told["worst"] < 0.6


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda a: a[:1], "expected at least 2"),
        (lambda a: tuple(np.full_like(i, 100) for i in a[:2]), "no chessboard in any"),
        (lambda a: (*a[:2], a[2][:300]), "different sizes"),
        (lambda a: tuple(np.pad(cv2.resize(i, (28, 21)), ((200, 139), (200, 252))) for i in a[:2]), "no chessboard"),
    ],
    ids=["one image", "no target", "two sizes", "too small"],
)
def test_bad_input_is_one_clear_line(make, said: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    files = write(tmp_path, make(album(PINHOLE, PLAIN)))
    with pytest.raises(AnnulusError, match=said) as caught:
        calibrate_camera(files)
    assert "\n" not in str(caught.value)


def test_what_is_no_photograph_is_said(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="no such file"):
        image_files([tmp_path / "nothing.jpg"])
    with pytest.raises(AnnulusError, match="no images in this folder"):
        image_files([tmp_path])
    (tmp_path / "a.jpg").write_text("not an image")
    (tmp_path / "b.jpg").write_text("nor this")
    with pytest.raises(AnnulusError, match="none of 2 files"):
        calibrate_camera(image_files([tmp_path]))
    with pytest.raises(AnnulusError, match="9x6"):
        parse_target("nine by six")
    with pytest.raises(AnnulusError, match="at least 3x3"):
        parse_target("2x9")
    assert parse_target("charuco 8x6") == (7, 5, True)


def test_a_target_miscounted_by_its_owner_is_pointed_out(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="show 7x5"):
        calibrate_camera(write(tmp_path, album(PINHOLE, PLAIN)), target="6x4")


@pytest.mark.deep(gate="tests/scenes/calibrate/test_camera.py::test_the_camera_joins_what_the_file_already_has")
def test_the_command_tells_a_program_all(tmp_path: Path) -> None:
    write(tmp_path, album(PINHOLE, PLAIN)[:3])
    out = tmp_path / "head.json"
    run = CliRunner().invoke(
        app, ["camera", str(tmp_path), "--model", "pinhole", "--json", "-o", str(out)], catch_exceptions=False
    )
    assert run.exit_code == 0
    assert '"kept": 3' in run.stdout
    assert (tmp_path / "head.camera.png").stat().st_size > 10_000
