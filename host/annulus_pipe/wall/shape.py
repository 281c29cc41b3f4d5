"""The pipe's own shape under its defects, and how well it is known where it was not seen.

A station's radii over the clock angle t are r = s0 + s1 cos t + s2 sin t + s3 cos 2t + s4 sin 2t, and what is left:
noise, defects, and dents that five numbers cannot follow. Over an arc that nobody saw, the five fit whatever the rest
demands: on a dented pipe they once stood 40 mm beside points that lay within 7.5 mm of a circle. So there the shape is
expected to stay near its circle, as a weak measurement; and its covariance, with what is left counted as often as
it is independent, says what it is worth anywhere round the clock.
"""

from collections.abc import Sequence

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY, nan_median, robust_sigma

# Held as a whole by test_shape.py and the benchmark topic diameter; ROUND_OF_RADIUS is the pose's SHAPE_PRIOR.
USUAL_MM = 0.2  # from the usual shape: this near is the usual shape
SPACING_MM = 5.0  # between two fits of the pipe's shape along it
WINDOW_MM = 10.0  # each side: what one fit of the pipe's shape looks at
# of the radius: how oval, or off its centre, a pipe may be before it was seen, standard deviation
ROUND_OF_RADIUS = 0.05
RADIUS_VARIES = 0.005  # of the radius: how far a station's mean radius is from those about it, standard deviation
LEAST_SIGMA_MM = 0.05  # of what is left of a station: medians of cells are no better
ALIKE = 30.0  # columns that count as one, before it is known how alike they are
ALIKE_DEG = 60.0  # what is left is alike over so much at most: what a shape of two waves leaves has three or more

_KNOWN = "f8 alike", "f8 round", "f8 tukey", "f8 of_mad"
_fit_shapes = door(
    "fit_shapes",
    "f8[c,a] lines",
    "f8[a,5] basis",
    "f8[5] usual",
    "f8 near_mm",
    "f8 least",
    *_KNOWN,
    "f8[8,a]! room",
    "f8[c,5]! fits",
)
_shape_covariances = door(
    "shape_covariances",
    "f8[c,a] lines",
    "f8[a,5] basis",
    "f8[c,5] fits",
    "f8 least",
    "f8 together",
    *_KNOWN[1:],
    "f8[8,a]! room",
    "f8[c,5,5]! out",
)
_running_medians = door("running_medians", "f8[n,k] values", "i8[m] first", "i8[m] last", "f8[n]! room", "f8[m,k]! out")


def harmonics(clock_deg: FloatArray) -> FloatArray:
    """(A, 5) columns 1, cos t, sin t, cos 2t, sin 2t of the clock angle."""
    t = np.radians(clock_deg)
    return np.stack([np.ones_like(t), np.cos(t), np.sin(t), np.cos(2 * t), np.sin(2 * t)], axis=1)


def spread(covariance: FloatArray, basis: FloatArray) -> Float32Array:
    """(Z, A) standard deviation of basis (A, n) times coefficients with covariance (Z, n, n)."""
    known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    finite = np.where(known[:, None, None], covariance, 0.0).reshape(len(covariance), -1)
    square = finite @ (basis[:, :, None] * basis[:, None, :]).reshape(len(basis), -1).T
    return np.where(known[:, None], np.sqrt(np.maximum(square, 0.0)), np.inf).astype(np.float32)


def fit_shape(grid: FloatArray, z_mm: FloatArray, clock_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(Z, 5) the shape along the pipe, and (Z, 5, 5) its covariance, mm^2.

    Parameters
    ----------
    grid : (Z, A) radii in mm, NaN where not seen. z_mm (Z,), clock_deg (A,): centres of its cells.

    Notes
    -----
    Fitted with redescending weights on windows of 20 mm, so that a defect pulls neither centre nor ovality. The mean
    radius is a median over two diameters, so that a groove all round stands out; where a window does not tell radius
    from centre and ovality (a part of a circle), these follow that median, or they would fit nothing that was seen.
    """
    centres = np.arange(z_mm[0], z_mm[-1] + SPACING_MM, SPACING_MM)
    basis = harmonics(clock_deg)
    ends = (np.searchsorted(z_mm, centres - WINDOW_MM), np.searchsorted(z_mm, centres + WINDOW_MM))
    lines = _medians(grid, *ends)
    typical = _fitted(basis, nan_median(lines)[None], np.full(5, np.nan))[0]
    fits = _fitted(basis, lines, typical)
    good = np.asarray(np.isfinite(fits[:, 0]))
    if not good.any():
        fits[:] = typical if np.isfinite(typical).all() else [float(np.nanmedian(grid)), 0.0, 0.0, 0.0, 0.0]
    covariance = _covariances(basis, lines, fits, good)
    usable = np.flatnonzero(good) if good.any() else np.arange(len(centres))
    at = centres[usable]
    far = 2.0 * float(np.median(fits[usable, 0]))  # one diameter each side
    wide = _first_reached(at, centres, (far, np.inf))
    radius = _medians(fits[usable, :1], *wide)
    _told_the_radius(fits, covariance, radius[:, 0], good)
    near = _medians(fits[usable, 1:], *_first_reached(at, centres, (1.01 * SPACING_MM, far, np.inf)))
    shape = np.stack([np.interp(z_mm, centres, column) for column in np.column_stack([radius, near]).T], axis=1)
    nearest = np.clip(np.round((z_mm - centres[0]) / SPACING_MM).astype(int), 0, len(centres) - 1)
    return shape, covariance[nearest]


def _first_reached(at: FloatArray, centres: FloatArray, reach_mm: Sequence[float]) -> tuple[IntArray, IntArray]:
    """(C,) the first and behind the last of some places `at`, rising, within the least reach of each centre that has
    any."""
    first = last = np.zeros(len(centres), np.int64)
    for far in reach_mm:
        none = first == last
        first = np.where(none, np.searchsorted(at, centres - far), first)
        last = np.where(none, np.searchsorted(at, centres + far, side="right"), last)
    return first, last


def _medians(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """(M, K) medians down the columns of (N, K) from row `first` (M,) up to `last`, NaN passed over."""
    out = np.empty((len(first), values.shape[1]))
    _running_medians(np.ascontiguousarray(values), first, last, np.empty(len(values)), out)
    return out


def _fitted(basis: FloatArray, lines: FloatArray, usual: FloatArray) -> FloatArray:
    """(C, 5) coefficients of each station by Tukey's biweight; NaN where too little was seen, less than 40 % of the way
    round. usual (5,): the pipe's shape, NaN where that is not known yet: begun from, and kept where it is seen."""
    out = np.empty((len(lines), 5))
    room = np.empty((8, lines.shape[1]))
    known = (USUAL_MM, LEAST_SIGMA_MM, ALIKE, ROUND_OF_RADIUS, TUKEY, SIGMA_OF_MAD)
    _fit_shapes(lines, basis, usual, *known, room, out)
    return out


def _covariances(basis: FloatArray, lines: FloatArray, fits: FloatArray, good: BoolArray) -> FloatArray:
    """(C, 5, 5) of each station's fit; infinite where there is none."""
    left = np.where(good[:, None], lines - fits @ basis.T, np.nan)
    out, room = np.full((len(fits), 5, 5), np.inf), np.empty((8, lines.shape[1]))
    fitted = np.where(good[:, None], fits, np.nan)
    known = (LEAST_SIGMA_MM, _alike(left), ROUND_OF_RADIUS, TUKEY, SIGMA_OF_MAD)
    _shape_covariances(lines, basis, fitted, *known, room, out)
    return out


def _alike(left: FloatArray) -> float:
    """Over how many columns the residuals of a shape are correlated, 1 or more: so many count as one observation."""
    scale = np.array([robust_sigma(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in left])
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.clip(left / np.maximum(scale, 1e-6)[:, None], -3.0, 3.0)  # a defect is not what the rest is like
    power = float(np.nanmean(unit**2)) if np.isfinite(unit).any() else 0.0
    if power <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, round(ALIKE_DEG * left.shape[1] / 360.0) + 1):
        both = unit * np.roll(unit, lag, axis=1)
        if not np.isfinite(both).any():
            break
        like = float(np.nanmean(both)) / power
        if like < 0.05:  # of one: from here on it is what chance makes it
            break
        total += 2.0 * like
    return total


def _told_the_radius(fits: FloatArray, covariance: FloatArray, radius: FloatArray, good: BoolArray) -> None:
    """Carries each station's smoothed radius into its other four numbers, as a measurement; changes both arrays."""
    for i in np.flatnonzero(good):
        gain = covariance[i, :, 0] / (covariance[i, 0, 0] + (RADIUS_VARIES * radius[i]) ** 2)
        fits[i] += gain * (radius[i] - fits[i, 0])
        covariance[i] -= np.outer(gain, covariance[i, 0])
