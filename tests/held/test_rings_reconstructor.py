"""A ray-traced pipe through the whole method, scored as its own scorer does (../shared/scenes/pipe-a)."""

import json
import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.rings.reconstructor import Reconstructor

PIPE_A = Path(__file__).resolve().parents[3] / "shared" / "scenes" / "pipe-a"


@pytest.mark.skipif(not PIPE_A.is_dir(), reason="../shared is not here")
def test_the_ray_traced_pipe_is_measured_as_promised(tmp_path):
    score = runpy.run_path(str(PIPE_A.parent / "score.py"))["score"]
    reconstructor = Reconstructor(Calibration.from_dict(json.loads((PIPE_A / "calibration.json").read_text())))
    pose, rows = None, []
    for line in (PIPE_A / "frames.csv").read_text().split()[1:]:
        index, name, light, z_mm = line.split(",")
        if light == "projector":
            image = np.asarray(cv2.imread(str(PIPE_A / name)))
            profile = reconstructor.profile(image, frame=int(index), z_mm=float(z_mm), seed=pose)
            pose = profile.pose
            rows.append(np.column_stack([profile.points_mm, profile.ring]).astype("<f4"))
    cloud = np.concatenate(rows)
    header = "".join(f"property float {name}\n" for name in ("x", "y", "z", "ring"))
    ply = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(cloud)}\n{header}end_header\n"
    (tmp_path / "cloud.ply").write_bytes(ply.encode() + cloud.tobytes())
    result = score(str(tmp_path / "cloud.ply"), str(PIPE_A / "truth.json"))
    assert result["rms_mm"] <= 0.10
    assert result["gross_over_2mm_percent"] <= 0.01
    assert result["points_per_slit_direction"] >= 0.94
    pocket, bump, groove = result["defects"]
    assert abs(pocket["measured_mm"] - pocket["true_mm"]) < 0.05
    assert abs(bump["measured_mm"] - bump["true_mm"]) < 0.1
    assert abs(groove["measured_mm"] - groove["true_mm"]) < 0.05
