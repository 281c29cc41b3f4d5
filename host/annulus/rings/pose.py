"""Where the pipe is, from points on its wall that may be dented, holed or wrong."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from annulus.geometry.pose import FloatArray, Pose
from annulus.rings.compiled import compiled

CAUCHY = 2.385  # 95 % efficient on clean normal errors
CLOSE = 2e-4  # the robust fit ends here, radians or parts of the radius ..
NEAR = 5e-6  # .. and the likelihood here
ROUNDS = 20  # at most, of the likelihood
TILT_PRIOR = 0.1  # radians; how far a head leans before a point has been seen, from alignment with the pipe
SHAPE_PRIOR = 0.02  # of the radius; how oval or how far from its nominal radius a pipe is
SHAPE_TOLERANCE = 0.001  # of the radius; what of that may still be there where the points do not show it
SHAPE_SHOWN = 16.3  # chi-square of the three numbers of the shape beyond which the points do show it, 1 in 1000
TILT_SHOWN = 0.02  # radians; a lean known no better than this could be an oval, and the other way round
NO_POINT = 1e-4  # density of wild points, in points a sigma, that is always reckoned with
CELL_POINTS = 12  # of a patch of wall judged as a whole ..
CELL_OFF, CELL_DOUBTED = 4.0, 1.0  # .. bad when its mean is so many sigma off, beside a bad one already from here
CELL_SOUND = 0.5  # a patch and those beside it vouch for no point when fewer than this part of theirs are likely
LEAST_POINTS = 40
LEAST_TURN = 0.4  # of the way round must have points, or a circle is a guess
WORST_SPREAD = 0.08  # of the radius; beyond it this is no pipe of that radius
LEAST_KEPT = 0.4  # part of the points that must lie on the cylinder
PARAMETERS = 7  # rx, ry, tx, ty; mean, twofold cosine and sine of the radius


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The pose, the robust spread (mm) of the points about the pipe, and how well the pose is known.

    `covariance` (4, 4): of rx, ry (radians), tx, ty (mm), in the pose's own order.
    """

    pose: Pose
    spread_mm: float
    covariance: FloatArray


def fit_pose(points_mm: FloatArray, radius_mm: float, sigma_mm: FloatArray, seed: Pose | None = None) -> Fit | None:
    """Pose of the pipe of known radius, its ovality allowed for.

    Parameters
    ----------
    points_mm : (N, 3) camera frame, finite. sigma_mm : (N,) each point's expected radial error, as weight.
    seed : first guess, such as the previous frame's pose; aligned with the camera when not given.

    Returns
    -------
    None where the points do not make a pipe: too few, not round enough the way, or spread too far.

    Notes
    -----
    Minimises (r - R) with R known (Alzuhiri 2022, Eq. 4.8, free in rx, ry, tx, ty): a quadric (§3.4.3) turns by 90
    degrees on a hole, this does not notice it. A Cauchy loss whose scale shrinks with the residuals comes near. Then
    the most likely pose if errors are normal and some points are wild, both learnt on the way, so that clean points
    count in full: as good as least squares told which points are clean. Damage hides within the noise of a point but
    not within that of a patch of wall: patches whose mean is farther off than means usually are get left out.

    A slightly oval or odd-sized pipe would lean the head to please half of the points (0.8 degrees on 2 % of
    ovality), so a mean and a twofold term of the radius are fitted along, but only where the points show them: on half
    a pipe they would cost the shift its accuracy. One ring alone does not show the lean: its points stay on the wall
    whichever way the head is turned about the ring's middle (turned far, they make an ellipse, as an oval pipe would).
    It is then left at the camera's own alignment, and the covariance says how little is known.
    Should a seed lead nowhere, the fit starts again without.
    """
    if len(points_mm) < LEAST_POINTS:
        return None
    points = np.ascontiguousarray(points_mm, dtype=float)
    weight = 1.0 / np.maximum(sigma_mm, 1e-6) ** 2
    weight /= weight.mean()
    for first in (seed, Pose()) if seed is not None else (Pose(),):
        x = _approach(points, weight, radius_mm, first)
        found = _settle(points, weight, radius_mm, x) if x is not None else None
        if found is not None:
            return found
    return None


def _approach(points: FloatArray, weight: FloatArray, radius: float, first: Pose) -> FloatArray | None:
    """(7,) near the answer, whatever part of the points is wrong; None when that led away from any pipe."""
    x = np.array([first.rx, first.ry, first.tx, first.ty, 0.0, 0.0, 0.0])
    error = np.empty(len(points))
    likely = np.empty(len(points))
    for _ in range(30):
        _errors(points, x, radius, error)
        scale = max(_spread(error), 1e-4 * radius)
        np.divide(weight, 1.0 + (error / (CAUCHY * scale)) ** 2, out=likely)
        step, _ = _step(points, likely, x, radius, scale, SHAPE_PRIOR)
        x = x + step
        if np.abs(step[:2]).max() < CLOSE and np.abs(step[2:]).max() < CLOSE * radius:
            break
    return x if _sane(x, radius) else None


def _settle(points: FloatArray, weight: FloatArray, radius: float, x: FloatArray) -> Fit | None:
    """The most likely pose near x, or None where the points about it do not make a pipe."""
    patches = _Patches(_pose(x).to_pipe(points), radius)
    root = np.sqrt(weight)
    error = np.empty(len(points))
    _errors(points, x, radius, error)
    scale = max(_spread(error * root), 1e-4 * radius)
    wild = NO_POINT / scale  # wild points, per mm of radius and per point
    shape, mildly = SHAPE_PRIOR, True
    for left in range(ROUNDS, 0, -1):
        off = error * root
        normal = np.exp(-0.5 * (off / scale) ** 2) * (0.4 / scale)
        likely = normal / (normal + wild)
        trust, unrest = patches.judge(off, likely, scale, mildly)
        likely *= trust
        sound = trust > 0.5
        known = float(likely.sum())
        if known < LEAST_KEPT * len(points):
            return None
        scale = max(math.sqrt(float(likely @ off**2) / known), 1e-4 * radius)
        away = np.abs(off[sound]) / scale
        wild = max(np.count_nonzero((away > 4) & (away < 8)) / (8 * len(away)), NO_POINT) / scale
        step, precision = _step(points, likely * weight, x, radius, scale, shape)
        x = x + step
        _errors(points, x, radius, error)
        moved = max(np.abs(step[:2]).max(), np.abs(step[2:]).max() / radius)
        if mildly:
            mildly = left > ROUNDS / 2 and moved > CLOSE
            continue
        if left > 3 and moved > NEAR:
            continue
        covariance = np.asarray((scale * unrest) ** 2 * np.linalg.inv(precision))
        if shape == SHAPE_TOLERANCE or _shows_shape(x, covariance):
            break
        shape = SHAPE_TOLERANCE
    if not _sane(x, radius) or scale > WORST_SPREAD * radius:
        return None
    pose = _pose(x)
    wall = pose.to_pipe(points[likely > 0.5])
    turn = np.bincount((np.arctan2(wall[:, 1], wall[:, 0]) * (18 / math.pi)).astype(int) % 36, minlength=36)
    if np.count_nonzero(turn) < LEAST_TURN * 36:
        return None
    return Fit(pose, _spread(error), covariance[:4, :4])


def _shows_shape(x: FloatArray, covariance: FloatArray) -> bool:
    lean = math.sqrt(max(covariance[0, 0], covariance[1, 1]))
    return lean > TILT_SHOWN or float(x[4:] @ np.linalg.solve(covariance[4:, 4:], x[4:])) > SHAPE_SHOWN


def _pose(x: FloatArray) -> Pose:
    return Pose(*(float(v) for v in x[:4]))


def _sane(x: FloatArray, radius: float) -> bool:
    return bool(np.isfinite(x).all() and np.abs(x[:2]).max() < 0.8 and np.abs(x[2:]).max() < 0.8 * radius)


class _Patches:
    """The wall cut into patches, nearly square, of a dozen points each on average."""

    def __init__(self, wall: FloatArray, radius: float) -> None:
        low, high = np.percentile(wall[:, 2], [1, 99])
        turn = 2 * math.pi * radius
        length = max(float(high - low), 0.01 * radius)
        side = math.sqrt(turn * length * CELL_POINTS / len(wall))
        columns, rows = max(round(turn / side), 8), max(round(length / side), 1)
        row = np.clip((wall[:, 2] - low) * (rows / length), 0, rows - 1).astype(np.int64)
        column = (np.arctan2(wall[:, 1], wall[:, 0]) * (columns / (2 * math.pi))).astype(np.int64) % columns
        self._shape = rows, columns
        self._cell = row * columns + column
        self._points = np.bincount(self._cell, minlength=rows * columns).astype(np.float64)

    def judge(self, off: FloatArray, likely: FloatArray, scale: float, mildly: bool) -> tuple[FloatArray, float]:
        """(N,) 0..1, how far to trust a point for its patch's sake; and how many times more the patches' means vary
        than single points say. `mildly`: a Cauchy weight, as long as the pose still leans on the damage itself.
        """
        size = self._shape[0] * self._shape[1]
        count = np.bincount(self._cell, likely, size)
        far = np.bincount(self._cell, likely * off, size) / (scale * np.sqrt(np.maximum(count, 1e-9)))
        used = count > 1.0
        if np.count_nonzero(used) < 8:
            return np.ones(len(off)), 1.0
        far[~used] = 0.0
        unrest = max(1.0, _spread(far[used]))
        far = (far / unrest).reshape(self._shape)
        if mildly:
            return np.asarray(1.0 / (1.0 + (far / CAUCHY) ** 2)).ravel()[self._cell], unrest
        bad = np.abs(far) > CELL_OFF
        around = ndimage.uniform_filter(
            np.stack([count, self._points]).reshape(2, *self._shape), (0, 1, 7), mode=("nearest", "nearest", "wrap")
        )
        if bad.any():
            # The rim of the damage: like its neighbour, if less so.
            for sign in (1.0, -1.0):
                beside = ndimage.maximum_filter(bad & (sign * far > 0), (3, 3), mode=("nearest", "wrap"))
                bad |= beside & (sign * far > CELL_DOUBTED)
        bad |= around[0] < CELL_SOUND * around[1]
        return (~bad).astype(np.float64).ravel()[self._cell], unrest


def _spread(error: FloatArray) -> float:
    middle = len(error) // 2
    return 1.4826 * float(np.partition(np.abs(error), middle)[middle])


@compiled
def _errors(points, x, radius, out):  # type: ignore[no-untyped-def]
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    for n in range(len(points)):
        px, py, pz = points[n, 0] - x[2], points[n, 1] - x[3], points[n, 2]
        u = cb * px + sb * (sa * py - ca * pz)
        v = ca * py + sa * pz
        r = math.sqrt(u * u + v * v)
        square = max(r * r, 1e-12)
        out[n] = r - radius - x[4] - x[5] * (u * u - v * v) / square - x[6] * 2.0 * u * v / square


def _step(
    points: FloatArray, weight: FloatArray, x: FloatArray, radius: float, scale: float, shape: float
) -> tuple[FloatArray, FloatArray]:
    """(7,) the next step, (7, 7) the matrix whose inverse times scale^2 is the covariance."""
    rows = np.empty((PARAMETERS + 1, len(points)))
    _rows(points, weight, x, radius, rows)
    product = rows @ rows.T
    size = np.array([1.0, 1.0, *[radius] * 5])  # angles and lengths alike
    normal = product[:-1, :-1] * size[:, None] * size
    prior = scale**2 / np.array([TILT_PRIOR, TILT_PRIOR, math.inf, math.inf, shape, shape, shape]) ** 2
    normal += np.diag(prior + 1e-12 * np.trace(normal))
    right = product[:-1, -1] * size + prior * x / size
    return np.asarray(-np.linalg.solve(normal, right) * size), normal / size[:, None] / size


@compiled
def _rows(points, weight, x, radius, out):  # type: ignore[no-untyped-def]
    """Each point's gradient and error about x, by the root of its weight; R = Rx(rx) Ry(ry), q = R^T (p - T),
    r = |q_xy|. How the twofold term turns with the pose is left out: it is small, and costs steps, not accuracy."""
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    for n in range(len(points)):
        px, py, pz = points[n, 0] - x[2], points[n, 1] - x[3], points[n, 2]
        turned = sa * py - ca * pz
        u = cb * px + sb * turned
        v = ca * py + sa * pz
        r = max(math.sqrt(u * u + v * v), 1e-9)
        cu, cv = u / r, v / r
        twofold, quarter = cu * cu - cv * cv, 2.0 * cu * cv
        e = r - radius - x[4] - x[5] * twofold - x[6] * quarter
        w = math.sqrt(weight[n])
        out[0, n] = w * (cu * sb * v + cv * (ca * pz - sa * py))
        out[1, n] = w * (cu * (cb * turned - sb * px))
        out[2, n] = -w * cu * cb
        out[3, n] = -w * (cu * sb * sa + cv * ca)
        out[4, n] = -w
        out[5, n] = -w * twofold
        out[6, n] = -w * quarter
        out[7, n] = w * e
