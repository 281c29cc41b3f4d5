"""Heights from the phase that two cameras see (Alzuhiri 2022, Eq. 6.4, 6.5), the slide no more than a mark on the wall.

A point of the wall has one phase, whoever looks. With the head's middle frame for reference:

    DC        of each camera, tracked as if the wall were flat, drawn straight into a rectified pair
    rough     disparity of the pair by OpenCV's semi-global matcher, with its left-right check
    fine      both cameras' phases along the point's own tracks; the height at which they agree, within half a period of
              their difference about the rough one

The nominal slide says only how the phase goes on from frame to frame and how steep it is. An error of it changes both
cameras' phases alike and leaves their difference as it is; so does what texture and blur do to the phase (`texture`),
which belongs to the place on the wall. Where the DC has no texture there is no rough height, and no height.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.heights import FringeView, Heights, Points
from annulus_pipe.wings.fringe.measure.projector import FringeProjector
from annulus_pipe.wings.fringe.measure.track import (
    AMBIGUOUS,
    EXCESS,
    GOOD,
    MODULATED,
    ROBUST_FROM,
    TOO_FEW,
    TUKEY_SQUARED,
    UNMODULATED,
)

BLOCK_PX = 7  # of the matcher: a DC image is smooth below its own blur
SMOOTH = (8 * BLOCK_PX**2, 32 * BLOCK_PX**2)  # OpenCV's own suggestion for steps of one and of more pixels
LEFT_RIGHT_PX = 1
SUBPIXEL = 16.0  # the matcher's unit
ROUNDS = 5
SEEN_MIN = 200  # points with a disparity, to say a phase by
STRONG = 0.1  # rad/mm: below that two cameras' phases do not tell heights apart
BLOCK = 20000  # points at a time: 24 frames of them, and their columns, are 40 MB
PERIOD_OFF = 0.05  # share by which a slide's period may be off its design
PERIOD_STEPS = 101  # tried over it
CONCENTRATED = 0.3  # length of the mean of all unit phases: below it the frames show no slide of that period
WINDOW = 0.5  # of a half period: farther from the rough height than that is another order's


@dataclass(frozen=True, slots=True)
class _CameraPhase:
    """A camera's own phase along tracks: off the nominal one (P,) rad, its variance, DC, AC, misfit, frames used."""

    off: FloatArray
    variance: FloatArray
    dc: FloatArray
    ac: FloatArray
    misfit: FloatArray
    used: FloatArray


def stereo_heights(
    pair: tuple[HeadCamera, HeadCamera],
    projector: FringeProjector,
    moved_mm: FloatArray,
    images: tuple[Float32Array, Float32Array],
    points: Points,
    bounds_mm: tuple[float, float],
    *,
    noise: tuple[float, float, float] = (1.0, 0.0, 0.0),
    drift_sigma: float = 0.0,
) -> Heights:
    """The height of every point, by two cameras of one head. `heights` says the rest; images : a camera's each.

    bounds_mm : between which heights the wall lies, for the matcher. Flag AMBIGUOUS where it finds none, or where the
    phases agree too far from what it found.
    """
    views = (FringeView.of(pair[0], projector, moved_mm), FringeView.of(pair[1], projector, moved_mm))
    rough = rough_heights(pair, projector, moved_mm, images, points, bounds_mm)
    blocks = [np.arange(k, min(k + BLOCK, len(rough))) for k in range(0, len(rough), BLOCK)]
    agreed = [_agreed(views, images, points.some(some), rough[some], noise, drift_sigma) for some in blocks]
    h, sigma, dc, ac, misfit, used, flag = (np.concatenate(one) for one in zip(*agreed, strict=True))
    return Heights(h, sigma, dc, ac, misfit, used, flag, np.empty((0, 0), np.float32))


def slide_seen(
    pair: tuple[HeadCamera, HeadCamera],
    projector: FringeProjector,
    moved_mm: FloatArray,
    images: tuple[Float32Array, Float32Array],
    points: Points,
    bounds_mm: tuple[float, float],
) -> FringeProjector:
    """The slide with the phase0 and period that the first camera sees where the disparity says that the wall is: a
    slide that was never calibrated has any phase, and a period within some percent of its design.

    As `stereo_heights` takes them. AnnulusError where there is no disparity, or no common phase.
    """
    rough = rough_heights(pair, projector, moved_mm, images, points, bounds_mm)
    which = np.flatnonzero(np.isfinite(rough))
    if len(which) < SEEN_MIN:
        low, high = bounds_mm
        raise AnnulusError(
            f"its cameras see no texture in common between {low:g} and {high:g} mm of height: only the slide says "
            "where the wall is"
        )
    some, h = points.some(which), rough[which]
    for _ in range(2):
        view = FringeView.of(pair[0], projector, moved_mm)
        off = _phase(view, images[0], some, h, (1.0, 0.0, 0.0), 0.0, robust=False).off
        x = some.at(h)
        ahead = np.mean([view.phase(x, n) for n in range(len(moved_mm))], axis=0) - projector.phase0
        good = np.isfinite(off + ahead)
        stretch = np.linspace(-PERIOD_OFF, PERIOD_OFF, PERIOD_STEPS)
        sums = [complex(np.mean(np.exp(1j * (off - one * ahead)[good]))) if good.any() else 0j for one in stretch]
        best = int(np.argmax(np.abs(sums)))
        if abs(sums[best]) < CONCENTRATED:
            raise AnnulusError(
                f"the frames' phases add up to {abs(sums[best]):.2f} under the slide, expected above {CONCENTRATED:g}: "
                "its period or its place is too far off"
            )
        period, phase0 = projector.period / (1 + stretch[best]), projector.phase0 + float(np.angle(sums[best]))
        projector = replace(projector, period=period, phase0=phase0)
    return projector


def _agreed(
    views: tuple[FringeView, FringeView],
    images: tuple[Float32Array, Float32Array],
    points: Points,
    rough: FloatArray,
    noise: tuple[float, float, float],
    drift_sigma: float,
) -> tuple[FloatArray, ...]:
    """What `Heights` has of the points but residuals, in its order: both phases followed to where they agree."""
    h = rough.copy()
    first, second = views
    for turn in range(ROUNDS):
        a, b = (
            _phase(view, frames, points, h, noise, drift_sigma, robust=turn > 1)
            for view, frames in zip(views, images, strict=True)
        )
        steep = first.radians_per_mm(points, h) - second.radians_per_mm(points, h)
        with np.errstate(invalid="ignore", divide="ignore"):
            step = np.angle(np.exp(1j * (a.off - b.off))) / np.where(np.abs(steep) > STRONG, steep, np.nan)
        if turn + 1 < ROUNDS:
            h = h + step
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = np.sqrt(a.variance + b.variance) / np.abs(steep)
        flag = np.where(np.abs(h - rough) < WINDOW * np.pi / np.abs(steep), GOOD, AMBIGUOUS)
        settled = np.abs(step) < np.maximum(sigma, 1e-6)
        weak = np.maximum(a.variance, b.variance) > MODULATED**-2.0  # sigma of a phase is that of AC over AC
    flag = np.where(weak, UNMODULATED, np.where(settled, flag, AMBIGUOUS))
    flag = np.where(np.minimum(a.used, b.used) < 3, TOO_FEW, flag)
    flag = np.where(np.isfinite(rough), flag, AMBIGUOUS).astype(float)
    known = (flag == GOOD) & np.isfinite(sigma)
    height, sigma = np.where(known, h, np.nan), np.where(known, sigma, np.nan)
    return height, sigma, a.dc, a.ac, a.misfit + b.misfit, a.used + b.used, flag


def rough_heights(
    pair: tuple[HeadCamera, HeadCamera],
    projector: FringeProjector,
    moved_mm: FloatArray,
    images: tuple[Float32Array, Float32Array],
    points: Points,
    bounds_mm: tuple[float, float],
) -> FloatArray:
    """(P,) mm, NaN where the matcher finds none: by the disparity of the rectified DC images of the middle frame."""
    low, high = bounds_mm
    if not high > low:
        raise AnnulusError(f"heights between {low:g} and {high:g} mm: the lower comes first")
    middle = len(moved_mm) // 2
    views = [FringeView.of(one, projector, moved_mm) for one in pair]
    eyes = [view.eyes[middle] for view in views]
    base = float(np.linalg.norm(eyes[1] - eyes[0]))
    if not base > 0:
        raise AnnulusError("the two cameras stand at one place: no disparity")
    along = (eyes[1] - eyes[0]) / base
    forward = views[0].cameras[middle, 2, :3] + views[1].cameras[middle, 2, :3]
    forward = forward - (forward @ along) * along
    forward = forward / np.linalg.norm(forward)
    turn = np.stack([along, np.cross(forward, along), forward])  # world to rectified
    focal = pair[0].camera.fx

    def place(eye: FloatArray, x: FloatArray) -> FloatArray:
        """(P, 2) of the tangents, (x, y) / z."""
        q = (x - eye) @ turn.T
        return np.asarray(q[:, :2] / q[:, 2:])

    corners = [place(eye, points.at(np.full(len(points.base), h))) for eye in eyes for h in bounds_mm]
    least = np.min([one.min(axis=0) for one in corners], axis=0)
    most = np.max([one.max(axis=0) for one in corners], axis=0)
    shape = tuple(int(np.ceil(focal * side)) + 1 for side in (most - least)[::-1])
    depths = [((points.at(np.full(len(points.base), h)) - eyes[0]) @ forward) for h in bounds_mm]
    disparities = [focal * base / depth for depth in depths]
    smallest = int(np.floor(np.min(disparities))) - BLOCK_PX
    count = (int(np.ceil(np.max(disparities))) + BLOCK_PX - smallest + 15) // 16 * 16
    row, column = np.indices(shape).reshape(2, -1)
    rays = np.stack([column / focal + least[0], row / focal + least[1], np.ones(column.size)], axis=1) @ turn
    normal = points.normal.mean(axis=0)
    plane = points.at(np.full(len(points.base), (low + high) / 2)).mean(axis=0)
    drawn = []
    for view, frames, eye in zip(views, images, eyes, strict=True):
        x = eye + rays * (((plane - eye) @ normal) / (rays @ normal))[:, None]
        flat = Points(x, np.broadcast_to(normal, x.shape), np.broadcast_to(normal, x.shape), (shape[0], shape[1]))
        dc = _phase(view, frames, flat, np.zeros(len(x)), (1.0, 0.0, 0.0), 0.0, robust=False).dc.reshape(shape)
        drawn.append(dc)
    top = float(np.nanpercentile(np.concatenate([one.ravel() for one in drawn]), 99.5))
    left, right = (np.uint8(np.clip(np.nan_to_num(one) * (255 / top), 0, 255)) for one in drawn)
    left, right = (
        cv2.copyMakeBorder(one, 0, 0, max(smallest, 0) + count, 0, cv2.BORDER_REPLICATE) for one in (left, right)
    )
    matcher = cv2.StereoSGBM.create(
        smallest, count, BLOCK_PX, *SMOOTH, LEFT_RIGHT_PX, uniquenessRatio=5, speckleWindowSize=200, speckleRange=2
    )
    found = matcher.compute(left, right)[:, max(smallest, 0) + count :] / SUBPIXEL
    found = np.where((found >= smallest) & np.isfinite(drawn[0]), found, np.nan)
    h = np.full(len(points.base), (low + high) / 2)
    for _ in range(3):  # the pixel of a point follows from its height
        at = (place(eyes[0], points.at(np.where(np.isfinite(h), h, (low + high) / 2))) - least) * focal
        i = np.clip(np.rint(at), 0, [shape[1] - 1, shape[0] - 1]).astype(int)
        around = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        near = [
            found[np.clip(i[:, 1] + dy, 0, shape[0] - 1), np.clip(i[:, 0] + dx, 0, shape[1] - 1)] for dy, dx in around
        ]
        depth = focal * base / nan_median(np.stack(near))
        zero = (points.base - eyes[0]) @ forward
        h = (depth - zero) / (points.path @ forward)
    return np.asarray(np.where((h >= low) & (h <= high), h, np.nan))


def _phase(
    view: FringeView,
    images: Float32Array,
    points: Points,
    h: FloatArray,
    noise: tuple[float, float, float],
    drift_sigma: float,
    *,
    robust: bool,
) -> _CameraPhase:
    """Least squares along each point's track: Eq. 6.9 to 6.14 with its own steps, in light that may drift."""
    x = points.at(h)
    value, phase = np.empty((len(images), len(x))), np.empty((len(images), len(x)))
    for n, image in enumerate(images):
        u, v = view.pixels(x, n)
        value[n] = ndimage.map_coordinates(image, [v, u], order=3, prefilter=False, cval=np.nan, output=float)
        phase[n] = view.phase(x, n)
    fine = np.isfinite(value)
    value, used = np.where(fine, value, 0.0), fine.sum(axis=0).astype(float)
    level = np.maximum(value, 0.0)
    weight = fine / (noise[0] + level * (noise[1] + level * noise[2]))
    phase = np.where(fine, phase, 0.0)
    columns = [np.ones_like(phase), np.cos(phase), -np.sin(phase)]  # Eq. 6.9
    prior = np.zeros(3)
    solution, fit, inverse, misfit, scale = _solve(columns, value, weight, prior, used)
    if drift_sigma > 0:
        columns.append(fit * view.drift[:, None])
        prior = np.array([0.0, 0.0, 0.0, drift_sigma**-2.0])
        solution, fit, inverse, misfit, scale = _solve(columns, value, weight, prior, used)
    for _ in range(2 if robust and len(images) >= ROBUST_FROM else 0):
        far = np.square(value - fit) * weight / (scale * TUKEY_SQUARED)
        tamed = weight * np.square(np.maximum(1 - far, 0.0))
        solution, fit, inverse, misfit, scale = _solve(columns, value, tamed, prior, used)
    dc, even, odd = solution[:, :3].T
    with np.errstate(invalid="ignore", divide="ignore"):
        ac = np.hypot(even, odd)
        across = np.stack([-odd, even], axis=1) / (ac * ac)[:, None]
        variance = np.einsum("pi,pij,pj->p", across, inverse[:, 1:3, 1:3], across) * scale
        empty = used < 3
    off = np.arctan2(odd, even)  # Eq. 6.14
    off, variance, dc, ac, misfit = (np.where(empty, np.nan, one) for one in (off, variance, dc, ac, misfit))
    return _CameraPhase(off, variance, dc, ac, misfit, used)


def _solve(
    columns: list[FloatArray], value: FloatArray, weight: FloatArray, prior: FloatArray, used: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Weighted least squares of every point: solution (P, K), fit (N, P), inverse (P, K, K), misfit and its scale."""
    rows = np.stack(columns, axis=-1)
    matrix = np.einsum("np,npi,npj->pij", weight, rows, rows, optimize=True) + np.diag(prior + 1e-12)
    inverse = np.linalg.inv(matrix)
    solution = np.einsum("pij,np,npj->pi", inverse, weight * value, rows, optimize=True)  # Eq. 6.13, weighted
    fit = np.einsum("npi,pi->np", rows, solution)
    misfit = (weight * np.square(value - fit)).sum(axis=0)
    free = np.maximum(used - 3, 1)
    excess = (used > 3) & (misfit > free + EXCESS * np.sqrt(2 * free))
    return solution, fit, inverse, misfit, np.where(excess, misfit / free, 1.0)
