"""A camera from photographs of a flat target: cold start, all poses and the lens together, and what they are worth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.camera import Camera, Model
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import optimize, spatial, transform
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError

# By topic intrinsics, every row of it a cold start.
FOCAL = (0.25, 0.35, 0.5, 0.7, 1.0, 1.5, 2.2, 3.5)  # of the image's longer side: where a cold start looks
COLD_VIEWS = 12  # as many are enough to choose between them
NUMBERS = {"pinhole": 9, "fisheye": 8}  # fx fy cx cy and the distortion
PROMISING = 3  # of them go on to the next stage
# What is set free in turn, for so many steps: one focal length; the principal point and the first bends; all.
STAGES: tuple[tuple[tuple[int, ...] | None, int], ...] = (((0,), 6), ((0, 2, 3, 4, 5), 12), (None, 12))


@dataclass(frozen=True, slots=True, eq=False)
class TargetObservation:
    """Corners of one target in one image: (N, 2) mm on the target, (N, 2) pixels."""

    target_mm: FloatArray
    pixels: FloatArray


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A camera fitted to views.

    `rotations` (V, 3, 3) and `translations` (V, 3) mm: target to camera. `residuals`: (N, 2) pixels of each view, seen
    less modelled; `views`: as given. `information` (V, P, P), `pulls` (V, P): what each view says of fx, fy,
    cx, cy and the distortion past its own pose: normal matrix and gradient. `bow` (P, P): see `covariance`.
    """

    camera: Camera
    rotations: FloatArray
    translations: FloatArray
    views: tuple[TargetObservation, ...]
    residuals: tuple[FloatArray, ...]
    information: FloatArray
    pulls: FloatArray
    bow: FloatArray

    @property
    def seen(self) -> tuple[FloatArray, ...]:
        """(N, 2) pixels of each view."""
        return tuple(view.pixels for view in self.views)

    @cached_property
    def moves(self) -> FloatArray:
        """(V, P) how the lens' numbers move when one view is left out, in one step."""
        return left_out(self.information, self.pulls)

    @cached_property
    def covariance(self) -> FloatArray:
        """(P, P) of the lens' numbers, from how they move when one view is left out, and from the target's bow.

        Corner errors of one view belong together (its blur, its light), so a view is one observation. Without it the
        lens moves by (sum of A - its A)^-1 its s; (V - 1) / V times the sum of these moves' squares is Efron's
        jackknife, in one step: the sandwich of MacKinnon & White 1985 (HC3) by groups (Bell & McCaffrey 2002).
        Somewhat large for few views, which is what two of it need to hold for 95 % there; two or three views leave
        next to nothing when one is gone. A target that is not flat is so in all views, and no view that is left out
        shows it: `bow` is what it makes of the lens (`_bow`).
        """
        return np.asarray((len(self.moves) - 1) / len(self.moves) * self.moves.T @ self.moves + self.bow)

    @property
    def rms_px(self) -> float:
        """Root of the mean squared distance between corners seen and modelled, over all corners."""
        return float(np.sqrt(np.mean(np.concatenate([(r**2).sum(axis=1) for r in self.residuals]))))

    @cached_property
    def view_rms_px(self) -> FloatArray:
        return np.array([np.sqrt(np.mean((r**2).sum(axis=1))) for r in self.residuals])

    def covered(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """(N,) whether (N, 2) pixels lie inside the outline of some view's corners."""
        inside = np.zeros(len(pixels), bool)
        for seen in self.seen:
            corner = seen[spatial.ConvexHull(seen).vertices]
            way, to = np.roll(corner, -1, axis=0) - corner, pixels[:, None] - corner
            inside |= (way[:, 0] * to[..., 1] >= way[:, 1] * to[..., 0]).all(axis=1)
        return inside

    def ray_sigma_px(self, pixels: FloatArray) -> FloatArray:
        """(N,) how far, one standard deviation, the fitted lens may send a ray of (N, 2) pixels off, in pixels; NaN
        where no target was, for there the lens is only extrapolated.

        A turn of the whole camera that calibration cannot tell from a shifted principal point is taken out: whoever
        uses the camera fits his own pose. It is the one that moves the corners seen least, in the mean square.
        """
        _, over_turn, over_lens = self._slopes(np.concatenate(self.seen))
        turned = np.linalg.lstsq(over_turn.reshape(-1, 3), over_lens.reshape(-1, over_lens.shape[2]), rcond=None)[0]
        good, by_turn, by_lens = self._slopes(pixels)
        left = by_lens - by_turn @ turned
        out = np.full(len(pixels), np.nan)
        out[good] = np.sqrt(np.maximum(np.einsum("nip,pq,niq->n", left, self.covariance, left), 0.0))
        return np.where(self.covered(pixels), out, np.nan)

    def _slopes(self, pixels: FloatArray) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
        """Which pixels have rays; how those pixels move with a turn of the camera, and with the lens' numbers."""
        rays = self.camera.rays(pixels)
        good = np.asarray(np.isfinite(rays).all(axis=1))
        _, by_point, by_lens = project_with_slopes(self.camera, rays[good])
        return good, by_point @ -cross_matrix(rays[good]), by_lens


def fit_intrinsics(
    views: list[TargetObservation],
    width: int,
    height: int,
    model: Model,
    start: Camera | None = None,
    *,
    robust: bool = False,
) -> Intrinsics:
    """Fit one camera to views of flat targets, every view with its own pose.

    Parameters
    ----------
    views : at least two (a single photograph leaves focal length and distance in each other's hands).
    start : a camera near the answer; without one, eight focal lengths are tried on some of the views.
    robust : corners far off count little in the answer too; to find out which ones they are.

    Notes
    -----
    Least squares with Cauchy weights on the way (corners far off must not pull), plain at the end; poses are
    eliminated view by view (Schur), so the cost grows with the number of views only linearly. Model and distortion
    are OpenCV's (Alzuhiri 2022, ch. 2). Raises AnnulusError where no focal length leads anywhere.
    """
    if len(views) < 2:
        raise AnnulusError(
            f"{len(views)} usable photograph of the target, expected at least 2, better 10 from all sides"
        )
    if start is None:
        start = _cold_start(views, width, height, model)
    camera, rotations, translations = start, *_poses(start, views)
    camera, rotations, translations = _adjust(camera, rotations, translations, views, None, robust=True)
    if not robust:
        camera, rotations, translations = _adjust(camera, rotations, translations, views, None, robust=False)
    rows = [target_rows(camera, *one) for one in zip(views, rotations, translations, strict=True)]
    information, pulls = (np.array(part) for part in zip(*map(_past_pose, rows), strict=True))
    bow = _bow(rows, views, rotations)
    return Intrinsics(
        camera, rotations, translations, tuple(views), tuple(off for off, _, _ in rows), information, pulls, bow
    )


def left_out(information: FloatArray, pulls: FloatArray) -> FloatArray:
    """(V, P) how the answer moves when one of V observations, each with its normal matrix and gradient, is left out."""
    whole = information.sum(axis=0)
    unit = 1 / np.sqrt(np.diag(whole))
    rest = np.outer(unit, unit) * (whole - information) + 1e-14 * np.eye(len(unit))
    return np.asarray(-unit * np.linalg.solve(rest, (unit * pulls)[:, :, None])[:, :, 0])


def target_pose(camera: Camera, view: TargetObservation) -> tuple[FloatArray, FloatArray, float]:
    """(3, 3) and (3,) mm: target to camera, and the rms in pixels. From four or more corners of a plane, corners that
    were mistaken for ones count little. For any camera with one centre."""
    rotations, translations = _poses(camera, [view])

    def moved(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return transform.Rotation.from_rotvec(x[:3]).as_matrix() @ rotations[0], translations[0] + x[3:]

    def off(x: FloatArray) -> FloatArray:
        rotation, shift = moved(x)
        return np.nan_to_num(camera.project(view.target_mm @ rotation[:, :2].T + shift) - view.pixels, nan=1e4).ravel()

    size = float(np.linalg.norm(translations[0]))
    fit = optimize.least_squares(
        off, np.zeros(6), loss="cauchy", f_scale=0.5, x_scale=np.array([0.01] * 3 + [0.01 * size] * 3)
    )
    return *moved(fit.x), float(np.sqrt(np.mean((off(fit.x).reshape(-1, 2) ** 2).sum(axis=1))))


def project_with_slopes(camera: Camera, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, 2) pixels of (N, 3) points, (N, 2, 3) slopes by the point, (N, 2, P) slopes by fx fy cx cy and distortion."""
    x, y, z = points.T
    focal = np.array([camera.fx, camera.fy])
    n = len(points)
    by_lens = np.zeros((n, 2, NUMBERS[camera.model]))
    if camera.model == "fisheye":
        k = np.pad(np.array(camera.distortion, float), (0, 4 - len(camera.distortion)))
        rho = np.maximum(np.hypot(x, y), 1e-12)
        theta = np.arctan2(rho, z)
        powers = theta[:, None] ** np.array([3, 5, 7, 9])
        bent = theta + powers @ k
        slope = 1 + (theta[:, None] ** np.array([2, 4, 6, 8]) * [3, 5, 7, 9]) @ k
        way = np.stack([x, y], axis=1) / rho[:, None]
        flat = bent[:, None] * way
        square = rho * rho + z * z
        by_theta = np.stack([way[:, 0] * z / square, way[:, 1] * z / square, -rho / square], axis=1)
        turn = np.stack([-way[:, 1], way[:, 0]], axis=1)  # what moves the direction in the image
        by_turn = np.stack([-way[:, 1] / rho, way[:, 0] / rho, 0 * rho], axis=1)
        by_point = slope[:, None, None] * way[:, :, None] * by_theta[:, None, :]
        by_point += bent[:, None, None] * turn[:, :, None] * by_turn[:, None, :]
        by_lens[:, :, 4:] = way[:, :, None] * powers[:, None, :]
    else:
        k1, k2, p1, p2, k3 = np.pad(np.array(camera.distortion, float), (0, 5 - len(camera.distortion)))
        a, b = x / z, y / z
        r2 = a * a + b * b
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bend = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # of radial by r2
        flat = np.stack(
            [a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a), b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b],
            axis=1,
        )
        cross = 2 * a * b * bend + 2 * p1 * a + 2 * p2 * b
        by_flat = np.empty((n, 2, 2))
        by_flat[:, 0, 0] = radial + 2 * a * a * bend + 2 * p1 * b + 6 * p2 * a
        by_flat[:, 1, 1] = radial + 2 * b * b * bend + 6 * p1 * b + 2 * p2 * a
        by_flat[:, 0, 1] = by_flat[:, 1, 0] = cross
        to_flat = np.zeros((n, 2, 3))
        to_flat[:, 0, 0] = to_flat[:, 1, 1] = 1 / z
        to_flat[:, 0, 2], to_flat[:, 1, 2] = -a / z, -b / z
        by_point = by_flat @ to_flat
        both = np.stack([a, b], axis=1)
        for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
            by_lens[:, :, column] = both * power[:, None]
        by_lens[:, :, 6] = np.stack([2 * a * b, r2 + 2 * b * b], axis=1)
        by_lens[:, :, 7] = np.stack([r2 + 2 * a * a, 2 * a * b], axis=1)
    by_lens[:, :, 4:] *= focal[None, :, None]
    by_lens[:, 0, 0], by_lens[:, 1, 1] = flat[:, 0], flat[:, 1]
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1.0
    return flat * focal + [camera.cx, camera.cy], by_point * focal[None, :, None], by_lens


Rows = tuple[FloatArray, FloatArray, FloatArray]  # of a view: (N, 2) off, (N, 2, P) slopes by lens, (N, 2, 6) by pose
Blocks = list[tuple[FloatArray, FloatArray, FloatArray]]  # of each view: pose by pose, lens by pose, pose gradient


def _cold_start(views: list[TargetObservation], width: int, height: int, model: Model) -> Camera:
    """The best of several focal lengths after a few steps on some of the views, from a lens without distortion."""
    some = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, COLD_VIEWS).astype(int))]
    tried: list[tuple[float, Camera]] = []
    for part in FOCAL:
        f = part * max(width, height)
        tried.append(
            (0.0, Camera(model, width, height, f, f, (width - 1) / 2, (height - 1) / 2, (0.0,) * (NUMBERS[model] - 4)))
        )
    for free, steps in STAGES:
        better: list[tuple[float, Camera]] = []
        for _, camera in tried:
            try:
                at = _adjust(camera, *_poses(camera, some), some, free, robust=True, steps=steps)
                better.append((_cost(*at, some), at[0]))
            except (np.linalg.LinAlgError, ValueError):
                continue
        tried = sorted(better, key=lambda one: one[0])[:PROMISING]
    if not tried:
        raise AnnulusError("no camera fits these targets: is every photograph from one camera, and the target flat?")
    return tried[0][1]


def _cost(camera: Camera, rotations: FloatArray, translations: FloatArray, views: list[TargetObservation]) -> float:
    """Median distance in pixels; a corner behind the lens counts as very far."""
    off = []
    for view, rotation, translation in zip(views, rotations, translations, strict=True):
        seen = camera.project(view.target_mm @ rotation[:, :2].T + translation)
        off.append(np.nan_to_num(np.linalg.norm(seen - view.pixels, axis=1), nan=1e6))
    return float(np.median(np.concatenate(off)))


def _poses(camera: Camera, views: list[TargetObservation]) -> tuple[FloatArray, FloatArray]:
    """Target poses from the rays of a camera, by the plane's homography onto directions: good past 90 degrees too."""
    rotations, translations = np.empty((len(views), 3, 3)), np.empty((len(views), 3))
    for i, view in enumerate(views):
        rays = camera.rays(view.pixels)
        good = np.isfinite(rays).all(axis=1)
        if np.count_nonzero(good) < 4:
            raise ValueError("the lens cannot have seen this")
        middle, spread = view.target_mm[good].mean(axis=0), float(np.std(view.target_mm[good]))
        flat = (view.target_mm[good] - middle) / spread
        homogeneous = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        rows = np.einsum("nij,nk->nijk", cross_matrix(rays[good]), homogeneous).reshape(-1, 9)
        h = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
        if np.einsum("ni,ij,nj->n", rays[good], h, homogeneous).sum() < 0:
            h = -h
        u, stretch, v = np.linalg.svd(np.stack([h[:, 0], h[:, 1]], axis=1), full_matrices=False)
        two = u @ v  # the nearest pair of unit vectors at right angles
        rotations[i] = np.stack([two[:, 0], two[:, 1], np.cross(two[:, 0], two[:, 1])], axis=1)
        translations[i] = h[:, 2] * spread / stretch.mean() - rotations[i][:, :2] @ middle
    return rotations, translations


def _adjust(
    camera: Camera,
    rotations: FloatArray,
    translations: FloatArray,
    views: list[TargetObservation],
    free: tuple[int, ...] | None,
    *,
    robust: bool,
    steps: int = 60,
) -> tuple[Camera, FloatArray, FloatArray]:
    """Levenberg-Marquardt over the lens and all poses; `free`: which of the lens' numbers (None: all; (0,) alone: one
    focal length for both ways)."""
    numbers = NUMBERS[camera.model]
    basis = np.eye(numbers)[:, list(range(numbers) if free is None else free)]
    if free is not None and 0 in free:
        basis[1, 0] = 1.0
    ratio = 1e-3
    normal, gradient, poses, cost = _normal(camera, rotations, translations, views, basis, robust, None)
    scale = poses[-1]
    for _ in range(steps):
        trial = None
        for _ in range(12):
            step, turns = _solve(normal, gradient, poses[0], ratio)
            trial = _moved(camera, rotations, translations, basis @ step, turns)
            after = _normal(*trial, views, basis, robust, scale)
            if after[3] <= cost:
                break
            ratio *= 6.0
            trial = None
        if trial is None:
            break
        gained = cost - after[3]
        camera, rotations, translations = trial
        normal, gradient, poses, cost = after
        ratio = max(ratio / 5.0, 1e-12)
        if gained <= 1e-10 * cost:
            break
        if robust:  # the scale follows the fit
            normal, gradient, poses, cost = _normal(camera, rotations, translations, views, basis, robust, None)
            scale = poses[-1]
    return camera, rotations, translations


def _past_pose(rows: Rows) -> tuple[FloatArray, FloatArray]:
    """What a view says of the lens with its own pose left free: (P, P) of the normal matrix, (P,) of the gradient."""
    off, by_lens, by_pose = rows
    lens, pose = by_lens.reshape(2 * len(off), -1), by_pose.reshape(-1, 6)
    lens = lens - pose @ np.linalg.lstsq(pose, lens, rcond=None)[0]
    return lens.T @ lens, lens.T @ off.ravel()


def _bow(rows: Sequence[Rows], views: Sequence[TargetObservation], rotations: FloatArray) -> FloatArray:
    """(P, P) of the lens' numbers: how far a target that is not flat may have moved them.

    A bow is of second order over the target, x x, x y and y y, the same in every view. One step of a fit that had it
    too says how large it is, and how well; the lens, which was fitted without, is off by what goes with it.
    """
    whole = np.concatenate([view.target_mm for view in views])
    middle, half = 0.5 * (whole.min(axis=0) + whole.max(axis=0)), 0.5 * float(np.ptp(whole, axis=0).max())
    normal, pull = np.zeros((0, 0)), np.zeros(0)
    squares, count = 0.0, 0
    for (off, by_lens, by_pose), view, rotation in zip(rows, views, rotations, strict=True):
        x, y = ((view.target_mm - middle) / half).T
        rise = by_pose[:, :, 3:] @ rotation[:, 2]
        bows = rise[:, :, None] * np.stack([x * x, x * y, y * y], axis=1)[:, None]
        own, towards = _past_pose((off, np.concatenate([by_lens, bows], axis=2), by_pose))
        normal, pull = (own, towards) if not count else (normal + own, pull + towards)
        squares += float((off**2).sum())
        count += off.size - 6
    unit = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    numbers = len(normal) - 3
    normal = np.outer(unit, unit) * normal + 1e-12 * np.eye(len(unit))
    by_bow = -np.linalg.solve(normal[:numbers, :numbers], normal[:numbers, numbers:])
    left = np.linalg.inv(normal[numbers:, numbers:] + normal[numbers:, :numbers] @ by_bow)
    size = left @ (unit * pull)[numbers:]
    spread = squares / max(count - len(normal), 1) * left
    moved = unit[:numbers, None] * by_bow
    return np.asarray(moved @ (np.outer(size, size) + spread) @ moved.T)


def target_rows(camera: Camera, view: TargetObservation, rotation: FloatArray, translation: FloatArray) -> Rows:
    turned = view.target_mm @ rotation[:, :2].T
    with np.errstate(all="ignore"):
        pixels, by_point, by_lens = project_with_slopes(camera, turned + translation)
    off = view.pixels - pixels
    if camera.model == "pinhole":
        off[(turned + translation)[:, 2] <= 0] = 1e6
    return off, by_lens, np.concatenate([by_point @ -cross_matrix(turned), by_point], axis=2)


def _normal(
    camera: Camera,
    rotations: FloatArray,
    translations: FloatArray,
    views: list[TargetObservation],
    basis: FloatArray,
    robust: bool,
    scale: float | None,
) -> tuple[FloatArray, FloatArray, tuple[Blocks, float], float]:
    """Normal equations, their blocks for each pose with the scale of the residuals, and the cost."""
    found = [
        (off, by_lens @ basis, by_pose)
        for off, by_lens, by_pose in (
            target_rows(camera, *one) for one in zip(views, rotations, translations, strict=True)
        )
    ]
    if not all(
        np.isfinite(off).all() and np.isfinite(lens).all() and np.isfinite(pose).all() for off, lens, pose in found
    ):
        return np.zeros((0, 0)), np.zeros(0), ([], 1.0), np.inf
    if scale is None:
        scale = max(robust_sigma(np.concatenate([off for off, _, _ in found])), 0.02)
    normal, gradient, cost = np.zeros((basis.shape[1],) * 2), np.zeros(basis.shape[1]), 0.0
    blocks: Blocks = []
    reach = 3.0 * scale
    for off, by_lens, by_pose in found:
        square = (off**2).sum(axis=1) / reach**2
        weight = 1 / (1 + square) if robust else np.ones(len(off))
        cost += float((reach**2 * np.log1p(square)).sum() if robust else (off**2).sum())
        lens, pose, flat = by_lens.reshape(2 * len(off), -1), by_pose.reshape(-1, 6), off.ravel()
        heavy = np.repeat(weight, 2)[:, None]
        normal += lens.T @ (heavy * lens)
        gradient += lens.T @ (heavy[:, 0] * flat)
        blocks.append((pose.T @ (heavy * pose), lens.T @ (heavy * pose), pose.T @ (heavy[:, 0] * flat)))
    return normal, gradient, (blocks, scale), cost


def _reduced(normal: FloatArray, gradient: FloatArray, blocks: Blocks, ratio: float) -> tuple[FloatArray, FloatArray]:
    left, right = normal + ratio * np.diag(np.diag(normal)), gradient.copy()
    for own, across, pull in blocks:
        inverse = np.linalg.inv(own + (ratio + 1e-14) * np.diag(np.diag(own)))
        left = left - across @ inverse @ across.T
        right -= across @ inverse @ pull
    return left, right


def _solve(
    normal: FloatArray, gradient: FloatArray, blocks: Blocks, ratio: float
) -> tuple[FloatArray, list[FloatArray]]:
    left, right = _reduced(normal, gradient, blocks, ratio)
    step: FloatArray = np.asarray(np.linalg.lstsq(left, right, rcond=1e-15)[0]) if len(right) else right
    turns: list[FloatArray] = [
        np.asarray(np.linalg.solve(own + (ratio + 1e-14) * np.diag(np.diag(own)), pull - across.T @ step))
        for own, across, pull in blocks
    ]
    return step, turns


def _moved(
    camera: Camera, rotations: FloatArray, translations: FloatArray, step: FloatArray, turns: list[FloatArray]
) -> tuple[Camera, FloatArray, FloatArray]:
    both = np.array(turns)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]) + step
    fx, fy, cx, cy = (float(v) for v in lens[:4])
    moved = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(float(v) for v in lens[4:]))
    return (moved, transform.Rotation.from_rotvec(both[:, :3]).as_matrix() @ rotations, translations + both[:, 3:])


def cross_matrix(v: FloatArray) -> FloatArray:
    """(N, 3) -> (N, 3, 3): times a vector, the cross product with it."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
