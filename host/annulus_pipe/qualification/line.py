"""A straight line through points that may be off both ways: reported depths against those that a dig found.

Maximum likelihood for known standard deviations of both coordinates (York and others, Am. J. Phys. 72 (2004) 367,
equations 13a to 13d). Where the points scatter more than those say, standard deviations of the answer are scaled up by
what they scatter more (the root of the reduced chi-square, never down).
"""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import stats

LEAST = 4  # points: with three, one degree of freedom makes an interval of 12.7 standard deviations
TURNS_MAX, SETTLED = 200, 1e-14  # of the iteration, and of the slope's change
# Part of the spread of x that its own errors may be: as much, and the slope is what the errors make of it.
NARROW = 0.5


@dataclass(frozen=True, slots=True)
class StraightLine:
    """reported = intercept_mm + slope · true; each with the half-width of its interval (Student's t).
    scatter : root of the reduced chi-square; 1 where the stated uncertainties explain the points.
    is_unity : whether intercept 0 and slope 1 lie in their joint region: each may lie in its own, and both not.
    """

    n: int
    confidence: float
    intercept_mm: float
    intercept_k_mm: float
    slope: float
    slope_k: float
    scatter: float
    is_unity: bool


def fit_line(
    x: FloatArray, y: FloatArray, x_sigma: FloatArray, y_sigma: FloatArray, confidence: float
) -> StraightLine | None:
    """(N,) mm each, sigmas k = 1, all of them finite and no pair of them both 0. None where the points cannot tell: too
    few, or spread along x by not much more than they may be off."""
    n = len(x)
    spread = float(np.std(x)) if n else 0.0
    if n < LEAST or spread == 0.0 or float(np.sqrt(np.mean(x_sigma**2))) > NARROW * spread:
        return None
    slope = float(np.polyfit(x, y, 1)[0])
    for _ in range(TURNS_MAX):
        weight = 1.0 / (y_sigma**2 + (slope * x_sigma) ** 2)
        u, v = x - np.average(x, weights=weight), y - np.average(y, weights=weight)
        beta = weight * (u * y_sigma**2 + slope * v * x_sigma**2)
        moment = float(np.sum(weight * beta * u))
        if moment == 0.0 or not math.isfinite(moment):
            return None
        before, slope = slope, float(np.sum(weight * beta * v)) / moment
        if abs(slope - before) <= SETTLED * (1.0 + abs(slope)):
            break
    else:
        return None
    weight = 1.0 / (y_sigma**2 + (slope * x_sigma) ** 2)
    x_mean, y_mean = np.average(x, weights=weight), np.average(y, weights=weight)
    intercept = float(y_mean - slope * x_mean)
    beta = weight * ((x - x_mean) * y_sigma**2 + slope * (y - y_mean) * x_sigma**2)
    adjusted = x_mean + beta  # points moved onto the line
    middle = float(np.average(adjusted, weights=weight))
    slope_variance = 1.0 / float(np.sum(weight * (adjusted - middle) ** 2))
    intercept_variance = 1.0 / float(np.sum(weight)) + middle**2 * slope_variance
    scatter = math.sqrt(float(np.sum(weight * (y - intercept - slope * x) ** 2)) / (n - 2))
    scale = max(scatter, 1.0)
    covariance = np.array([[intercept_variance, -middle * slope_variance], [-middle * slope_variance, slope_variance]])
    apart = np.array([intercept, slope - 1.0])
    distance = float(apart @ np.linalg.solve(covariance, apart)) / (2.0 * scale**2)
    k = float(stats.t.ppf((1.0 + confidence) / 2.0, n - 2)) * scale
    return StraightLine(
        n,
        confidence,
        intercept,
        k * math.sqrt(intercept_variance),
        slope,
        k * math.sqrt(slope_variance),
        scatter,
        distance <= float(stats.f.ppf(confidence, 2, n - 2)),
    )
