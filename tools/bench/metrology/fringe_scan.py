"""The ray-traced plate (SCENES/fringe-a): the slide from its reference frames, both scans with that slide, by the slide
and by the two cameras alone, scored.
"""

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.wings.fringe.calibrate_plate import calibrate_fringe, save_fringe
from annulus_pipe.wings.fringe.job import open_fringe
from annulus_pipe.wings.fringe.plate import reconstruct_fringe
from tools.bench.metrology.fringe_pipe import judge
from tools.bench.table import SCENES, Row

PLATE = SCENES / "fringe-a"
TRUTH = PLATE / "truth" / "truth.json"
RMS_MM = {"uniform": (0.0189, 0.018), "nonuniform": (0.0196, 0.019)}  # the prototype's, and what is asked


def rows() -> list[Row]:
    if not PLATE.is_dir():
        return []
    told = json.loads((PLATE / "calibration.json").read_text())
    del told["pattern"]["projector"]
    out = []
    with tempfile.TemporaryDirectory() as folder:
        cameras, head = Path(folder) / "cameras.json", Path(folder) / "head.json"
        cameras.write_text(json.dumps(told))
        save_fringe(calibrate_fringe(PLATE / "reference", cameras), head)
        for name, (prototype, asked) in RMS_MM.items():
            began = time.process_time()
            plate = reconstruct_fringe(open_fringe(PLATE / name, head))
            seconds = time.process_time() - began
            score = _score(plate, name, Path(folder))
            gross, sized = score["gross_over_0.5mm_percent"], sum(bool(d.get("measured")) for d in score["defects"])
            out += [
                Row(
                    f"plate, {name}: height rms",
                    f"{prototype} mm, prototype",
                    f"<= {asked} mm",
                    f"{score['rms_mm']:.4f} mm",
                    score["rms_mm"] <= asked,
                ),
                Row(
                    "completeness; beyond 0.5 mm",
                    "-; 0.2 %",
                    ">= 0.994; <= 0.1 %",
                    f"{score['completeness']:.3f}; {gross:.3f} %",
                    score["completeness"] >= 0.994 and gross <= 0.1,
                ),
                Row(
                    "features found; depths right, of 19",
                    "19; 18",
                    "all; 19",
                    f"{score['defects_found'].split()[0]}; {sized}",
                    sized >= 19,
                ),
                Row(f"{len(plate.places_mm)} flashes of two cameras, CPU", "-", "-", f"{seconds:.0f} s"),
            ]
        by_cameras = reconstruct_fringe(open_fringe(PLATE / "uniform", head, "cameras"))
        score = _score(by_cameras, "uniform", Path(folder))
        out.append(
            Row(
                "uniform, by the cameras alone (6.4): rms; completeness",
                "-",
                "-",
                f"{score['rms_mm']:.4f} mm; {score['completeness']:.3f}",
            )
        )
    return out


def _score(plate: Any, name: str, folder: Path) -> dict[str, Any]:
    file = folder / "plate.npz"
    np.savez(file, x_mm=plate.x_mm, y_mm=plate.y_mm, height_mm=plate.height_mm, sigma_mm=plate.sigma_mm)
    score: dict[str, Any] = judge().main(str(file), str(TRUTH), name)
    return score
