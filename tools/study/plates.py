"""Chapter 11's future work: a glass-fibre plate from one side, through air. The source has no figure of it."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from annulus_pipe.wings.tai.measure.budget import Laminate, SingleSidedRig, budget, code_cost
from annulus_pipe.wings.tai.measure.elastic import Kind, PlateDefect, PlateSample, face_velocity, sound_in_air
from annulus_pipe.wings.tai.measure.layered import PlateModel
from annulus_pipe.wings.tai.measure.seek import PlateAnswer, time_reversal
from annulus_pipe.wings.tai.single_sided import (
    PITCH_MM,
    POSITIONS,
    SAMPLES,
    decoded,
    draw_plate,
    examine_plate,
    with_noise,
)
from tools.study.figure import Figure, FloatArray

RIG, SEQUENCE = SingleSidedRig(), "manchester"
X_MM = (np.arange(POSITIONS) - (POSITIONS - 1) / 2) * PITCH_MM


def drawn(seed: int, kinds: tuple[Kind, ...]) -> PlateSample:
    """A plate by lot: stiffness within 4 %, thickness within 0.25 mm and loss within 30 % of what it was bought as, a
    beam that is 5 mm and 8 % off, and a defect of each kind."""
    rng = np.random.default_rng(seed)
    bought = Laminate()
    stiff = {
        name: getattr(bought, name) * rng.uniform(0.96, 1.04) for name in ("c11_gpa", "c13_gpa", "c33_gpa", "c55_gpa")
    }
    laminate = replace(
        bought,
        thickness_mm=bought.thickness_mm + 0.25 * int(rng.integers(-1, 2)),
        attenuation_db_mm=bought.attenuation_db_mm * rng.uniform(0.7, 1.3),
        **stiff,
    )
    side = rng.choice([-1, 1])
    defects = (
        PlateDefect("delamination", side * rng.uniform(12, 35), rng.uniform(3, 15), rng.uniform(12, 28)),
        PlateDefect(
            "water", -side * rng.uniform(12, 35), rng.uniform(4, 15), rng.uniform(8, 16), rng.uniform(0.5, 1.5)
        ),
    )
    chosen = tuple(one for one in defects if one.kind in kinds)
    return PlateSample(laminate, chosen, rng.uniform(-5, 5), 60 * rng.uniform(0.92, 1.08))


def seconds_for(kind: str) -> float:
    """Time a position that the budget asks for, of that kind 8 mm deep."""
    return code_cost(SEQUENCE, RIG).seconds_for(budget(RIG, Laminate(), kind, 8.0).missing_db)


def traces(sample: PlateSample) -> FloatArray:
    """What one chip sounds like at every position, without noise."""
    velocity, x_mm = face_velocity(sample, RIG)
    return sound_in_air(velocity, x_mm, RIG, X_MM, SAMPLES)


@dataclass(frozen=True, eq=False)
class Looked:
    """One plate: what codes and the model say of it; and single pulses, as many and in the same time, run backwards:
    plain, and with what all positions have in common taken out."""

    model: PlateModel
    answer: PlateAnswer
    plain: FloatArray
    helped: FloatArray
    in_time: FloatArray


def looked(sound: FloatArray, seconds: float, seed: int) -> Looked:
    model, answer = examine_plate(with_noise(sound, RIG, SEQUENCE, seconds, seed))
    single = decoded(with_noise(sound, RIG, "single", single_s(seconds), seed))
    longer = decoded(with_noise(sound, RIG, "single", seconds, seed))
    return Looked(
        model,
        answer,
        time_reversal(model, single),
        time_reversal(model, single - np.median(single, axis=0)),
        time_reversal(model, longer - np.median(longer, axis=0)),
    )


def single_s(seconds: float) -> float:
    """In which as many single pulses are sent as there are bursts of the sequence in `seconds`."""
    return seconds / code_cost(SEQUENCE, RIG).period_s * code_cost("single", RIG).period_s


def off_mm(defect: PlateDefect, x_mm: float, depth_mm: float) -> float:
    return float(np.hypot(defect.x_mm - x_mm, defect.depth_mm - depth_mm))


def brightest(model: PlateModel, image: FloatArray) -> tuple[float, float, float]:
    """Of a time-reversed image: x, depth, and the peak over the image's median."""
    at = np.unravel_index(int(image.argmax()), image.shape)
    return float(X_MM[at[1]]), float(model.depths_mm[at[0]]), float(image.max() / np.median(image))


@cache
def from_one_side() -> Figure:
    """A delamination and a water pocket, each at the noise of its budget, beside time reversal of single pulses."""
    plates = {
        "delamination": PlateSample(defects=(PlateDefect("delamination", -20.0, 6.0, 20.0),)),
        "water": PlateSample(defects=(PlateDefect("water", 22.0, 12.0, 12.0, 1.0),)),
    }
    done = {name: looked(traces(plate), seconds_for(name), 1) for name, plate in plates.items()}
    numbers: dict[str, float] = {}
    for name, one in done.items():
        truth = plates[name].defects[0]
        numbers[f"{name}_s"] = seconds_for(name)
        found = one.answer.places[0] if one.answer.places else None
        numbers[f"{name}_off_mm"] = off_mm(truth, found.x_mm, found.depth_mm) if found else float("nan")
        x_mm, depth_mm, _ = brightest(one.model, one.helped)
        numbers[f"{name}_time_reversal_off_mm"] = off_mm(truth, x_mm, depth_mm)

    def draw(figure: Any) -> None:
        columns = figure.subplots(3, 2)
        for n, (name, one) in enumerate(done.items()):
            shown = replace(one.answer, time_reversed=one.helped)
            draw_plate(columns[:, n], figure, X_MM, one.model, shown)
            truth = plates[name].defects[0]
            for axes in columns[:, n]:
                ends = (truth.x_mm - truth.wide_mm / 2, truth.x_mm + truth.wide_mm / 2)
                axes.plot(ends, (truth.depth_mm, truth.depth_mm), color="lime", lw=1)
            columns[0, n].set_title(f"{name}, {seconds_for(name):.2g} s a position; green: truth", fontsize=9)
            columns[2, n].set_title("time reversal of as many single pulses, common part out", fontsize=9)

    return Figure(numbers, draw, (12.0, 7.6))
