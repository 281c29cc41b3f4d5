"""Model A ray-traced (SCENES/fringe-pipe-a): the projector from the clean pipe, the wall with that projector, scored.

The design that calibration begins with is off by two millimetres and a tenth of a fringe; the scene's exact projector
only judges.
"""

import importlib.util
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from annulus_pipe.wall.defects import Defect
from annulus_pipe.wings.fringe.calibrate_pipe import calibrate_fringe_pipe, save_fringe_pipe
from annulus_pipe.wings.fringe.measure import CleanPipeFit, FringeProjector
from annulus_pipe.wings.fringe.pipe import MeasuredPipe, open_fringe_pipe, reconstruct_fringe_pipe
from tools.bench.table import SCENES, Row

PIPE = SCENES / "fringe-pipe-a"
DESIGN = {
    "kind": "rings",
    "centre_mm": [0.0, 0.0, -58.0],
    "rotation": np.eye(3).tolist(),
    "period_mm": 8.05,
    "nominal_radius_mm": 101.6,
    "phase0": 0.0,
}
PLAIN_MM = 2.0  # from any feature


@dataclass(frozen=True, slots=True)
class Judged:
    """centre_mm : how far the calibrated projector is off. covered : share of the plain wall within k = 2."""

    calibrated: CleanPipeFit
    centre_mm: float
    measured: MeasuredPipe
    score: dict[str, Any]
    covered: float
    seconds: float

    @property
    def defects(self) -> tuple[Defect, ...]:
        return self.measured.survey.defects


def judged() -> Judged:
    """Calibrates, measures and scores the scene, as the commands do."""
    told = json.loads((PIPE / "calibration.json").read_text())
    exact = FringeProjector.from_dict(told["pattern"]["projector"])
    told["pattern"]["projector"] = DESIGN
    radius = told["pipe"]["radius_mm"]
    with tempfile.TemporaryDirectory() as folder:
        design, head = Path(folder) / "design.json", Path(folder) / "head.json"
        design.write_text(json.dumps(told))
        calibrated = calibrate_fringe_pipe(PIPE / "reference", design)
        save_fringe_pipe(calibrated, head)
        began = time.process_time()
        measured = reconstruct_fringe_pipe(open_fringe_pipe(PIPE / "uniform", head))
        seconds = time.process_time() - began
        seen = measured.map
        judging, truth = judge(), PIPE / "truth" / "truth.json"
        file = Path(folder) / "depth.npz"
        np.savez(file, phi_deg=seen.phi_deg, z_mm=seen.z_mm, radius_mm=seen.radius_mm, sigma_mm=seen.sigma_mm)
        score = judging.main(str(file), str(truth), "uniform")
    centre = float(np.abs(np.subtract(calibrated.found.projector.centre_mm, exact.centre_mm)).max())
    phi, z = np.meshgrid(seen.phi_deg, seen.z_mm)
    features = json.loads(truth.read_text())["worlds"]["wall"]["features"]
    depth, which = judging.pipe_radius(features, radius, phi, z)
    plain = (which < 0) & (judging.distance(which >= 0, seen.cell_mm[0]) > PLAIN_MM) & np.isfinite(seen.radius_mm)
    error = (seen.radius_mm - radius - depth)[plain]
    covered = float(np.mean(np.abs(error - np.median(error)) < 2 * seen.sigma_mm[plain]))
    return Judged(calibrated.found, centre, measured, score, covered, seconds)


def rows() -> list[Row]:
    if not PIPE.is_dir():
        return []
    one = judged()
    score, sigma = one.score, float(one.calibrated.sigma[:3].max())
    measured = sum(bool(d.get("measured")) for d in score["defects"])
    return [
        Row(
            "Model A, 8-inch, clean pipe: the projector's place off, and its sigma",
            "-",
            "within 3 sigma",
            f"{one.centre_mm:.3f}, {sigma:.3f} mm",
            one.centre_mm < 3 * sigma,
        ),
        Row(
            "the scan: radius rms, aligned (before)",
            "0.037 (0.041) mm, prototype",
            "<= 0.035 mm",
            f"{score['rms_mm']:.4f} ({score['rms_before_alignment_mm']:.4f}) mm",
            score["rms_mm"] <= 0.035,
        ),
        Row("completeness", "0.94", ">= 0.95", f"{score['completeness']:.3f}", score["completeness"] >= 0.95),
        Row(
            "defects found; depths right, of 13",
            "12; 8",
            "all; 11",
            f"{score['defects_found'].split()[0]}; {measured}",
            measured >= 11,
        ),
        Row("in the defect list", "-", "13, none else", f"{len(one.defects)}", len(one.defects) == 13),
        Row("k = 2 covers", "-", "93 to 97 %", f"{one.covered:.1%}", 0.93 <= one.covered <= 0.97),
        Row("24 frames, CPU", "-", "-", f"{one.seconds:.0f} s"),
    ]


def judge() -> ModuleType:
    """The scenes' own scorer."""
    spec = importlib.util.spec_from_file_location("score_fringe", SCENES / "score_fringe.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(SCENES / "score_fringe.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
