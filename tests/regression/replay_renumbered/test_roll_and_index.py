"""A scan folder played back was numbered anew, closed its holes and lost its frames' roll: frames.csv had two readers
(bd49478). Fails when the camera counts for itself or leaves RollDeg out."""

from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.capture.camera import grab
from annulus_pipe.daemon.filmed import ScanFolderCamera


def test_frames_keep_their_index_their_time_and_their_roll(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for i in range(3):
        cv2.imwrite(str(tmp_path / "frames" / f"{i}.png"), np.full((8, 12, 3), 60 * i, np.uint8))
    rows = "12,frames/2.png,led,9.0,-4.5\n7,frames/0.png,projector,4.0,\n8,frames/1.png,projector,5.0,3\n"
    (tmp_path / "frames.csv").write_text("index,file,light,z_mm,roll_deg\n" + rows)
    camera = ScanFolderCamera(tmp_path, fps=10.0)
    camera.start()
    frames = [grab(camera) for _ in range(3)]
    assert [f.sequence for f in frames] == [7, 8, 12]
    assert np.diff([f.timestamp_ns for f in frames]).tolist() == [100_000_000, 400_000_000]  # a hole stays one
    assert [f.metadata.get("RollDeg") for f in frames] == [None, 3.0, -4.5]
