"""Where the pipe is, from points on its wall that may be dented, holed or wrong."""

import math
from dataclasses import dataclass

import numpy as np

from annulus.geometry.pose import FloatArray, Pose
from annulus.rings.compiled import compiled

CAUCHY = 2.385  # 95 % efficient on clean normal errors
CLOSE = 2e-4  # the robust fit ends here, radians or parts of the radius; least squares goes the rest of the way
KEEP = 3.0  # trimmed least squares keeps residuals within this many sigma
LEAST_POINTS = 40
LEAST_TURN = 0.4  # of the way round must have points, or a circle is a guess
WORST_SPREAD = 0.08  # of the radius; beyond it this is no pipe of that radius
SHAPE_PRIOR = 1e-3  # see _step
LEAST_KEPT = 0.4  # part of the points that must lie on the cylinder


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
    Minimises (r - R) with R known (Alzuhiri 2022, Eq. 4.8, free in rx, ry, tx, ty), Cauchy loss whose scale shrinks
    with the residuals, then least squares on what lies within 3 sigma: a quadric (§3.4.3) turns by 90 degrees on a
    hole, this does not notice it. A slightly oval or odd-sized pipe would make such a loss lean the head to please half
    of the points (0.8 degrees on 2 % of ovality), so a mean and a twofold term of the radius are fitted along and
    thrown away. Should a seed lead nowhere, the fit starts again without.
    """
    if len(points_mm) < LEAST_POINTS:
        return None
    points = np.ascontiguousarray(points_mm, dtype=float)
    weight = 1.0 / np.maximum(sigma_mm, 1e-6) ** 2
    weight /= weight.mean()
    for first in (seed, Pose()) if seed is not None else (Pose(),):
        found = _descend(points, weight, radius_mm, first)
        if found is not None:
            return found
    return None


def _descend(points: FloatArray, weight: FloatArray, radius: float, first: Pose) -> Fit | None:
    x = np.array([first.rx, first.ry, first.tx, first.ty, 0.0, 0.0, 0.0])  # pose; mean, twofold cosine and sine
    error = np.empty(len(points))
    _errors(points, x, radius, error)
    scale = _spread(error)
    for _ in range(30):
        step, _ = _step(points, weight, x, radius, CAUCHY * max(scale, 1e-4 * radius), False)
        x = x + step
        _errors(points, x, radius, error)
        scale = _spread(error)
        if np.abs(step[:2]).max() < CLOSE and np.abs(step[2:]).max() < CLOSE * radius:
            break
    for _ in range(3):
        step, normal = _step(points, weight, x, radius, KEEP * max(scale, 1e-4 * radius), True)
        x = x + step
    _errors(points, x, radius, error)
    scale = _spread(error)
    kept = np.abs(error) < KEEP * max(scale, 1e-3 * radius)
    if not np.isfinite(x).all() or np.abs(x[:2]).max() > 0.8 or np.abs(x[2:]).max() > 0.8 * radius:
        return None
    pose = Pose(*(float(v) for v in x[:4]))
    wall = pose.to_pipe(points[kept])
    turn = np.bincount((np.arctan2(wall[:, 1], wall[:, 0]) * (18 / math.pi)).astype(int) % 36, minlength=36)
    if kept.mean() < LEAST_KEPT or scale > WORST_SPREAD * radius or np.count_nonzero(turn) < LEAST_TURN * 36:
        return None
    return Fit(pose, scale, np.asarray(scale**2 * np.linalg.inv(normal)[:4, :4]))


def _spread(error: FloatArray) -> float:
    middle = len(error) // 2
    return 1.4826 * float(np.partition(np.abs(error), middle)[middle])


def _step(
    points: FloatArray, weight: FloatArray, x: FloatArray, radius: float, scale: float, trimmed: bool
) -> tuple[FloatArray, FloatArray]:
    rows = np.empty((8, len(points)))
    _rows(points, weight, x, radius, scale, trimmed, rows)
    product = rows @ rows.T
    normal, right = product[:7, :7], product[:7, 7]
    size = np.array([1.0, 1.0, *[radius] * 5])  # angles and lengths alike
    normal = normal * size[:, None] * size
    # The shape is believed to be within a few percent, lest half a pipe be taken for an oval one.
    prior = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * SHAPE_PRIOR * len(points) * scale**2
    right = right * size + prior * x / size
    normal += np.diag(prior + 1e-9 * np.trace(normal))
    return np.asarray(-np.linalg.solve(normal, right) * size), normal / size[:, None] / size


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


@compiled
def _rows(points, weight, x, radius, scale, trimmed, out):  # type: ignore[no-untyped-def]
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
        if trimmed:
            w = math.sqrt(weight[n]) if abs(e) <= scale else 0.0
        else:
            w = math.sqrt(weight[n] / (1.0 + (e / scale) ** 2))
        out[0, n] = w * (cu * sb * v + cv * (ca * pz - sa * py))
        out[1, n] = w * (cu * (cb * turned - sb * px))
        out[2, n] = -w * cu * cb
        out[3, n] = -w * (cu * sb * sa + cv * ca)
        out[4, n] = -w
        out[5, n] = -w * twofold
        out[6, n] = -w * quarter
        out[7, n] = w * e
