"""Frames and where they were taken, to a height for every point: the door to the loop in `track`, and the fringe order.

    view = FringeView.of(camera, projector, moved_mm)      one camera of the head, N frames
    found = heights(view, images, points, noise=noise)     noise as `fringe.noise` finds it

A phase says the height but for whole periods. Three witnesses decide the order: the coarse height, where its bounds
admit one order only; the fit along the track, for at a wrong height the wall's texture moves otherwise than the track
(parallax; a flat wall without texture has none, its fringes stand still in the image); continuity with neighbours that
are decided. Where none does, the height is NaN and its flag AMBIGUOUS.
"""

from dataclasses import dataclass, field

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.projector import PLAIN, FringeProjector, phase_at
from annulus_pipe.wings.fringe.measure.track import (
    AMBIGUOUS,
    GOOD,
    UNMODULATED,
    Tracked,
    TrackFrames,
    Tracks,
    follow,
    look,
)

TOLERANCE_RAD = 1e-3  # of the phase, where rounds end: a thousandth of what a grey level's noise makes of it at SNR 1
PARALLAX = 16.0  # chi^2 by which the best order must beat the next: four sigma
ORDERS_MAX = 8  # either way
SOME = 1000  # points that say how fast the phase changes with height
NAMES = ("height_mm", "sigma_mm", "dc", "ac", "misfit", "used", "flag")
EPSILON_MM = 1e-4  # of a difference in place of a derivative
AGAIN_MAX = 4  # points that neighbours can help, as wide as that
CONTINUOUS = 0.25  # of a period: neighbours nearer than that are one surface


@dataclass(frozen=True, slots=True)
class FringeView:
    """One camera of a head in N frames. World to camera and to projector (N, 3, 4), eyes (N, 3) in the world."""

    lens: FloatArray  # as track.look takes it
    cameras: FloatArray
    projectors: FloatArray
    eyes: FloatArray
    slide: FloatArray  # FringeProjector.numbers
    drift: FloatArray  # (N,) place along the track, -1..1

    @staticmethod
    def of(
        one: HeadCamera, projector: FringeProjector, moved_mm: FloatArray, turns: FloatArray | None = None
    ) -> "FringeView":
        """moved_mm : (N, 3) where the head's origin is in the world. turns : (N, 3, 3) world's vectors to the head's.

        AnnulusError for fewer than three frames, for a head that stood still, and for a lens it cannot follow.
        """
        if len(moved_mm) < 3:
            raise AnnulusError(f"{len(moved_mm)} frames: phase, DC and AC of a point need at least 3")
        extent = np.ptp(moved_mm, axis=0)
        if not np.linalg.norm(extent) > 0:
            raise AnnulusError("the head did not move between the frames: nothing shifted the phase")
        camera = one.camera
        if camera.model not in ("pinhole", "fisheye"):
            raise AnnulusError(f"a {camera.model} camera: fringes are followed with pinhole and fisheye lenses")
        distortion = camera.distortion[:5] if camera.model == "pinhole" else camera.distortion[:4]
        if any(camera.distortion[len(distortion) :]):
            raise AnnulusError(f"{len(camera.distortion)} coefficients of distortion, expected at most 5")
        lens = np.zeros(10)
        lens[:5] = float(camera.model == "fisheye"), camera.fx, camera.fy, camera.cx, camera.cy
        lens[5 : 5 + len(distortion)] = distortion
        turns = np.broadcast_to(np.eye(3), (len(moved_mm), 3, 3)) if turns is None else turns
        rotation, away = np.array(one.rotation), np.array(one.translation_mm)
        light, centre = np.array(projector.rotation), np.array(projector.centre_mm)

        def pose(turn: FloatArray, shift: FloatArray) -> FloatArray:
            both = turn @ turns
            return np.concatenate([both, (shift - np.einsum("nij,nj->ni", both, moved_mm))[..., None]], axis=2)

        along = (moved_mm - moved_mm.mean(axis=0)) @ np.linalg.svd(moved_mm - moved_mm.mean(axis=0))[2][0]
        return FringeView(
            lens,
            pose(rotation, away),
            pose(light, -light @ centre),
            moved_mm - np.einsum("nji,j->ni", turns, rotation.T @ away),
            projector.numbers,
            along / np.abs(along).max(),
        )

    def phase(self, x: FloatArray, frame: int) -> FloatArray:
        """(P, 3) mm, world -> (P,) rad: the slide's phase there in that frame."""
        q = x @ self.projectors[frame, :, :3].T + self.projectors[frame, :, 3]
        return phase_at(self.slide, q)

    def wave(self, phase: FloatArray) -> FloatArray:
        """The light's waveform at phases of any shape, of amplitude 1."""
        total = np.cos(phase)
        for k, (even, odd) in enumerate(self.slide[PLAIN:].reshape(-1, 2), start=2):
            total = total + even * np.cos(k * phase) + odd * np.sin(k * phase)
        return total

    def pixels(self, x: FloatArray, frame: int) -> tuple[FloatArray, FloatArray]:
        """(P, 3) mm, world -> where that frame shows them, px."""
        return look(self.lens, self.cameras[frame], x)

    def radians_per_mm(self, points: "Points", height: FloatArray) -> FloatArray:
        """(P,) how fast the phase changes with height along the ray of the middle frame."""
        middle = len(self.eyes) // 2
        x = points.at(height)
        way = x - self.eyes[middle]
        way = way / np.einsum("pi,pi->p", way, points.normal)[:, None]
        return (self.phase(x + EPSILON_MM * way, middle) - self.phase(x - EPSILON_MM * way, middle)) / (2 * EPSILON_MM)


@dataclass(frozen=True, slots=True)
class Points:
    """(P, 3) mm, world: at height h a point lies at base + h path. normal : (P, 3) unit, path . normal = 1: how the
    wall stands there, roughly. shape : of the grid they are, for neighbours."""

    base: FloatArray
    path: FloatArray
    normal: FloatArray
    shape: tuple[int, int]

    def at(self, height: FloatArray) -> FloatArray:
        """(P, 3) mm, world."""
        return self.base + height[:, None] * self.path

    @staticmethod
    def plate(x_mm: FloatArray, y_mm: FloatArray, distance_mm: float) -> "Points":
        """A grid before the head: x, y of the world, height towards the head from the plane z = distance_mm."""
        y, x = np.meshgrid(y_mm, x_mm, indexing="ij")
        base = np.stack([x.ravel(), y.ravel(), np.full(x.size, distance_mm)], axis=1)
        up = np.broadcast_to([0.0, 0.0, -1.0], base.shape)
        return Points(base, up, up, (len(y_mm), len(x_mm)))

    @staticmethod
    def pipe(phi_rad: FloatArray, z_mm: FloatArray, radius_mm: float) -> "Points":
        """A grid on the wall of a pipe along z: height outwards, wall loss is positive."""
        z, phi = np.meshgrid(z_mm, phi_rad, indexing="ij")
        out = np.stack([np.cos(phi).ravel(), np.sin(phi).ravel(), np.zeros(phi.size)], axis=1)
        return Points(radius_mm * out + z.reshape(-1, 1) * [0.0, 0.0, 1.0], out, out, (len(z_mm), len(phi_rad)))

    def some(self, which: BoolArray | IntArray) -> "Points":
        """A selection of the points, as a grid of one row."""
        base = self.base[which]
        return Points(base, self.path[which], self.normal[which], (1, len(base)))


@dataclass(frozen=True, slots=True)
class Heights:
    """(P,) of each point: height and sigma (mm, NaN where not told), DC and AC (grey levels, linear in light), misfit
    (chi^2), frames used, flag (track.GOOD ..); residual (N, P) grey levels, if asked for."""

    height_mm: FloatArray
    sigma_mm: FloatArray
    dc: FloatArray
    ac: FloatArray
    misfit: FloatArray
    used: FloatArray
    flag: FloatArray
    residual: Float32Array
    who: IntArray = field(default_factory=lambda: np.empty(0, int))  # of a head of several eyes: see `bore.follow_wall`

    @property
    def modulation(self) -> FloatArray:
        """(P,) AC over DC: sqrt(2) times Eq. 6.19, whose AC is an rms (6.18)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.ac / self.dc)


def heights(
    view: FringeView,
    images: Float32Array,
    points: Points,
    start_mm: FloatArray | float = 0.0,
    *,
    bounds_mm: tuple[FloatArray | float, FloatArray | float] | None = None,
    noise: tuple[float, float, float] = (1.0, 0.0, 0.0),
    drift_sigma: float = 0.0,
    tolerance_mm: float | None = None,
    residuals: bool = False,
) -> Heights:
    """The height of every point.

    images : (N, H, W), `spline` of frames linear in light; or (N, P, 1): each point's samples already.
    start_mm, bounds_mm : coarse height, and between which heights it lies; without bounds the order nearest to the
    start.
    noise : a, b, c: a grey level I has variance a + b I + c I^2. drift_sigma : how much a point's light may drift along
    half its track, as a share; 0: not at all. tolerance_mm : where rounds end; a thousandth of a radian's worth if
    None.
    """
    if len(images) != len(view.cameras):
        raise AnnulusError(f"{len(images)} images for {len(view.cameras)} positions")
    start = np.array(np.broadcast_to(np.asarray(start_mm, dtype=float), len(points.base)))
    fit = _HeightFit(noise, drift_sigma, tolerance_mm)
    found = _again(view, images, points, _run(view, images, points, start, fit, residuals), fit)
    if bounds_mm is None:
        return found
    low, high = (np.broadcast_to(np.asarray(one, dtype=float), start.shape) for one in bounds_mm)
    return _order(view, images, points, found, start, (low, high), fit)


def spline(images: Float32Array) -> Float32Array:
    """(N, H, W) pixels, NaN where saturated, to the coefficients of the cubic splines through them, NaN about there.

    A pixel's share dies out as 0.27 to the power of the distance: the neighbours of a filled-in one are off by what
    was filled in, and stay NaN for two pixels around by the samples' own reach.
    """
    out = np.empty_like(images, dtype=np.float32)
    for one, into in zip(images, out, strict=True):
        missing = ~np.isfinite(one)
        filled = np.where(missing, np.nanmax(one), one) if missing.any() else one
        ndimage.spline_filter(filled, order=3, output=into, mode="mirror")
        into[missing] = np.nan
    return out


@dataclass(frozen=True, slots=True)
class _HeightFit:
    """What a fit takes beside its frames; see `heights`."""

    noise: tuple[float, float, float]
    drift_sigma: float
    tolerance_mm: float | None


def _run(
    view: FringeView, images: Float32Array, points: Points, start: FloatArray, fit: _HeightFit, residuals: bool = False
) -> Heights:
    count = len(points.base)
    tolerance = fit.tolerance_mm
    if tolerance is None:
        some = np.linspace(0, count - 1, min(count, SOME)).astype(int)
        rate = np.abs(view.radians_per_mm(points.some(some), start[some]))
        tolerance = TOLERANCE_RAD / float(np.median(rate[np.isfinite(rate)]))
    tracked = images.shape[2] > 1
    frames = TrackFrames(
        images=images.astype(np.float32, copy=False) if tracked else None,
        samples=None if tracked else images[..., 0].astype(float),
        lens=view.lens,
        cameras=view.cameras,
        eyes=view.eyes,
        projectors=view.projectors,
        slide=view.slide,
        drift=view.drift,
    )
    tracks = Tracks(points.base, _rows(points.path), _rows(points.normal), start)
    outcome, left = follow(frames, tracks, fit.drift_sigma, fit.noise, tolerance, residuals)
    return Heights(*outcome, left)


def _of(images: Float32Array, which: BoolArray | IntArray) -> Float32Array:
    """What some of the points are read from: the frames, or the samples that are theirs."""
    return images if images.shape[2] > 1 else images[:, which]


def _rows(vectors: FloatArray) -> FloatArray:
    """(P, 3), or (1, 3) where one stands for all."""
    return vectors[:1] if vectors.strides[0] == 0 else vectors


def _again(view: FringeView, images: Float32Array, points: Points, found: Heights, fit: _HeightFit) -> Heights:
    """Points without a height, fitted again from their neighbours' heights: at a step's upper edge the first start lies
    too far below."""
    columns = points.shape[1]
    for _ in range(AGAIN_MAX if min(points.shape) > 1 else 0):
        which = np.flatnonzero(found.flag >= UNMODULATED)
        j, i = np.divmod(which, columns)
        framed = np.pad(found.height_mm.reshape(points.shape), 1, constant_values=np.nan) if len(which) else np.empty(0)
        start = (
            nan_median(np.stack([framed[j + dj, i + di] for dj in range(3) for di in range(3)])) if len(which) else j
        )
        which, start = which[np.isfinite(start)], start[np.isfinite(start)]
        if not len(which):
            break
        some = _run(view, _of(images, which), points.some(which), start, fit)
        if not (some.flag == GOOD).any():
            break
        for name in NAMES:
            getattr(found, name)[which] = getattr(some, name)
    return found


def _order(
    view: FringeView,
    images: Float32Array,
    points: Points,
    found: Heights,
    start_mm: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    fit: _HeightFit,
) -> Heights:
    """The order of each point among those whose height lies within the bounds."""
    low, high = bounds
    first = np.where(np.isfinite(found.height_mm), found.height_mm, start_mm)
    spacing = 2 * np.pi / np.abs(view.radians_per_mm(points, first))
    candidates = [found]
    for k in (sign * order for order in range(1, ORDERS_MAX + 1) for sign in (-1, 1)):
        with np.errstate(invalid="ignore"):
            start = first + k * spacing
            which = (start > low - CONTINUOUS * spacing) & (start < high + CONTINUOUS * spacing)
        if which.any():
            some = _run(view, _of(images, which), points.some(which), start[which], fit)
            candidates.append(_spread(some, which))
    h = np.stack([one.height_mm for one in candidates])
    with np.errstate(invalid="ignore"):
        h[(h < low) | (h > high)] = np.nan
    cost = np.where(np.isfinite(h), np.stack([one.misfit for one in candidates]), np.inf)
    for i in range(1, len(h)):  # two starts that came to one height are one candidate
        with np.errstate(invalid="ignore"):
            cost[i, (np.abs(h[:i] - h[i]) < CONTINUOUS * spacing).any(axis=0)] = np.inf
    ranked = np.sort(cost, axis=0)
    best = np.argmin(cost, axis=0)
    some = np.isfinite(ranked[0])
    with np.errstate(invalid="ignore"):
        decided = some & (ranked[1] - ranked[0] > PARALLAX if len(ranked) > 1 else True)
    h[~np.isfinite(cost)] = np.nan
    best, decided = _continue(h.reshape(len(h), *points.shape), best, some, decided, spacing)
    chosen = [
        np.take_along_axis(np.stack([getattr(one, name) for one in candidates]), best[None], axis=0)[0]
        for name in NAMES
    ]
    chosen[0] = np.where(decided, chosen[0], np.nan)
    chosen[1] = np.where(decided, chosen[1], np.nan)
    chosen[6] = np.where(~decided & (chosen[6] == GOOD), AMBIGUOUS, chosen[6])
    return Heights(*Tracked(*chosen), found.residual)


def _continue(
    h: FloatArray, best: IntArray, some: BoolArray, decided: BoolArray, spacing: FloatArray
) -> tuple[IntArray, BoolArray]:
    """Undecided points take the candidate that carries on a decided neighbour's surface, and decide theirs in turn."""
    shape = h.shape[1:]
    order, settled, left = best.reshape(shape).copy(), decided.reshape(shape).copy(), some.reshape(shape)
    near = CONTINUOUS * spacing.reshape(shape)
    while True:
        height = np.where(settled, np.take_along_axis(h, order[None], axis=0)[0], np.nan)
        framed = np.pad(height, 1, constant_values=np.nan)
        around = np.stack([framed[:-2, 1:-1], framed[2:, 1:-1], framed[1:-1, :-2], framed[1:-1, 2:]])
        known = np.isfinite(around)
        mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        far = np.where(np.isfinite(h), np.abs(h - mean), np.inf)
        nearest = np.argmin(far, axis=0)
        new = left & ~settled & known.any(axis=0) & (np.take_along_axis(far, nearest[None], axis=0)[0] < near)
        if not new.any():
            return order.ravel(), settled.ravel()
        order, settled = np.where(new, nearest, order), settled | new


def _spread(some: Heights, which: BoolArray) -> Heights:
    """(P,) values of some points put at those points' places among all; NaN elsewhere."""
    values = np.full((len(NAMES), len(which)), np.nan)
    values[:, which] = [getattr(some, name) for name in NAMES]
    return Heights(*Tracked(*values), some.residual)
