"""Where the pipe is, from points on its wall that may be dented, holed or wrong."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from annulus.geometry.pose import Pose
from annulus.numeric.arrays import FloatArray
from annulus.numeric.jit import jit
from annulus.numeric.robust import CAUCHY, SIGMA_OF_MAD, cauchy

# Held as a whole by test_pose.py and by the benchmark topics stabilisation (200 seeds, beside least squares told the
# clean points) and few_rings (one ring, damaged rings); not tried one by one.
CLOSE = 2e-4  # radians or parts of the radius: the robust fit ends with a step this small ..
NEAR = 2e-5  # .. and the likelihood with this
THERE = 0.01  # of the radius; points that scatter no more about it say that the pose is near enough to begin with
ROUNDS = 20  # steps of the likelihood at most
TILT_PRIOR = 0.1  # radians; how far a head leans before a point has been seen, from alignment with the pipe
SHAPE_PRIOR = 0.02  # of the radius; how oval or how far from its nominal radius a pipe is
SHAPE_TOLERANCE = 0.001  # of the radius; what of that may still be there where the points do not show it
SHAPE_SHOWN = 30.0  # chi-square of the three numbers of the shape beyond which the points do show it, one in a million
TILT_SHOWN = 0.008  # radians; a lean known no better than this could be an oval, and the other way round: then ..
TILT_KEPT = 1e-5  # radians; .. it is left at none, known no better than what the play of a head's runners allows:
TILT_UNSEEN = 0.04  # radians
NO_POINT = 1e-4  # density of wild points, in points a sigma, that is always reckoned with
CELL_POINTS = 12  # points of a patch of wall judged as a whole ..
CELL_OFF, CELL_DOUBTED = 4.0, 1.0  # .. bad when its mean is so many sigma off, beside a bad one already from here
CELL_SOUND = 0.5  # .. or when fewer than this part of the points are likely, its own and those ..
CELL_BESIDE = 7  # .. of so many patches around the pipe
BEYOND = 0.03  # of the length of wall seen; points farther off the ends than this are left out
LEAST_POINTS = 40  # points
LEAST_TURN = 0.4  # part of the way round that must have points, or a circle is a guess
WORST_SIGMA = 0.08  # of the radius; beyond it this is no pipe of that radius
LEAST_KEPT = 0.4  # part of the points that must lie on the cylinder


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The pose, the robust sigma of the points about the pipe, and how well the pose is known.

    `covariance` (4, 4): of rx, ry (radians), tx, ty (mm), in the pose's own order.
    """

    pose: Pose
    robust_sigma_mm: float
    covariance: FloatArray

    @property
    def lean_sigma_deg(self) -> float:
        """Standard deviation of the lean, in the direction in which it is known worst (of x and y)."""
        return math.degrees(math.sqrt(max(self.covariance[0, 0], self.covariance[1, 1])))


def fit_pose(
    points_mm: FloatArray, radius_mm: float, sigma_mm: FloatArray, seed: Pose | None = None, one_ring: bool = False
) -> Fit | None:
    """Pose of the pipe of known radius, its ovality allowed for.

    Parameters
    ----------
    points_mm : (N, 3) camera frame, finite. sigma_mm : (N,) each point's expected radial error, as weight.
    seed : first guess, such as the previous frame's pose; aligned with the camera when not given.
    one_ring : all points are of one ring, which does not show the lean.

    Returns
    -------
    None where the points do not make a pipe: too few, not round enough the way, or scattered too far.

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
        found = None if one_ring else _fit(points, weight, radius_mm, first, TILT_PRIOR)
        if one_ring or (found is not None and max(np.diag(found.covariance)[:2]) > TILT_SHOWN**2):
            found = _fit(points, weight, radius_mm, Pose(0.0, 0.0, first.tx, first.ty), TILT_KEPT)
        if found is not None:
            return found
    return None


def _fit(points: FloatArray, weight: FloatArray, radius: float, first: Pose, tilt: float) -> Fit | None:
    x = _approach(points, weight, radius, first, tilt)
    return _settle(points, weight, radius, x, tilt) if x is not None else None


def _approach(points: FloatArray, weight: FloatArray, radius: float, first: Pose, tilt: float) -> FloatArray | None:
    """(7,) rx, ry, tx, ty; the radius' mean, twofold cosine and sine beyond the nominal. Near the answer, whatever part
    of the points is wrong; None when that led away from any pipe.
    """
    x = np.array([first.rx, first.ry, first.tx, first.ty, 0.0, 0.0, 0.0])
    error = np.empty(len(points))
    likely, rows = np.empty(len(points)), np.empty((8, len(points)))
    for _ in range(30):
        _errors(points, x, radius, error)
        scale = max(_robust_sigma(error), 1e-4 * radius)
        if scale < THERE * radius:
            break
        np.divide(weight, 1.0 + (error / (CAUCHY * scale)) ** 2, out=likely)
        step, _ = _step(points, likely, x, radius, _prior(scale, radius, tilt, SHAPE_PRIOR), rows)
        x = x + step
        if np.abs(step[:2]).max() < CLOSE and np.abs(step[2:]).max() < CLOSE * radius:
            break
    return x if _sane(x, radius) else None


def _settle(points: FloatArray, weight: FloatArray, radius: float, x: FloatArray, tilt: float) -> Fit | None:
    """The most likely pose near x, or None where the points about it do not make a pipe."""
    root = np.sqrt(weight)
    off, likely, used = np.empty(len(points)), np.empty(len(points)), np.empty(len(points))
    rows = np.empty((8, len(points)))
    _errors(points, x, radius, off)
    scale = max(_robust_sigma(off * root), 1e-4 * radius)
    patches = _Patches(points, x, off * root, scale, radius)
    wild = NO_POINT / scale  # wild points, per mm of radius and per point
    shape, mildly = SHAPE_TOLERANCE, True  # a hole as wide as an oval's flank is a hole as long as a circle will do
    for left in range(ROUNDS, 0, -1):
        _weigh(points, root, patches.of, x, radius, scale, wild, off, likely, patches.count, patches.total)
        trust, unrest = patches.judge(scale, mildly)
        known, square, sound, beyond = _tally(off, likely, weight, trust, patches.of, scale, used)
        if known < LEAST_KEPT * len(points):
            return None
        scale = max(math.sqrt(square / known), 1e-4 * radius)
        wild = max(beyond / (8 * sound), NO_POINT) / scale
        step, seen = _step(points, used, x, radius, _prior(scale, radius, tilt, shape), rows)
        x = x + step
        moved = max(np.abs(step[:2]).max(), np.abs(step[2:]).max() / radius)
        if mildly:
            mildly = left > ROUNDS / 2 and moved > CLOSE
            shape = SHAPE_TOLERANCE if mildly else SHAPE_PRIOR
            continue
        if left > 3 and moved > NEAR:
            continue
        seen += np.diag(_prior(scale, radius, tilt, shape))
        covariance = np.asarray((scale * unrest) ** 2 * np.linalg.inv(seen))
        if shape == SHAPE_TOLERANCE or _shows_shape(x, covariance):
            break
        shape = SHAPE_TOLERANCE
    if tilt == TILT_KEPT:  # the head may lean all the same, with the shift that makes up for it
        along = np.vstack([np.eye(2), -np.linalg.solve(seen[2:, 2:], seen[2:, :2])])
        covariance += TILT_UNSEEN**2 * along @ along.T
    if not _sane(x, radius) or scale > WORST_SIGMA * radius:
        return None
    if _turn(points, x, used) < LEAST_TURN * 36:
        return None
    _errors(points, x, radius, off)
    return Fit(_pose(x), _robust_sigma(off), covariance[:4, :4])


def _shows_shape(x: FloatArray, covariance: FloatArray) -> bool:
    lean = math.sqrt(max(covariance[0, 0], covariance[1, 1]))
    return lean > TILT_SHOWN or float(x[4:] @ np.linalg.solve(covariance[4:, 4:], x[4:])) > SHAPE_SHOWN


def _pose(x: FloatArray) -> Pose:
    return Pose(*(float(v) for v in x[:4]))


def _sane(x: FloatArray, radius: float) -> bool:
    return bool(np.isfinite(x).all() and np.abs(x[:2]).max() < 0.8 and np.abs(x[2:]).max() < 0.8 * radius)


class _Patches:
    """The wall cut into patches, nearly square, of a dozen points each on average; what lies beyond is in none.

    `of` (N,) each point's patch, the last one standing for none; `count` and `total` (P + 1,) room for sums.
    """

    def __init__(self, points: FloatArray, x: FloatArray, off: FloatArray, scale: float, radius: float) -> None:
        self.of = np.empty(len(points), np.int32)
        near = points[np.abs(off) < 3 * scale]  # wild points do not say how long the wall is
        z = np.sort(_pose(x).to_pipe(near[:: max(1, len(near) // 400)])[:, 2])
        low, high = float(z[len(z) // 100]), float(z[-1 - len(z) // 100])
        length = max(high - low, 0.01 * radius)
        side = math.sqrt(2 * math.pi * radius * length * CELL_POINTS / len(points))
        columns, rows = max(round(2 * math.pi * radius / side), 8), max(round(length / side), 1)
        _assign(points, x, low, length, rows, columns, self.of)
        self._shape = rows, columns
        self._points = np.bincount(self.of, minlength=rows * columns + 1)[:-1].astype(np.float64)
        self.count, self.total = np.empty(rows * columns + 1), np.empty(rows * columns + 1)

    def judge(self, scale: float, mildly: bool) -> tuple[FloatArray, float]:
        """(P + 1,) 0..1, how far to trust a patch; and how many times more patches' means vary than single points say.

        `mildly`: a Cauchy weight, as long as the pose still leans on the damage itself.
        """
        count = self.count[:-1]
        used = count > 1.0
        if np.count_nonzero(used) < 8:
            return np.append(np.ones(len(used)), 0.0), 1.0
        far = np.where(used, self.total[:-1], 0.0) / (scale * np.sqrt(np.maximum(count, 1.0)))
        unrest = max(1.0, _robust_sigma(far[used]))
        far /= unrest
        if mildly:
            return np.append(cauchy(far / CAUCHY), 0.0), unrest
        far = far.reshape(self._shape)
        bad = np.abs(far) > CELL_OFF
        if bad.any():
            # The rim of the damage: like its neighbour, if less so.
            for sign in (1.0, -1.0):
                beside = ndimage.maximum_filter(bad & (sign * far > 0), (3, 3), mode=("nearest", "wrap"))
                bad |= beside & (sign * far > CELL_DOUBTED)
        if (count < CELL_SOUND * self._points).any():
            both = np.stack([count, self._points]).reshape(2, *self._shape)
            around = ndimage.uniform_filter1d(both, CELL_BESIDE, axis=2, mode="wrap")
            bad |= around[0] < CELL_SOUND * (around[1] + 0.5)
        return np.append(np.where(bad, 0.0, 1.0), 0.0), unrest


def _robust_sigma(error: FloatArray) -> float:
    middle = len(error) // 2
    return SIGMA_OF_MAD * float(np.partition(np.abs(error), middle)[middle])


@jit
def _assign(points, x, low, length, rows, columns, out):  # type: ignore[no-untyped-def]
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    for n in range(len(points)):
        px, py, pz = points[n, 0] - x[2], points[n, 1] - x[3], points[n, 2]
        turn = math.atan2(ca * py + sa * pz, cb * px + sb * (sa * py - ca * pz)) / (2.0 * math.pi)
        z = sb * px - cb * (sa * py - ca * pz)
        along = (z - low) / length
        if not -BEYOND <= along <= 1.0 + BEYOND:
            out[n] = rows * columns
            continue
        row = min(max(int(along * rows), 0), rows - 1)
        out[n] = row * columns + int((turn + 1.0) * columns) % columns


@jit
def _weigh(points, root, patch, x, radius, scale, wild, off, likely, count, total):  # type: ignore[no-untyped-def]
    """Each point's error, scaled to that of a mean sigma; how likely it is no wild one; sums of both for each patch."""
    _errors(points, x, radius, off)
    count[:] = 0.0
    total[:] = 0.0
    for n in range(len(points)):
        off[n] *= root[n]
        normal = math.exp(-0.5 * (off[n] / scale) ** 2) * (0.4 / scale)
        likely[n] = normal / (normal + wild)
        count[patch[n]] += likely[n]
        total[patch[n]] += likely[n] * off[n]


@jit
def _tally(off, likely, weight, trust, patch, scale, used):  # type: ignore[no-untyped-def]
    """Weights to fit with, their sum and that of the squares; of trusted patches, points and those 4..8 sigma off."""
    known, square = 0.0, 0.0
    sound, beyond = 1, 0
    for n in range(len(off)):
        p = likely[n] * trust[patch[n]]
        used[n] = p * weight[n]
        known += p
        square += p * off[n] * off[n]
        if trust[patch[n]] > 0.5:
            sound += 1
            if 4.0 * scale < abs(off[n]) < 8.0 * scale:
                beyond += 1
    return known, square, sound, beyond


@jit
def _turn(points, x, used):  # type: ignore[no-untyped-def]
    """How many of 36 directions from the pipe's axis have points that count."""
    seen = np.zeros(36, np.bool_)
    for n in range(len(points)):
        if used[n] > 0.0:
            turn = math.atan2(points[n, 1] - x[3] + x[0] * points[n, 2], points[n, 0] - x[2] - x[1] * points[n, 2])
            seen[int((turn / (2.0 * math.pi) + 1.0) * 36) % 36] = True
    return np.count_nonzero(seen)


@jit
def _errors(points, x, radius, out):  # type: ignore[no-untyped-def]
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    for n in range(len(points)):
        px, py, pz = points[n, 0] - x[2], points[n, 1] - x[3], points[n, 2]
        u = cb * px + sb * (sa * py - ca * pz)
        v = ca * py + sa * pz
        r = math.sqrt(u * u + v * v)
        square = max(r * r, 1e-12)
        out[n] = r - radius - x[4] - x[5] * (u * u - v * v) / square - x[6] * 2.0 * u * v / square


def _prior(scale: float, radius: float, tilt: float, shape: float) -> FloatArray:
    """(7,) what is known beforehand, as precisions times scale^2."""
    return np.asarray((scale / np.array([tilt, tilt, math.inf, math.inf, *[shape * radius] * 3])) ** 2)


def _step(
    points: FloatArray, weight: FloatArray, x: FloatArray, radius: float, prior: FloatArray, rows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(7,) the next step, (7, 7) what the points know: its inverse times scale^2 is the covariance. rows: (8, N) to
    work in."""
    product = np.empty((8, 8))
    _products(points, weight, x, radius, rows, product)
    size = np.array([1.0, 1.0, *[radius] * 5])  # angles and lengths alike
    normal = (product[:7, :7] + np.diag(prior)) * size[:, None] * size
    normal += 1e-12 * np.trace(product) * np.eye(7)
    return np.asarray(-np.linalg.solve(normal, (product[:7, 7] + prior * x) * size) * size), product[:7, :7]


@jit
def _products(points, weight, x, radius, rows, out):  # type: ignore[no-untyped-def]
    """Sums of products of each point's gradient and error about x, those times the root of its weight being `rows`.

    R = Rx(rx) Ry(ry), q = R^T (p - T), r = |q_xy|. How the twofold term turns with the pose is left out: it is small,
    and costs steps, not accuracy.
    """
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    for n in range(len(points)):
        px, py, pz = points[n, 0] - x[2], points[n, 1] - x[3], points[n, 2]
        turned = sa * py - ca * pz
        u = cb * px + sb * turned
        v = ca * py + sa * pz
        r = max(math.sqrt(u * u + v * v), 1e-9)
        cu, cv = u / r, v / r
        twofold, quarter = cu * cu - cv * cv, 2.0 * cu * cv
        w = math.sqrt(weight[n])
        rows[0, n] = w * (cu * sb * v + cv * (ca * pz - sa * py))
        rows[1, n] = w * (cu * (cb * turned - sb * px))
        rows[2, n] = -w * cu * cb
        rows[3, n] = -w * (cu * sb * sa + cv * ca)
        rows[4, n] = -w
        rows[5, n] = -w * twofold
        rows[6, n] = -w * quarter
        rows[7, n] = w * (r - radius - x[4] - x[5] * twofold - x[6] * quarter)
    for i in range(len(rows)):
        for j in range(i, len(rows)):
            a, b = rows[i], rows[j]
            total = 0.0
            for n in range(len(a)):
                total += a[n] * b[n]
            out[i, j] = out[j, i] = total
