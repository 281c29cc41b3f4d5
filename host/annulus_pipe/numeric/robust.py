"""Statistics that a few wild values do not move, and the weights of fits that leave wild values behind.

Assumed: errors are normal but for a minority, less than half, that is anything. The scale is the median absolute
deviation's; a weight is of a residual over its tuning constant times that scale. With more than half wild all of it
fails unseen: who fits with these checks how much of the data still has weight.
"""

import math

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray

SIGMA_OF_MAD = 1.4826  # standard deviation of normal errors over the median of their sizes: 1 / 0.6745
TUKEY = 4.685  # sigma at which `biweight` ends: 95 % efficient on clean normal errors
CAUCHY = 2.385  # sigma at which `cauchy` is down to half: the same
ROUNDS = 20  # of expectation-maximisation


def robust_sigma(residual: FloatArray) -> float:
    """Standard deviation of residuals about zero, any shape, as their median size says; in their unit."""
    return SIGMA_OF_MAD * float(np.median(np.abs(residual)))


def biweight(u: FloatArray) -> FloatArray:
    """Tukey's weight: 1 at zero, nothing from |u| = 1 on. u : residual over the size at which it counts no more."""
    return np.where(np.abs(u) < 1, (1 - u * u) ** 2, 0.0)


def cauchy(u: FloatArray) -> FloatArray:
    """Cauchy's weight: 1 at zero, half at |u| = 1, never nothing: pulls from afar."""
    return np.asarray(1.0 / (1.0 + u**2))


def nan_median(rows: FloatArray) -> FloatArray:
    """(A,) median down the columns of (N, A), NaN passed over; NaN for an empty column, and without numpy's warning."""
    ordered = np.sort(rows, axis=0)
    n = np.isfinite(ordered).sum(axis=0)
    if not len(rows):
        return np.full(rows.shape[1], np.nan)
    low = np.take_along_axis(ordered, (np.maximum(n - 1, 0) // 2)[None], axis=0)[0]
    high = np.take_along_axis(ordered, np.minimum(n // 2, len(rows) - 1)[None], axis=0)[0]
    return np.asarray(0.5 * (low + high))


def prior_sigma(weight: FloatArray, pull: FloatArray) -> float:
    """Standard deviation about zero under which values with these weights, pulled so, are the likeliest.

    weight, pull : (N,) sums of w a^2 and w a v over the observations v = a x of each value x. Expectation-maximisation:
    the ridge of a fit whose unknowns are believed to be of one size, that size found from the data.
    """
    usual = float(np.median(weight[weight > 0])) if (weight > 0).any() else 1.0
    square = max(float(np.mean((pull / np.maximum(weight, 0.1 * usual)) ** 2)), 1e-3 / usual)
    for _ in range(ROUNDS):
        left = 1.0 / (weight + 1.0 / square)
        square = max(float(np.mean((pull * left) ** 2 + left)), 1e-3 / usual)
    return math.sqrt(square)
