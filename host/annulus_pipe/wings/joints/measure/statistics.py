"""Whether a joint's features go with the strengths of its dogbones, where zero angle and sense were sought too.

The source (ch. 9) slides a feature over +-40 degrees in 81 steps, as it is and mirrored, keeps the best correlation and
gives it the ordinary p-value of a single try. Here the statistic is what was sought, the greatest |r| over all shifts
and senses, and its p-value comes from features that have nothing to do with the strengths and were sought in alike.

A feature is its Fourier series round the pipe. With the phases of its harmonics drawn anew (Theiler 1992) it is another
feature as smooth as the first; all features get the same draw, which keeps how they go together (Prichard & Theiler
1994), so that one p-value can be had for the best of all that was tried (Westfall & Young 1993). The strengths are left
as they are: their own smoothness needs no model, their angles no even spacing. Permuting dogbones is not valid where
neighbours are alike.

Assumed: under no relation a feature is a Gaussian process that is alike all round the pipe. One deep sector (a cold
side) is none, and where the strengths have one as well p <= 0.05 comes out in a third of all studies. So `related`
asks for more: that few of the feature's own rotations agree as well, which holds for any shape if the pipe's angle was
left to chance. A search over +-40 degrees covers 81 of 360 rotations, so that it can never be passed there: one
joint whose zero angle is not known cannot be told to be related. With the zero marked it can.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import stats
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.distance import distance_correlation

GRID = 360  # a feature's values round the pipe, one a degree
HARMONICS = 90  # a dogbone sees nothing finer than 4 degrees
DOGBONES_MIN = 5  # with fewer a search fits anything
TOLD_MIN = 0.8  # part of the pipe's circumference at which a feature must be told
LEVEL = 0.05  # a relation is called one below
CONSTANT = 1e-9  # of its size: what varies by less does not vary
AT_ONCE = 200  # surrogates: 200 x 162 tries x 28 pairs of dogbones are 7 MB
DECIMALS = 3  # of |r|; finer differences are of the steps in which was sought


@dataclass(frozen=True, slots=True)
class Strengths:
    """angle_deg (n,), in the dogbones' own frame, 0 <= angle < 360; energy (n,), any unit. Checked when made."""

    angle_deg: FloatArray
    energy: FloatArray

    def __post_init__(self) -> None:
        n = len(self.angle_deg)
        if n < DOGBONES_MIN:
            raise AnnulusError(f"{n} dogbones, expected at least {DOGBONES_MIN}: with fewer a search fits anything")
        if not (np.isfinite(self.angle_deg).all() and np.isfinite(self.energy).all()):
            raise AnnulusError("an angle or a strength is no number")
        wrong = (self.angle_deg < 0) | (self.angle_deg > 360)
        if wrong.any():
            raise AnnulusError(f"angle {self.angle_deg[wrong][0]:g}, expected degrees from 0 to 360")
        if self.angle_deg.max() <= 2 * math.pi:
            raise AnnulusError(
                f"no angle is over {self.angle_deg.max():g}, expected degrees from 0 to 360, not radians"
            )
        turns = np.sort(self.angle_deg % 360)
        if (np.diff(turns) == 0).any():
            raise AnnulusError(
                f"angle {turns[:-1][np.diff(turns) == 0][0]:g} is there twice, expected one dogbone each"
            )
        if np.ptp(self.energy) <= CONSTANT * np.abs(self.energy).max():
            raise AnnulusError(f"all strengths are {self.energy[0]:g}: nothing can go with what does not vary")


@dataclass(frozen=True, slots=True)
class Search:
    """What is tried: the feature at sense * angle + shift, shift from -within_deg to within_deg."""

    within_deg: float = 40.0
    step_deg: float = 1.0
    senses: tuple[int, ...] = (1, -1)

    @property
    def tried(self) -> tuple[FloatArray, FloatArray]:
        """(S,) shifts, degrees, and (S,) senses."""
        half = round(self.within_deg / self.step_deg)
        shifts = self.step_deg * np.arange(-half, half + 1)
        return np.tile(shifts, len(self.senses)), np.repeat(np.array(self.senses, float), len(shifts))


@dataclass(frozen=True, slots=True)
class Relation:
    """One feature against the strengths, where they agree best.

    p : over the whole search, against features as smooth. p_all : of this search among all features tried. p_rotated :
    against the feature's own rotations, times the number of features tried. least_p, least_p_rotated : no outcome could
    have had a smaller one. ordinary_p : as if nothing had been sought; for comparison only. chance : (N,) greatest |r|
    of features that have nothing to do with the strengths. at_dogbones : (n,) the smoothed feature where it fits best.
    distance, distance_p : the greatest bias-corrected distance correlation in the same search, and how often chance has
    a greater. It sees what is no straight line; for a look: no verdict is had of it, so that none needs correcting for.
    """

    name: str
    r: float
    shift_deg: float
    sense: int
    p: float
    p_all: float
    least_p: float
    p_rotated: float
    least_p_rotated: float
    ordinary_p: float
    distance: float
    distance_p: float
    at_dogbones: FloatArray
    chance: FloatArray = field(repr=False)

    @property
    def related(self) -> bool:
        return self.p_all <= LEVEL and self.p_rotated <= LEVEL

    @property
    def verdict(self) -> str:
        if self.related:
            return "related"
        if max(self.least_p, self.least_p_rotated) > LEVEL:
            return (
                "cannot be told, whatever had come out: too wide a search for so smooth a feature; mark the zero angle"
            )
        return "not told from chance"

    def figures(self) -> dict[str, Any]:
        """What correlate.json says of it, but for the power and the verdict."""
        return {
            "r": self.r,
            "shift_deg": self.shift_deg,
            "sense": self.sense,
            "p": self.p,
            "p_all": self.p_all,
            "least_p": self.least_p,
            "p_rotated": self.p_rotated,
            "least_p_rotated": self.least_p_rotated,
            "ordinary_p": self.ordinary_p,
            "related": self.related,
            "distance_correlation": self.distance,
            "distance_p": self.distance_p,
        }


def moving_mean(phi_deg: FloatArray, values: FloatArray, width_deg: float) -> FloatArray:
    """(GRID,) mean of a feature over width_deg, at 0, 1 .. 359 degrees, round the circle.

    phi_deg, values : (P,), rising angles; NaN where not told, over which it is drawn straight. Raises AnnulusError if
    too little is told, or if nothing varies.
    """
    known = np.isfinite(values)
    if known.mean() < TOLD_MIN:
        raise AnnulusError(f"told at {100 * known.mean():.0f} % of the angles, expected {100 * TOLD_MIN:.0f}")
    even = np.interp(np.arange(GRID), phi_deg[known], values[known], period=360)
    wave = np.fft.rfft(even) * np.sinc(np.arange(GRID // 2 + 1) * width_deg / 360)
    smooth: FloatArray = np.fft.irfft(wave, GRID)
    if np.ptp(smooth) <= CONSTANT * np.abs(smooth).max():
        raise AnnulusError("the same at all angles: nothing can go with what does not vary")
    return smooth


def correlate(
    features: Mapping[str, FloatArray], strengths: Strengths, search: Search, surrogates: int = 1999, seed: int = 0
) -> list[Relation]:
    """Each feature's best agreement with the strengths, and how often chance does as well; in the order given.

    features : (GRID,) each, as `moving_mean` makes them, all of one pipe and in one frame.
    """
    shifts, senses = search.tried
    at = _waves(strengths.angle_deg, shifts, senses)
    energy = _standard(strengths.energy)
    turns = _turns(np.random.default_rng(seed), surrogates)
    best = np.empty((surrogates + 1, len(features)))
    peaks, rotated, distances = [], [], []
    for column, values in enumerate(features.values()):
        series = np.fft.rfft(values)[1 : HARMONICS + 1]
        seen = _seen(series[None], at)[0]
        r = _standard(seen) @ energy
        peak = int(np.argmax(np.abs(r)))
        peaks.append((float(r[peak]), peak, values.mean() + seen[peak]))
        best[0, column] = np.abs(r[peak])
        turned = _rotated(series[None], strengths.angle_deg, energy[None], search)[0]
        rotated.append([min(1.0, len(features) * p) for p in (_share(turned, turned[0]), _share(turned, turned.max()))])
        apart = distance_correlation(seen, strengths.energy).max(keepdims=True)
        for some in np.array_split(np.arange(surrogates), math.ceil(surrogates / AT_ONCE)):
            drawn = _seen(series * turns[some], at)
            best[1 + some, column] = np.abs(_standard(drawn) @ energy).max(axis=1)
            apart = np.append(apart, distance_correlation(drawn, strengths.energy).max(axis=1))
        distances.append((float(apart[0]), _share(np.round(apart, DECIMALS), float(np.round(apart[0], DECIMALS)))))
    best = np.round(best, DECIMALS)
    p = _shares(best)
    least_of_all = p.min(axis=1)
    return [
        Relation(
            name,
            r,
            float(shifts[peak]),
            int(senses[peak]),
            float(p[0, column]),
            float(np.mean(least_of_all <= p[0, column])),
            _share(best[:, column], float(best[:, column].max())),
            rotated[column][0],
            rotated[column][1],
            float(stats.pearsonr(seen, strengths.energy).pvalue),
            *distances[column],
            seen,
            best[1:, column],
        )
        for column, (name, (r, peak, seen)) in enumerate(zip(features, peaks, strict=True))
    ]


def power(
    values: FloatArray, angle_deg: FloatArray, search: Search, r: float = 0.8, studies: int = 200, seed: int = 0
) -> tuple[float, float]:
    """How often a true correlation r gives p <= LEVEL, and how often it is called related: one feature, these angles.

    values : (GRID,) a feature, for its smoothness. What is not the feature in the strengths is white.
    """
    rng = np.random.default_rng(seed)
    shifts, senses = search.tried
    at = _waves(angle_deg, shifts, senses)
    series = np.fft.rfft(values)[1 : HARMONICS + 1]
    size = 2 / GRID * math.sqrt(0.5 * np.sum(np.abs(series) ** 2))  # rms of the feature round the pipe
    chance = _standard(_seen(series * _turns(rng, 199), at))
    drawn = series * _turns(rng, studies)
    seen = _seen(drawn, at)
    true = seen[np.arange(studies), rng.integers(len(shifts), size=studies)]
    energy = _standard(r / size * true + math.sqrt(1 - r * r) * rng.standard_normal(true.shape))
    found = np.abs(np.einsum("msn,mn->ms", _standard(seen), energy)).max(axis=1)
    by_chance = np.array([np.abs(chance @ one).max(axis=1) for one in energy])
    significant = (1 + (by_chance >= found[:, None]).sum(axis=1)) / (1 + by_chance.shape[1]) <= LEVEL
    turned = _rotated(drawn, angle_deg, energy, search)
    return float(significant.mean()), float(
        np.mean([t and _share(own, own[0]) <= LEVEL for t, own in zip(significant, turned, strict=True)])
    )


def _rotated(series: np.ndarray, angle_deg: FloatArray, energy: FloatArray, search: Search) -> FloatArray:
    """(M, GRID) greatest |r| in the search, the feature turned by 0, 1 .. 359 degrees; energy : (M, n), standard."""
    best = np.zeros((len(series), GRID))
    within = np.unique(np.round(search.tried[0]).astype(int) % GRID)
    for sense in search.senses:
        wave = np.zeros((len(series), len(angle_deg), GRID // 2 + 1), complex)
        at = _waves(angle_deg, np.zeros(1), np.full(1, float(sense)))[0]
        wave[:, :, 1 : HARMONICS + 1] = series[:, None] * at
        seen = _standard(np.swapaxes(np.fft.irfft(wave, GRID), 1, 2))
        size = np.abs(np.einsum("msn,mn->ms", seen, energy))
        best = np.maximum(best, np.max([np.roll(size, -shift, axis=1) for shift in within], axis=0))
    return best


def _share(all_of_them: FloatArray, one: float) -> float:
    """The share of values that reach a given one, up to rounding."""
    return float(np.mean(all_of_them >= one - 1e-9))


def _waves(angle_deg: FloatArray, shifts: FloatArray, senses: FloatArray) -> np.ndarray:
    """(S, n, HARMONICS) complex: the harmonics at every dogbone, for every try."""
    at = np.radians(senses[:, None] * angle_deg + shifts[:, None])
    return np.asarray(np.exp(1j * at[:, :, None] * np.arange(1, HARMONICS + 1)))


def _seen(series: np.ndarray, at: np.ndarray) -> FloatArray:
    """(N, S, n) features at the dogbones, less their mean round the pipe; series : (N, HARMONICS)."""
    tries, n, harmonics = at.shape
    flat = at.reshape(-1, harmonics)
    seen = series.real @ flat.real.T - series.imag @ flat.imag.T
    return np.asarray(seen.reshape(len(series), tries, n) * (2 / GRID))


def _turns(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, HARMONICS) complex, of size one, their phases even round the circle."""
    return np.asarray(np.exp(2j * math.pi * rng.random((count, HARMONICS))))


def _standard(values: FloatArray) -> FloatArray:
    """Along the last axis without mean and of length one: a product of two such is Pearson's r."""
    off = values - values.mean(axis=-1, keepdims=True)
    return np.asarray(off / np.maximum(np.linalg.norm(off, axis=-1, keepdims=True), 1e-300))


def _shares(best: FloatArray) -> FloatArray:
    """(N + 1, F): of each row, the share of all rows that do as well or better."""
    order, rows = np.sort(best, axis=0), len(best)
    below = [np.searchsorted(order[:, f], best[:, f], side="left") for f in range(best.shape[1])]
    return (rows - np.stack(below, axis=1)) / rows
