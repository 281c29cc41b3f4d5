"""Every camera comes through one door, and what it says is checked."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from annulus.capture.camera import (
    BGR8,
    Camera,
    EndOfFrames,
    HeldRequest,
    PicameraAdapter,
    ScanFolderCamera,
    V4L2Camera,
    VideoFileCamera,
    grab,
    plug,
)
from annulus.vocabulary import AnnulusError


class StubPicamera2:
    """The methods and shapes of the real one (which imports only on a Pi): configured, "main" padded to its stride."""

    def __init__(self, name: str = "RGB888", *, sequence: int | None = 41) -> None:
        self.name, self.sequence, self.released, self.controls = name, sequence, 0, {}

    def camera_configuration(self) -> dict[str, Any]:
        return {"main": {"size": (6, 4), "format": self.name}}

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...

    def set_controls(self, controls: dict[str, Any]) -> None:
        self.controls |= controls

    def capture_request(self) -> Any:
        channels = 4 if self.name.startswith("X") else 3
        array = np.zeros((4, 6, channels), np.uint8)
        array[..., 0] = 200  # the first byte in memory
        buffers = {} if self.sequence is None else {"s": SimpleNamespace(metadata=SimpleNamespace(sequence=41))}

        def release() -> None:
            self.released += 1

        return SimpleNamespace(
            make_array=lambda name: array,
            get_metadata=lambda: {"SensorTimestamp": 123, "ExposureTime": 38000},
            release=release,
            request=SimpleNamespace(buffers=buffers),
        )


@pytest.mark.parametrize(("name", "channel"), [("RGB888", 0), ("BGR888", 2), ("XRGB8888", 0), ("XBGR8888", 2)])
def test_a_picamera2_object_plugs_in_unchanged_and_its_colours_are_right(name: str, channel: int) -> None:
    theirs = StubPicamera2(name)
    camera = plug(theirs)
    assert isinstance(camera, PicameraAdapter) and isinstance(camera, Camera)
    frame = grab(camera)
    assert frame.image.shape == (4, 6, 3) and frame.image[0, 0, channel] == 200
    assert (frame.timestamp_ns, frame.sequence, frame.encoding) == (123, 41, BGR8)
    camera.set_controls({"ExposureTime": 38000})
    assert theirs.released == 1 and theirs.controls == {"ExposureTime": 38000}


def test_a_picamera2_without_a_driver_count_has_none_rather_than_a_made_up_one() -> None:
    assert grab(plug(StubPicamera2(sequence=None))).sequence is None


def test_what_cannot_be_used_is_refused_in_one_line() -> None:
    with pytest.raises(AnnulusError, match="main format is SBGGR10"):
        plug(StubPicamera2("SBGGR10"))
    with pytest.raises(AnnulusError, match="has not Picamera2's methods"):
        plug(object())
    with pytest.raises(AnnulusError, match="/dev/video99: no such camera"):
        V4L2Camera("/dev/video99")


class Lying(ScanFolderCamera):
    metadata: dict[str, Any]
    image: Any

    def __init__(self) -> None:
        self.width, self.height, self.encoding = 6, 4, BGR8

    def capture_request(self) -> HeldRequest:
        return HeldRequest(self.image, self.metadata)


def test_a_frame_of_another_size_or_without_a_timestamp_is_not_let_in() -> None:
    camera = Lying()
    camera.image, camera.metadata = np.zeros((4, 7, 3), np.uint8), {"SensorTimestamp": 1}
    with pytest.raises(AnnulusError, match="4x7x3 came, expected uint8 4x6x3"):
        grab(camera)
    camera.image, camera.metadata = np.zeros((4, 6, 3), np.uint8), {}
    with pytest.raises(AnnulusError, match="SensorTimestamp None"):
        grab(camera)


def scan_folder(path: Path, rows: list[str]) -> Path:
    (path / "frames").mkdir()
    for i in range(3):
        cv2.imwrite(str(path / "frames" / f"{i}.png"), np.full((8, 12, 3), 60 * i, np.uint8))
    (path / "frames.csv").write_text("\n".join(["index,file,light,z_mm", *rows]) + "\n")
    return path


def test_a_scan_folder_is_a_camera(tmp_path: Path) -> None:
    rows = [f"{i},frames/{i}.png,projector,{2.5 * i}" for i in range(3)]
    camera = plug(ScanFolderCamera(scan_folder(tmp_path, rows)))
    camera.start()
    frames = [grab(camera) for _ in range(3)]
    assert [int(f.image[0, 0, 0]) for f in frames] == [0, 60, 120]
    assert [f.metadata["ZMm"] for f in frames] == [0.0, 2.5, 5.0]
    assert np.diff([f.timestamp_ns for f in frames]).tolist() == [40_000_000] * 2
    with pytest.raises(EndOfFrames):
        grab(camera)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], "lists no frame"),
        (["0,frames/0.png,led,far"], "frames.csv:2: expected index,file,light,z_mm"),
        (["0,frames/9.png,led,1.0"], "not a readable image"),
    ],
)
def test_a_bad_scan_folder_is_said_to_be_bad(tmp_path: Path, rows: list[str], words: str) -> None:
    with pytest.raises(AnnulusError, match=words):
        ScanFolderCamera(scan_folder(tmp_path, rows))


def test_a_video_file_is_a_camera(tmp_path: Path) -> None:
    path = tmp_path / "pipe.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    for i in range(4):
        writer.write(np.full((48, 64, 3), 60 * i, np.uint8))
    writer.release()
    camera = plug(VideoFileCamera(path))
    camera.start()
    frames = [grab(camera) for _ in range(4)]
    assert [f.sequence for f in frames] == [0, 1, 2, 3]
    assert np.diff([f.timestamp_ns for f in frames]).tolist() == [50_000_000] * 3
    with pytest.raises(EndOfFrames):
        camera.capture_array()
    with pytest.raises(AnnulusError, match="no such video file"):
        VideoFileCamera(tmp_path / "missing.avi")
