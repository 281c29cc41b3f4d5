"""Accuracy and precision of a gauge study: ASTM E691 and E177 of each piece, and of all pieces together.

    one = precision(values)     # (p, n): p operators (E691's laboratories) measured one piece n times each
    all = components(errors)    # (q, p, n): q pieces, the same operators, the same number of repeats

What E691 states for one piece is stated as the standard has it. Of all pieces together errors are in percent of the
diameter, and follow the random model of a gauge study: error = bias + operator + operator with piece + repeat, and
where a run shows all pieces, + run: what the head was off in that run it is off in each of them. Intervals are exact
(chi-squared, t) but for those of a sum of mean squares, which are Graybill and Wang's (1980; Burdick and Graybill,
Confidence Intervals on Variance Components, 1992, section 3.2): they hold their confidence or a little more.
"""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import stats

CONFIDENCE = 0.95  # of every interval here; a report's tolerances have the same
LIMIT = 2.8  # times a standard deviation: what two results differ by in 19 of 20 pairs; E177, 1.96 sqrt(2) rounded
SIGNIFICANCE = 0.005  # of h and k: the level of E691, section 15
SAME_K = 0.5  # K: temperatures of one operator and piece that differ by less say nothing of a slope; a thermometer's


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
class Variance:
    """A variance as independent mean squares, each times a factor."""

    terms: tuple[tuple[float, MeanSquare], ...]

    @property
    def value(self) -> float:
        """Below 0 where a difference of mean squares happens to be."""
        return sum(factor * square.value for factor, square in self.terms)

    @property
    def dof(self) -> float:
        """Degrees of freedom by Satterthwaite; infinite of what is 0."""
        spread = sum((factor * square.value) ** 2 / square.dof for factor, square in self.terms if square.dof)
        return self.value**2 / spread if spread > 0.0 else math.inf

    def times(self, factor: float) -> "Variance":
        return Variance(tuple((factor * own, square) for own, square in self.terms))

    def interval(self) -> Interval:
        """Of the standard deviation; all factors positive. Of one mean square it is exact."""
        down = up = 0.0
        for factor, square in self.terms:
            if square.dof:
                low, high = (float(stats.chi2.ppf(part, square.dof)) for part in _ends())
                down += ((1.0 - square.dof / high) * factor * square.value) ** 2
                up += ((square.dof / low - 1.0) * factor * square.value) ** 2
        ends = (self.value, self.value - math.sqrt(down), self.value + math.sqrt(up))
        return Interval(*(math.sqrt(max(0.0, end)) for end in ends))


@dataclass(frozen=True, slots=True)
class Components:
    """All pieces together; percent of the diameter. shape : (q, p, n).

    runs : of the mean errors of runs of one operator, where a run shows all pieces and what it is off they share;
    None where each run shows one. residual : within operator and piece, beyond that. per_kelvin : what an error changes
    by with a kelvin, and its standard deviation; None where temperatures did not differ while operator and piece stayed
    the same. Errors are then those at the mean temperature.
    """

    shape: tuple[int, int, int]
    mean: float
    pieces: MeanSquare
    operators: MeanSquare
    both: MeanSquare
    runs: MeanSquare | None
    residual: MeanSquare
    per_kelvin: tuple[float, float] | None

    @property
    def repeats(self) -> Variance:
        """What readings of one operator and piece differ by."""
        if self.runs is None:
            return Variance(((1.0, self.residual),))
        q = self.shape[0]
        return Variance(((1.0 / q, self.runs), (1.0 - 1.0 / q, self.residual)))

    @property
    def total(self) -> Variance:
        """What readings of any operator differ by."""
        q, _, n = self.shape
        between = ((1 / (q * n), self.operators), ((q - 1) / (q * n), self.both))
        return Variance((*between, *self.repeats.times((n - 1) / n).terms))

    @property
    def of_mean(self) -> Variance:
        """Of the mean of all readings, these pieces and operators given."""
        return Variance(((1.0 / math.prod(self.shape), self.runs or self.residual),))

    @property
    def of_operators(self) -> Variance:
        """What operators differ by, beyond what their runs and the pieces make them."""
        q, _, n = self.shape
        below = self.both if q > 1 else self.residual
        shared = () if self.runs is None else ((-1.0, self.runs), (1.0, self.residual))
        return Variance(((1.0, self.operators), (-1.0, below), *shared)).times(1.0 / (q * n))

    @property
    def of_both(self) -> Variance:
        """What an operator reads of one piece and not of the others."""
        return Variance(((1.0, self.both), (-1.0, self.residual))).times(1.0 / self.shape[2])

    @property
    def of_pieces(self) -> Variance:
        """What pieces differ by in their mean errors."""
        _, p, n = self.shape
        return Variance(((1.0, self.pieces), (-1.0, self.both))).times(1.0 / (p * n))

    def bias(self, reference_u: float = 0.0) -> Interval:
        """The mean error of these pieces as these operators measure them: what others would add is in the
        reproducibility. reference_u : standard uncertainty that the pieces' diameters have in common, percent."""
        own = self.of_mean
        u = math.hypot(math.sqrt(own.value), reference_u)
        half = _t(math.inf if own.value == 0.0 else own.dof * (u * u / own.value) ** 2) * u
        return Interval(self.mean, self.mean - half, self.mean + half)

    def repeatability(self) -> Interval:
        """s_r, of one operator with one piece."""
        return self.repeats.interval()

    def reproducibility(self) -> Interval:
        """s_R, of any operator; E691: operators who differ by less than their repeats do not differ."""
        made, least = self.total.interval(), math.sqrt(self.repeats.value)
        return Interval(max(made.value, least), made.low, max(made.high, least))


def components(errors: FloatArray, kelvin: FloatArray | None = None, *, shared: bool = False) -> Components:
    """Mean squares of a balanced study.

    errors : (q, p, n) percent of the diameter. kelvin : (q, p, n), each run's temperature on any scale of kelvins; NaN
    or None: not measured. shared : repeat i of an operator is one run through all pieces. Raises ValueError where
    operators or repeats are fewer than 2.
    """
    q, p, n = errors.shape
    if p < 2 or n < 2:
        raise ValueError(f"{p} operators with {n} repeats each, expected 2 of both or more")
    shared = shared and q > 1
    slope, errors = _levelled(errors, kelvin)
    lost = int(slope is not None)  # a degree of freedom, to the slope
    mean = float(errors.mean())
    cell, by_piece, by_operator = errors.mean(axis=2), errors.mean(axis=(1, 2)), errors.mean(axis=(0, 2))
    away = errors - cell[:, :, None]
    within, dof, runs = float(np.sum(away**2)), q * p * (n - 1), None
    if shared:
        between = q * float(np.sum(away.mean(axis=0) ** 2))
        runs = MeanSquare(between / max(1, p * (n - 1) - lost), max(1, p * (n - 1) - lost))
        residual = MeanSquare((within - between) / ((q - 1) * p * (n - 1)), (q - 1) * p * (n - 1))
    else:
        residual = MeanSquare(within / (dof - lost), dof - lost)
    both = n * float(np.sum((cell - by_piece[:, None] - by_operator[None, :] + mean) ** 2))
    if slope is not None:
        slope = (slope[0], math.sqrt((runs or residual).value) * slope[1])
    return Components(
        (q, p, n),
        mean,
        MeanSquare(p * n * float(np.sum((by_piece - mean) ** 2)) / max(1, q - 1), q - 1),
        MeanSquare(q * n * float(np.sum((by_operator - mean) ** 2)) / (p - 1), p - 1),
        MeanSquare(both / max(1, (p - 1) * (q - 1)), (p - 1) * (q - 1)),
        runs,
        residual,
        slope,
    )


def _levelled(errors: FloatArray, kelvin: FloatArray | None) -> tuple[tuple[float, float] | None, FloatArray]:
    """The slope over temperature within operator and piece (and 1 / sqrt of its sum of squares), and the errors as they
    would be at the mean temperature."""
    if kelvin is None or not np.isfinite(kelvin).all():
        return None, errors
    away = kelvin - kelvin.mean(axis=2, keepdims=True)
    if float(np.abs(away).max()) < SAME_K:
        return None, errors
    squares = float(np.sum(away**2))
    slope = float(np.sum(away * errors)) / squares
    return (slope, 1.0 / math.sqrt(squares)), errors - slope * (kelvin - kelvin.mean())


def _ends() -> tuple[float, float]:
    return (1.0 - CONFIDENCE) / 2, (1.0 + CONFIDENCE) / 2


def _t(dof: float) -> float:
    return float(stats.norm.ppf(_ends()[1]) if math.isinf(dof) else stats.t.ppf(_ends()[1], dof))
