"""What host/native/wall_shape.c fits to one station, in NumPy."""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY, biweight, robust_sigma
from annulus_pipe.wall.shape import ALIKE, LEAST_SIGMA_MM, ROUND_OF_RADIUS, USUAL_MM

ROUNDS, SHRINKS, COUNTED, SEEN, AGREE, RIDGE = 12, 0.8, 0.3, 0.4, 0.5, 1e-9


def kept_round(basis: FloatArray, seen: BoolArray, sigma: float, radius: float, alike: float) -> FloatArray:
    """(5, 5) K: what is known of centre and ovality before they were seen, as much of it as was not."""
    wave = basis[~seen]
    wave[:, 0] = 0.0
    return 2.0 * alike / len(basis) * (sigma / (ROUND_OF_RADIUS * max(radius, 1.0))) ** 2 * wave.T @ wave


def fitted(basis: FloatArray, line: FloatArray, usual: FloatArray) -> FloatArray:
    """(5,) coefficients; NaN where too little was seen."""
    seen = np.isfinite(line)
    if seen.mean() < SEEN:
        return np.full(5, np.nan)
    a, r = basis[seen], line[seen]
    centre = float(np.median(r))
    kept = kept_round(basis, seen, 1.0, centre, ALIKE)
    found = []
    if np.isfinite(usual).all():
        found = [graduated(a, r, usual + np.array([np.median(r - a @ usual), 0, 0, 0, 0]), kept)]
        if np.mean(np.abs(r - a @ found[0]) < USUAL_MM) >= AGREE:
            return found[0]
    rest = max(robust_sigma(r - centre), LEAST_SIGMA_MM)
    plain = np.linalg.solve(a.T @ a + rest**2 * kept + RIDGE * np.eye(5), a.T @ r)
    found.insert(0, graduated(a, r, plain, kept))
    common = max(min(robust_sigma(r - a @ fit) for fit in found), LEAST_SIGMA_MM)
    cost = [float(np.minimum(((r - a @ fit) / (TUKEY * common)) ** 2, 1.0).sum()) for fit in found]
    return found[int(np.argmin(cost))]


def graduated(a: FloatArray, r: FloatArray, fit: FloatArray, kept: FloatArray) -> FloatArray:
    """(5,) what a start comes to while the scale shrinks, Eq. 1 in each round."""
    scale = max(_rest(r - a @ fit), LEAST_SIGMA_MM)
    for _ in range(ROUNDS):
        u = (r - a @ fit) / (TUKEY * scale)
        if np.count_nonzero(np.abs(u) < 1) < COUNTED * len(r):
            break
        weighted = a * biweight(u)[:, None]
        fit = np.linalg.solve(weighted.T @ a + scale**2 * kept + RIDGE * np.eye(5), weighted.T @ r)
        scale = max(min(_rest(r - a @ fit), SHRINKS * scale), LEAST_SIGMA_MM)
    return fit


def _rest(left: FloatArray) -> float:
    """Robust sigma by the upper one of two medians."""
    return SIGMA_OF_MAD * float(np.sort(np.abs(left))[len(left) // 2])


def covariance(basis: FloatArray, line: FloatArray, fit: FloatArray, together: float) -> FloatArray:
    """(5, 5) mm^2, so many columns counted as one."""
    seen = np.isfinite(line)
    a, left = basis[seen], line[seen] - basis[seen] @ fit
    sigma = max(robust_sigma(left), LEAST_SIGMA_MM)
    used = biweight(left / (TUKEY * sigma))
    normal = (a * used[:, None]).T @ a + kept_round(basis, seen, sigma, fit[0], together) + RIDGE * np.eye(5)
    independent = float(used.sum()) / together
    return sigma**2 * together * independent / max(independent - 5.0, 1.0) * np.linalg.inv(normal)
