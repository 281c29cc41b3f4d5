"""A ray-traced clean pipe calibrates the slide (../shared/scenes/calibration-a)."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.calibrate.pipe import calibrate_pipe, save_pipe
from annulus_pipe.storage.calibration_file import load_calibration

SCENE = Path(__file__).resolve().parents[3] / "shared" / "scenes" / "calibration-a"


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
