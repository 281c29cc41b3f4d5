"""Promises of the engine on input that is wrong: one clear line, whatever the executor."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from synthetic_pipe import CALIBRATION

from annulus_pipe.cli import main
from annulus_pipe.reprocess.engine import Reprocessed, reprocess
from annulus_pipe.reprocess.executors import Processes, in_process
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.reprocess.method import method_for
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.vocabulary import AnnulusError

FRAMES = 20


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A scan of black frames: right in form, nothing to see."""
    folder = tmp_path / "scan"
    folder.mkdir()
    camera = CALIBRATION.camera
    lines = ["index,file,light,z_mm"]
    for i in range(FRAMES):
        cv2.imwrite(str(folder / f"{i}.jpg"), np.zeros((camera.height, camera.width, 3), np.uint8))
        lines.append(f"{i},{i}.jpg,{'led' if i % 5 == 4 else 'projector'},{2.0 * i}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    save_calibration(tmp_path / "calibration.json", CALIBRATION)
    return folder


def run(scan: Path, calibration: Path | None = None, executor=in_process) -> Reprocessed:
    return reprocess(open_job(scan, calibration or scan.parent / "calibration.json"), executor)


def said(scan: Path, calibration: Path | None = None, executor=in_process) -> str:
    with pytest.raises(AnnulusError) as error:
        run(scan, calibration, executor)
    text = str(error.value)
    assert "\n" not in text
    return text


def test_a_scan_of_darkness_is_one_clear_line(scan: Path) -> None:
    text = said(scan)
    assert "all dark" in text and "lens cap" in text


def test_a_calibration_for_another_camera_is_one_clear_line(scan: Path) -> None:
    cv2.imwrite(str(scan / "0.jpg"), np.zeros((480, 640, 3), np.uint8))
    text = said(scan)
    assert "416x308" in text and "640x480" in text and "0.jpg" in text


def test_a_frame_of_another_size_anywhere_is_named(scan: Path) -> None:
    cv2.imwrite(str(scan / "13.jpg"), np.zeros((480, 640, 3), np.uint8))
    assert "13.jpg" in said(scan)


@pytest.mark.deep(gate="tests/unit/reprocess/test_job.py::test_a_frame_of_another_size_anywhere_is_named")
def test_a_truncated_frame_is_named_even_from_a_worker_process(scan: Path) -> None:
    data = (scan / "17.jpg").read_bytes()
    (scan / "17.jpg").write_bytes(data[: len(data) // 2])
    text = said(scan, executor=Processes(2))
    assert "17.jpg" in text and "truncated" in text


def test_a_folder_without_calibration_asks_for_one(scan: Path) -> None:
    with pytest.raises(AnnulusError, match="carries no calibration"):
        open_job(scan)


def test_nothing_is_computed_when_the_output_is_a_file(
    scan: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, calibration = scan.parent / "out", scan.parent / "calibration.json"
    out.write_text("mine")
    monkeypatch.setattr(
        "annulus_pipe.reprocess.whole.surveyed", lambda *_: pytest.fail("worked before looking at the output")
    )
    monkeypatch.setattr(
        "sys.argv", ["annulus", "reconstruct", str(scan), "--calibration", str(calibration), "-o", str(out)]
    )
    with pytest.raises(SystemExit):
        main()
    assert "is a file" in capsys.readouterr().err and out.read_text() == "mine"


def test_a_missing_calibration_is_named(scan: Path) -> None:
    assert "nowhere.json" in said(scan, calibration=scan.parent / "nowhere.json")


def test_a_scan_without_projector_frames_is_one_clear_line(scan: Path) -> None:
    table = scan / "frames.csv"
    table.write_text(table.read_text().replace("projector", "unknown"))
    assert "none of its 20 frames is labelled projector" in said(scan)


@pytest.mark.parametrize("kind", ["lines", "fringe"])
def test_a_head_that_no_method_knows_is_one_clear_line(kind: str) -> None:
    with pytest.raises(AnnulusError, match=f"the head projects {kind}"):
        method_for(replace(CALIBRATION, pattern={"kind": kind}))
