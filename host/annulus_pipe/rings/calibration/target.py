"""The projector's cones from points on flat targets whose place is known: plane by plane, ring by ring."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import optimize
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError

# By topic intrinsics (rings on drawn targets) and test_target.
TRIALS = 300  # pairs of points that a first cone is drawn through
NEAR_MM = 3.0  # and how far from it a point still counts as its own
REACH = 3.0  # robust standard deviations, where the loss turns over
OUTLIER = 5.0  # of them: left out at the end
LEAST = 60  # points a ring needs, from ..
LEAST_TARGETS = 3  # .. so many targets


@dataclass(frozen=True, slots=True, eq=False)
class TargetPoints:
    """Slits on targets: where the rays of a slit's two edges meet the target's plane. One row a slit."""

    target: NDArray[np.int64]  # (N,) which pose of the target
    ring: NDArray[np.int64]  # (N,)
    inner_mm: FloatArray  # (N, 3) camera frame
    outer_mm: FloatArray  # (N, 3)

    def take(self, which: NDArray[np.bool_]) -> "TargetPoints":
        return replace(
            self,
            target=self.target[which],
            ring=self.ring[which],
            inner_mm=self.inner_mm[which],
            outer_mm=self.outer_mm[which],
        )


@dataclass(frozen=True, slots=True, eq=False)
class TargetCones:
    """Cones fitted to target points.

    `distance_mm` (N,): signed, of every point given, from its ring's cone (Eq. 4.3). `used` (N,): the fit rests on it.
    `covariance` (6K, 6K): ring after ring half-angle rad, axis x, y, vertex x, y, z mm; from how much the targets
    disagree, since a target's pose is wrong for all its points alike.
    """

    cones: tuple[Cone, ...]
    distance_mm: FloatArray
    used: NDArray[np.bool_]
    covariance: FloatArray


def on_plane(
    camera: Camera, pixels: FloatArray, centre: FloatArray, width: FloatArray, rotation: FloatArray, shift: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) mm each, camera frame: where both edges' rays of slits at (N, 2) `pixels`, `width` (N,) px on lines from
    `centre`, meet the target at `rotation`, `shift` (target to camera, its z = 0). Alzuhiri 2022, Eq. 3.6-3.9."""
    way = pixels - centre
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    ends = []
    for side in (-0.5, 0.5):
        origins, rays = camera.lines(pixels + side * width[:, None] * way)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = ((shift - origins) @ rotation[:, 2]) / (rays @ rotation[:, 2])  # Eq. 3.9
        ends.append(origins + np.where(s > 0, s, np.nan)[:, None] * rays)  # Eq. 3.6
    return ends[0], ends[1]


def fit_cones(points: TargetPoints, rings: int, seed: int = 0) -> TargetCones:
    """Each ring's cone from its points: a first one that most agree with, then least squares with a robust loss.

    A slit's cone lies at the middle of its edges' angles. Minimised is the distance from the surface (Alzuhiri 2022,
    Eq. 4.4). Raises AnnulusError naming the ring that has too few points or targets.
    """
    rng = np.random.default_rng(seed)
    cones, distance, used = [], np.full(len(points.ring), np.nan), np.zeros(len(points.ring), bool)
    targets = int(points.target.max()) + 1 if len(points.target) else 0
    bread = np.zeros((6 * rings, 6 * rings))
    scores = np.zeros((targets, 6 * rings))
    for k in range(rings):
        mine = np.flatnonzero(points.ring == k)
        seen = len(np.unique(points.target[mine]))
        if len(mine) < LEAST or seen < LEAST_TARGETS:
            raise AnnulusError(
                f"ring {k} was read at {len(mine)} places on {seen} targets, expected {LEAST} on {LEAST_TARGETS}. "
                "Hold the target where the rings fall on it, near and far, and tilted."
            )
        inner, outer = points.inner_mm[mine], points.outer_mm[mine]
        x = _first(0.5 * (inner + outer), rng)
        scale = 1.0
        for _ in range(3):
            fit = optimize.least_squares(
                _distances, x, args=(inner, outer), loss="cauchy", f_scale=REACH * scale, x_scale=_SCALE, max_nfev=60
            )
            x = fit.x
            off = _distances(x, inner, outer)
            scale = max(robust_sigma(off), 1e-4)
        good = np.abs(off) < OUTLIER * scale
        fit = optimize.least_squares(_distances, x, args=(inner[good], outer[good]), x_scale=_SCALE, max_nfev=60)
        cones.append(_cone(fit.x))
        distance[mine] = _distances(fit.x, inner, outer)
        used[mine] = good
        part = slice(6 * k, 6 * k + 6)
        bread[part, part] = np.linalg.pinv(fit.jac.T @ fit.jac)
        for target in range(targets):
            own = points.target[mine[good]] == target
            scores[target, part] = fit.jac[own].T @ fit.fun[own]
    several = int(np.count_nonzero(scores.any(axis=1)))
    covariance = bread @ (scores.T @ scores) @ bread * several / max(several - 1, 1)
    return TargetCones(tuple(cones), distance, used, covariance)


def vertex_order(cones: tuple[Cone, ...], covariance: FloatArray) -> list[int]:
    """Rings whose vertex lies farther back than that of the ring before, beyond what the fit leaves open: a glass tube
    moves the vertex back the less, the wider the cone (Alzuhiri 2022, Fig. 4.11)."""
    out = []
    for k in range(1, len(cones)):
        step = abs(cones[k].vertex_mm[2]) - abs(cones[k - 1].vertex_mm[2])
        a, b = 6 * k + 5, 6 * k - 1
        sigma = math.sqrt(max(covariance[a, a] + covariance[b, b] - 2 * covariance[a, b], 0.0))
        if step > 2 * sigma:
            out.append(k)
    return out


_SCALE = np.array([0.01, 0.01, 0.01, 1.0, 1.0, 1.0])


def _cone(x: FloatArray) -> Cone:
    az = math.sqrt(max(1.0 - x[1] ** 2 - x[2] ** 2, 0.0))
    return Cone(float(x[0]), (float(x[1]), float(x[2]), az), (float(x[3]), float(x[4]), float(x[5])))


def _distances(x: FloatArray, inner: FloatArray, outer: FloatArray) -> FloatArray:
    """(N,) mm: distance of slits from a cone, where their two edges' mean angle is."""
    axis = np.array([x[1], x[2], math.sqrt(max(1.0 - x[1] ** 2 - x[2] ** 2, 1e-9))])
    angle, length = np.zeros(len(inner)), np.zeros(len(inner))
    for end in (inner, outer):
        v = end - x[3:6]
        along = v @ axis
        squared = np.einsum("ij,ij->i", v, v)
        angle += 0.5 * np.arctan2(np.sqrt(np.maximum(squared - along * along, 0.0)), along)
        length += 0.5 * np.sqrt(squared)
    return np.asarray(length * np.sin(x[0] - angle))


def _first(middle: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A cone about the optical axis, z = vertex + distance from the axis / tan: the line through two points that most
    others lie near."""
    away, z = np.hypot(middle[:, 0], middle[:, 1]), middle[:, 2]
    best, most = (0.45, -50.0), -1
    for _ in range(TRIALS):
        i, j = (int(v) for v in rng.integers(0, len(z), 2))
        if abs(z[j] - z[i]) < 0.02 * np.ptp(z):
            continue
        slope = (away[j] - away[i]) / (z[j] - z[i])
        if not 0.02 < slope < 10.0:
            continue
        vertex = z[i] - away[i] / slope
        count = int(np.count_nonzero(np.abs(away - slope * (z - vertex)) < NEAR_MM))
        if count > most:
            best, most = (math.atan(slope), float(vertex)), count
    return np.array([best[0], 0.0, 0.0, 0.0, 0.0, best[1]])
