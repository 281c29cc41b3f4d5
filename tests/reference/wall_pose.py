"""The pose of a pipe as host/native/wall_pose.c finds it, to be read: whole arrays, a step a line, nothing kept.

x is rx, ry, tx, ty and a mean, a twofold cosine and sine of the radius beyond the nominal. Points (N, 3), mm.
"""

import math

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.robust import CAUCHY, SIGMA_OF_MAD

TILT_PRIOR, TILT_KEPT, TILT_UNSEEN, TILT_SHOWN = 0.1, 1e-5, 0.04, 0.008
SHAPE_PRIOR, SHAPE_TOLERANCE, SHAPE_SHOWN = 0.02, 0.001, 30.0
NO_POINT = 1e-4


def fit(points, weight, radius, seed=None, one_ring=False):
    """(pose (4,), robust sigma, covariance (4, 4)), or None."""
    if len(points) < 40:
        return None
    weight = weight / weight.mean()
    for first in ((0.0, 0.0, 0.0, 0.0),) if seed is None else (seed, (0.0, 0.0, 0.0, 0.0)):
        found = None if one_ring else fit_near(points, weight, radius, first, TILT_PRIOR)
        if one_ring or (found is not None and found[2].diagonal()[:2].max() > TILT_SHOWN**2):
            found = fit_near(points, weight, radius, (0.0, 0.0, *first[2:]), TILT_KEPT)
        if found is not None:
            return found
    return None


def fit_near(points, weight, radius, first, tilt):
    x = np.array([*first, 0.0, 0.0, 0.0])
    try:
        approach(points, weight, x, radius, tilt)
        if not sane(x, radius):
            return None
        scale, seen, covariance, p = settle(points, weight, x, radius, tilt)
    except (np.linalg.LinAlgError, ArithmeticError):  # the points do not say
        return None
    if not sane(x, radius) or not scale <= 0.08 * radius or not all_round(points, x, p):
        return None
    if tilt == TILT_KEPT:  # the head may lean all the same, with the shift that makes up for it
        along = np.vstack([np.eye(2), -np.linalg.solve(seen[2:, 2:], seen[2:, :2])])
        covariance = covariance + TILT_UNSEEN**2 * along @ along.T
    return x[:4], robust_sigma(errors(points, x, radius)), covariance[:4, :4]


def sane(x, radius):
    return bool((np.abs(x[:2]) < 0.8).all() and (np.abs(x[2:]) < 0.8 * radius).all())


def across(points, x):
    """q = R^T (p - T), R = Rx(rx) Ry(ry): (N,) each; u, v across the pipe."""
    return Pose(*x[:4]).to_pipe(points).T


def errors(points, x, radius):
    """Eq. 4.8 with the shape beside it."""
    u, v, _ = across(points, x)
    r = np.maximum(np.hypot(u, v), 1e-9)
    return r - radius - x[4] - x[5] * (u * u - v * v) / r**2 - x[6] * 2.0 * u * v / r**2


def robust_sigma(error):
    return SIGMA_OF_MAD * ranked(np.abs(error), len(error) // 2)


def ranked(values, rank):
    return float(np.sort(values)[rank]) if len(values) else 0.0


def approach(points, weight, x, radius, tilt):
    """A Cauchy loss whose scale shrinks with the residuals."""
    for _ in range(30):
        error = errors(points, x, radius)
        scale = max(robust_sigma(error), 1e-4 * radius)
        if scale < 0.01 * radius:
            break
        worth = weight / (1.0 + (error / (CAUCHY * scale)) ** 2)
        if step(points, worth, x, radius, prior(scale, radius, tilt, SHAPE_PRIOR))[0] < 2e-4:
            break


def settle(points, weight, x, radius, tilt):
    """The most likely pose where errors are normal and some points wild, both learnt on the way."""
    size, root = len(points), np.sqrt(weight)
    off = errors(points, x, radius) * root
    scale = max(robust_sigma(off), 1e-4 * radius)
    rows, columns, patch = cut(points, x, off, scale, radius)
    every = np.bincount(patch, minlength=rows * columns + 1)[:-1]
    wild, shape, mildly = NO_POINT / scale, SHAPE_TOLERANCE, True
    for left in range(20, 0, -1):
        off = errors(points, x, radius) * root
        normal = np.exp(-0.5 * (off / scale) ** 2) * (0.4 / scale)
        likely = normal / (normal + wild)
        count = np.bincount(patch, likely, rows * columns + 1)[:-1]
        total = np.bincount(patch, likely * off, rows * columns + 1)[:-1]
        unrest, trust = judge(count, total, every, rows, columns, scale, mildly)
        trusted = np.append(trust, 0.0)[patch]
        p = likely * trusted
        if not p.sum() >= 0.4 * size:
            return math.inf, None, None, None
        sound = 1 + np.count_nonzero(trusted > 0.5)
        beyond = np.count_nonzero((trusted > 0.5) & (np.abs(off) > 4.0 * scale) & (np.abs(off) < 8.0 * scale))
        scale = max(math.sqrt((p * off * off).sum() / p.sum()), 1e-4 * radius)
        wild = max(beyond / (8 * sound), NO_POINT) / scale
        known = prior(scale, radius, tilt, shape)
        moved, seen = step(points, p * weight, x, radius, known)
        if mildly:
            mildly = left > 10 and moved > 2e-4
            shape = SHAPE_TOLERANCE if mildly else SHAPE_PRIOR
            continue
        if left > 3 and moved > 2e-5:
            continue
        seen = seen + np.diag(known)
        covariance = (scale * unrest) ** 2 * np.linalg.inv(seen)
        if shape == SHAPE_TOLERANCE or math.sqrt(covariance.diagonal()[:2].max()) > TILT_SHOWN:
            break
        if x[4:] @ np.linalg.solve(covariance[4:, 4:], x[4:]) > SHAPE_SHOWN:
            break
        shape = SHAPE_TOLERANCE
    return scale, seen, covariance, p


def cut(points, x, off, scale, radius):
    """Patches of the wall, a dozen points each; beyond it, the last: rows, columns, (N,)."""
    u, v, along = across(points, x)
    near = along[np.abs(off) < 3.0 * scale]
    near = near[:: max(1, len(near) // 400)]
    low, high = ranked(near, len(near) // 100), ranked(near, len(near) - 1 - len(near) // 100)
    length = max(high - low, 0.01 * radius)
    side = math.sqrt(2.0 * math.pi * radius * length * 12 / len(off))
    columns = min(max(round(2.0 * math.pi * radius / side), 8), len(off) + 8)
    rows = min(max(round(length / side), 1), (len(off) + 8) // columns)
    row = (along - low) / length
    column = ((np.arctan2(v, u) / (2.0 * math.pi) + 1.0) * columns).astype(int) % columns
    patch = np.clip((row * rows).astype(int), 0, rows - 1) * columns + column
    return rows, columns, np.where((row >= -0.03) & (row <= 1.03), patch, rows * columns)


def judge(count, total, every, rows, columns, scale, mildly):
    """How many times more patches' means vary than single points say; how far to trust each."""
    some = count > 1.0
    far = np.where(some, total / (scale * np.sqrt(np.where(some, count, 1.0))), 0.0)
    if some.sum() < 8:
        return 1.0, np.ones(len(count))
    unrest = max(1.0, SIGMA_OF_MAD * ranked(np.abs(far[some]), int(some.sum()) // 2))
    far /= unrest
    if mildly:
        return unrest, 1.0 / (1.0 + (far / CAUCHY) ** 2)
    trust = np.ones((rows, columns))
    sparse = (count < 0.5 * every).any()
    count, every, far = (values.reshape(rows, columns) for values in (count, every, far))
    for row, column in np.ndindex(rows, columns):
        if abs(far[row, column]) > 4.0:
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in (column - 1, column, (column + 1) % columns):
                    if far[r, c] * math.copysign(1.0, far[row, column]) > 1.0:
                        trust[r, c] = 0.0
        around = [c % columns for c in range(column - 3, column + 4)]
        if sparse and count[row, around].sum() < 0.5 * (every[row, around].sum() + 3.5):
            trust[row, column] = 0.0
    return unrest, trust.ravel()


def prior(scale, radius, tilt, shape):
    """(7,) what is known beforehand, as precisions times scale^2."""
    return np.repeat([(scale / tilt) ** 2, 0.0, (scale / (shape * radius)) ** 2], [2, 2, 3])


def step(points, worth, x, radius, known):
    """Gauss-Newton; x is moved. How far, in radians or parts of the radius; what the points know, (7, 7)."""
    (ca, sa), (cb, sb) = ((math.cos(a), math.sin(a)) for a in x[:2])
    (px, py), pz = points[:, :2].T - x[2:4, None], points[:, 2]
    u, v, _ = across(points, x)
    r = np.maximum(np.hypot(u, v), 1e-9)
    cu, cv = u / r, v / r
    gradient = np.stack(
        [
            cu * sb * v + cv * (ca * pz - sa * py),
            cu * (cb * (sa * py - ca * pz) - sb * px),
            -cu * cb,
            -(cu * sb * sa + cv * ca),
            -np.ones(len(points)),
            cv * cv - cu * cu,
            -2.0 * cu * cv,
        ]
    )
    error = errors(points, x, radius)
    seen = (gradient * worth) @ gradient.T
    trace = np.trace(seen) + (worth * error * error).sum()
    size = np.repeat([1.0, radius], [2, 5])  # angles and lengths alike
    normal = seen * size * size[:, None] + np.diag(known * size**2 + 1e-12 * trace)
    np.linalg.cholesky(normal)  # or the points do not say
    taken = np.linalg.solve(normal, (gradient @ (worth * error) + known * x) * size)
    x -= taken * size
    return np.abs(taken).max(), seen


def all_round(points, x, p):
    """Whether 0.4 of 36 directions from the axis have points that count."""
    px, py = points[:, 0] - x[2] - x[1] * points[:, 2], points[:, 1] - x[3] + x[0] * points[:, 2]
    way = ((np.arctan2(py, px)[p > 1e-300] / (2.0 * math.pi) + 1.0) * 36).astype(int) % 36
    return len(set(way.tolist())) >= 0.4 * 36
