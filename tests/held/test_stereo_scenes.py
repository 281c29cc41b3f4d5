"""A traced head with two cameras, calibrated by its own scan of a tube, measures a damaged pipe."""

import csv
import importlib.util
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from annulus_pipe.calibrate.head import calibrate_head
from annulus_pipe.calibrate.pipe import PipeCalibration, save_pipe
from annulus_pipe.calibrate.pipe_picture import draw_pipe
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.reprocess.engine import reprocess
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.defects import Kind

SCENES = Path(__file__).resolve().parents[3] / "shared" / "scenes"
pytestmark = pytest.mark.skipif(not (SCENES / "stereo-a").is_dir(), reason="needs ../shared/scenes/stereo-a")


def scorer() -> Any:
    spec = importlib.util.spec_from_file_location("score_stereo", SCENES / "score_stereo.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> PipeCalibration:
    """From intrinsics and radius, beside a target that put the second camera where it is, give or take 0.01 mm."""
    tube, camera = SCENES / "stereo-calib-a", tmp_path_factory.mktemp("stereo") / "camera.json"
    true = json.loads((tube / "truth" / "calibration.json").read_text())["cameras"][1]
    target = {"camera": 1, **{key: true[key] for key in ("rotation", "translation_mm")}}
    target["covariance"] = np.diag([1e-6] * 3 + [1e-4] * 3).tolist()
    camera.write_text(json.dumps({**json.loads((tube / "camera.json").read_text()), "target_placement": target}))
    return calibrate_head(tube, camera, 76.2)


@pytest.fixture(scope="module")
def calibration(found: PipeCalibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("stereo") / "calibration.json"
    save_pipe(found, out)
    return out


def test_how_far_a_target_puts_the_second_camera_elsewhere_is_said_in_sigmas(found: PipeCalibration) -> None:
    (told,) = found.target
    assert told.camera == 1 and told.agrees and told.sigmas < 1.5
    assert told.moved_mm < 0.02 and told.turned_deg < 0.012
    assert found.to_dict()["target"][0]["sigmas"] == told.sigmas
    assert not any("the target has" in warning for warning in found.warnings)


def test_what_frames_held_out_say_is_drawn(found: PipeCalibration, tmp_path: Path) -> None:
    draw_pipe(found, tmp_path / "pipe.png")
    picture = np.asarray(cv2.imread(str(tmp_path / "pipe.png"))).astype(int)
    bars = picture[picture.shape[0] * 55 // 100 :, picture.shape[1] * 68 // 100 :]
    assert np.count_nonzero(np.ptp(bars, axis=2) > 40) > 0.05 * bars[..., 0].size  # coloured; an empty panel has none


def test_the_second_cameras_place_is_as_well_known_as_is_said(found: PipeCalibration) -> None:
    true = json.loads((SCENES / "stereo-calib-a" / "truth" / "calibration.json").read_text())["cameras"][1]
    off = found.solution.cameras[0].centre_mm + np.array(true["rotation"]).T @ true["translation_mm"]
    sigma = np.sqrt(np.diag(found.solution.camera_covariance))[3:]
    assert np.abs(off / sigma).max() < 3.0  # 1.6
    assert sigma.max() < 0.015  # 0.005


def test_the_head_is_known_from_intrinsics_and_the_tubes_radius(calibration: Path) -> None:
    found = scorer().score_calibration(str(calibration), str(SCENES / "stereo-calib-a" / "truth"))
    assert found["camera_1_turn_error_deg"] < 0.012
    assert max(map(abs, found["camera_1_place_error_mm"])) < 0.012  # 0.0073 measured, 0.005 asked
    assert max(map(abs, found["theta_full_error_deg"])) < 0.012
    assert max(abs(v) for vertex in found["vertex_error_mm"] for v in vertex) < 0.025
    assert found["radius_error_rms_mm"] < 0.012


def test_a_damaged_pipe_is_measured_all_round(calibration: Path, tmp_path: Path) -> None:
    done = reprocess(open_job(SCENES / "stereo-a", calibration))
    pipe = done.survey()
    write(pipe, ScanAccount("stereo-a", done.frames, done.drops, done.timing_ms), tmp_path)
    found = scorer().score_cloud(str(tmp_path / "cloud.ply"), str(SCENES / "stereo-a" / "truth"))
    assert found["rms_mm"] < 0.07
    assert found["rms_at_seams_mm"] < 0.08
    assert found["gross_over_1mm_percent"] < 0.02
    assert found["coverage"]["of_seen"] > 0.985
    assert found["seam_step_rms_mm"] < 0.05
    assert found["coverage"]["camera_0_only"] + found["coverage"]["camera_1_only"] > 2 * 0.95
    assert json.loads((tmp_path / "summary.json").read_text())["points"] > 70_000
    losses = sorted(d.depth_mm for d in pipe.defects if d.kind is Kind.LOSS)
    bumps = sorted(d.depth_mm for d in pipe.defects if d.kind is Kind.BUMP)
    assert losses[-3:] == pytest.approx([0.8, 2.5, 4.0], abs=0.15)
    assert bumps == pytest.approx([3.0, 4.0], abs=0.15)
    assert pipe.texture is not None
    assert (pipe.texture[..., 3] > 0).mean() > 0.9


def rewritten(scan: Path, out: Path, change: Callable[[list[dict[str, str]]], list[dict[str, str]]]) -> Path:
    """A copy of a scan with its table changed."""
    shutil.copytree(scan, out, ignore=shutil.ignore_patterns("truth"))
    with (scan / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    with (out / "frames.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(change(rows))
    return out


def test_a_tenth_of_one_cameras_frames_lost_costs_directions_and_no_wrong_point(
    calibration: Path, tmp_path: Path
) -> None:
    def drop(rows: list[dict[str, str]]) -> list[dict[str, str]]:
        second = [i for i, row in enumerate(rows) if row["camera"] == "1" and row["light"] == "projector"]
        lost = set(np.random.default_rng(10).choice(second, 2, replace=False).tolist())
        return [row for i, row in enumerate(rows) if i not in lost]

    done = reprocess(open_job(rewritten(SCENES / "stereo-a", tmp_path / "scan", drop), calibration))
    write(done.survey(), ScanAccount("drop", done.frames, done.drops, done.timing_ms), tmp_path / "out")
    found = scorer().score_cloud(str(tmp_path / "out" / "cloud.ply"), str(SCENES / "stereo-a" / "truth"))
    assert any("camera 1 has no frame" in finding.text for finding in done.findings)
    assert found["rms_mm"] < 0.08
    assert found["gross_over_1mm_percent"] < 0.03


def shifted(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    second = [row for row in rows if row["camera"] == "1" and row["light"] == "projector"]
    files = [row["file"] for row in second]
    for row, file in zip(second, files[1:] + files[:1], strict=True):
        row["file"] = file
    return rows


def test_frames_paired_with_their_neighbours_are_refused_in_one_line(calibration: Path, tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="not of one flash"):
        reprocess(open_job(rewritten(SCENES / "stereo-a", tmp_path / "scan", shifted), calibration))
    tube = SCENES / "stereo-calib-a"
    with pytest.raises(AnnulusError, match="of one flash"):
        calibrate_head(rewritten(tube, tmp_path / "tube", shifted), tube / "camera.json", 76.2)


def test_a_calibration_without_placements_is_refused_in_one_line() -> None:
    with pytest.raises(AnnulusError, match="rotation"):
        load_calibration(SCENES / "stereo-calib-a" / "camera.json")
