"""The defects of a drawn pipe as `annulus pod match` takes them: truths.csv beside its scan.

What is held against them, and how, is the product's own matching, which knows nothing of score.py.
"""

import math
from pathlib import Path

from annulus_pipe.qualification.trial_files import truths_csv
from annulus_pipe.qualification.trials import TrueDefect
from tools.bench.blind.pipe import Scene

FILE = "truths.csv"
AS = {"pocket": "loss", "groove": "loss", "bump": "bump", "dent": "bump"}  # as a survey names it; all else is a feature
JOINTS = ("joint", "gap")


def truths(scene: Scene) -> tuple[TrueDefect, ...]:
    """All defects, in the order in which they were drawn."""
    radius = scene.pipe.radius_mm
    return tuple(
        TrueDefect(
            f"{number}",
            AS[one.kind],
            one.z_mm,
            one.clock_deg,
            one.depth_mm,
            one.length_mm,
            math.radians(one.arc_deg) * radius,
            one.beside in JOINTS,
            f"blind {scene.seed}",
        )
        for number, one in enumerate(scene.pipe.things, start=1)
        if one.kind in AS
    )


def write_truths(scene: Scene, folder: Path) -> None:
    (folder / FILE).write_text(truths_csv(truths(scene)), encoding="utf-8")
