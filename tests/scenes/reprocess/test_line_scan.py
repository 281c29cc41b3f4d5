"""A dented pipe from a video: one bright ring, 110 degrees that nobody saw, oval by 4 %, radius guessed 3 % off."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from line_heads import ONE_RING, head, picture

from annulus_pipe.reprocess import survey_of
from annulus_pipe.scans.video import Chainage, import_video
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.wall.defects import Kind

pytestmark = pytest.mark.deep(gate="tests/unit/scans/test_video.py::test_a_video_becomes_a_scan_of_the_same_pictures")

FRAMES, STEP_MM, OVAL_MM = 16, 4.0, 3.05


@pytest.mark.parametrize("guess", [1.03, 0.97])
def test_a_dented_pipe_is_measured_from_a_video(guess: float, tmp_path: Path) -> None:
    dent = WorldFeature("oval", z_mm=106.0, length_mm=900.0, depth_mm=OVAL_MM, clock_deg=40.0)
    world = head(*ONE_RING, features=(dent,), rods=False)
    size = world.camera.width, world.camera.height
    x, y = np.meshgrid(np.arange(size[0]) - world.camera.cx, np.arange(size[1]) - world.camera.cy)
    unseen = np.abs(np.degrees(np.arctan2(x, y))) < 55.0  # about 6 o'clock
    video = cv2.VideoWriter(str(tmp_path / "pull.mkv"), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 25.0, size)
    for i in range(FRAMES):
        image = picture(world, STEP_MM * i, seed=i)
        image[unseen] = 2
        video.write(image)
    video.release()
    import_video(tmp_path / "pull.mkv", tmp_path / "scan", chainage=Chainage((0, 100), (0.0, 100 * STEP_MM)))
    known = replace(world.calibration(), pipe_radius_mm=guess * world.radius_mm)
    save_calibration(tmp_path / "head.json", known)
    pipe = survey_of(tmp_path / "scan", tmp_path / "head.json")
    assert all(profile.pose is not None for profile in pipe.profiles) and len(pipe.profiles) == FRAMES
    for d in pipe.defects:
        print(d)
    print(pipe.findings, pipe.detection.undecided, pipe.wall.shape_sigma_mm().max())
    (found,) = pipe.defects
    assert found.kind is Kind.OVALITY, "no defect is invented"
    assert abs(found.depth_mm - 2 * OVAL_MM) < found.depth_k2_mm < 1.5
    assert pipe.findings == ()
