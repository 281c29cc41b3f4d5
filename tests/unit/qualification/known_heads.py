"""A head whose errors are known, a gauge study of it, and the certificate that follows."""

import json
import math
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.qualification.certificate import Certificate
from annulus_pipe.qualification.plan import ReferencePiece, StudyPlan, planned
from annulus_pipe.qualification.signature import make_key, sign
from annulus_pipe.qualification.study import Conditions, GaugeReading, certified

DAY = date(2026, 11, 29)
CONDITIONS = Conditions("ab12cd34ef567890", "1.4.0 abc", "0.1.0", "annulus calibrate camera, rms 0.2 px", 1700.0)
PIECES = tuple(ReferencePiece(f"sleeve {n}", d, 0.02) for n, d in (("A", 151.8), ("B", 152.4), ("C", 153.2)))
PLAN = StudyPlan("three sleeves", "7", "laboratory", ("Ames", "Bose"), 6, PIECES)
PULL = replace(PLAN, one_pull=True)


class World:
    """A head whose errors are known: standard deviations in percent of the diameter."""

    def __init__(
        self, bias: float, operator: float, both: float, repeat: float, slope: float = 0.0, run: float = 0.0
    ) -> None:
        self.bias, self.operator, self.both, self.repeat, self.slope = bias, operator, both, repeat, slope
        self.run = run

    @property
    def s_r(self) -> float:
        return math.hypot(self.repeat, self.run)

    @property
    def s_R(self) -> float:
        return math.sqrt(self.operator**2 + self.both**2 + self.s_r**2)

    def times(self, factor: float) -> "World":
        """As many times as bad."""
        every = (self.bias, self.operator, self.both, self.repeat, self.slope, self.run)
        return World(*(factor * one for one in every))

    def study(self, rng: np.random.Generator, plan: StudyPlan) -> tuple[FloatArray, FloatArray, float]:
        """Errors (q, p, n), temperatures, and the true mean error of these pieces and operators."""
        q, p, n = len(plan.pieces), len(plan.operators), plan.repeats
        gauge = rng.normal(0.0, 50.0 * plan.pieces[0].k2_mm / plan.pieces[0].diameter_mm)
        operator, both = rng.normal(0.0, self.operator, p), rng.normal(0.0, self.both, (q, p))
        warm, run = rng.uniform(12.0, 22.0, (q, p, n)), rng.normal(0.0, self.run, (q, p, n))
        if plan.one_pull:
            warm, run = np.broadcast_to(warm[0], warm.shape), np.broadcast_to(run[0], run.shape)
        true = self.bias + operator[None, :, None] + both[:, :, None] + self.slope * (warm - 17.0)
        mean = self.bias + float(operator.mean()) + float(both.mean()) + self.slope * (float(warm.mean()) - 17.0)
        return true + run + gauge + rng.normal(0.0, self.repeat, (q, p, n)), warm, mean


WORLDS = {
    "repeats": World(0.05, 0.0, 0.0, 0.03),
    "operators": World(-0.08, 0.03, 0.0, 0.03),
    "warm": World(0.02, 0.02, 0.02, 0.03, 0.004),
    "runs": World(0.02, 0.01, 0.0, 0.02, 0.002, run=0.03),
}


def readings(plan: StudyPlan, errors: FloatArray, warm: FloatArray) -> list[GaugeReading]:
    out = []
    for run in planned(replace(plan, one_pull=False)):
        i = [piece.name for piece in plan.pieces].index(run.piece)
        at = (i, plan.operators.index(run.operator), run.repeat - 1)
        piece, error = plan.pieces[i], float(errors[at])
        run = replace(run, temperature_c=float(warm[at]))
        out.append(GaugeReading(run, piece, piece.diameter_mm * (1 + error / 100), abs(error), 0.01, 20, 0.0, "0" * 12))
    return out


def made(seed: int = 1) -> Certificate:
    rng = np.random.default_rng(seed)
    errors, warm, _ = WORLDS["operators"].study(rng, PLAN)
    return certified(PLAN, readings(PLAN, errors, warm), CONDITIONS, DAY)


def signed_file(folder: Path, certificate: Certificate | None = None) -> Path:
    """certificate.json in `folder`, signed by a new key beside it (lab.key, lab.key.pub)."""
    for name, pem in zip(("lab.key", "lab.key.pub"), make_key(), strict=True):
        (folder / name).write_bytes(pem)
    whole = certificate or made()
    whole = replace(whole, signature=sign(whole.content(), folder / "lab.key"))
    file = folder / "certificate.json"
    file.write_text(json.dumps(whole.to_dict(), indent=3))
    return file
