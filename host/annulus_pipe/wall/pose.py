"""Where the pipe is, from points on its wall that may be dented, holed or wrong."""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import around, jit, middle, ranked
from annulus_pipe.numeric.robust import CAUCHY, SIGMA_OF_MAD

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
CELL_OFF = 4.0  # .. bad when its mean is so many sigma off ..
CELL_DOUBTED = 1.0  # .. and beside a bad one already from here ..
CELL_SOUND = 0.5  # .. or when fewer than this part of the points are likely, its own and those ..
CELL_BESIDE = 7  # .. of so many patches around the pipe
BEYOND = 0.03  # of the length of wall seen; points farther off the ends than this are left out
LEAST_POINTS = 40  # points
LEAST_TURN = 0.4  # part of the way round that must have points, or a circle is a guess
WORST_SIGMA = 0.08  # of the radius; beyond it this is no pipe of that radius
LEAST_KEPT = 0.4  # part of the points that must lie on the cylinder
BLOCK = 256  # points whose gradients stay in the fastest cache; times, not results


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
    points = np.ascontiguousarray(points_mm.T, dtype=float)  # loops then read runs of x, y and z
    weight = 1.0 / np.maximum(sigma_mm, 1e-6) ** 2
    weight /= weight.mean()
    for first in (seed, Pose()) if seed is not None else (Pose(),):
        found = None if one_ring else _fit(points, weight, radius_mm, first, TILT_PRIOR)
        if one_ring or (found is not None and max(found.covariance[0, 0], found.covariance[1, 1]) > TILT_SHOWN**2):
            found = _fit(points, weight, radius_mm, Pose(0.0, 0.0, first.tx, first.ty), TILT_KEPT)
        if found is not None:
            return found
    return None


def _fit(points: FloatArray, weight: FloatArray, radius: float, first: Pose, tilt: float) -> Fit | None:
    """The most likely pose near the first guess, or None where the points about it do not make a pipe."""
    x = np.array([first.rx, first.ry, first.tx, first.ty, 0.0, 0.0, 0.0])
    seen, covariance = np.empty((7, 7)), np.empty((7, 7))
    found, robust = _likely(points, weight, x, radius, tilt, seen, covariance)
    if not found:
        return None
    if tilt == TILT_KEPT:  # the head may lean all the same, with the shift that makes up for it
        along = np.vstack([np.eye(2), -np.linalg.solve(seen[2:, 2:], seen[2:, :2])])
        covariance += TILT_UNSEEN**2 * along @ along.T
    return Fit(Pose(*x[:4].tolist()), robust, covariance[:4, :4])


@jit
def _likely(points, weight, x, radius, tilt, seen, covariance):  # type: ignore[no-untyped-def]
    """Moves x (7,) to the most likely pose; whether the points there make a pipe, and their robust sigma."""
    used = np.empty(len(weight))
    _approach(points, weight, x, radius, tilt, used)
    if not _sane(x, radius):
        return False, np.inf
    scale, robust = _settle(points, weight, x, radius, tilt, used, seen, covariance)
    found = _sane(x, radius) and scale <= WORST_SIGMA * radius
    return found and _all_round(points, x, used), robust


@jit
def _sane(x, radius):  # type: ignore[no-untyped-def]
    return np.all(np.abs(x[:2]) < 0.8) and np.all(np.abs(x[2:]) < 0.8 * radius)


@jit
def _approach(points, weight, x, radius, tilt, likely):  # type: ignore[no-untyped-def]
    """Moves x (7,) near the answer, whatever part of the points is wrong: rx, ry, tx, ty; the radius' mean, twofold
    cosine and sine beyond the nominal."""
    error, work = np.empty(len(weight)), np.empty(len(weight))
    step, seen = np.empty(7), np.empty((7, 7))
    for _ in range(30):
        _errors(points, x, radius, error)
        scale = max(_robust_sigma(error, work), 1e-4 * radius)
        if scale < THERE * radius:
            break
        for n in range(len(weight)):
            likely[n] = weight[n] / (1.0 + (error[n] / (CAUCHY * scale)) ** 2)
        if _step(points, likely, x, radius, _prior(scale, radius, tilt, SHAPE_PRIOR), step, seen) < CLOSE:
            break


@jit
def _settle(points, weight, x, radius, tilt, used, seen, covariance):  # type: ignore[no-untyped-def]
    """Moves x (7,) on to the most likely pose; what points are worth, what they know, and the covariance, (N,) (7, 7)
    (7, 7), are written. Returns the errors' scale, inf where too few lie on the cylinder, and their robust sigma."""
    size = len(weight)
    root = np.sqrt(weight)
    off, likely, work, step = np.empty(size), np.empty(size), np.empty(size), np.empty(7)
    patch = np.empty(size, np.int32)
    _errors(points, x, radius, off)
    for n in range(size):
        off[n] *= root[n]
    scale = max(_robust_sigma(off, work), 1e-4 * radius)
    rows, columns = _cut(points, x, off, scale, radius, work, patch)
    count, total, trust = np.empty(rows * columns + 1), np.empty(rows * columns + 1), np.empty(rows * columns + 1)
    every = np.zeros(rows * columns + 1)
    for n in range(size):
        every[patch[n]] += 1.0
    wild = NO_POINT / scale  # wild points, per mm of radius and per point
    shape, mildly = SHAPE_TOLERANCE, True  # a hole as wide as an oval's flank is a hole as long as a circle will do
    for left in range(ROUNDS, 0, -1):
        _weigh(points, root, patch, x, radius, scale, wild, off, likely, count, total)
        unrest = _judge(count, total, every, rows, columns, scale, mildly, trust)
        known, square, sound, beyond = _tally(off, likely, weight, trust, patch, scale, used)
        if known < LEAST_KEPT * size:
            return np.inf, np.inf
        scale = max(math.sqrt(square / known), 1e-4 * radius)
        wild = max(beyond / (8 * sound), NO_POINT) / scale
        prior = _prior(scale, radius, tilt, shape)
        moved = _step(points, used, x, radius, prior, step, seen)
        if mildly:
            mildly = left > ROUNDS / 2 and moved > CLOSE
            shape = SHAPE_TOLERANCE if mildly else SHAPE_PRIOR
            continue
        if left > 3 and moved > NEAR:
            continue
        for i in range(7):
            seen[i, i] += prior[i]
        covariance[:] = (scale * unrest) ** 2 * np.linalg.inv(seen)
        shown = np.sqrt(max(covariance[0, 0], covariance[1, 1])) > TILT_SHOWN
        if shape == SHAPE_TOLERANCE or shown:
            break
        oval = np.ascontiguousarray(x[4:])
        if np.dot(oval, np.linalg.solve(np.ascontiguousarray(covariance[4:, 4:]), oval)) > SHAPE_SHOWN:
            break
        shape = SHAPE_TOLERANCE
    _errors(points, x, radius, off)
    return scale, _robust_sigma(off, work)


@jit
def _robust_sigma(error, work):  # type: ignore[no-untyped-def]
    for n in range(len(error)):
        work[n] = abs(error[n])
    return SIGMA_OF_MAD * middle(work, len(error))


@jit
def _cut(points, x, off, scale, radius, work, patch):  # type: ignore[no-untyped-def]
    """Cuts the wall into patches, nearly square, of a dozen points each on average, and says which is each point's,
    (N,); what lies beyond is in none, the last. Returns their rows and columns."""
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    along, near, total = np.empty(len(off)), np.empty(len(off), np.int64), 0
    for n in range(len(off)):
        px, py, pz = points[0, n] - x[2], points[1, n] - x[3], points[2, n]
        along[n] = sb * px - cb * (sa * py - ca * pz)
        near[total] = n
        total += abs(off[n]) < 3 * scale  # wild points do not say how long the wall is
    every = max(1, total // 400)
    size = (total + every - 1) // every
    for i in range(size):
        work[i] = along[near[i * every]]
    low, high = ranked(work, size, size // 100), ranked(work, size, size - 1 - size // 100)
    length = max(high - low, 0.01 * radius)
    side = math.sqrt(2 * math.pi * radius * length * CELL_POINTS / len(off))
    rows, columns = max(round(length / side), 1), max(round(2 * math.pi * radius / side), 8)
    for n in range(len(off)):
        row = (along[n] - low) / length
        if not -BEYOND <= row <= 1.0 + BEYOND:
            patch[n] = rows * columns
            continue
        px, py, pz = points[0, n] - x[2], points[1, n] - x[3], points[2, n]
        turn = math.atan2(ca * py + sa * pz, cb * px + sb * (sa * py - ca * pz)) / (2.0 * math.pi)
        patch[n] = min(max(int(row * rows), 0), rows - 1) * columns + int((turn + 1.0) * columns) % columns
    return rows, columns


@jit
def _judge(count, total, every, rows, columns, scale, mildly, trust):  # type: ignore[no-untyped-def]
    """Writes (P + 1,) 0..1, how far to trust a patch; how many times more patches' means vary than single points say.

    count, total, every (P + 1,) : of likely points, of their errors, of all points. mildly: a Cauchy weight, as long
    as the pose still leans on the damage itself.
    """
    cells = rows * columns
    far, work = np.zeros(cells), np.empty(cells)
    size, sparse = 0, False
    trust[:cells], trust[cells] = 1.0, 0.0
    for p in range(cells):
        sparse |= count[p] < CELL_SOUND * every[p]
        if count[p] > 1.0:
            far[p] = total[p] / (scale * math.sqrt(count[p]))
            work[size] = abs(far[p])
            size += 1
    if size < 8:
        return 1.0
    unrest = max(1.0, SIGMA_OF_MAD * middle(work, size))
    for p in range(cells):
        far[p] /= unrest
        if mildly:
            trust[p] = 1.0 / (1.0 + (far[p] / CAUCHY) ** 2)
    if mildly:
        return unrest
    for row in range(rows):
        for column in range(columns):
            p = row * columns + column
            if abs(far[p]) > CELL_OFF:
                # The rim of the damage: like its neighbour, if less so.
                for r in range(max(row - 1, 0), min(row + 2, rows)):
                    for c in range(column - 1, column + 2):
                        beside = far[r * columns + around(c, columns)] * math.copysign(1.0, far[p])
                        if beside > CELL_DOUBTED:
                            trust[r * columns + around(c, columns)] = 0.0
            if sparse:
                likely, there = 0.0, 0.0
                for c in range(column - CELL_BESIDE // 2, column + CELL_BESIDE // 2 + 1):
                    likely += count[row * columns + around(c, columns)]
                    there += every[row * columns + around(c, columns)]
                if likely < CELL_SOUND * (there + 0.5 * CELL_BESIDE):
                    trust[p] = 0.0
    return unrest


@jit
def _weigh(points, root, patch, x, radius, scale, wild, off, likely, count, total):  # type: ignore[no-untyped-def]
    """Each point's error, scaled to that of a mean sigma; how likely it is no wild one; sums of both for each patch."""
    _errors(points, x, radius, off)
    count[:] = 0.0
    total[:] = 0.0
    for n in range(len(off)):
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
def _all_round(points, x, used):  # type: ignore[no-untyped-def]
    """Whether enough of 36 directions from the pipe's axis have points that count."""
    seen, directions, some = np.zeros(36, np.bool_), 0, 16
    for first in range(some):  # neighbours look one way: every sixteenth is soon enough
        for n in range(first, len(used), some):
            if used[n] > 0.0:
                turn = math.atan2(points[1, n] - x[3] + x[0] * points[2, n], points[0, n] - x[2] - x[1] * points[2, n])
                way = int((turn / (2.0 * math.pi) + 1.0) * 36) % 36
                directions += not seen[way]
                seen[way] = True
                if directions >= LEAST_TURN * 36:
                    return True
    return False


@jit
def _errors(points, x, radius, out):  # type: ignore[no-untyped-def]
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    for n in range(len(out)):
        px, py, pz = points[0, n] - x[2], points[1, n] - x[3], points[2, n]
        u = cb * px + sb * (sa * py - ca * pz)
        v = ca * py + sa * pz
        r = math.sqrt(u * u + v * v)
        square = max(r * r, 1e-12)
        out[n] = r - radius - x[4] - x[5] * (u * u - v * v) / square - x[6] * 2.0 * u * v / square


@jit
def _prior(scale, radius, tilt, shape):  # type: ignore[no-untyped-def]
    """(7,) what is known beforehand, as precisions times scale^2."""
    prior = np.zeros(7)
    prior[:2] = (scale / tilt) ** 2
    prior[4:] = (scale / (shape * radius)) ** 2
    return prior


@jit
def _step(points, weight, x, radius, prior, step, seen):  # type: ignore[no-untyped-def]
    """Takes x (7,) a step on; how far, in radians or parts of the radius. seen (7, 7): what the points know; its
    inverse times scale^2 is the covariance."""
    product = np.zeros((8, 8))
    _products(points, weight, x, radius, product)
    seen[:] = product[:7, :7]
    normal, trace = np.empty((7, 7)), np.trace(product)
    for i in range(7):
        size = 1.0 if i < 2 else radius  # angles and lengths alike
        for j in range(7):
            normal[i, j] = seen[i, j] * size * (1.0 if j < 2 else radius)
        normal[i, i] += prior[i] * size * size + 1e-12 * trace
        step[i] = (product[i, 7] + prior[i] * x[i]) * size
    step[:] = np.linalg.solve(normal, step)
    moved = 0.0
    for i in range(7):
        moved = max(moved, abs(step[i]))
        x[i] -= step[i] * (1.0 if i < 2 else radius)
    return moved


@jit
def _products(points, weight, x, radius, out):  # type: ignore[no-untyped-def]
    """Sums of products of each point's gradient and error about x, times its weight: (8, 8).

    R = Rx(rx) Ry(ry), q = R^T (p - T), r = |q_xy|. How the twofold term turns with the pose is left out: it is small,
    and costs steps, not accuracy.
    """
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    rows = np.empty((8, BLOCK))
    for start in range(0, len(weight), BLOCK):
        size = min(BLOCK, len(weight) - start)
        xs, ys, zs = points[0][start:], points[1][start:], points[2][start:]
        worth = weight[start:]
        for n in range(size):
            px, py, pz = xs[n] - x[2], ys[n] - x[3], zs[n]
            turned = sa * py - ca * pz
            u = cb * px + sb * turned
            v = ca * py + sa * pz
            r = max(math.sqrt(u * u + v * v), 1e-9)
            cu, cv = u / r, v / r
            twofold, quarter = cu * cu - cv * cv, 2.0 * cu * cv
            w = math.sqrt(worth[n])
            rows[0, n] = w * (cu * sb * v + cv * (ca * pz - sa * py))
            rows[1, n] = w * (cu * (cb * turned - sb * px))
            rows[2, n] = -w * cu * cb
            rows[3, n] = -w * (cu * sb * sa + cv * ca)
            rows[4, n] = -w
            rows[5, n] = -w * twofold
            rows[6, n] = -w * quarter
            rows[7, n] = w * (r - radius - x[4] - x[5] * twofold - x[6] * quarter)
        for i in range(8):
            for j in range(i, 8):
                a, b = rows[i], rows[j]
                total = 0.0
                for n in range(size):
                    total += a[n] * b[n]
                out[i, j] += total
    for i in range(8):
        for j in range(i):
            out[i, j] = out[j, i]
