"""The pipe's own shape under its defects, and how well it is known where it was not seen.

A station's radii over the clock angle t are r = s0 + s1 cos t + s2 sin t + s3 cos 2t + s4 sin 2t, and what is left:
noise, defects, and dents that five numbers cannot follow. Over an arc that nobody saw, the five fit whatever the rest
demands: on a dented pipe they once stood 40 mm beside points that lay within 7.5 mm of a circle. So there the shape is
expected to stay near its circle, as a weak measurement; and its covariance, with what is left counted as often as
it is independent, says what it is worth anywhere round the clock.
"""

from collections.abc import Sequence

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.jit import jit, middle
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY, biweight, nan_median, robust_sigma

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
    lines = np.full((len(centres), len(clock_deg)), np.nan)
    for i, centre in enumerate(centres):
        lines[i] = nan_median(
            grid[np.searchsorted(z_mm, centre - WINDOW_MM) : np.searchsorted(z_mm, centre + WINDOW_MM)]
        )
    typical = _robust(basis, nan_median(lines), [])
    fits = np.array([_robust(basis, line, [typical]) for line in lines])
    good = np.asarray(np.isfinite(fits[:, 0]))
    if not good.any():
        fits[:] = typical if np.isfinite(typical).all() else [float(np.nanmedian(grid)), 0.0, 0.0, 0.0, 0.0]
    covariance = _covariances(basis, lines, fits, good)
    far = 2.0 * float(np.median(fits[good, 0] if good.any() else fits[:, 0]))  # one diameter each side
    usable = good if good.any() else ~good
    smooth_fits = np.empty_like(fits)
    for i, centre in enumerate(centres):
        wide = usable & (np.abs(centres - centre) <= far)
        smooth_fits[i, 0] = np.median(fits[wide if wide.any() else usable, 0])
    _told_the_radius(fits, covariance, smooth_fits[:, 0], good)
    for i, centre in enumerate(centres):
        close = usable & (np.abs(centres - centre) <= 1.01 * SPACING_MM)
        wide = usable & (np.abs(centres - centre) <= far)
        near = close if close.any() else wide if wide.any() else usable
        smooth_fits[i, 1:] = np.median(fits[near, 1:], axis=0)
    shape = np.stack([np.interp(z_mm, centres, column) for column in smooth_fits.T], axis=1)
    nearest = np.clip(np.round((z_mm - centres[0]) / SPACING_MM).astype(int), 0, len(centres) - 1)
    return shape, covariance[nearest]


def _covariances(basis: FloatArray, lines: FloatArray, fits: FloatArray, good: BoolArray) -> FloatArray:
    """(C, 5, 5) of each station's fit; infinite where there is none."""
    left = np.where(good[:, None], lines - fits @ basis.T, np.nan)
    out = np.full((len(fits), 5, 5), np.inf)
    alike = _alike(left)
    for i in np.flatnonzero(good):
        seen = np.isfinite(left[i])
        sigma = max(robust_sigma(left[i, seen]), LEAST_SIGMA_MM)
        used = biweight(left[i, seen] / (TUKEY * sigma))
        a = basis[seen] * np.sqrt(used)[:, None]
        normal = a.T @ a + _kept_round(basis, seen, sigma, fits[i, 0], alike)
        independent = float(used.sum()) / alike
        took = independent / max(independent - 5.0, 1.0)  # five of them went into the fit: what is left looks small
        out[i] = sigma**2 * alike * took * np.linalg.inv(normal + 1e-9 * np.eye(5))
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


def _kept_round(basis: FloatArray, seen: BoolArray, sigma: float, radius: float, alike: float) -> FloatArray:
    """(5, 5) what is known of a shape before it was seen, as much of it as was not: a normal matrix in units of
    1 / (sigma^2 alike), one unit for each of centre and ovality where nothing was seen."""
    wave = basis[~seen]
    wave[:, 0] = 0.0
    weight = 2.0 * alike / len(basis) * (sigma / (ROUND_OF_RADIUS * max(radius, 1.0))) ** 2
    return np.asarray(weight * wave.T @ wave)


def _told_the_radius(fits: FloatArray, covariance: FloatArray, radius: FloatArray, good: BoolArray) -> None:
    """Carries each station's smoothed radius into its other four numbers, as a measurement; changes both arrays."""
    for i in np.flatnonzero(good):
        gain = covariance[i, :, 0] / (covariance[i, 0, 0] + (RADIUS_VARIES * radius[i]) ** 2)
        fits[i] += gain * (radius[i] - fits[i, 0])
        covariance[i] -= np.outer(gain, covariance[i, 0])


def _robust(basis: FloatArray, line: FloatArray, starts: Sequence[FloatArray]) -> FloatArray:
    """(5,) coefficients of one station by Tukey's biweight, the best of several starts; NaN when too little was seen.

    From each start the scale shrinks in steps (graduated non-convexity), so that a smooth oval is followed and a third
    of the circle standing 2 mm out is not. Fewer than 40 % of the angles cannot carry five unknowns.
    """
    seen = np.isfinite(line)
    if seen.mean() < 0.4:
        return np.full(5, np.nan)
    a, r = basis[seen], line[seen]
    centre = float(np.median(r))
    kept = _kept_round(basis, seen, 1.0, centre, ALIKE)
    shifted = [s + np.array([np.median(r - a @ s), 0, 0, 0, 0]) for s in starts if np.isfinite(s).all()]
    found: list[FloatArray] = [_graduated(a, r, start, kept) for start in shifted]
    if found:  # the pipe's shape changes slowly: where half of the angles still show it, the rest is a defect
        usual = found[-1]
        if np.mean(np.abs(r - a @ usual) < USUAL_MM) >= 0.5:
            return usual
    rest = max(robust_sigma(r - centre), LEAST_SIGMA_MM)
    plain = np.linalg.solve(a.T @ a + rest**2 * kept + 1e-9 * np.eye(5), a.T @ r)
    found.insert(0, _graduated(a, r, plain, kept))
    common = max(min(robust_sigma(r - a @ fit) for fit in found), LEAST_SIGMA_MM)
    cost = [float(np.minimum(((r - a @ fit) / (TUKEY * common)) ** 2, 1.0).sum()) for fit in found]
    return found[int(np.argmin(cost))]


@jit
def _graduated(a, r, start, kept):  # type: ignore[no-untyped-def]
    """(5,) the fit of a (N, 5) to r (N,) that a start of (5,) comes to while the scale shrinks. kept (5, 5): what is
    known before, as a normal matrix over the square of the scale."""
    size, fit, step = len(r), start.copy(), np.empty(5)
    left, work, normal = np.empty(size), np.empty(size), np.empty((5, 5))
    scale = max(_left(a, r, fit, left, work), LEAST_SIGMA_MM)
    for _ in range(12):
        normal[:] = scale * scale * kept
        step[:] = 0.0
        counted = 0
        for n in range(size):
            u = left[n] / (TUKEY * scale)
            if abs(u) >= 1.0:
                continue
            counted += 1
            w = (1.0 - u * u) ** 2
            for i in range(5):
                step[i] += w * a[n, i] * r[n]
                for j in range(i + 1):
                    normal[i, j] += w * a[n, i] * a[n, j]
        if counted < 0.3 * size:
            break
        for i in range(5):
            normal[i, i] += 1e-9
            for j in range(i):
                normal[j, i] = normal[i, j]
        fit = np.linalg.solve(normal, step)
        scale = max(min(_left(a, r, fit, left, work), 0.8 * scale), LEAST_SIGMA_MM)
    return fit


@jit
def _left(a, r, fit, left, work):  # type: ignore[no-untyped-def]
    """Writes what a fit leaves of r, (N,), and returns its robust sigma."""
    for n in range(len(r)):
        left[n] = r[n] - (a[n, 0] * fit[0] + a[n, 1] * fit[1] + a[n, 2] * fit[2] + a[n, 3] * fit[3] + a[n, 4] * fit[4])
        work[n] = abs(left[n])
    return SIGMA_OF_MAD * middle(work, len(r))
