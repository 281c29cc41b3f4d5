"""Accuracy and precision of a gauge study: ASTM E691 and E177 of each piece, and of all pieces together.

    one = precision(values)     # (p, n): p operators (E691's laboratories) measured one piece n times each
    all = components(errors)    # (q, p, n): q pieces, the same operators, the same number of repeats

What E691 states for one piece is stated as the standard has it. Of all pieces together errors are in percent of the
diameter, and follow the two-way random model of a gauge study: error = bias + operator + operator with piece + repeat.
Its intervals are exact (chi-squared, t) but for the reproducibility's, a sum of mean squares, whose interval is that of
Graybill and Wang (1980; Burdick and Graybill, Confidence Intervals on Variance Components, 1992, section 3.2): it holds
its confidence or a little more.
"""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import stats

CONFIDENCE = 0.95  # of every interval here; a report's tolerances have the same
LIMIT = 2.8  # times a standard deviation: what two results differ by in 19 of 20 pairs; E177, 1.96 sqrt(2) rounded
SIGNIFICANCE = 0.005  # of h and k: the level of E691, section 15
FORGETS_K = 0.5  # K: temperatures of one operator and piece that differ by less say nothing of a slope; a thermometer's


@dataclass(frozen=True, slots=True)
class Interval:
    """A value with the bounds that hold at CONFIDENCE; of a standard deviation they are not symmetric."""

    value: float
    low: float
    high: float

    def holds(self, true: float) -> bool:
        return self.low <= true <= self.high


@dataclass(frozen=True, slots=True, eq=False)
class Precision:
    """One piece by E691, in the unit of the values. cell_mean, cell_sd, h, k : (p,), one an operator."""

    cell_mean: FloatArray
    cell_sd: FloatArray
    mean: float
    s_means: float
    s_r: float
    s_R: float
    h: FloatArray
    k: FloatArray
    h_critical: float
    k_critical: float

    @property
    def r(self) -> float:
        """The repeatability limit."""
        return LIMIT * self.s_r

    @property
    def R(self) -> float:
        """The reproducibility limit."""
        return LIMIT * self.s_R


def precision(values: FloatArray) -> Precision:
    """values : (p, n), p operators, n repeats each, both at least 2. Raises ValueError for less, and for NaN."""
    p, n = values.shape
    if p < 2 or n < 2:
        raise ValueError(f"{p} operators with {n} repeats each, expected 2 of both or more")
    if not np.isfinite(values).all():
        raise ValueError("a result is missing")
    means, deviations = values.mean(axis=1), values.std(axis=1, ddof=1)
    s_means = float(means.std(ddof=1))
    s_r = math.sqrt(float(np.mean(deviations**2)))
    s_R = max(s_r, math.sqrt(s_means**2 + s_r**2 * (n - 1) / n))
    return Precision(
        means,
        deviations,
        float(means.mean()),
        s_means,
        s_r,
        s_R,
        (means - means.mean()) / s_means if s_means > 0 else np.zeros(p),
        deviations / s_r if s_r > 0 else np.zeros(p),
        _h_critical(p),
        _k_critical(p, n),
    )


def _h_critical(p: int) -> float:
    """E691, Annex: of Student's t with p - 2 degrees of freedom. Two operators lie as far from their mean, whatever
    they read: h says nothing of them, and cannot be exceeded."""
    if p == 2:
        return math.inf
    t = float(stats.t.ppf(1.0 - SIGNIFICANCE / 2, p - 2))
    return (p - 1) * t / math.sqrt(p * (t * t + p - 2))


def _k_critical(p: int, n: int) -> float:
    """E691, Annex: of F with n - 1 and (p - 1)(n - 1) degrees of freedom."""
    f = float(stats.f.ppf(1.0 - SIGNIFICANCE, n - 1, (p - 1) * (n - 1)))
    return math.sqrt(p / (1.0 + (p - 1) / f))


@dataclass(frozen=True, slots=True)
class MeanSquare:
    """value : in squared percent of the diameter; dof : its degrees of freedom."""

    value: float
    dof: int


@dataclass(frozen=True, slots=True)
class Components:
    """All pieces together; percent of the diameter. shape : (q, p, n).

    per_kelvin : what an error changes by with a kelvin, and its standard deviation; None where temperatures did not
    differ while operator and piece stayed the same. Errors are then those at the mean temperature.
    """

    shape: tuple[int, int, int]
    mean: float
    pieces: MeanSquare
    operators: MeanSquare
    both: MeanSquare
    repeats: MeanSquare
    per_kelvin: tuple[float, float] | None

    def bias(self, reference_u: float = 0.0) -> Interval:
        """The mean error of these pieces as these operators measure them: what others would add is in the
        reproducibility. reference_u : standard uncertainty that the pieces' diameters have in common, percent."""
        q, p, n = self.shape
        own = self.repeats.value / (p * q * n)
        u = math.hypot(math.sqrt(own), reference_u)
        half = _t(math.inf if own == 0.0 else self.repeats.dof * (u * u / own) ** 2) * u
        return Interval(self.mean, self.mean - half, self.mean + half)

    def repeatability(self) -> Interval:
        """s_r, of one operator with one piece."""
        dof, s = self.repeats.dof, math.sqrt(self.repeats.value)
        low, high = (s * math.sqrt(dof / float(stats.chi2.ppf(part, dof))) for part in _ends()[::-1])
        return Interval(s, low, high)

    def reproducibility(self) -> Interval:
        """s_R, of any operator: what repeats, operators, and operators with pieces differ by."""
        q, _, n = self.shape
        parts = ((1 / (q * n), self.operators), ((q - 1) / (q * n), self.both), ((n - 1) / n, self.repeats))
        total = sum(c * one.value for c, one in parts)
        down = up = 0.0
        for c, one in parts:
            if one.dof == 0:
                continue
            chi_low, chi_high = (float(stats.chi2.ppf(part, one.dof)) for part in _ends())
            down += ((1.0 - one.dof / chi_high) * c * one.value) ** 2
            up += ((one.dof / chi_low - 1.0) * c * one.value) ** 2
        low, high = total - math.sqrt(down), total + math.sqrt(up)
        total = max(total, self.repeats.value)  # E691: operators who differ by less than their repeats do not differ
        return Interval(math.sqrt(total), math.sqrt(max(0.0, low)), math.sqrt(max(high, total)))


def components(errors: FloatArray, kelvin: FloatArray | None = None) -> Components:
    """Mean squares of a balanced study.

    errors : (q, p, n) percent of the diameter. kelvin : (q, p, n), each run's temperature on any scale of kelvins; NaN
    or None: not measured. Raises ValueError where operators or repeats are fewer than 2.
    """
    q, p, n = errors.shape
    if p < 2 or n < 2:
        raise ValueError(f"{p} operators with {n} repeats each, expected 2 of both or more")
    slope, errors = _levelled(errors, kelvin)
    mean = float(errors.mean())
    cell, by_piece, by_operator = errors.mean(axis=2), errors.mean(axis=(1, 2)), errors.mean(axis=(0, 2))
    within = float(np.sum((errors - cell[:, :, None]) ** 2))
    dof = q * p * (n - 1) - (slope is not None)
    both = n * float(np.sum((cell - by_piece[:, None] - by_operator[None, :] + mean) ** 2))
    if slope is not None:
        slope = (slope[0], math.sqrt(within / dof) * slope[1])
    return Components(
        (q, p, n),
        mean,
        MeanSquare(p * n * float(np.sum((by_piece - mean) ** 2)) / max(1, q - 1), q - 1),
        MeanSquare(q * n * float(np.sum((by_operator - mean) ** 2)) / (p - 1), p - 1),
        MeanSquare(both / max(1, (p - 1) * (q - 1)), (p - 1) * (q - 1)),
        MeanSquare(within / dof, dof),
        slope,
    )


def _levelled(errors: FloatArray, kelvin: FloatArray | None) -> tuple[tuple[float, float] | None, FloatArray]:
    """The slope over temperature within operator and piece (and 1 / sqrt of its sum of squares), and the errors as they
    would be at the mean temperature."""
    if kelvin is None or not np.isfinite(kelvin).all():
        return None, errors
    away = kelvin - kelvin.mean(axis=2, keepdims=True)
    if float(np.abs(away).max()) < FORGETS_K:
        return None, errors
    squares = float(np.sum(away**2))
    slope = float(np.sum(away * errors)) / squares
    return (slope, 1.0 / math.sqrt(squares)), errors - slope * (kelvin - kelvin.mean())


def _ends() -> tuple[float, float]:
    return (1.0 - CONFIDENCE) / 2, (1.0 + CONFIDENCE) / 2


def _t(dof: float) -> float:
    return float(stats.norm.ppf(_ends()[1]) if math.isinf(dof) else stats.t.ppf(_ends()[1], dof))
