"""The bend: how far its centre line, its wall and its list are from the truth."""

import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
from plyfile import PlyData

from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from tools.bench.scenes.judge import Check

ELBOW = "elbow-a"
BOUNDS = {  # of what score_elbow.py says, in the unit its names end in
    "bend_radius_percent": 1.0,
    "angle_deg": 0.3,
    "plane_deg": 0.3,
    "start_mm": 1.5,
    "camera_last_mm": 3.0,
}
DENT_MM = 0.2
ABOUT_MODEL_MM = 0.06  # robust sigma of the wall about its own model; against the world it has the bend's error, too
NEAR_MM = 28.0  # of a true defect's middle, along the centre line: what is listed so close is that defect


def elbow_checks(score_elbow: ModuleType, out: Path, truth_file: Path) -> Iterator[Check]:
    """Of results with a centreline.json in the form the scorer reads."""
    truth = json.loads(truth_file.read_text(encoding="utf-8"))
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    line = json.loads((out / "centreline.json").read_text(encoding="utf-8"))
    if not line.get("bends"):
        yield Check("bends", "none found", False)
        return
    for name, value in score_elbow.score(line, truth, str(out / "cloud.ply")).items():
        yield Check(name, f"{value:g}", abs(value) <= BOUNDS[name] if name in BOUNDS else None)
    radius = np.asarray(PlyData.read(out / "cloud.ply")["vertex"]["radius"], float) - line["pipe_radius_mm"]
    about = SIGMA_OF_MAD * float(np.median(np.abs(radius - np.median(radius))))
    yield Check("wall_about_model_mm", f"{about:.4f}", about <= ABOUT_MODEL_MM)
    defects = truth["scene"]["pipe"]["defects"]
    for one in (d for d in defects if d["kind"].startswith("dent")):
        near = [d for d in summary["defects"] if abs(d["z_mm"] - one["s"]) <= NEAR_MM]
        depth = max((d["depth_mm"] for d in near), default=None)
        asked = depth is not None and abs(depth - one["depth"]) <= DENT_MM
        yield Check("dent", f"{depth} of {one['depth']} mm", asked)
    false = [d for d in summary["defects"] if all(abs(d["z_mm"] - one["s"]) > NEAR_MM for one in defects)]
    yield Check("false", ", ".join(f"{d['kind']} at {d['z_mm']:.0f} mm" for d in false) or "none", not false)
