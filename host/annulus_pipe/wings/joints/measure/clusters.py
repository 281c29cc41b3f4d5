"""Whether features of joints (W, T) tell good dogbones from bad in a joint that had no say: one left out at a time.

A joint is told by Fisher's line between good and bad of all the others. Fitted and tested on one pipe it always tells:
its own dogbones are alike with their neighbours. p asks how often chance does as well: each joint's results are turned
and mirrored as a whole, which leaves neighbours alike, and dealt among joints of as many dogbones.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.statistics import LEVEL

PIPES_MIN = 3
SHRUNK = 0.1  # of the common variance, towards independence: two features of eight dogbones may lie on a line
DEALT = 999


@dataclass(frozen=True, slots=True)
class Clusters:
    """called_good : (n,) by the other joints, None where they had only good ones or only bad ones. accuracy : of all;
    balanced : mean of the shares of good and of bad ones told rightly. least_p : the least that could come out."""

    called_good: list[bool | None]
    accuracy: float
    balanced: float
    p: float
    least_p: float

    @property
    def verdict(self) -> str:
        if self.p <= LEVEL:
            return "told"
        return (
            "cannot be told, whatever had come out: too few joints" if self.least_p > LEVEL else "not told from chance"
        )

    def figures(self) -> dict[str, Any]:
        """What clusters.json says of it."""
        return {
            "called_good": self.called_good,
            "accuracy": self.accuracy,
            "balanced": self.balanced,
            "p": self.p,
            "least_p": self.least_p,
            "verdict": self.verdict,
        }


def leave_one_out(
    values: FloatArray, good: BoolArray, pipe: IntArray, angle_deg: FloatArray, seed: int = 0, dealt: int = DEALT
) -> Clusters:
    """values (n, F); good, pipe, angle_deg (n,): of each dogbone. AnnulusError where there are too few joints, only
    good or only bad dogbones, or a feature is not told at one."""
    names = np.unique(pipe)
    if len(names) < PIPES_MIN:
        raise AnnulusError(f"{len(names)} joints, expected {PIPES_MIN} or more: each is told by the others")
    if good.all() or not good.any():
        raise AnnulusError(f"{good.sum()} of {len(good)} dogbones are good, expected good and bad ones")
    if not np.isfinite(values).all():
        raise AnnulusError(f"{int((~np.isfinite(values).all(axis=1)).sum())} dogbones where a feature is not told")
    members = [np.flatnonzero(pipe == name)[np.argsort(angle_deg[pipe == name] % 360)] for name in names]
    called = _called(values, good, members)
    balanced = _balanced(called, good)
    random = np.random.default_rng(seed)
    as_good, ways = 0, 1.0
    for one in members:
        ways *= len({tuple(np.roll(way, k)) for way in (good[one], good[one][::-1]) for k in range(len(one))})
    for size in {len(one) for one in members}:
        ways *= len({tuple(sorted(good[one])) for one in members if len(one) == size})
    for _ in range(dealt):
        other = np.empty_like(good)
        for size in {len(one) for one in members}:
            alike = [one for one in members if len(one) == size]
            for one, k in zip(alike, random.permutation(len(alike)), strict=True):
                taken = good[alike[k]]
                other[one] = np.roll(taken if random.random() < 0.5 else taken[::-1], random.integers(size))
        as_good += _balanced(_called(values, other, members), other) >= balanced - 1e-12
    right = [one is not None and one == true for one, true in zip(called, good, strict=True)]
    return Clusters(
        called, float(np.mean(right)), balanced, (1 + as_good) / (1 + dealt), max(1 / (1 + dealt), 1 / ways)
    )


def _called(values: FloatArray, good: BoolArray, members: list[IntArray]) -> list[bool | None]:
    out: list[bool | None] = [None] * len(good)
    for mine in members:
        rest = np.setdiff1d(np.arange(len(good)), mine)
        fair, foul = values[rest][good[rest]], values[rest][~good[rest]]
        if len(fair) < 2 or len(foul) < 2:
            continue
        scatter = (np.cov(fair.T, ddof=0) * len(fair) + np.cov(foul.T, ddof=0) * len(foul)) / len(rest)
        scatter = np.atleast_2d(scatter)
        own = np.diag(np.diag(scatter))
        matrix = (1 - SHRUNK) * scatter + SHRUNK * own + 1e-12 * np.eye(len(own))
        way = np.linalg.solve(matrix, fair.mean(axis=0) - foul.mean(axis=0))
        middle = (fair.mean(axis=0) + foul.mean(axis=0)) / 2
        for k in mine:
            out[k] = bool((values[k] - middle) @ way > 0)
    return out


def _balanced(called: list[bool | None], good: BoolArray) -> float:
    """Mean of the shares of good and of bad dogbones that are called right; one that is not called counts half."""
    right = np.array([0.5 if one is None else float(one == true) for one, true in zip(called, good, strict=True)])
    return float((right[good].mean() + right[~good].mean()) / 2)
