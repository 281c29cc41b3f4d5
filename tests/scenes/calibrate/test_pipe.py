"""`annulus calibrate pipe` on files: the ray-traced scene, and what is said about scans that cannot be used."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from annulus.calibrate.pipe import calibrate_pipe, save_pipe
from annulus.record.calibration_file import load_calibration
from annulus.vocabulary import AnnulusError

SCENE = Path(__file__).resolve().parents[4] / "shared" / "scenes" / "calibration-a"
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


@pytest.mark.skipif(not SCENE.exists(), reason="needs ../shared/scenes")
def test_the_ray_traced_scene_is_calibrated_as_well_as_it_says(tmp_path: Path) -> None:
    table = (SCENE / "frames.csv").read_text().splitlines()
    shutil.copytree(SCENE / "frames", tmp_path / "frames")
    (tmp_path / "frames.csv").write_text("\n".join(table[:5]) + "\n")  # four frames: half the time
    result = calibrate_pipe(tmp_path, SCENE / "camera.json", 76.2)
    out = tmp_path / "calibration.json"
    designed = {"by": "annulus pattern design", "nominal": True}
    before = {"note": "kept", "rings": [], "provenance": {"rings": designed, "camera": {"by": "a board"}}}
    out.write_text(json.dumps({"format": "annulus-calibration/1", **before}))
    save_pipe(result, out)
    written = json.loads(out.read_text())
    assert written["note"] == "kept"
    assert written["provenance"].keys() == {"rings"}  # neither the design's rings nor the board's camera are in it now
    assert written["provenance"]["rings"]["by"] == "annulus calibrate pipe"
    truth = json.loads((SCENE / "truth.json").read_text())["scene"]["projector"]
    for ring, full in zip(load_calibration(out).rings, truth["theta_full_deg"], strict=True):
        assert abs(np.degrees(2 * ring.half_angle) - full) < 0.01
        assert np.abs(np.subtract(ring.vertex_mm, truth["vertex"])).max() < 0.05
    told = json.loads(json.dumps(result.to_dict()))
    assert told["poses_good"] and not told["warnings"] and len(told["rings"]) == 5
