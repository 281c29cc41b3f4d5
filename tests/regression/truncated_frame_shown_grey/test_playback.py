"""OpenCV fills the missing part of a truncated image with grey and says nothing, and it was played back as a frame like
any other (bd49478). Fails when the camera reads its images with cv2.imread."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.capture.camera import grab
from annulus_pipe.daemon.filmed import ScanFolderCamera
from annulus_pipe.vocabulary import AnnulusError


def test_a_truncated_image_is_not_played(tmp_path: Path) -> None:
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.full((8, 12, 3), 60 * i, np.uint8))
    (tmp_path / "frames.csv").write_text("index,file,light,z_mm\n0,0.png,projector,0\n1,1.png,projector,1\n")
    whole = (tmp_path / "1.png").read_bytes()
    (tmp_path / "1.png").write_bytes(whole[:-20])
    camera = ScanFolderCamera(tmp_path)
    camera.start()
    grab(camera)
    with pytest.raises(AnnulusError, match="truncated"):
        grab(camera)
