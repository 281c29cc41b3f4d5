"""How many defects of which sizes have to be laid for a wanted a90/95, if the head is as good as somebody assumes.

Sizes lie evenly between one that is hardly ever detected and one that nearly always is (MIL-HDBK-1823A, 4.5.2.2 a:
evenly on a Cartesian scale gives the more precise a90). How many follows from the Fisher information of a90 under the
assumed curve, and is then tried: simulated studies are drawn and fitted as a real one would be, and their number of
targets is raised until so many of them reach the wanted a90/95.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import special, stats
from annulus_pipe.qualification.hit_miss import CONFIDENCE, POD, TARGETS_ASKED, SizeAxis, fit_hit_miss
from annulus_pipe.qualification.trials import GATE_MM, TrueDefect
from annulus_pipe.vocabulary import AnnulusError

PROBABILITY = 0.8  # with which a study reaches what is wanted: the power that studies are planned for by custom
STUDIES = 100  # simulated: 80 of 100 is known to 4, and a plan costs seconds
TARGETS_MOST = 600  # more than anybody machines
TRIES_MOST = 6
MORE = 1.15  # times as many, where a try falls short by less than the information says
LOW_POD, HIGH_POD = 0.03, 0.99  # of the least and the largest laid: 1823A 4.5.2.2 a (2), neither always nor never
FIRST_MM = 200.0  # along a spool: before, some rings of a head that starts at its end pass no wall
APART_MM = 2 * GATE_MM + 10.0  # of sound wall between two: none is within the other's gate
SPOOL_MM = 6000.0  # a length of pipe as it is sold


@dataclass(frozen=True, slots=True)
class SizePlan:
    """reached : part of `studies` simulated ones whose a90/95 is at most what is wanted."""

    wanted_mm: float
    a50_mm: float
    a90_mm: float
    depths_mm: tuple[float, ...]
    reached: float
    studies: int


def plan_sizes(
    wanted_mm: float, a50_mm: float, a90_mm: float, *, deepest_mm: float = math.inf, seed: int = 1
) -> SizePlan:
    """Depths for a90/95 <= wanted_mm with probability PROBABILITY. Raises AnnulusError where that cannot be."""
    if not 0 < a50_mm < a90_mm < wanted_mm:
        raise AnnulusError(
            f"a50 {a50_mm:g}, a90 {a90_mm:g}, a wanted a90/95 of {wanted_mm:g} mm: expected each above the one before"
        )
    slope = float(special.logit(POD)) / (a90_mm - a50_mm)
    least = max(a50_mm + float(special.logit(LOW_POD)) / slope, 0.1 * a50_mm)
    largest = min(max(a50_mm + float(special.logit(HIGH_POD)) / slope, 1.1 * wanted_mm), deepest_mm)
    if largest <= wanted_mm:
        raise AnnulusError(
            f"defects of at most {largest:g} mm: expected deeper ones than the wanted a90/95 of {wanted_mm:g} mm,"
            " for nothing is stated beyond the largest laid"
        )
    count = max(_by_information(wanted_mm, a50_mm, a90_mm, least, largest), TARGETS_ASKED)
    for _ in range(TRIES_MOST):
        if count > TARGETS_MOST:
            break
        depths = np.linspace(least, largest, count)
        reached = _reached(depths, wanted_mm, a50_mm, slope, seed)
        if reached >= PROBABILITY:
            return SizePlan(wanted_mm, a50_mm, a90_mm, tuple(float(one) for one in depths), reached, STUDIES)
        count = math.ceil(count * MORE)
    raise AnnulusError(
        f"an a90/95 of {wanted_mm:g} mm takes more than {TARGETS_MOST} defects if a90 is {a90_mm:g} mm: expected one"
        " farther above it"
    )


def spools(
    plan: SizePlan,
    kind: str,
    length_mm: float,
    width_mm: float,
    *,
    spool_mm: float = SPOOL_MM,
    bore_mm: float = 0.0,
    seed: int = 1,
) -> tuple[tuple[TrueDefect, ...], ...]:
    """The plan's defects along as many spools as they take, in an order and at clocks drawn from the seed; side by side
    round a pipe of inner diameter bore_mm, where that is known."""
    rng = np.random.default_rng(seed)
    if 0.0 < math.pi * bore_mm < width_mm:
        raise AnnulusError(f"a pipe of {bore_mm:g} mm inside: a defect {width_mm:g} mm wide is wider than its wall")
    around = max(1, math.floor(math.pi * bore_mm / (width_mm + APART_MM)))
    each = around * (math.floor((spool_mm - FIRST_MM - length_mm) / (length_mm + APART_MM)) + 1)
    if each < 1:
        raise AnnulusError(
            f"a spool of {spool_mm:g} mm: no defect {length_mm:g} mm long has room on it behind {FIRST_MM:g} mm"
        )
    depths = np.round(rng.permutation(np.array(plan.depths_mm)), 2)
    if kind == "bump" and 2 * depths.max() > min(length_mm, width_mm):
        raise AnnulusError(
            f"a bump {depths.max():g} mm high and {length_mm:g} long: expected one at least twice as long as high"
        )
    turns = rng.uniform(0.0, 360.0, math.ceil(len(depths) / around))[:, None] + 360.0 / around * np.arange(around)
    clocks = np.round(turns.ravel()[: len(depths)]) % 360.0
    out: list[tuple[TrueDefect, ...]] = []
    for first in range(0, len(depths), each):
        name = f"spool {len(out) + 1}"
        rows = zip(depths[first : first + each], clocks[first : first + each], strict=True)
        out.append(
            tuple(
                TrueDefect(
                    f"{len(out) + 1}-{i + 1:02d}",
                    kind,
                    FIRST_MM + length_mm / 2 + i // around * (length_mm + APART_MM),
                    float(clock),
                    float(depth),
                    length_mm,
                    width_mm,
                    False,
                    name,
                )
                for i, (depth, clock) in enumerate(rows)
            )
        )
    return tuple(out)


def _by_information(wanted: float, a50: float, a90: float, least: float, largest: float) -> int:
    """Targets with which the bound lies below the wanted size with PROBABILITY, both errors taken for normal."""
    size = np.linspace(least, largest, 200)
    slope = float(special.logit(POD)) / (a90 - a50)
    pod = special.expit(slope * (size - a50))
    weight = pod * (1 - pod) / len(size)
    design = np.stack([np.ones_like(size), size], axis=1)
    toward = np.array([-1.0, -a90]) / slope
    variance = float(toward @ np.linalg.solve((design.T * weight) @ design, toward))  # of one target
    quantiles = float(stats.norm.ppf(CONFIDENCE) + stats.norm.ppf(PROBABILITY))
    return math.ceil(variance * (quantiles / (wanted - a90)) ** 2)


def _reached(depths: FloatArray, wanted: float, a50: float, slope: float, seed: int) -> float:
    rng = np.random.default_rng([seed, len(depths)])
    pod = special.expit(slope * (depths - a50))
    found = [
        fit_hit_miss(depths.tolist(), (rng.random(len(depths)) < pod).tolist(), SizeAxis.LINEAR, curve=False).a9095_mm
        for _ in range(STUDIES)
    ]
    return sum(one is not None and one <= wanted for one in found) / STUDIES


def in_words(plan: SizePlan, laid: Sequence[Sequence[TrueDefect]]) -> str:
    return (
        f"{len(plan.depths_mm)} defects from {plan.depths_mm[0]:.2f} to {plan.depths_mm[-1]:.2f} mm on {len(laid)}"
        f" spool{'s' * (len(laid) > 1)}: a90/95 is at most {plan.wanted_mm:g} mm in {100 * plan.reached:.0f} of 100"
        f" studies, if a50 is {plan.a50_mm:g} and a90 {plan.a90_mm:g} mm"
    )
