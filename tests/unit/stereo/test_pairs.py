"""Two-camera scans: frames of one index are of one flash, or one line says what is wrong; a lost frame is told."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_head import RADIUS_MM, draw, head

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.reprocess.engine import reprocess
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.storage.calibration_file import load_calibration, save_calibration
from annulus_pipe.vocabulary import AnnulusError

POSES = [Pose(0.01, 0.0, -8.0, -7.0), Pose(0.0, -0.02, -9.0, -8.0)]
FLASHES = 6


@pytest.fixture(scope="module")
def drawn() -> list[dict[int, np.ndarray]]:
    calibration = head()
    return [{one.id: draw(calibration, one, pose) for one in calibration.cameras} for pose in POSES]


def write(folder: Path, drawn: list[dict[int, np.ndarray]], lost: set[tuple[int, int]] = frozenset()) -> Path:
    """Projector flashes, and an LED one; without the frames (index, camera) that are lost."""
    folder.mkdir()
    rows = ["index,camera,file,light,z_mm"]
    for index in range(FLASHES):
        for camera, image in drawn[index % 2].items():
            if (index, camera) in lost:
                continue
            cv2.imwrite(str(folder / f"{index}-{camera}.png"), image)
            rows.append(f"{index},{camera},{index}-{camera}.png,projector,{4.0 * index}")
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    save_calibration(folder.parent / "calibration.json", head())
    return folder


def said(scan: Path) -> str:
    with pytest.raises(AnnulusError) as error:
        reprocess(open_job(scan, scan.parent / "calibration.json"))
    assert "\n" not in str(error.value)
    return str(error.value)


def edit(scan: Path, old: str, new: str) -> None:
    table = scan / "frames.csv"
    text = table.read_text()
    assert old in text
    table.write_text(text.replace(old, new))


@pytest.mark.deep(gate="tests/unit/stereo/test_pairs.py::test_a_pair_of_two_flashes_is_refused")
def test_a_flash_is_measured_once_by_both(tmp_path: Path, drawn: list[dict[int, np.ndarray]]) -> None:
    done = reprocess(open_job(write(tmp_path / "scan", drawn), tmp_path / "calibration.json"))
    assert [p.frame for p in done.profiles] == list(range(FLASHES))
    assert not done.findings
    for profile in done.profiles:
        assert {0, 1, 2} == set(profile.seen_by.tolist())


@pytest.mark.deep(gate="tests/unit/stereo/test_pairs.py::test_cameras_exchanged_are_told")
def test_frames_lost_at_random_cost_no_wrong_point_and_are_told(
    tmp_path: Path, drawn: list[dict[int, np.ndarray]]
) -> None:
    lost = {(1, 0), (4, 1), (5, 1)}
    done = reprocess(open_job(write(tmp_path / "scan", drawn, lost), tmp_path / "calibration.json"))
    assert len(done.profiles) == FLASHES
    told = {f.text for f in done.findings if f.kind == "camera-missing"}
    assert told == {
        "camera 0 has no frame of 1 of 6 flashes: measured without it (1)",
        "camera 1 has no frame of 2 of 6 flashes: measured without it (4, 5)",
    }
    for profile in done.profiles:
        missing = {camera for index, camera in lost if index == profile.frame}
        assert profile.rejected.get("camera missing", 0) == len(missing)
        assert not missing & set(profile.seen_by.tolist())
        error = np.hypot(*profile.points_mm[:, :2].T.astype(float)) - RADIUS_MM
        assert (np.abs(error) > 6 * profile.sigma_mm).mean() < 0.002


def test_a_pair_of_two_flashes_is_refused(tmp_path: Path, drawn: list[dict[int, np.ndarray]]) -> None:
    scan = write(tmp_path / "scan", drawn)
    edit(scan, "3,1,3-1.png,projector,12.0", "3,1,3-1.png,projector,16.0")
    assert "index 3: camera 0's frame is projector at 12 mm, camera 1's projector at 16 mm" in said(scan)
    edit(scan, "3,1,3-1.png,projector,16.0", "3,1,3-1.png,led,12.0")
    assert "camera 1's led at 12 mm, expected one flash" in said(scan)


def test_a_calibration_of_one_camera_is_refused(tmp_path: Path, drawn: list[dict[int, np.ndarray]]) -> None:
    scan, whole = write(tmp_path / "scan", drawn), head()
    save_calibration(
        tmp_path / "calibration.json", Calibration(whole.camera, whole.colours, whole.rings, whole.pipe_radius_mm)
    )
    assert "has frames of cameras 0, 1, expected one camera" in said(scan)


def test_a_camera_that_the_head_has_not_is_refused(tmp_path: Path, drawn: list[dict[int, np.ndarray]]) -> None:
    scan = write(tmp_path / "scan", drawn)
    edit(scan, ",1,", ",5,")
    assert "has frames of camera 5, but the calibration's cameras are 0, 1" in said(scan)


def test_images_of_another_size_are_refused(tmp_path: Path, drawn: list[dict[int, np.ndarray]]) -> None:
    scan = write(tmp_path / "scan", drawn)
    cv2.imwrite(str(scan / "2-1.png"), np.zeros((400, 600, 3), np.uint8))
    assert "2-1.png is 600x400. Calibrate with the camera that took this scan" in said(scan)


def test_cameras_exchanged_are_told(tmp_path: Path, drawn: list[dict[int, np.ndarray]]) -> None:
    scan = write(tmp_path / "scan", [{0: both[1], 1: both[0]} for both in drawn])
    try:
        told = " ".join(f.text for f in reprocess(open_job(scan, tmp_path / "calibration.json")).findings)
    except AnnulusError as error:
        told = str(error)
    assert "the cameras look exchanged" in told


def test_the_colours_shifts_are_kept_with_the_cameras(tmp_path: Path) -> None:
    data = head().to_dict()
    data["cameras"][1]["colour_shift_px"] = [[0.03, 0.03, 0.01, 0.0], [0, 0, 0, 0], [-0.04, -0.04, 0, 0]]
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(data))
    known = load_calibration(path)
    assert known.others[0].camera.colour_shift_px[2] == (-0.04, -0.04, 0.0, 0.0)
    assert Calibration.from_dict(known.to_dict()) == known
    data["cameras"][1]["colour_shift_px"] = [[0.03, 0.03]]
    path.write_text(json.dumps(data))
    with pytest.raises(AnnulusError, match="colour_shift_px"):
        load_calibration(path)
