"""POD of a depth from what was measured of it: ASTM E3023, MIL-HDBK-1823A appendix G.3 ("a-hat against a").

Assumed: a reported depth is b0 + b1 a + s e, e standard normal, on linear or logarithmic axes, and a defect is detected
when that lies above the decision limit. A miss is then a depth below the limit (censored left), a lower limit one above
itself (censored right). POD(a) is the part of the normal above the limit.

By gamma = 1 / s and delta = b / s the loglikelihood is concave (Olsen 1978, Econometrica 46, 1211), and stays so with
a90 held at a value: Newton's method finds both maxima. The signed root of their ratio covers 93 to 94 % of 40 to 80
targets; its mean and deviation, simulated under the fit (DiCiccio, Martin & Stern 2001, Canadian J. Statistics 29, 67),
make it cover what it says (`python -m tools.bench pod`).

It says more than hits and misses do where its assumption holds, and what is wrong where defects are missed for another
reason than their depth. So its curve must explain the hits and misses as well as a logistic of their own does (their
likelihood ratio, two parameters); else it is refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray, IntArray
from annulus_pipe.numeric.late import optimize, special, stats
from annulus_pipe.qualification.hit_miss import (
    CONFIDENCE,
    CURVE_LEVELS,
    CURVE_POINTS,
    POD,
    Curve,
    Logistic,
    PodFit,
    SizeAxis,
    shared,
    stated,
)
from annulus_pipe.vocabulary import AnnulusError

TARGETS_ASKED = 40  # MIL-HDBK-1823A, 4.5.2.2 b: "at least 40" for a quantitative response
TARGETS_LEAST = 20
MEASURED_LEAST = 10  # of them with a depth: a line of fewer is none
DRAWS = 400  # simulated studies: the deviation of the root is known to 4 %, which moves a coverage of 95 % by 0.6 %
SEED = 3023  # the same data give the same bound
UNEXPLAINED = 0.05  # chance of hits and misses that follow so badly from the line: below, it is not what decides
# In loglikelihood, as in hit_miss: few misses say how reported depths spread where they are decided, so more is asked.
# With 2 a90/95 covers 94 to 96 % whichever axes are true; with 0.5 it covered 90 % (tools/bench, table pod).
NEARLY_AS_LIKELY = 2.0
STEPS_MAX = 60
LEFT, MEASURED, RIGHT = -1, 0, 1


@dataclass(frozen=True, slots=True)
class ResponseLine:
    """Reported depth against true: intercept + slope a, deviation sigma, on these axes; decision in mm."""

    intercept: float
    slope: float
    sigma: float
    decision_mm: float
    true_axis: str
    reported_axis: str


class ResponseData(NamedTuple):
    """(N,) of one set on its axes: x of the true depth, y reported (of a miss: its limit), side LEFT | MEASURED |
    RIGHT, limit below which each would have been missed, target of each."""

    x: FloatArray
    y: FloatArray
    side: IntArray
    limit: FloatArray
    target: IntArray


class _Maximum(NamedTuple):
    """Of a batch of B sets: parameters (B, K), gamma first; loglikelihood (B,)."""

    at: FloatArray
    value: FloatArray


class Regression:
    """The line by maximum likelihood, and the confidence bound of the depth at which POD is p."""

    def __init__(self, data: ResponseData, decision: float) -> None:
        """decision : on the axis of y. Raises AnnulusError where no line fits."""
        self.data, self.decision = data, decision
        self.weight = shared(data.target.tolist(), len(data.x))[1]
        best = _maximum(*_full(data.x, data.y[None, :]), data.side[None, :], self.weight)
        self.gamma, self.delta0, self.delta1 = (float(one) for one in best.at[0])
        self.loglikelihood = float(best.value[0])
        self._moments: dict[float, tuple[float, float]] = {}

    @property
    def line(self) -> tuple[float, float, float]:
        """Intercept, slope, sigma."""
        return self.delta0 / self.gamma, self.delta1 / self.gamma, 1.0 / self.gamma

    def at(self, pod: float) -> float:
        """x at which POD is this."""
        return (self.gamma * self.decision + float(special.ndtri(pod)) - self.delta0) / self.delta1

    def root(self, pod: float, x: float) -> float:
        """The signed root of the likelihood ratio of "POD is this at x"; positive above the estimate."""
        held = self._held(pod, x, self.data.y[None, :], self.data.side[None, :])
        away = max(2.0 * (self.loglikelihood - float(held.value[0])), 0.0)
        return math.copysign(math.sqrt(away), x - self.at(pod))

    def bound(self, pod: float, z: float, farthest: float, *, corrected: bool = True) -> float | None:
        """The largest x at which POD may be as low as this. None where it lies beyond `farthest`."""
        first = self._crossing(pod, z, farthest)
        if first is None or not corrected:
            return first
        mean, deviation = self._moments.setdefault(pod, self.moments(pod, first))
        return self._crossing(pod, mean + deviation * z, farthest)

    def wald(self, pod: float, z: float) -> float:
        """The bound from the information at the estimate, as 1823A G.3.4.3 has it and E3023: for comparison."""
        a, offset = _full(self.data.x, self.data.y[None, :])
        _, hessian = _slopes(
            np.array([[self.gamma, self.delta0, self.delta1]]), a, offset, self.data.side[None, :], self.weight
        )
        toward = np.array([self.decision, -1.0, -self.at(pod)]) / self.delta1
        return self.at(pod) + z * math.sqrt(float(toward @ np.linalg.solve(-hessian[0], toward)))

    def moments(self, pod: float, x: float) -> tuple[float, float]:
        """Mean and deviation of the root over studies like this one, were POD this at x."""
        gamma, delta1 = self._held(pod, x, self.data.y[None, :], self.data.side[None, :]).at[0]
        targets, of_target = np.unique(self.data.target, return_inverse=True)
        drawn = np.random.default_rng(SEED).standard_normal((DRAWS, len(targets)))[:, of_target]  # one a target
        level = self.decision + float(special.ndtri(pod)) / gamma + delta1 / gamma * (self.data.x - x)
        y = level + drawn / gamma
        ceiling = np.where(self.data.side == RIGHT, np.maximum(self.data.y, self.data.limit), np.inf)
        side = np.where(y < self.data.limit, LEFT, np.where(y > ceiling, RIGHT, MEASURED))
        y = np.clip(y, self.data.limit, ceiling)
        full = _maximum(*_full(self.data.x, y), side, self.weight)
        held = self._held(pod, x, y, side)
        estimate = (full.at[:, 0] * self.decision + float(special.ndtri(pod)) - full.at[:, 1]) / full.at[:, 2]
        roots = np.copysign(np.sqrt(np.maximum(2 * (full.value - held.value), 0.0)), x - estimate)
        roots = roots[np.isfinite(roots) & (full.at[:, 2] > 0)]
        return float(np.mean(roots)), float(np.std(roots))

    def _held(self, pod: float, x: float, y: FloatArray, side: IntArray) -> _Maximum:
        """With POD held at x: delta0 = gamma decision + z - delta1 x. y, side : (B, N)."""
        a = np.stack([y - self.decision, np.broadcast_to(x - self.data.x, y.shape)], axis=-1)
        return _maximum(a, np.full(y.shape, -float(special.ndtri(pod))), side, self.weight)

    def _crossing(self, pod: float, z: float, farthest: float) -> float | None:
        estimate = self.at(pod)
        if not estimate < farthest or self.root(pod, farthest) < z:
            return None
        return float(optimize.brentq(lambda x: self.root(pod, x) - z, estimate, farthest, xtol=1e-8))


def fit_signal_response(
    true_mm: Sequence[float],
    reported_mm: Sequence[float],
    side: Sequence[int],
    limit_mm: Sequence[float],
    axes: tuple[SizeAxis, SizeAxis] | None = None,
    *,
    target: Sequence[int] | None = None,
    curve: bool = True,
) -> tuple[PodFit, ResponseLine | None]:
    """POD of depths, and the line it follows from.

    true_mm, reported_mm, side, limit_mm (N,): side LEFT | MEASURED | RIGHT; the limit that a defect had to reach to be
    listed, which stands for the reported depth of a miss. The decision limit is the largest of them. axes : of the true
    and of the reported depth; None takes the likelier. Raises AnnulusError for what is no positive number.
    """
    a, limit, censored = np.asarray(true_mm, float), np.asarray(limit_mm, float), np.asarray(side, np.int64)
    reported = np.where(censored == LEFT, limit, np.asarray(reported_mm, float))
    if not all(np.all(np.isfinite(one) & (one > 0)) for one in (a, reported, limit)):
        raise AnnulusError(
            "a depth or its decision limit is not a positive number of mm. Expected one for every trial."
        )
    if not len(a):
        return PodFit("ASTM E3023", 0, 0, 0, math.nan, math.nan, why="no defect of this kind was laid and judged"), None
    which, weight = shared(target, len(a))
    laid, detected = len(np.unique(which)), int((censored != LEFT).sum())
    none = PodFit("ASTM E3023", laid, len(a), detected, float(a.min()), float(a.max()))
    why = _unfit(a, censored, laid)
    if why:
        return replace(none, why=why), None
    decision_mm, fits = float(limit.max()), []
    for one in (axes,) if axes else ((one, one) for one in SizeAxis):
        data = ResponseData(one[0].of(a), one[1].of(reported), censored, one[1].of(limit), which)
        fit = Regression(data, float(one[1].of(np.array(decision_mm))))
        # of one density of reported depths: that of a logarithm is narrower by the depth itself
        jacobian = float((weight * np.log(reported))[censored == MEASURED].sum()) if one[1] is SizeAxis.LOG else 0.0
        fits.append((fit.loglikelihood - jacobian, one, fit))
    fits = [one for one in fits if one[2].delta1 > 0]
    if not fits:
        return replace(none, why="reported depths do not rise with true ones in these trials"), None
    fits.sort(key=lambda one: -one[0])
    _, used, best = fits[0]
    line = ResponseLine(*best.line, decision_mm, *map(str, used))
    if unexplained(best) < UNEXPLAINED:
        return replace(none, why="what was detected does not follow from the depths that were reported"), line
    z = float(stats.norm.ppf(CONFIDENCE))
    likely = [one for one in fits if fits[0][0] - one[0] < NEARLY_AS_LIKELY]
    found = stated(
        replace(
            none,
            axis=f"{used[1]} of what was reported against {used[0]}",
            curve=_curve(used[0], best, none, z) if curve else None,
        ),
        (used[0].back(best.at(0.5)), used[0].back(best.at(POD))),
        [_bound_mm(axis[0], fit, none.to_mm, z) for _, axis, fit in likely],
    )
    return found, line


def _unfit(true: FloatArray, side: IntArray, laid: int) -> str:
    if laid < TARGETS_LEAST:
        return f"{laid} laid, at least {TARGETS_ASKED} are asked for (MIL-HDBK-1823A, 4.5.2.2)"
    if (side == MEASURED).sum() < MEASURED_LEAST:
        return f"{int((side == MEASURED).sum())} depths were measured, at least {MEASURED_LEAST} are needed for a line"
    if np.ptp(true[side == MEASURED]) < 1e-6 * true.max():
        return "all that was measured is of one size: no line can be fitted"
    return ""


def unexplained(fit: Regression) -> float:
    """Chance of hits and misses that a logistic of their own explains so much better than the line does."""
    x, _, side, limit, _ = fit.data
    hit = (side != LEFT).astype(float)
    above = fit.delta0 + fit.delta1 * x - fit.gamma * limit
    followed = float(fit.weight @ special.log_ndtr(np.where(hit > 0, above, -above)))
    overlap = 0 < hit.sum() < len(hit) and x[hit == 0].max() > x[hit == 1].min()
    free = Logistic(x, hit, fit.weight).loglikelihood if overlap else 0.0
    return float(stats.chi2.sf(max(2 * (free - followed), 0.0), 2))


def _bound_mm(axis: SizeAxis, fit: Regression, largest_mm: float, z: float, pod: float = POD) -> float | None:
    found = fit.bound(pod, z, float(axis.of(np.array(largest_mm))))
    return None if found is None else axis.back(found)


def _curve(axis: SizeAxis, fit: Regression, none: PodFit, z: float) -> Curve:
    """With a bound that has the correction of POD 90 % everywhere: it changes little, and each costs a simulation."""
    size = np.linspace(none.from_mm, none.to_mm, CURVE_POINTS)
    pod = special.ndtr(fit.delta0 + fit.delta1 * axis.of(size) - fit.gamma * fit.decision)
    levels = [float(one) for one in special.ndtr(np.linspace(-2.3, 2.6, CURVE_LEVELS))]
    farthest = float(axis.of(np.array(none.to_mm)))
    first = fit.bound(POD, z, farthest)
    mean, deviation = (0.0, 1.0) if first is None else fit.moments(POD, first)
    known = [fit.bound(one, mean + deviation * z, farthest, corrected=False) for one in levels]
    bounds = [None if one is None else axis.back(one) for one in known]
    return Curve.through(size, pod, levels, bounds)


def _full(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """e = a theta + offset with theta (gamma, delta0, delta1). x (N,), y (B, N) -> (B, N, 3), (B, N)."""
    ones = np.ones_like(y)
    return np.stack([y, -ones, np.broadcast_to(-x, y.shape)], axis=-1), np.zeros_like(y)


def _maximum(a: FloatArray, offset: FloatArray, side: IntArray, weight: FloatArray) -> _Maximum:
    """By Newton's method, every set of the batch by itself; the loglikelihood is concave, so there is one maximum."""
    theta = np.zeros((len(a), a.shape[-1]))
    theta[:, 0] = 1.0 / np.maximum(a[..., 0].std(axis=1), 1e-9)
    value = _value(theta, a, offset, side, weight)
    for _ in range(STEPS_MAX):
        slope, hessian = _slopes(theta, a, offset, side, weight)
        hessian -= 1e-12 * np.trace(-hessian, axis1=1, axis2=2)[:, None, None] * np.eye(theta.shape[1])
        step = np.linalg.solve(-hessian, slope[..., None])[..., 0]
        part = np.ones(len(a))
        for _ in range(STEPS_MAX):
            moved = theta + part[:, None] * step
            new = np.where(
                moved[:, 0] > 0, _value(np.where(moved[:, :1] > 0, moved, theta), a, offset, side, weight), -np.inf
            )
            worse = new < value - 1e-12 * np.abs(value)
            if not worse.any():
                break
            part = np.where(worse, part / 2, part)
        theta, value = np.where(worse[:, None], theta, moved), np.where(worse, value, new)
        if (np.abs(part[:, None] * step) < 1e-9 * (1e-3 + np.abs(theta))).all():
            break
    return _Maximum(theta, value)


def _value(theta: FloatArray, a: FloatArray, offset: FloatArray, side: IntArray, weight: FloatArray) -> FloatArray:
    e = np.einsum("bnk,bk->bn", a, theta) + offset
    exact = np.log(theta[:, :1]) - 0.5 * math.log(2 * math.pi) - e**2 / 2
    return np.asarray(np.where(side == MEASURED, exact, special.log_ndtr(-side * e)) @ weight)


def _slopes(
    theta: FloatArray, a: FloatArray, offset: FloatArray, side: IntArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """First (B, K) and second (B, K, K) derivatives."""
    e = np.einsum("bnk,bk->bn", a, theta) + offset
    toward = -side * e
    hazard = np.exp(-(toward**2) / 2 - 0.5 * math.log(2 * math.pi) - special.log_ndtr(toward))
    first = weight * np.where(side == MEASURED, -e, -side * hazard)
    second = weight * np.where(side == MEASURED, -1.0, -hazard * (hazard + toward))
    measured = (side == MEASURED) @ weight
    slope = np.einsum("bn,bnk->bk", first, a)
    slope[:, 0] += measured / theta[:, 0]
    hessian = np.einsum("bn,bnk,bnl->bkl", second, a, a)
    hessian[:, 0, 0] -= measured / theta[:, 0] ** 2
    return slope, hessian
