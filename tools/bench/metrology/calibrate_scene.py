"""The real command's path on ray-traced frames: calibration-a, then pipe-a measured with that calibration."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from annulus_pipe.calibrate.pipe import calibrate_pipe, save_pipe
from annulus_pipe.calibrate.pipe_picture import draw_pipe
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.reprocess.engine import reprocess
from annulus_pipe.reprocess.job import open_job
from tools.bench.metrology import TABLE
from tools.bench.table import SCENES, Row

RADIUS_MM = 76.2


def rows() -> list[Row]:
    scene = SCENES / "calibration-a"
    if not scene.exists():
        return []
    truth = json.loads((scene / "truth.json").read_text())["scene"]["projector"]
    result = calibrate_pipe(scene, scene / "camera.json", RADIUS_MM)
    again = calibrate_pipe(scene, scene / "camera.json", RADIUS_MM)
    rings = result.calibration.rings
    angle = max(abs(np.degrees(2 * r.half_angle) - t) for r, t in zip(rings, truth["theta_full_deg"], strict=True))
    vertex = max(float(np.abs(np.subtract(r.vertex_mm, truth["vertex"])).max()) for r in rings)
    known = np.sqrt(np.diag(result.solution.covariance)).reshape(-1, 6)
    draw_pipe(result, TABLE.pictures / "calibrate_pipe.png")
    print(f"   angle {angle:.4f} deg, vertex {vertex:.4f} mm, {again.timing_s}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / "calibration.json", Path(folder) / "out"
        save_pipe(result, file)
        began = time.monotonic()
        done = reprocess(open_job(SCENES / "pipe-a", file))
        write(done.survey(), ScanAccount("pipe-a", done.frames, done.drops, done.timing_ms), out)
        print(f"   pipe-a in {time.monotonic() - began:.0f} s", flush=True)
        told = subprocess.run(
            [sys.executable, SCENES / "score.py", out / "cloud.ply", SCENES / "pipe-a" / "truth.json", "--json"],
            capture_output=True,
            text=True,
            check=True,
        )
    rms = json.loads(told.stdout)["rms_mm"]
    spent = again.timing_s
    solve, decode, read = spent["solve"], spent["decode"], spent["read"]
    held = result.held_out.rms_mm() if result.held_out is not None else float("nan")
    return [
        Row("calibration-a, 8 frames: worst full angle", "-", "<= 0.01 deg", f"{angle:.4f} deg", bool(angle <= 0.01)),
        Row("calibration-a: worst vertex component", "-", "<= 0.05 mm", f"{vertex:.4f} mm", vertex <= 0.05),
        Row(
            "stated standard deviation of those, the worst",
            "-",
            "-",
            f"{np.degrees(2 * known[:, 0].max()):.4f} deg, {known[:, 3:].max():.4f} mm",
            None,
        ),
        Row("radius error in frames held out", "0.34..1.12 mm, real frames", "-", f"{held:.3f} mm rms", None),
        Row("pipe-a measured with that calibration", "-", "<= 0.12 mm", f"{rms:.4f} mm rms", rms <= 0.12),
        Row(
            "8 frames: rings found and solved, CPU",
            "-",
            "<= 2 s",
            f"{decode + solve:.2f} s ({decode:.2f} + {solve:.2f})",
            decode + solve <= 2.0,
        ),
        Row(
            "the same with JPEG decoding; and with hold-out and the trial of fine-tuning",
            "-",
            "-",
            f"{read + decode + solve:.2f} s; {sum(spent.values()):.2f} s",
            None,
        ),
    ]
