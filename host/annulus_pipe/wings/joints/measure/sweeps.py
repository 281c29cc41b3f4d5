"""A probe's answer over frequency: where it resonates, how sharply, and how surely (Alzuhiri 2022, §9.6.3 and §9.7).

Near a resonance the amplitude of a reflection or transmission is a + b / (1 + i x), x = 2 Q (f / f0 - 1): its power is
a constant, plus a part even and a part odd in x over 1 + x^2, which no phase is needed for. A slope along the band is
the cables'. f0 and Q are fitted; given them the other four are linear. Sigma is the fit's own, of what it leaves over;
a feature that does not stand out of that, lies at the band's edge or is narrower than its samples is not told.
"""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import optimize
from annulus_pipe.vocabulary import AnnulusError

POINTS_MIN = 16  # of a sweep: six numbers are fitted
STANDS_OUT = 8.0  # sigma of what is left: noise alone has a peak of 5 in so many starts
EDGE = 0.04  # of the band: a resonance nearer to an end has one side only
STARTS = 25  # of f0 along the band
MOVED = 3.0  # sigma of two resonances: less is no shift, one of 370 by chance
QUALITIES = (4.0, 12.0, 40.0, 120.0)  # tried at each: one step is a factor of three


@dataclass(frozen=True, slots=True)
class Resonance:
    """f0_hz and its sigma, quality (f0 over the full width at half power), depth of power (0..1 of the background), all
    NaN where no resonance is told."""

    f0_hz: float
    f0_sigma_hz: float
    quality: float
    depth: float


UNKNOWN = Resonance(math.nan, math.nan, math.nan, math.nan)


def resonance(frequency_hz: FloatArray, magnitude: FloatArray) -> Resonance:
    """Of one sweep: (F,) Hz, rising, and (F,) linear magnitudes of S11 or S21, in any unit.

    Raises AnnulusError where there are too few samples, or frequencies that do not rise.
    """
    if len(frequency_hz) < POINTS_MIN:
        raise AnnulusError(f"{len(frequency_hz)} frequencies, expected a sweep of {POINTS_MIN} or more")
    if not (np.diff(frequency_hz) > 0).all() or frequency_hz[0] <= 0:
        raise AnnulusError("frequencies that do not rise, expected a sweep from low to high")
    power = magnitude.astype(float) ** 2
    scale = float(np.median(power))
    if not scale > 0:
        return UNKNOWN
    power = power / scale
    low, high = float(frequency_hz[0]), float(frequency_hz[-1])
    t = (frequency_hz - low) / (high - low)
    widest = len(t) / 3

    def terms(p: FloatArray) -> FloatArray:
        x = 2 * math.exp(p[1]) * (frequency_hz / (low + p[0] * (high - low)) - 1)
        return np.stack([np.ones_like(t), t - 0.5, 1 / (1 + x * x), x / (1 + x * x)], axis=1)

    def residual(p: FloatArray) -> FloatArray:
        a = terms(p)
        return np.asarray(power - a @ np.linalg.lstsq(a, power, rcond=None)[0])

    finest = (high + low) / (high - low) * widest / 2
    starts = [
        np.array([at, math.log(q)]) for at in np.linspace(EDGE, 1 - EDGE, STARTS) for q in QUALITIES if q < finest
    ]
    starts = starts or [np.array([0.5, math.log(QUALITIES[0])])]
    begin = min(starts, key=lambda p: float(np.sum(residual(p) ** 2)))
    done = optimize.least_squares(residual, begin, x_scale=[0.02, 0.3], max_nfev=60)
    at, quality = float(done.x[0]), math.exp(float(done.x[1]))
    left = residual(done.x)
    sigma = max(float(np.sqrt(np.sum(left**2) / (len(left) - 6))), 1e-12)
    bell = terms(done.x)
    fit = np.linalg.lstsq(bell, power, rcond=None)[0]
    feature = bell[:, 2:] @ fit[2:]
    stands = float(np.linalg.norm(feature - feature.mean())) / sigma
    f0 = low + at * (high - low)
    wide = f0 / quality / (high - low)
    if not (EDGE < at < 1 - EDGE) or stands < STANDS_OUT or wide > 1.0 or wide * len(t) < 2:
        return UNKNOWN
    covariance = np.linalg.pinv(done.jac.T @ done.jac) * sigma**2
    background = max(float(fit[0] + fit[1] * (at - 0.5)), 1e-12)
    return Resonance(f0, math.sqrt(float(covariance[0, 0])) * (high - low), quality, abs(float(fit[2])) / background)


def moved(first: Resonance, second: Resonance) -> bool | None:
    """Whether the second resonance lies elsewhere than the first; None where one of them is not known."""
    shift = abs(second.f0_hz - first.f0_hz)
    return bool(shift > MOVED * math.hypot(first.f0_sigma_hz, second.f0_sigma_hz)) if math.isfinite(shift) else None
