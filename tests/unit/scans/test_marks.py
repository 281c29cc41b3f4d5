"""What an operator marked comes back as it was said, whatever else lies there; a picture is decoded in bounds."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from annulus_pipe.record.parts import Part
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.scans.identity import identity
from annulus_pipe.scans.marks import MARKS_MAX, SHOWN_PX, observations_of, read_marks
from annulus_pipe.scans.scan import open_scan

H, W = 48, 64
NOTHING = {"host_ns": 1, "z_mm": 5.0, "text": "a", "clock_deg": None}


def jpeg(height: int = 40, width: int = 30, level: int = 200) -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((height, width, 3), level, np.uint8))[1])


def write(path: Path, marks: list[Any], first: int = 0, part: Part | None = None) -> Path:
    """Four frames 10 mm apart, the last under LED, then the marks."""
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=5, part=part) as writer:
        for index in range(first, first + 4):
            label = {
                "index": index,
                "label": "led" if index == first + 3 else "projector",
                "z_mm": 10.0 * index,
                "encoding": "bayer_rggb8",
                "width": W,
                "height": H,
            }
            writer.frame(label, np.tile(np.arange(W, dtype=np.uint8), (H, 1)), 1000 * index)
        for at, mark in enumerate(marks):
            writer.note("/mark", mark if isinstance(mark, dict) else {"value": mark, "z_mm": "here"}, 5000 + at)
    return path


def picture(data: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


def test_marks_come_back_by_distance_with_their_pictures(tmp_path: Path) -> None:
    photo = jpeg(900, 1200)
    marks = [
        {"host_ns": 1, "z_mm": 25.0, "text": "root\n\x1b[31m", "clock_deg": 370.0 - 360.0, "frame": 3, "camera": 0},
        {"host_ns": 2, "z_mm": 12.5, "text": "joint", "clock_deg": -90.0, "photo": photo, "frame": 3, "camera": 0},
        {"host_ns": 3, "z_mm": None, "text": "too early", "clock_deg": None, "frame": None, "camera": None},
        {"host_ns": 4, "z_mm": None, "text": "at its frame", "clock_deg": None, "frame": 3},
    ]
    path = write(tmp_path / "a.mcap", marks)
    found, left_out = observations_of(open_scan(path))
    assert left_out == 0 and [one.text for one in found] == ["joint", "root \\x1b[31m", "at its frame", "too early"]
    assert [one.clock_deg for one in found] == [270.0, 10.0, None, None]
    assert [one.z_mm for one in found[:3]] == [12.5, 25.0, 30.0] and math.isnan(found[3].z_mm)
    assert [(one.shows, one.frame) for one in found] == [("photo", None), ("frame", 3), ("frame", 3), ("", None)]
    assert picture(found[0].picture).shape == (360, SHOWN_PX, 3) and found[0].picture not in photo
    led = picture(found[1].picture)
    assert led.shape == (H, W, 3) and led.min() < 20 and led.max() > 235  # stretched
    assert found[0].utc.startswith("20") and len(found[0].utc) == 25
    assert (identity(path)["marks"], identity(path)["marks_unread"]) == (4, 0)


@pytest.mark.parametrize(
    "bad",
    [
        "text",
        {**NOTHING, "z_mm": True},
        {**NOTHING, "z_mm": 1e300},
        {**NOTHING, "text": 3},
        {**NOTHING, "text": "x" * 501},
        {**NOTHING, "clock_deg": 361.0},
        {**NOTHING, "clock_deg": "3:00"},
        {**NOTHING, "frame": -1},
        {**NOTHING, "frame": 2.5},
        {**NOTHING, "camera": 256},
    ],
)
def test_a_malformed_mark_is_counted_and_costs_nothing_else(bad: Any, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [NOTHING, bad, {**NOTHING, "text": "b"}])
    marks = read_marks(open_recording(path))
    assert [one.text for one in marks.of] == ["a", "b"] and (marks.unread, marks.left_out) == (1, 0)
    assert observations_of(open_scan(path))[1] == 1


@pytest.mark.parametrize(
    "photo",
    [
        b"",
        b"\xff\xd8",
        jpeg()[:-200],
        b"\xff\xd8" + bytes(70_000),
        "text",
        7,
        bytes(cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1]),
        jpeg(8, 5000),
    ],
    ids=["empty", "head only", "cut short", "large", "text", "number", "png", "wide"],
)
def test_a_photo_that_is_none_leaves_the_mark_with_its_frame(photo: Any, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [{**NOTHING, "photo": photo, "frame": 3}, {**NOTHING, "photo": photo}])
    (beside, alone), left_out = observations_of(open_scan(path))
    assert left_out == 0 and beside.photo_unread and alone.photo_unread
    assert (beside.shows, alone.shows, alone.picture) == ("frame", "", b"")


def test_only_a_frame_under_led_is_shown(tmp_path: Path) -> None:
    found, _ = observations_of(open_scan(write(tmp_path / "a.mcap", [{**NOTHING, "frame": i} for i in (2, 99)])))
    assert [one.shows for one in found] == ["", ""]


def test_more_than_anybody_marks_is_counted_and_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [NOTHING] * (MARKS_MAX + 30))
    found, left_out = observations_of(open_scan(path))
    assert len(found) == MARKS_MAX and left_out == 30


def test_marks_of_all_parts_and_of_a_torn_file_are_read(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [NOTHING], part=Part("s", 1))
    later = write(tmp_path / "a-002.mcap", [{**NOTHING, "text": "b"}, {**NOTHING, "text": "c"}], 4, Part("s", 2))
    assert [one.text for one in observations_of(open_scan(tmp_path / "a.mcap"))[0]] == ["a", "b", "c"]
    data = later.read_bytes()
    later.write_bytes(data[: len(data) // 2])
    scan = open_scan(tmp_path / "a.mcap")
    assert scan.recording is not None and scan.recording.torn
    assert observations_of(scan)[0][0].text == "a"
