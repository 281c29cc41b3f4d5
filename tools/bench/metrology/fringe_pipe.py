"""Model A ray-traced (SCENES/fringe-pipe-a): the projector from the clean pipe, the wall with that projector, scored.

The design that calibration begins with is off by two millimetres and a tenth of a fringe; the scene's exact projector
only judges.
"""

import csv
import importlib.util
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from annulus.fringe import FringeProjector, PipeCalibration, PipeMap, calibrate_pipe, find_scratches, measure_pipe
from annulus.geometry.calibration import HeadCamera
from annulus.geometry.camera import Camera
from annulus.numeric.arrays import Float32Array
from annulus.wall.defects import Defect
from tools.bench.table import SCENES, Row

PIPE = SCENES / "fringe-pipe-a"
STILL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
PLAIN_MM = 2.0  # from any feature


@dataclass(frozen=True, slots=True)
class Judged:
    """centre_mm : how far the calibrated projector is off. covered : share of the plain wall within k = 2."""

    calibrated: PipeCalibration
    centre_mm: float
    seen: PipeMap
    score: dict[str, Any]
    covered: float
    defects: list[Defect]
    seconds: float


def judged() -> Judged:
    """Calibrates, measures and scores the scene."""
    told = json.loads((PIPE / "calibration.json").read_text())
    one, radius = told["cameras"][0], told["pipe"]["radius_mm"]
    camera = HeadCamera(0, Camera("fisheye", *(one[k] for k in ("width", "height", "fx", "fy", "cx", "cy"))))
    designed = FringeProjector("rings", (0.0, 0.0, -58.0), STILL, 8.05, nominal_radius_mm=radius)
    images, rows = _frames("reference", told["transfer"]["reference"])
    places = np.array([[float(row["tx_mm"]), float(row["ty_mm"]), 0.0] for row in rows])
    calibrated = calibrate_pipe(camera, designed, images, places, radius)
    exact = FringeProjector.from_dict(told["pattern"]["projector"])
    centre = float(np.abs(np.subtract(calibrated.projector.centre_mm, exact.centre_mm)).max())
    images, rows = _frames("uniform", told["transfer"]["uniform"])
    began = time.process_time()
    seen = measure_pipe(camera, calibrated.projector, images, np.array([float(row["z_mm"]) for row in rows]), radius)
    seconds = time.process_time() - began
    judge, truth = _judge(), PIPE / "truth" / "truth.json"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "depth.npz"
        np.savez(file, phi_deg=seen.phi_deg, z_mm=seen.z_mm, radius_mm=seen.radius_mm, sigma_mm=seen.sigma_mm)
        score = judge.main(str(file), str(truth), "uniform")
    phi, z = np.meshgrid(seen.phi_deg, seen.z_mm)
    features = json.loads(truth.read_text())["worlds"]["wall"]["features"]
    depth, which = judge.pipe_radius(features, radius, phi, z)
    plain = (which < 0) & (judge.distance(which >= 0, seen.cell_mm[0]) > PLAIN_MM) & np.isfinite(seen.radius_mm)
    error = (seen.radius_mm - radius - depth)[plain]
    covered = float(np.mean(np.abs(error - np.median(error)) < 2 * seen.sigma_mm[plain]))
    return Judged(calibrated, centre, seen, score, covered, find_scratches(seen), seconds)


def rows() -> list[Row]:
    if not PIPE.is_dir():
        return []
    one = judged()
    score, sigma = one.score, float(one.calibrated.sigma[:3].max())
    measured = sum(bool(d.get("measured")) for d in score["defects"])
    return [
        Row("Model A, 8-inch, clean pipe: the projector's place off, and its sigma", "-", "within 3 sigma",
            f"{one.centre_mm:.3f}, {sigma:.3f} mm", one.centre_mm < 3 * sigma),
        Row("the scan: radius rms, aligned (before)", "0.037 (0.041) mm, prototype", "<= 0.035 mm",
            f"{score['rms_mm']:.4f} ({score['rms_before_alignment_mm']:.4f}) mm", score["rms_mm"] <= 0.035),
        Row("completeness", "0.94", ">= 0.95", f"{score['completeness']:.3f}", score["completeness"] >= 0.95),
        Row("defects found; depths right, of 13", "12; 8", "all; 11",
            f"{score['defects_found'].split()[0]}; {measured}", measured >= 11),
        Row("in the defect list", "-", "13, none else", f"{len(one.defects)}", len(one.defects) == 13),
        Row("k = 2 covers", "-", "93 to 97 %", f"{one.covered:.1%}", 0.93 <= one.covered <= 0.97),
        Row("24 frames, CPU", "-", "-", f"{one.seconds:.0f} s"),
    ]  # fmt: skip


def _frames(name: str, transfer: dict[str, Any]) -> tuple[Float32Array, list[dict[str, str]]]:
    with (PIPE / name / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    pictures = [cv2.imread(str(PIPE / name / row["file"]), cv2.IMREAD_GRAYSCALE) for row in rows]
    black = transfer["black"]
    light = [(np.float32(one) - black) * 255 / (255 - black) for one in pictures if one is not None]
    full = [np.where(np.asarray(one) >= 254, np.nan, lit) for one, lit in zip(pictures, light, strict=True)]
    return np.array(full, np.float32), rows


def _judge() -> ModuleType:
    spec = importlib.util.spec_from_file_location("score_fringe", SCENES / "score_fringe.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(SCENES / "score_fringe.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
