"""Promises of the recorder: up at once, it never writes into a file that nobody will find, and says so when it did."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.daemon import recorder
from annulus_pipe.daemon.recorder import RecorderJob
from annulus_pipe.daemon.rotation import Bounds
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.recording import open_recording
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import AnnulusError, Label

IMAGE = np.zeros((60, 80), np.uint8)


@pytest.fixture(autouse=True)
def always_looking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "LOOK_S", 0.0)


def frame(job: RecorderJob, index: int) -> str:
    header = FrameHeader(index, None, 0, Label.LED, "", None, None, None, 0.0, "mono8", 80, 60)
    return Path(job.frame(header, IMAGE, None)).name


def begin(folder: Path) -> RecorderJob:
    job = RecorderJob(folder, "scan", None, {})
    assert [(Path(one["path"]).name, one["gone"], one["problem"]) for one in job.idle()] == [("scan.mcap", False, "")]
    return job


def test_it_imports_neither_opencv_nor_scipy() -> None:
    code = "import sys, annulus_pipe.daemon.recorder; print(*{'cv2', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize("what", ["file", "folder", "replaced", "cut short"])
def test_a_file_that_is_gone_is_said_at_once_and_another_begun(tmp_path: Path, what: str) -> None:
    folder = tmp_path / "scans"
    job = begin(folder)
    assert [frame(job, n) for n in range(3)] == ["scan.mcap"] * 3
    if what == "folder":
        shutil.rmtree(folder)
    elif what == "cut short":
        os.truncate(folder / "scan.mcap", 100)
    else:
        (folder / "scan.mcap").unlink()
        if what == "replaced":
            (folder / "scan.mcap").write_bytes(b"somebody else's")
    where = frame(job, 3)
    assert where == ("scan.mcap" if what in ("file", "folder") else "scan-2.mcap")
    gone, begun = job.idle()
    assert gone["gone"] and "the frames in it are lost" in gone["problem"]
    assert not begun["gone"] and Path(begun["path"]).name == where
    job.close()
    assert [one.index for one in open_recording(folder / where).frames] == [3]


def test_without_a_place_to_go_on_it_says_so_once_and_goes_on_when_there_is(tmp_path: Path) -> None:
    folder = tmp_path / "scans"
    job = begin(folder)
    shutil.rmtree(folder)
    folder.write_text("in the way")
    assert [frame(job, n) for n in range(5)] == [""] * 5
    problems = [one["problem"] for one in job.idle() or []]
    assert len(problems) == 2 and "cannot be made" in problems[1] and "not recorded" in problems[1]
    folder.unlink()
    assert frame(job, 5) == "scan.mcap"
    assert [one["gone"] for one in job.close()] == [False]


def test_frames_that_come_faster_than_they_are_written_are_not_packed_until_there_is_a_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = RecorderJob(tmp_path, "scan", None, {})
    monkeypatch.setattr(recorder, "PAUSE_S", 0.0)
    for n in range(3):
        frame(job, n)
    monkeypatch.setattr(recorder, "PAUSE_S", 1e9)
    for n in range(3, 20):
        frame(job, n)
    monkeypatch.setattr(recorder, "PAUSE_S", 0.0)
    frame(job, 20)
    job.close()
    packed = [one.chunk is not None and one.chunk.size > 0 for one in open_recording(tmp_path / "scan.mcap").frames]
    assert packed == [True] * 11 + [False] * 9 + [True]  # eight cameras' frames may come at once


def test_all_parts_have_the_clock_of_the_scan(tmp_path: Path) -> None:
    clock = Clock(1_000, 1_800_000_000_000_000_000)
    job = RecorderJob(tmp_path, "scan", None, {}, Bounds(part_bytes=2000.0), clock=clock)
    for n in range(12):
        frame(job, n)
    job.close()
    recording = open_recording(tmp_path / "scan.mcap")
    assert len(recording.parts) > 2 and {part.utc_offset_ns for part in recording.parts} == {clock.offset_ns}
    assert [one.timestamp_ns for one in recording.frames] == [0] * 12


def test_a_file_that_is_gone_at_the_end_is_said_too(tmp_path: Path) -> None:
    job = begin(tmp_path)
    frame(job, 0)
    (tmp_path / "scan.mcap").unlink()
    assert [one["gone"] for one in job.close()] == [True]
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AnnulusError, match="cannot be made"):
        RecorderJob(tmp_path / "file", "scan", None, {})
