"""The projector's rings found from frames of a clean pipe of known radius, the head leaning differently in each.

The light path closes: camera -> wall -> ring's cone -> camera. Each slit says how far along its line, in pixels, the
image of its ring on the pipe lies from where it was seen (Alzuhiri 2022, Eq. 4.10): that alone is safe to minimise. A
cost in angles or in millimetres weighs the far, badly seen wall most and, under noise, shrinks towards a false scale.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus.geometry.camera import Camera
from annulus.geometry.cone import Cone, intersect_cylinder
from annulus.geometry.pose import Pose
from annulus.numeric.arrays import FloatArray
from annulus.numeric.jit import jit
from annulus.numeric.robust import CAUCHY, biweight, cauchy, prior_sigma, robust_sigma
from annulus.vocabulary import AnnulusError

RAY_STEP_PX = 4.0  # rays of a sighting: at its place and so far to both sides along its line; between them a parabola
PROBE_PX = 4.0  # step of the finite differences for a slit's middle, as in triangulate
REACH_PX = 60.0  # a ring farther from a slit than this pulls no harder
DISTANCES = (
    -0.7,
    -0.25,
    0.3,
    -1.8,
    1.0,
)  # vertex beside the camera, parts of the radius, tried as starts in this order
COARSE = 32  # sightings of each ring in each frame that a start is tried with
REJECTED = 6.0  # sigma, Tukey's: 98 % efficient on normal errors, blind beyond 6 sigma
STEPS = 60
SINGULAR = 1e-11  # least eigenvalue of the normal equations, all unknowns scaled to 1
SETTLED, NEAR = 1e-6, 1e-3  # of a parameter's size: the descent ends; a start is good enough to be compared


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Slits of known ring, seen in several frames. One row a slit."""

    frame: NDArray[np.int64]  # (N,) 0..F-1
    ring: NDArray[np.int64]  # (N,) 0..K-1, innermost first
    rays: FloatArray  # (N, 3, 3) unit vectors, camera frame: RAY_STEP_PX nearer, at the slit, RAY_STEP_PX farther out
    origins: FloatArray  # (N, 3, 3) mm, where those rays start; zeros for a camera with one centre
    width: FloatArray  # (N,) px between the slit's edges; 0 where the place is that of the cone itself

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, which: NDArray[np.int64]) -> "Sightings":
        return Sightings(
            self.frame[which], self.ring[which], self.rays[which], self.origins[which], self.width[which]
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Rings and poses that fit the sightings best, and how well they are known."""

    rings: tuple[Cone, ...]
    poses: tuple[Pose, ...]
    radius_mm: float
    error_px: FloatArray  # (N,) where each slit was seen less where its ring should be, along its line; NaN = nowhere
    weight: FloatArray  # (N,) 0..1 of the robust loss
    slope_px: FloatArray  # (N,) px a rad: how a wider half-angle moves the place where a slit should be seen, and ..
    axial_px: FloatArray  # (N,) .. px a mm: how a vertex farther along its axis does, and ..
    radius_px: FloatArray  # (N,) .. px a mm: how a wider pipe does
    sigma_px: FloatArray  # (K,) spread of the errors of each ring
    alike: FloatArray  # (K,) so many neighbouring errors are worth one independent one
    covariance: FloatArray  # (6K, 6K) ring after ring: half-angle rad, axis x y, vertex x y z mm
    rival: float  # cost of the second best start that led elsewhere, over the cost of this one; inf where none did
    off_radius_mm: tuple[float, float]  # what the sightings say of the radius, less what was given, and its standard
    # deviation: infinite for a camera with one centre, whose images stay the same when everything grows alike


def sight(
    camera: Camera,
    frame: NDArray[np.int64],
    ring: NDArray[np.int64],
    pixels: FloatArray,
    centre: FloatArray,
    width: FloatArray | None = None,
) -> Sightings:
    """Sightings from (N, 2) pixels on lines through `centre` (2,) px. Drops those that the lens model cannot invert."""
    way = pixels - centre
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    places = np.stack([pixels - RAY_STEP_PX * way, pixels, pixels + RAY_STEP_PX * way], axis=1)
    origins, rays = camera.lines(places.reshape(-1, 2))
    seen = Sightings(
        np.asarray(frame, np.int64), np.asarray(ring, np.int64), rays.reshape(-1, 3, 3), origins.reshape(-1, 3, 3),
        np.zeros(len(pixels)) if width is None else np.asarray(width, float),
    )  # fmt: skip
    good = np.isfinite(seen.rays).all(axis=(1, 2)) & np.isfinite(seen.origins).all(axis=(1, 2))
    return seen.take(np.flatnonzero(good))


def calibrate(
    seen: Sightings,
    radius_mm: float,
    *,
    start: Solution | None = None,
    offsets: FloatArray | None = None,
    directions: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Solution:
    """All rings and all poses together, from a cold start.

    Parameters
    ----------
    seen : at least two frames. radius_mm : the pipe's; it alone sets the scale of the answer.
    start : an answer nearby, saves the search. offsets : (K, 2, n) rad and mm, what each ring is known to be off its
    cone, see RingCorrection. directions : so many sectors round each ring may each be off the cone
    by their own angle (lumps of the slide); 0 = none is. Only what differs between poses then tells of the cones.

    Raises
    ------
    AnnulusError where the sightings do not determine the rings: frames too few or too alike.

    Notes
    -----
    Alzuhiri 2022, §4.3.2, Alg. 2 (Alg. 1 when there is one ring). Gauss-Newton with analytic derivatives: every
    sighting touches the six numbers of its ring and the four of its pose, so the normal equations are gathered in
    small blocks. A sighting's error is where its ring's image crosses the sighting's line, found by Newton's method.
    """
    rings, frames = int(seen.ring.max()) + 1, int(seen.frame.max()) + 1
    if frames < 2:
        raise AnnulusError("one frame cannot tell the projector's place from its angles: lean the head the other way")
    fine = np.zeros((rings, 2, 0)) if offsets is None else np.ascontiguousarray(offsets)
    problem = _Problem(seen, rings, frames, radius_mm, fine)
    rival = math.inf
    report = progress or (lambda done, total: None)
    if start is not None:
        x = _pack(start)
    else:
        few = _Problem(seen.take(_thinned(seen, rings, frames)), rings, frames, radius_mm, fine)
        found: list[tuple[float, FloatArray]] = []
        for done, distance in enumerate(DISTANCES):
            report(done, len(DISTANCES) + 1)
            found.append(few.descend(few.first(distance * radius_mm), robust=True, settled=NEAR))
        found.sort(key=lambda one: one[0])
        best, x = found[0]
        far = 0.05 * radius_mm
        others = [cost for cost, other in found if abs(other[5] - x[5]) > far]
        rival = min(others, default=math.inf) / max(best, 1e-300)
    if directions:
        problem.allow_lumps(x, directions)
    for _ in range(2):  # with the slits' middles of the first round
        _, x = problem.descend(x, robust=False, settled=SETTLED)
    report(len(DISTANCES) + 1, len(DISTANCES) + 1)
    return problem.solution(x, rival)


class _Problem:
    """The sightings and the unknowns: per ring half-angle, axis x y, vertex; per frame rx, ry, tx, ty."""

    def __init__(self, seen: Sightings, rings: int, frames: int, radius: float, fine: FloatArray) -> None:
        self.seen, self.rings, self.frames, self.radius, self.fine = seen, rings, frames, radius, fine
        self.place, self.middle = np.zeros(len(seen)), np.zeros(len(seen))
        self.error, self.rows = np.empty(len(seen)), np.empty((len(seen), 11))
        self.size = np.concatenate(
            [np.tile([1.0, 1.0, 1.0, *[radius] * 3], rings), np.tile([1.0, 1.0, radius, radius], frames)]
        )
        self.members = [np.flatnonzero(seen.ring == k) for k in range(rings)]
        self.sector: NDArray[np.int64] | None = None  # (N,) of all rings' sectors; None: rings are cones
        self.lump, self.lump_weight = np.zeros(0), np.zeros(0)  # (K n,) rad, 1/rad^2 of each sector, its prior included
        self.rest = self.error  # (N,) errors less the lumps'

    def first(self, along: float) -> FloatArray:
        """Vertices `along` mm from the camera on its axis, the head in the middle of the pipe."""
        x = np.zeros(6 * self.rings + 4 * self.frames)
        w, o = self.seen.rays[:, 1], self.seen.origins[:, 1]
        outward = np.maximum(np.hypot(w[:, 0], w[:, 1]), 1e-9)
        height = o[:, 2] + (self.radius - np.hypot(o[:, 0], o[:, 1])) * w[:, 2] / outward
        angle = np.arctan2(self.radius, height - along)
        for k, mine in enumerate(self.members):
            x[6 * k], x[6 * k + 5] = np.median(angle[mine]) if len(mine) else 0.5, along
        return x

    def look(self, x: FloatArray, middles: bool = False) -> None:
        """Errors and their derivatives at x. `middles`: anew, too, where slits' cones lie between their edges."""
        cones, poses = x[: 6 * self.rings].reshape(-1, 6), x[6 * self.rings :].reshape(-1, 4)
        turns = np.stack([np.cos(poses[:, 0]), np.sin(poses[:, 0]), np.cos(poses[:, 1]), np.sin(poses[:, 1])], axis=1)
        seen = self.seen
        _errors(
            seen.frame, seen.ring, seen.rays, seen.origins, seen.width if middles else seen.width[:0], cones, poses,
            turns, self.radius, self.fine, self.place, self.middle, self.error, self.rows,
        )  # fmt: skip

    def allow_lumps(self, x: FloatArray, directions: int) -> None:
        """From here on each of so many sectors of a ring may be off the cone by its own angle."""
        turn = azimuths(self.seen, *self._unpacked(x), self.radius)
        self.sector = self.seen.ring * directions + np.minimum((turn * directions).astype(np.int64), directions - 1)
        self.lump, self.lump_weight = np.zeros(self.rings * directions), np.full(self.rings * directions, np.inf)

    def fit_lumps(self, weight: FloatArray) -> float:
        """The sectors' angles for these weights, how large they are believed to be found along; returns their loss."""
        if self.sector is None:
            self.rest = self.error
            return 0.0
        sectors = len(self.lump)
        slope = self.rows[:, 0]
        good = weight > 0
        at, w, a = self.sector[good], weight[good], slope[good]
        seen = np.bincount(at, w * a * a, sectors).astype(float)
        pull = np.bincount(at, w * a * self.error[good], sectors).astype(float)
        loss = 0.0
        for k in range(self.rings):
            own = slice(k * sectors // self.rings, (k + 1) * sectors // self.rings)
            believed = prior_sigma(seen[own], pull[own])
            self.lump_weight[own] = seen[own] + 1.0 / believed**2
            self.lump[own] = pull[own] / self.lump_weight[own]
            loss += float(np.sum((self.lump[own] / believed) ** 2)) + 2 * (own.stop - own.start) * math.log(believed)
        self.rest = self.error - slope * self.lump[self.sector]
        return loss

    def spread(self) -> FloatArray:
        """(K,) px."""
        out = np.empty(self.rings)
        for k, mine in enumerate(self.members):
            rest = np.where(np.isfinite(self.rest[mine]), self.rest[mine], REACH_PX)
            out[k] = robust_sigma(rest) if len(mine) else 1.0
        return np.maximum(out, 1e-3)

    def weights(self, scale: FloatArray, robust: bool) -> tuple[FloatArray, float]:
        """(N,) weights in 1/px^2 of the step's least squares, and the loss they come from."""
        sigma = scale[self.seen.ring]
        u = np.where(np.isfinite(self.rest), self.rest, REACH_PX) / sigma
        if robust:  # Cauchy: pulls from afar
            weight, loss = cauchy(u / CAUCHY), CAUCHY**2 * np.log1p((u / CAUCHY) ** 2)
        else:
            weight = biweight(u / REJECTED)
            loss = REJECTED**2 / 3 * (1.0 - np.clip(1.0 - (u / REJECTED) ** 2, 0.0, None) ** 3)
        return np.where(np.isfinite(self.rest), weight, 0.0) / sigma**2, float(loss.sum())

    def normal(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """J^T W J and J^T W e over all unknowns and, last, the radius."""
        k, f = self.rings, self.frames
        blocks, right = np.zeros((k, f, 11, 11)), np.zeros((k, f, 11))
        _gather(self.seen.frame, self.seen.ring, weight, self.rest, self.rows, blocks, right)
        n = 6 * k + 4 * f
        matrix, vector = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
        for ring in range(k):
            at = slice(6 * ring, 6 * ring + 6)
            matrix[at, at] = blocks[ring, :, :6, :6].sum(axis=0)
            matrix[at, 6 * k : n] = blocks[ring, :, :6, 6:10].transpose(1, 0, 2).reshape(6, -1)
            matrix[at, n:] = blocks[ring, :, :6, 10:].sum(axis=0)
            vector[at] = right[ring, :, :6].sum(axis=0)
        for frame in range(f):
            at = slice(6 * k + 4 * frame, 6 * k + 4 * frame + 4)
            matrix[at, at] = blocks[:, frame, 6:10, 6:10].sum(axis=0)
            matrix[at, n:] = blocks[:, frame, 6:10, 10:].sum(axis=0)
            vector[at] = right[:, frame, 6:10].sum(axis=0)
        matrix[n:, n:], vector[n:] = blocks[:, :, 10:, 10:].sum(axis=(0, 1)), right[:, :, 10:].sum(axis=(0, 1))
        matrix = np.triu(matrix) + np.triu(matrix, 1).T
        if self.sector is not None:  # what the lumps could take over tells nothing
            per = len(self.lump) // k
            shared = np.zeros((len(self.lump), 7 + 4 * f))
            _gather_sectors(self.seen.frame, self.sector, weight, self.rows, shared)
            for ring in range(k):
                own = slice(ring * per, (ring + 1) * per)
                columns = np.r_[6 * ring : 6 * ring + 6, 6 * k : n + 1]
                part = shared[own] / np.sqrt(self.lump_weight[own])[:, None]
                matrix[np.ix_(columns, columns)] -= part.T @ part
        return matrix, vector

    def descend(
        self, x: FloatArray, robust: bool, settled: float, poses_only: bool = False
    ) -> tuple[float, FloatArray]:
        """Levenberg-Marquardt; the loss's scale follows the errors down. Returns the cost in px^2 and the place."""
        free = np.arange(6 * self.rings if poses_only else 0, len(x))
        damping, sizes = 1e-3, self.size[free]
        self.look(x, middles=True)
        for _ in range(STEPS):
            scale = self.spread()
            weight, loss = self.weights(scale, robust)
            if self.sector is not None:
                self.fit_lumps(weight)
                scale = self.spread()
                weight, _ = self.weights(scale, robust)
                held = self.fit_lumps(weight)
                loss = self.weights(scale, robust)[1] + held
            matrix, vector = self.normal(weight)
            a, b = matrix[np.ix_(free, free)] * sizes[:, None] * sizes, vector[free] * sizes
            moved = 0.0
            for _ in range(8):
                step = np.linalg.solve(a + np.diag(damping * np.diag(a) + 1e-12 * np.trace(a)), b)
                trial = x.copy()
                trial[free] += step * sizes
                self.look(trial)
                held = self.fit_lumps(weight)
                if self.weights(scale, robust)[1] + held <= loss:
                    x, moved, damping = trial, float(np.abs(step).max()), max(damping / 10, 1e-9)
                    break
                if np.abs(step).max() < settled:
                    break
                damping *= 10
            if moved < settled:
                break
        self.look(x, middles=True)
        self.fit_lumps(weight)
        self.last_weight = weight
        size = np.where(np.isfinite(self.error), np.minimum(np.abs(self.error), REACH_PX), REACH_PX)
        return float(np.mean(np.minimum(size, 10 * np.median(size)) ** 2)), x

    def solution(self, x: FloatArray, rival: float) -> Solution:
        self.look(x, middles=True)
        self.fit_lumps(np.ones(len(self.seen)) if self.sector is None else self.last_weight)
        scale = self.spread()
        weight, _ = self.weights(scale, robust=False)
        n, inner = len(x), 6 * self.rings
        relative = weight * scale[self.seen.ring] ** 2
        alike = self._alike(relative)
        rest = self.rest.copy()
        honest = weight / alike[self.seen.ring]
        self.fit_lumps(honest)  # so that what they may take over is counted with these weights
        matrix, vector = self.normal(honest)
        self.rest = rest
        unit = 1.0 / np.sqrt(np.maximum(np.diag(matrix)[:n], 1e-300))
        values, vectors = np.linalg.eigh(matrix[:n, :n] * unit[:, None] * unit)
        if values[0] < SINGULAR:
            raise AnnulusError("the poses are all alike: they leave the projector's place open")
        half = vectors[:inner] * unit[:inner, None] / np.sqrt(values)
        cover = half @ half.T
        of_radius = (vectors.T @ (unit * matrix[:n, n])) / np.sqrt(values)
        known = matrix[n, n] - of_radius @ of_radius  # 1/mm^2, all other unknowns free
        pulled = vector[n] - of_radius @ ((vectors.T @ (unit * vector[:n])) / np.sqrt(values))
        off = (float(pulled / known), float(known**-0.5)) if known > 1e-9 * matrix[n, n] else (0.0, math.inf)
        rings, poses = self._unpacked(x)
        return Solution(
            rings, poses, self.radius,
            self.error.copy(), relative, self.rows[:, 0].copy(), self._axial(x), self.rows[:, 10].copy(),
            scale, alike, cover, rival, off,
        )  # fmt: skip

    def _unpacked(self, x: FloatArray) -> tuple[tuple[Cone, ...], tuple[Pose, ...]]:
        cones, poses = x[: 6 * self.rings].reshape(-1, 6), x[6 * self.rings :].reshape(-1, 4)
        return tuple(_cone(c) for c in cones), tuple(Pose(*(float(v) for v in p)) for p in poses)

    def _axial(self, x: FloatArray) -> FloatArray:
        cones = x[: 6 * self.rings].reshape(-1, 6)
        axis = np.column_stack([cones[:, 1:3], np.sqrt(np.maximum(1.0 - (cones[:, 1:3] ** 2).sum(axis=1), 0.0))])
        return np.asarray((self.rows[:, 3:6] * axis[self.seen.ring]).sum(axis=1))

    def _alike(self, weight: FloatArray) -> FloatArray:
        """(K,) sum of the errors' autocorrelation along their rings: neighbours share noise, and what is no cone."""
        out = np.ones(self.rings)
        for k, mine in enumerate(self.members):
            e = np.where(weight[mine] > 0, self.rest[mine], 0.0)
            frame = self.seen.frame[mine]
            square = float(e @ e)
            for lag in range(1, min(60, len(e) // 4)):
                same = frame[lag:] == frame[:-lag]
                part = float((e[lag:] * e[:-lag])[same].sum()) / max(square, 1e-300)
                if part < 0.05:
                    break
                out[k] += 2.0 * part
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A pipe as rings measure it, frame by frame, the poses as found from the rings."""

    error_px: FloatArray  # (N,) where each slit was seen less where it should be; NaN where it has no weight, and ..
    off_mm: FloatArray  # (N,) .. the wall's radius less the pipe's there
    off_radius_mm: FloatArray  # (F,) the same for each frame's pipe as a whole, and ..
    sigma_mm: FloatArray  # (F,) .. its standard deviation

    def rms_mm(self, which: NDArray[np.bool_] | slice = slice(None)) -> float:
        return float(np.sqrt(np.nanmean(self.off_mm[which] ** 2)))


def measure(seen: Sightings, solution: Solution, poses: Sequence[Pose], offsets: FloatArray | None = None) -> Measured:
    """Measure frames with a solution's rings, starting from `poses` of them. offsets : (K, 2, n), see `calibrate`."""
    rings, frames = len(solution.rings), len(poses)
    fine = np.zeros((rings, 2, 0)) if offsets is None else offsets
    px, mm, of_frame, sigma = (np.full(n, np.nan) for n in (len(seen), len(seen), frames, frames))
    for j, pose in enumerate(poses):
        mine = np.flatnonzero(seen.frame == j)
        one = replace(seen.take(mine), frame=np.zeros(len(mine), np.int64))
        problem = _Problem(one, rings, 1, solution.radius_mm, fine)
        problem.descend(_pack(replace(solution, poses=(pose,))), robust=False, settled=SETTLED, poses_only=True)
        weight, _ = problem.weights(problem.spread(), robust=False)
        px[mine] = np.where(weight > 0, problem.error, np.nan)
        mm[mine] = px[mine] / problem.rows[:, 10]
        matrix, vector = problem.normal(weight / solution.alike[one.ring])
        own = [*range(6 * rings, 6 * rings + 5)]
        cover = np.linalg.inv(matrix[np.ix_(own, own)])
        of_frame[j], sigma[j] = (cover @ vector[own])[4], math.sqrt(cover[4, 4])
    return Measured(px, mm, of_frame, sigma)


def hold_out(
    seen: Sightings,
    solution: Solution,
    folds: int,
    *,
    fit: Callable[[Sightings, Solution], tuple[Solution, FloatArray]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Measured:
    """Calibrate `folds` times, each time without one part of the frames, and measure the pipe in those.

    `fit` goes on from a part's solution and adds what the rings are off their cones, (K, 2, n), as `fine.tune` does.
    """
    frames = len(solution.poses)
    out = Measured(*(np.full(n, np.nan) for n in (len(seen), len(seen), frames, frames)))
    part = np.arange(frames) % folds
    for fold in range(folds):
        found, fine = None, None
        for chosen in (np.flatnonzero(part != fold), np.flatnonzero(part == fold)):
            number = np.full(frames, -1)
            number[chosen] = np.arange(len(chosen))
            mine = np.flatnonzero(number[seen.frame] >= 0)
            few = seen.take(mine)
            few = replace(few, frame=number[few.frame])
            poses = tuple(solution.poses[j] for j in chosen)
            if found is None:
                start = replace(solution, poses=poses)
                found = calibrate(few, solution.radius_mm, start=start)
                if fit is not None:
                    found, fine = fit(few, found)
            else:
                one = measure(few, found, poses, fine)
                out.error_px[mine], out.off_mm[mine] = one.error_px, one.off_mm
                out.off_radius_mm[chosen], out.sigma_mm[chosen] = one.off_radius_mm, one.sigma_mm
        if progress is not None:
            progress(fold + 1, folds)
    return out


def azimuths(seen: Sightings, rings: Sequence[Cone], poses: Sequence[Pose], radius_mm: float) -> FloatArray:
    """(N,) 0..1: where round its cone's axis the light of each slit runs, see RingCorrection."""
    points = _wall_points(seen, poses, radius_mm)
    axis = np.array([ring.axis for ring in rings])[seen.ring]
    away = points - np.array([ring.vertex_mm for ring in rings])[seen.ring]
    first = away[:, 0] - axis[:, 0] * (away * axis).sum(axis=1)
    second = axis[:, 2] * away[:, 1] - axis[:, 1] * away[:, 2]
    return np.asarray(np.nan_to_num(np.arctan2(second, first)) / (2 * math.pi) % 1.0)


def _wall_points(seen: Sightings, poses: Sequence[Pose], radius_mm: float) -> FloatArray:
    """(N, 3) mm, camera frame: where each slit's ray meets the wall of the pipe in its frame's pose."""
    out = np.empty((len(seen), 3))
    for j, pose in enumerate(poses):
        mine = np.flatnonzero(seen.frame == j)
        axis = pose.rotation[:, 2]
        out[mine] = intersect_cylinder(seen.rays[mine, 1], pose.translation, axis, radius_mm, seen.origins[mine, 1])
    return out


def with_frame(solution: Solution, one: Sightings, pose: Pose) -> FloatArray:
    """The covariance that the rings would have if a frame with these sightings, taken in `pose`, were added."""
    rings = len(solution.rings)
    problem = _Problem(one, rings, 1, solution.radius_mm, np.zeros((rings, 2, 0)))
    problem.look(_pack(replace(solution, poses=(pose,))), middles=True)
    weight = np.where(np.isfinite(problem.error), 1.0, 0.0) / (solution.sigma_px**2 * solution.alike)[one.ring]
    matrix, _ = problem.normal(weight)
    n = 6 * rings
    own, cross, four = matrix[:n, :n], matrix[:n, n : n + 4], matrix[n : n + 4, n : n + 4]
    gained = own - cross @ np.linalg.solve(four, cross.T)
    unit = np.sqrt(np.diag(solution.covariance))
    cover = solution.covariance / unit[:, None] / unit
    return np.asarray(
        np.linalg.solve(np.eye(n) + cover @ (gained * unit[:, None] * unit), cover) * unit[:, None] * unit
    )


def _thinned(seen: Sightings, rings: int, frames: int) -> NDArray[np.int64]:
    """At most COARSE sightings of each ring in each frame, evenly taken."""
    out = []
    for frame in range(frames):
        for ring in range(rings):
            mine = np.flatnonzero((seen.frame == frame) & (seen.ring == ring))
            out.append(mine[:: max(1, len(mine) // COARSE)])
    return np.concatenate(out)


def _pack(start: Solution) -> FloatArray:
    cones = [[c.half_angle, c.axis[0], c.axis[1], *c.vertex_mm] for c in start.rings]
    return np.concatenate([np.ravel(cones), np.ravel([[p.rx, p.ry, p.tx, p.ty] for p in start.poses])])


def _cone(c: FloatArray) -> Cone:
    x, y = float(c[1]), float(c[2])
    return Cone(float(c[0]), (x, y, math.sqrt(max(1.0 - x * x - y * y, 0.0))), (float(c[3]), float(c[4]), float(c[5])))


@jit
def _gather_sectors(frame, sector, weight, rows, shared):  # type: ignore[no-untyped-def]
    """(K n, 6 + 4 F + 1): each sector's angle against its ring, all poses and the radius."""
    last = shared.shape[1] - 1
    for n in range(len(frame)):
        w = weight[n] * rows[n, 0]
        if w == 0.0:
            continue
        row = shared[sector[n]]
        for a in range(6):
            row[a] += w * rows[n, a]
        for a in range(4):
            row[6 + 4 * frame[n] + a] += w * rows[n, 6 + a]
        row[last] += w * rows[n, 10]


@jit
def _gather(frame, ring, weight, error, rows, blocks, right):  # type: ignore[no-untyped-def]
    for n in range(len(frame)):
        w = weight[n]
        if w == 0.0:
            continue
        block, vector = blocks[ring[n], frame[n]], right[ring[n], frame[n]]
        for a in range(11):
            scaled = w * rows[n, a]
            vector[a] += scaled * error[n]
            for b in range(a, 11):
                block[a, b] += scaled * rows[n, b]


@jit
def _errors(frame, ring, rays, origins, width, cones, poses, turns, radius, fine, places, middles, error, rows):  # type: ignore[no-untyped-def]
    """Seen less expected place along each line (px), NaN where ray, wall and cone do not meet; `rows` (N, 11): how the
    expected place moves with half-angle, axis x y, vertex x y z, rx, ry, tx, ty, radius. `places` and `middles` are
    kept from call to call: where the ring's image crosses the line, and how far beyond its slit's middle that is; the
    latter is found again where `width` is given."""
    more = np.empty(10)
    for n in range(len(frame)):
        cone, pose, turn, own = cones[ring[n]], poses[frame[n]], turns[frame[n]], fine[ring[n]]
        at = places[n]  # px from the slit, outwards positive
        good = True
        for _ in range(6):
            value, slope = _off(rays[n], origins[n], at, cone, pose, turn, radius, own, more, False)
            if not abs(slope) > 1e-9:
                good = False
                break
            step = value / slope
            at -= min(max(step, -20.0), 20.0)
            if abs(at) > REACH_PX or abs(step) < 1e-4:
                break
        if not good or not abs(at) < REACH_PX:
            error[n] = np.nan
            places[n] = 0.0
            continue
        places[n] = at
        if len(width) > 0:
            middles[n] = 0.0
            if width[n] > 0.0:
                # the cone lies at the middle of the edges' angles, not of their pixels (see triangulate.ring_optics)
                before, s0 = _off(rays[n], origins[n], at - PROBE_PX, cone, pose, turn, radius, own, more, False)
                after, s1 = _off(rays[n], origins[n], at + PROBE_PX, cone, pose, turn, radius, own, more, False)
                middles[n] = (s1 - s0) / (after - before) * width[n] * width[n] / 8.0
        value, slope = _off(rays[n], origins[n], at, cone, pose, turn, radius, own, more, True)
        error[n] = middles[n] - at
        if not abs(error[n]) < REACH_PX:
            error[n] = np.nan
            continue
        rows[n, 0] = 1.0 / slope
        for a in range(9):
            rows[n, a + 1] = -more[a] / slope
        rows[n, 10] = -more[9] / slope


@jit
def _off(rays, origins, at, cone, pose, turn, radius, fine, more, wanted):  # type: ignore[no-untyped-def]
    """Angle about the cone's axis of the wall's point seen at `at`, less the cone's half-angle there; its slope along
    the line. In `more`, if wanted, its gradient: axis x y, vertex x y z, rx, ry, tx, ty, radius."""
    part = at / RAY_STEP_PX
    wx, wy, wz, ux, uy, uz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ox, oy, oz, vx, vy, vz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):  # Lagrange's parabola and its slope
        if i == 0:
            c, d = 0.5 * part * (part - 1.0), (part - 0.5) / RAY_STEP_PX
        elif i == 1:
            c, d = 1.0 - part * part, -2.0 * part / RAY_STEP_PX
        else:
            c, d = 0.5 * part * (part + 1.0), (part + 0.5) / RAY_STEP_PX
        wx += c * rays[i, 0]
        wy += c * rays[i, 1]
        wz += c * rays[i, 2]
        ux += d * rays[i, 0]
        uy += d * rays[i, 1]
        uz += d * rays[i, 2]
        ox += c * origins[i, 0]
        oy += c * origins[i, 1]
        oz += c * origins[i, 2]
        vx += d * origins[i, 0]
        vy += d * origins[i, 1]
        vz += d * origins[i, 2]
    # the wall: rows 0 and 1 of R^T are what counts across the pipe
    ca, sa, cb, sb = turn[0], turn[1], turn[2], turn[3]
    r00, r01, r02 = cb, sb * sa, -sb * ca
    r11, r12 = ca, sa
    qx, qy = ox - pose[2], oy - pose[3]
    qu, qv = r00 * qx + r01 * qy + r02 * oz, r11 * qy + r12 * oz
    wu, wv = r00 * wx + r01 * wy + r02 * wz, r11 * wy + r12 * wz
    a, b, c = wu * wu + wv * wv, qu * wu + qv * wv, qu * qu + qv * qv - radius * radius
    under = b * b - a * c
    if not under > 0.0 or not a > 0.0:
        return np.nan, np.nan
    s = (math.sqrt(under) - b) / a
    if not s > 0.0:
        return np.nan, np.nan
    x, y, z = ox + s * wx, oy + s * wy, oz + s * wz
    cu, cv = (qu + s * wu) / radius, (qv + s * wv) / radius
    nx, ny, nz = r00 * cu, r01 * cu + r11 * cv, r02 * cu + r12 * cv  # outwards, across the wall
    against = nx * wx + ny * wy + nz * wz
    # the cone
    ax, ay = cone[1], cone[2]
    az = math.sqrt(max(1.0 - ax * ax - ay * ay, 1e-12))
    dx, dy, dz = x - cone[3], y - cone[4], z - cone[5]
    far = math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / far, dy / far, dz / far
    cosine = dx * ax + dy * ay + dz * az
    mx, my, mz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    sine = math.sqrt(mx * mx + my * my + mz * mz)
    if not sine > 1e-9:
        return np.nan, np.nan
    value = math.atan2(sine, cosine) - cone[0]
    if fine.shape[1] > 0:
        offset, shift = fine_at(fine, dx, dy, dz, ax, ay, az)
        value = math.atan2(sine * far, cosine * far - shift) - cone[0] - offset
    # how the angle turns when the wall's point moves
    gx, gy, gz = (cosine * dx - ax) / (far * sine), (cosine * dy - ay) / (far * sine), (cosine * dz - az) / (far * sine)
    along = gx * wx + gy * wy + gz * wz
    # how the point moves with the place on the line: its ray turns, and it stays on the wall
    px, py, pz = vx + s * ux, vy + s * uy, vz + s * uz
    slide = -(nx * px + ny * py + nz * pz) / against
    slope = gx * px + gy * py + gz * pz + along * slide
    if wanted:
        more[0] = -(dx - dz * ax / az) / sine
        more[1] = -(dy - dz * ay / az) / sine
        more[2], more[3], more[4] = -gx, -gy, -gz
        tx, ty = x - pose[2], y - pose[3]
        turned = sa * ty - ca * z
        v = ca * ty + sa * z
        push = along / against  # mm across the wall -> angle
        more[5] = -push * (cu * sb * v + cv * (ca * z - sa * ty))
        more[6] = -push * (cu * (cb * turned - sb * tx))
        more[7] = push * nx
        more[8] = push * ny
        more[9] = push
    return value, slope


@jit
def fine_at(fine, dx, dy, dz, ax, ay, az):  # type: ignore[no-untyped-def]
    """One ring's offset (rad) and shift (mm), (2, n), where direction d runs from its vertex: see RingCorrection."""
    # along e1 = camera x less its part along the axis, and e2 = axis x e1; both of length sqrt(1 - ax^2)
    first = dx - ax * (dx * ax + dy * ay + dz * az)
    second = az * dy - ay * dz
    turn = math.atan2(second, first) / (2.0 * math.pi)
    at = (turn - math.floor(turn)) * fine.shape[1]
    i = min(int(at), fine.shape[1] - 1)
    part = at - i
    j = (i + 1) % fine.shape[1]
    return fine[0, i] + part * (fine[0, j] - fine[0, i]), fine[1, i] + part * (fine[1, j] - fine[1, i])
