"""All rings and all poses as one least-squares problem: the bundle that autocalibration adjusts."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import transform
from annulus_pipe.numeric.robust import CAUCHY, biweight, cauchy, prior_sigma, robust_sigma
from annulus_pipe.rings.calibration.kernels import (
    REACH_PX,
    Guess,
    Lines,
    Residuals,
    errors,
    gather,
    gather_sectors,
    of_head,
)
from annulus_pipe.rings.calibration.observations import Observations, Placement, azimuths
from annulus_pipe.vocabulary import AnnulusError

# By topic autocalibration (errors, time); a factor of two either way moves no test.
REJECTED = 6.0  # sigma, Tukey's: 98 % efficient on normal errors, nothing beyond counts
STEPS = 60  # of the descent
SINGULAR = 1e-11  # least eigenvalue of the normal equations, all unknowns scaled to 1
TINT_PX = 0.2  # what a colour's image is off by, standard deviation ..
TINT_COMMON_PX = 0.001  # .. and all three alike: the lens would show it
_ALL = np.tile(np.eye(4)[:2], 3) / 3.0  # (2, 12): the way that all three colours are off by
TINTS = np.eye(12) / TINT_PX**2 + _ALL.T @ _ALL / TINT_COMMON_PX**2
SETTLED = 1e-6  # of a parameter's size: the descent ends
# What a stretch of a ring's image is off in every pose alike, standard deviation, and how many stretches a ring has:
# what a mosaic of colours and a JPEG leave after TINTS. No residual shows it, for the unknowns take it up. By
# topic stereo: 0.0097 px at the truth of stereo-calib-a, 0.0079 of a clean drawing sent through mosaic and JPEG.
ALIKE_PX = 0.01
STRETCHES = 12


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Rings and poses that fit the observations best, and how well they are known."""

    rings: tuple[Cone, ...]
    poses: tuple[Pose, ...]
    radius_mm: float
    error_px: FloatArray  # (N,) where each slit was seen less where its ring should be, along its line; NaN = nowhere
    weight: FloatArray  # (N,) 0..1 of the robust loss
    slope_px: FloatArray  # (N,) px a rad: how a wider half-angle moves the place where a slit should be seen, and ..
    axial_px: FloatArray  # (N,) .. px a mm: how a vertex farther along its axis does, and ..
    radius_px: FloatArray  # (N,) .. px a mm: how a wider pipe does
    sigma_px: FloatArray  # (K,) robust, of the errors of each ring
    correlation_length: FloatArray  # (K,) so many neighbouring errors are worth one independent one
    covariance: FloatArray  # (6K, 6K) ring after ring: half-angle rad, axis x y, vertex x y z mm
    runner_up: float  # cost of the second best start that led elsewhere, over the cost of this one; inf where none did
    off_radius_mm: tuple[float, float]  # what the observations say of the radius, less what was given, and its standard
    # deviation: infinite for a camera with one centre, whose images stay the same when everything grows alike
    flat: tuple[bool, ...] = ()  # which rings are planes: half-angle and place across the axis given, their sigma 0
    cameras: tuple[Placement, ...] = ()  # of those after the first, and how well that is known, ..
    camera_covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # .. each turn rad, centre mm
    colour_shift_px: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))  # (3, 4) of red, green, blue images


class Bundle:
    """The observations and the unknowns: per ring half-angle, axis x y, vertex; per frame rx, ry, tx, ty; per camera
    after the first its turn (a rotation vector) and its centre, in the first one's frame; where observations have a
    tint, how far each colour's image is off, alike in all cameras, which are of one make: JPEG's chroma does it."""

    def __init__(
        self,
        seen: Observations,
        rings: int,
        frames: int,
        radius: float,
        corrections: FloatArray,
        flat: tuple[bool, ...] = (),
    ) -> None:
        self.seen, self.rings, self.frames, self.radius, self.corrections = seen, rings, frames, radius, corrections
        self.place, self.middle = np.zeros(len(seen)), np.zeros(len(seen))
        self.error, self.rows = np.empty(len(seen)), np.zeros((len(seen), 17 + seen.tint.shape[1]))
        self.cameras = int(seen.camera.max(initial=0)) + 1
        self.head = seen  # all rays in the first camera's frame
        self.size = np.concatenate(
            [
                np.tile([1.0, 1.0, 1.0, *[radius] * 3], rings),
                np.tile([1.0, 1.0, radius, radius], frames),
                np.tile([1.0, 1.0, 1.0, *[radius] * 3], self.cameras - 1),
                np.full(seen.tint.shape[1], 10.0),
            ]
        )
        self.flat = flat or (False,) * rings
        # a plane has no half-angle to find, and its vertex may be anywhere on it: it is kept on the camera's axis
        others = np.ones(4 * frames + 6 * (self.cameras - 1) + seen.tint.shape[1], bool)
        self.free = np.append(~np.outer(self.flat, (1, 0, 0, 1, 1, 0)).astype(bool).ravel(), others)
        self.members = [np.flatnonzero(seen.ring == k) for k in range(rings)]
        self.sector: NDArray[np.int64] | None = None  # (N,) of all rings' sectors; None: rings are cones
        self.sector_offset, self.sector_weight = (
            np.zeros(0),
            np.zeros(0),
        )  # (K n,) rad, 1/rad^2 of each sector, its prior included
        self.rest = self.error  # (N,) errors less the lumps'
        self.shift = np.zeros(seen.tint.shape[1])  # px

    def first(self, along: float) -> FloatArray:
        """Vertices `along` mm from the camera on its axis, the head in the middle of the pipe."""
        x = np.zeros(6 * self.rings + 4 * self.frames)
        w, o = self.seen.rays[:, 1], self.seen.origins[:, 1]
        outward = np.maximum(np.hypot(w[:, 0], w[:, 1]), 1e-9)
        height = o[:, 2] + (self.radius - np.hypot(o[:, 0], o[:, 1])) * w[:, 2] / outward
        angle = np.arctan2(self.radius, height - along)
        for k, mine in enumerate(self.members):
            x[6 * k], x[6 * k + 5] = np.median(angle[mine]) if len(mine) else 0.5, along
            if self.flat[k]:
                x[6 * k], x[6 * k + 5] = math.pi / 2, np.median(height[mine]) if len(mine) else self.radius
        return x

    def first_beside(self, vertex: FloatArray) -> FloatArray:
        """Vertices (x, y) mm to the side of the only camera, the pipe's axis half way between the two."""
        x = np.zeros(len(self.size))
        w, middle = self.seen.rays[:, 1], vertex / 2
        a, b, c = (w[:, :2] ** 2).sum(axis=1), w[:, :2] @ middle, middle @ middle - self.radius**2
        wall = ((b + np.sqrt(b * b - a * c)) / np.maximum(a, 1e-12))[:, None] * w
        angle = np.arctan2(np.hypot(*(wall[:, :2] - vertex).T), wall[:, 2])
        cones, poses, *_ = self._split(x)
        for k, mine in enumerate(self.members):
            cones[k, 0], cones[k, 3:5] = np.median(angle[mine]) if len(mine) else 0.5, vertex
        poses[:, 2:] = middle
        return x

    def evaluate(self, x: FloatArray, middles: bool = False) -> None:
        """Errors and their derivatives at x. `middles`: anew, too, where slits' cones lie between their edges."""
        cones, poses, cameras, shift = self._split(x)
        turns = np.stack([np.cos(poses[:, 0]), np.sin(poses[:, 0]), np.cos(poses[:, 1]), np.sin(poses[:, 1])], axis=1)
        if len(cameras):
            self.head = self.seen.in_head(_placements(cameras))
        seen = self.head
        width = seen.width if middles else None
        errors(
            Lines(seen.frame, seen.ring, seen.rays, seen.origins, width),
            Guess(cones, poses, turns, self.radius, self.corrections),
            Residuals(self.place, self.middle, self.error, self.rows),
        )
        self.shift = shift
        if self.cameras > 1 or len(shift):
            turns = np.stack([np.eye(3), *(turned_by(row[:3]) for row in cameras)])
            of_head(seen.camera, turns, seen.tint, shift, self.error, self.rows)

    def _split(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Cones (K, 6), poses (F, 4), cameras (C - 1, 6), colours' shifts (6,) or none."""
        a, b = 6 * self.rings, 6 * self.rings + 4 * self.frames
        c = b + 6 * (self.cameras - 1)
        return x[:a].reshape(-1, 6), x[a:b].reshape(-1, 4), x[b:c].reshape(-1, 6), x[c:]

    def allow_sector_offsets(self, x: FloatArray, directions: int) -> None:
        """From here on each of so many sectors of a ring may be off the cone by its own angle."""
        turn = azimuths(self.head, *self._unpacked(x), self.radius)
        self.sector = self.seen.ring * directions + np.minimum((turn * directions).astype(np.int64), directions - 1)
        self.sector_offset, self.sector_weight = (
            np.zeros(self.rings * directions),
            np.full(self.rings * directions, np.inf),
        )

    def fit_sector_offsets(self, weight: FloatArray) -> float:
        """The sectors' angles for these weights, how large they are believed to be found along; returns their loss."""
        if self.sector is None:
            self.rest = self.error
            return 0.0
        sectors = len(self.sector_offset)
        slope = self.rows[:, 0]
        good = weight > 0
        at, w, a = self.sector[good], weight[good], slope[good]
        seen = np.bincount(at, w * a * a, sectors).astype(float)
        pull = np.bincount(at, w * a * self.error[good], sectors).astype(float)
        loss = 0.0
        for k in range(self.rings):
            own = slice(k * sectors // self.rings, (k + 1) * sectors // self.rings)
            believed = prior_sigma(seen[own], pull[own])
            self.sector_weight[own] = seen[own] + 1.0 / believed**2
            self.sector_offset[own] = pull[own] / self.sector_weight[own]
            loss += float(np.sum((self.sector_offset[own] / believed) ** 2)) + 2 * (own.stop - own.start) * math.log(
                believed
            )
        self.rest = self.error - slope * self.sector_offset[self.sector]
        return loss

    def sigma_px(self) -> FloatArray:
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
        k, f, c = self.rings, self.frames, self.cameras
        wide = self.rows.shape[1]
        of, of_right = np.zeros((c, k, f, wide, wide)), np.zeros((c, k, f, wide))
        gather(self.seen.frame, self.seen.ring, self.seen.camera, weight, self.rest, self.rows, of, of_right)
        blocks, right = of[..., :11, :11].sum(axis=0), of_right[..., :11].sum(axis=0)
        placed = 6 * k + 4 * f  # where the cameras' numbers begin
        tinted = placed + 6 * (c - 1)  # .. and the colours'
        n = tinted + wide - 17
        matrix, vector = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
        for ring in range(k):
            at = slice(6 * ring, 6 * ring + 6)
            matrix[at, at] = blocks[ring, :, :6, :6].sum(axis=0)
            matrix[at, 6 * k : placed] = blocks[ring, :, :6, 6:10].transpose(1, 0, 2).reshape(6, -1)
            matrix[at, n:] = blocks[ring, :, :6, 10:].sum(axis=0)
            vector[at] = right[ring, :, :6].sum(axis=0)
        for frame in range(f):
            at = slice(6 * k + 4 * frame, 6 * k + 4 * frame + 4)
            matrix[at, at] = blocks[:, frame, 6:10, 6:10].sum(axis=0)
            matrix[at, n:] = blocks[:, frame, 6:10, 10:].sum(axis=0)
            vector[at] = right[:, frame, 6:10].sum(axis=0)
        matrix[n:, n:], vector[n:] = blocks[:, :, 10:, 10:].sum(axis=(0, 1)), right[:, :, 10:].sum(axis=(0, 1))
        for number in range(1, c):
            at, own = slice(placed + 6 * (number - 1), placed + 6 * number), of[number]
            matrix[: 6 * k, at] = own[:, :, :6, 11:17].sum(axis=1).reshape(-1, 6)
            matrix[6 * k : placed, at] = own[:, :, 6:10, 11:17].sum(axis=0).reshape(-1, 6)
            matrix[at, at], matrix[at, n] = (
                own[..., 11:17, 11:17].sum(axis=(0, 1)),
                own[..., 10, 11:17].sum(axis=(0, 1)),
            )
            matrix[at, tinted:n] = own[..., 11:17, 17:].sum(axis=(0, 1))
            vector[at] = of_right[number, :, :, 11:17].sum(axis=(0, 1))
        if n > tinted:
            both = of.sum(axis=0)
            matrix[: 6 * k, tinted:n] = both[..., :6, 17:].sum(axis=1).reshape(6 * k, -1)
            matrix[6 * k : placed, tinted:n] = both[..., 6:10, 17:].sum(axis=0).reshape(4 * f, -1)
            matrix[tinted:n, n] = both[..., 10, 17:].sum(axis=(0, 1))
            matrix[tinted:n, tinted:n] = both[..., 17:, 17:].sum(axis=(0, 1)) + TINTS
            vector[tinted:n] = of_right[..., 17:].sum(axis=(0, 1, 2)) - TINTS @ self.shift
        matrix = np.triu(matrix) + np.triu(matrix, 1).T
        if self.sector is not None:  # what the lumps could take over tells nothing
            per = len(self.sector_offset) // k
            shared = np.zeros((len(self.sector_offset), 7 + 4 * f))
            gather_sectors(self.seen.frame, self.sector, weight, self.rows, shared)
            for ring in range(k):
                own = slice(ring * per, (ring + 1) * per)
                columns = np.r_[6 * ring : 6 * ring + 6, 6 * k : n + 1]
                part = shared[own] / np.sqrt(self.sector_weight[own])[:, None]
                matrix[np.ix_(columns, columns)] -= part.T @ part
        return matrix, vector

    def descend(
        self, x: FloatArray, robust: bool, settled: float, poses_only: bool = False
    ) -> tuple[float, FloatArray]:
        """Levenberg-Marquardt; the loss's scale follows the errors down. Returns the cost in px^2 and the place."""
        free = np.flatnonzero(self.free & (np.arange(len(x)) >= (6 * self.rings if poses_only else 0)))
        damping, sizes = 1e-3, self.size[free]
        self.evaluate(x, middles=True)
        for _ in range(STEPS):
            scale = self.sigma_px()
            weight, loss = self.weights(scale, robust)
            if self.sector is not None:
                self.fit_sector_offsets(weight)
                scale = self.sigma_px()
                weight, _ = self.weights(scale, robust)
                held = self.fit_sector_offsets(weight)
                loss = self.weights(scale, robust)[1] + held
            matrix, vector = self.normal(weight)
            a, b = matrix[np.ix_(free, free)] * sizes[:, None] * sizes, vector[free] * sizes
            moved = 0.0
            for _ in range(8):
                step = np.linalg.solve(a + np.diag(damping * np.diag(a) + 1e-12 * np.trace(a)), b)
                trial = x.copy()
                trial[free] += step * sizes
                self.evaluate(trial)
                held = self.fit_sector_offsets(weight)
                if self.weights(scale, robust)[1] + held <= loss:
                    x, moved, damping = trial, float(np.abs(step).max()), max(damping / 10, 1e-9)
                    break
                if np.abs(step).max() < settled:
                    break
                damping *= 10
            if moved < settled:
                break
        self.evaluate(x, middles=True)
        self.fit_sector_offsets(weight)
        self.last_weight = weight
        size = np.where(np.isfinite(self.error), np.minimum(np.abs(self.error), REACH_PX), REACH_PX)
        return float(np.mean(np.minimum(size, 10 * np.median(size)) ** 2)), x

    def solution(self, x: FloatArray, runner_up: float) -> Solution:
        self.evaluate(x, middles=True)
        self.fit_sector_offsets(np.ones(len(self.seen)) if self.sector is None else self.last_weight)
        scale = self.sigma_px()
        weight, _ = self.weights(scale, robust=False)
        n, inner = len(x), 6 * self.rings
        relative = weight * scale[self.seen.ring] ** 2
        length = self._correlation_length(relative)
        rest = self.rest.copy()
        honest = weight / length[self.seen.ring]
        self.fit_sector_offsets(honest)  # so that what they may take over is counted with these weights
        matrix, vector = self.normal(honest)
        self.rest = rest
        free = np.flatnonzero(self.free)
        unit = 1.0 / np.sqrt(np.maximum(np.diag(matrix)[free], 1e-300))
        values, vectors = np.linalg.eigh(matrix[np.ix_(free, free)] * unit[:, None] * unit)
        if values[0] < SINGULAR:
            raise AnnulusError("the poses are all alike: they leave the projector's place open")
        half = np.zeros((n, len(free)))
        half[free] = vectors * unit[:, None] / np.sqrt(values)
        if self.cameras > 1:  # for one camera nobody has shown the need
            half = np.hstack([half, ALIKE_PX * half @ (half.T @ self._alike(honest))])
        placed = half[inner + 4 * self.frames : n - self.seen.tint.shape[1]]
        cover = half[:inner] @ half[:inner].T
        of_radius = (vectors.T @ (unit * matrix[free, n])) / np.sqrt(values)
        known = matrix[n, n] - of_radius @ of_radius  # 1/mm^2, all other unknowns free
        pulled = vector[n] - of_radius @ ((vectors.T @ (unit * vector[free])) / np.sqrt(values))
        off = (float(pulled / known), float(known**-0.5)) if known > 1e-9 * matrix[n, n] else (0.0, math.inf)
        rings, poses = self._unpacked(x)
        return Solution(
            rings,
            poses,
            self.radius,
            self.error.copy(),
            relative,
            self.rows[:, 0].copy(),
            self._axial(x),
            self.rows[:, 10].copy(),
            scale,
            length,
            cover,
            runner_up,
            off,
            self.flat,
            _placements(self._split(x)[2]),
            placed @ placed.T,
            self.shift.reshape(-1, 4).copy(),
        )

    def _alike(self, weight: FloatArray) -> FloatArray:
        """(n, C K STRETCHES) how each stretch of a ring's image in one camera, a px off, pulls at the unknowns."""
        seen, k, f, per = self.seen, self.rings, self.frames, self.rings * STRETCHES
        turn = np.arctan2(seen.rays[:, 1, 1], seen.rays[:, 1, 0]) / (2 * math.pi) % 1.0
        stretch = np.minimum((turn * STRETCHES).astype(np.int64), STRETCHES - 1)
        which, many = (seen.camera * k + seen.ring) * STRETCHES + stretch, self.cameras * per
        of = np.arange(many)
        good = weight > 0  # the others' rows are anything
        which, at = which[good], seen.frame[good] * many + which[good]
        pulls = weight[good][:, None] * self.rows[good]

        def summed(column: int) -> FloatArray:
            return np.bincount(which, pulls[:, column], many).astype(float)

        out = np.zeros((len(self.size), many))
        for a in range(6):
            out[6 * (of // STRETCHES % k) + a, of] = summed(a)
            later = of[per:]
            out[6 * k + 4 * f + 6 * (later // per - 1) + a, later] = summed(11 + a)[per:]
        for a in range(4):
            out[6 * k + a : 6 * k + 4 * f : 4] = np.bincount(at, pulls[:, 6 + a], many * f).reshape(f, many)
        for a in range(seen.tint.shape[1]):
            out[len(out) - seen.tint.shape[1] + a] = summed(17 + a)
        return out

    def _unpacked(self, x: FloatArray) -> tuple[tuple[Cone, ...], tuple[Pose, ...]]:
        cones, poses, *_ = self._split(x)
        return tuple(_cone(c) for c in cones), tuple(Pose(*(float(v) for v in p)) for p in poses)

    def _axial(self, x: FloatArray) -> FloatArray:
        cones = x[: 6 * self.rings].reshape(-1, 6)
        axis = np.column_stack([cones[:, 1:3], np.sqrt(np.maximum(1.0 - (cones[:, 1:3] ** 2).sum(axis=1), 0.0))])
        return np.asarray((self.rows[:, 3:6] * axis[self.seen.ring]).sum(axis=1))

    def _correlation_length(self, weight: FloatArray) -> FloatArray:
        """(K,) sum of the errors' autocorrelation along their rings: neighbours share noise, and what is no cone."""
        out = np.ones(self.rings)
        for k, mine in enumerate(self.members):
            e = np.where(weight[mine] > 0, self.rest[mine], 0.0)
            frame = self.seen.frame[mine] * self.cameras + self.seen.camera[mine]
            square = float((e * e).sum())
            for lag in range(1, min(60, len(e) // 4)):
                same = frame[lag:] == frame[:-lag]
                part = float((e[lag:] * e[:-lag])[same].sum()) / max(square, 1e-300)
                if part < 0.05:
                    break
                out[k] += 2.0 * part
        return out


def packed(start: Solution) -> FloatArray:
    cones = [[c.half_angle, c.axis[0], c.axis[1], *c.vertex_mm] for c in start.rings]
    cameras = [[*transform.Rotation.from_matrix(c.rotation).as_rotvec(), *c.centre_mm] for c in start.cameras]
    poses = [[p.rx, p.ry, p.tx, p.ty] for p in start.poses]
    return np.concatenate([np.ravel(cones), np.ravel(poses), np.ravel(cameras), start.colour_shift_px.ravel()])


def _placements(cameras: FloatArray) -> tuple[Placement, ...]:
    return tuple(
        Placement(np.asarray(transform.Rotation.from_rotvec(row[:3]).as_matrix()), row[3:].copy()) for row in cameras
    )


def turned_by(vector: FloatArray) -> FloatArray:
    """(3, 3) small turn that a change of a rotation vector adds, on the left: the group's left Jacobian."""
    angle = float(np.linalg.norm(vector))
    cross = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]])
    if angle < 1e-6:
        return np.asarray(np.eye(3) + cross / 2)
    a, b = (1 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + a * cross + b * cross @ cross)


def _cone(c: FloatArray) -> Cone:
    x, y = float(c[1]), float(c[2])
    return Cone(float(c[0]), (x, y, math.sqrt(max(1.0 - x * x - y * y, 0.0))), (float(c[3]), float(c[4]), float(c[5])))
