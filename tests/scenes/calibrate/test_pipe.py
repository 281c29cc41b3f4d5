"""`annulus calibrate pipe` on files: the ray-traced scene, and what is said about scans that cannot be used."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from annulus_pipe.calibrate.pipe import calibrate_pipe
from annulus_pipe.vocabulary import AnnulusError

CAMERA = {
    "format": "annulus-calibration/1",
    "camera": {"model": "pinhole", "width": 640, "height": 480, "fx": 300, "fy": 300, "cx": 319.5, "cy": 239.5},
    "pattern": {"colours": "RRGBGR"},
}
Paint = Callable[[int], NDArray[np.uint8]]


def _scan(folder: Path, count: int, paint: Paint) -> tuple[Path, Path]:
    """A scan of `count` painted frames, and the camera's file."""
    lines = ["index,file,light,z_mm"]
    for i in range(count):
        cv2.imwrite(str(folder / f"{i}.png"), paint(i))
        lines.append(f"{i},{i}.png,projector,0")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    return folder, folder / "camera.json"


def _noise(level: int, shape: tuple[int, int] = (480, 640)) -> Paint:
    return lambda i: np.random.default_rng(i).integers(0, level, (*shape, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    "count, paint, words",
    [
        (3, _noise(5), "all 3 projector frames are dark.*lens cap"),
        (1, _noise(200), "one projector frame, expected at least two"),
        (2, _noise(200), "pattern.colours|clean pipe"),
        (2, _noise(200, (240, 320)), "is 320x240 but the camera's file says 640x480"),
    ],
)
def test_a_scan_that_cannot_be_used_is_refused_in_one_line(
    tmp_path: Path, count: int, paint: Paint, words: str
) -> None:
    with pytest.raises(AnnulusError, match=words) as refused:
        calibrate_pipe(*_scan(tmp_path, count, paint), 76.2)
    assert "\n" not in str(refused.value)


def test_a_camera_file_without_colours_and_a_radius_of_nothing_are_named(tmp_path: Path) -> None:
    scan, camera = _scan(tmp_path, 2, _noise(5))
    with pytest.raises(AnnulusError, match="the radius is 0 mm"):
        calibrate_pipe(scan, camera, 0.0)
    camera.write_text(json.dumps({key: CAMERA[key] for key in ("format", "camera")}))
    with pytest.raises(AnnulusError, match=r'camera\.json: "pattern" is missing'):
        calibrate_pipe(scan, camera, 76.2)
