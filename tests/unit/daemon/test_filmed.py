"""What was filmed before plays back as a camera would have seen it: true indices, roll, and nothing made up."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.capture.camera import EndOfFrames, grab
from annulus_pipe.capture.picamera import plug
from annulus_pipe.daemon.filmed import ScanFolderCamera, VideoFileCamera
from annulus_pipe.vocabulary import AnnulusError


def scan_folder(path: Path, rows: list[str], header: str = "index,file,light,z_mm") -> Path:
    (path / "frames").mkdir()
    for i in range(3):
        cv2.imwrite(str(path / "frames" / f"{i}.png"), np.full((8, 12, 3), 60 * i, np.uint8))
    (path / "frames.csv").write_text("\n".join([header, *rows]) + "\n")
    return path


def test_a_scan_folder_is_a_camera(tmp_path: Path) -> None:
    rows = [f"{i},frames/{i}.png,projector,{2.5 * i}" for i in range(3)]
    camera = plug(ScanFolderCamera(scan_folder(tmp_path, rows)))
    camera.start()
    frames = [grab(camera) for _ in range(3)]
    assert [int(f.image[0, 0, 0]) for f in frames] == [0, 60, 120]
    assert [f.metadata["ZMm"] for f in frames] == [0.0, 2.5, 5.0]
    assert np.diff([f.timestamp_ns for f in frames]).tolist() == [40_000_000] * 2
    assert "RollDeg" not in frames[0].metadata
    with pytest.raises(EndOfFrames):
        grab(camera)


def test_one_camera_of_several_in_step_with_the_others(tmp_path: Path) -> None:
    rows = ["0,0,frames/0.png,led,0", "0,3,frames/1.png,led,0", "1,3,frames/2.png,projector,1"]
    folder = scan_folder(tmp_path, rows, "index,camera,file,light,z_mm")
    seen = {}
    for number in (0, 3):
        camera = ScanFolderCamera(folder, camera=number)
        camera._start_ns = 0
        frames = [grab(camera) for _ in range(1 + number // 3)]
        seen[number] = [(f.sequence, f.timestamp_ns, int(f.image[0, 0, 0])) for f in frames]
    assert seen == {0: [(0, 0, 0)], 3: [(0, 0, 60), (1, 40_000_000, 120)]}
    with pytest.raises(AnnulusError, match="no frame of camera 1"):
        ScanFolderCamera(folder, camera=1)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], "lists no frame"),
        (["0,frames/0.png,led,far"], r'frames.csv: line 2: z_mm is "far"'),
        (["0,frames/9.png,led,1.0"], "frames/9.png is not there"),
        (["0,frames/0.png,led,1.0", f"{10**17},frames/1.png,led,2.0"], "index runs from 0 to"),
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
