from pathlib import Path

import numpy as np
import pytest
from photographs import DrawnTarget
from ringed_targets import COLOURS, cones, write_scan

from annulus_pipe.calibrate.target import calibrate_target, save_target
from annulus_pipe.geometry.calibration import camera_to_dict
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.vocabulary import AnnulusError

CAMERA = Camera("pinhole", 624, 462, 176.0, 176.0, 314.0, 229.0)
TARGET = DrawnTarget(8, 6, 40.0)
THREE = cones((37.9, 47.5, 57.7))
STRIPES = "RGBR"


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("targets")
    write_scan(folder, CAMERA, TARGET, THREE, 6, STRIPES)
    return folder


def test_rings_are_measured_on_targets_and_the_file_reconstructs(scan: Path, tmp_path: Path) -> None:
    result = calibrate_target(scan, CAMERA, STRIPES, TARGET.square_mm)
    assert result.rms_mm < 0.05
    for fitted, true in zip(result.cones, THREE, strict=True):
        assert abs(np.degrees(2 * (fitted.half_angle - true.half_angle))) < 0.04
        assert np.linalg.norm(np.subtract(fitted.vertex_mm, true.vertex_mm)) < 0.3
    assert all(not pair.rejected for pair in result.pairs)
    save_target(result, camera_to_dict(CAMERA), 76.2, tmp_path / "c.json")
    again = load_calibration(tmp_path / "c.json")
    for read, cone in zip(again.rings, result.cones, strict=True):
        assert (read.half_angle, *read.axis, *read.vertex_mm) == pytest.approx(
            (cone.half_angle, *cone.axis, *cone.vertex_mm)
        )
    assert again.covariance is not None
    assert np.linalg.eigvalsh(np.array(again.covariance)).min() > -1e-12


@pytest.mark.deep(
    gate="tests/scenes/calibrate/test_target.py::test_rings_are_measured_on_targets_and_the_file_reconstructs"
)
def test_a_target_that_moved_between_its_two_frames_is_left_out(scan: Path, tmp_path: Path) -> None:
    for file in scan.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "00-led.png").write_bytes((scan / "03-led.png").read_bytes())
    result = calibrate_target(tmp_path, CAMERA, STRIPES, TARGET.square_mm)
    assert "moved" in result.pairs[0].rejected
    assert result.rms_mm < 0.05


def test_what_is_missing_is_said(scan: Path, tmp_path: Path) -> None:
    table = (scan / "frames.csv").read_text().splitlines()
    for file in scan.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "frames.csv").write_text("\n".join(line for line in table if "led" not in line))
    with pytest.raises(AnnulusError, match="0 pairs of a led and a projector frame"):
        calibrate_target(tmp_path, CAMERA, STRIPES, TARGET.square_mm)
    with pytest.raises(AnnulusError, match="the camera's file says 640x480"):
        calibrate_target(scan, Camera("pinhole", 640, 480, 200.0, 200.0, 320.0, 240.0), COLOURS, TARGET.square_mm)
