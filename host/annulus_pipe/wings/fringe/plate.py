"""A scan under a slide of fringes to the heights of the plate it went past.

By cameras (`job.by`) the same, but a height is where both cameras see one phase (`fringe.stereo_heights`); of the slide
they need about what its design says, its phase and period are taken from the first window.

A scan is worked through in windows of consecutive flashes, half of each shared with the next, so that memory does not
grow with its length. Each window places its own frames (`fringe.steps`) and says the heights of the cells that stand
before its middle; windows are joined where they share frames. A camera's frames are held one camera at a time.
"""

import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.reprocess.executors import Executor, in_process
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.vocabulary import AnnulusError, Finding, first_few
from annulus_pipe.wings.fringe.job import COARSE, DRIFT, Box, FringeJob, cell_mm, check_order
from annulus_pipe.wings.fringe.measure import (
    FringeView,
    Heights,
    Points,
    Transfer,
    edged,
    find_steps,
    heights,
    light_of,
    merged,
    noise_of,
    slide_seen,
    spline,
    stereo_heights,
    untextured,
)
from annulus_pipe.wings.fringe.measure.plate import Plate
from annulus_pipe.wings.fringe.measure.track import AMBIGUOUS, GOOD, TOO_FEW, UNDETERMINED, UNMODULATED, UNSETTLED
from annulus_pipe.wings.fringe.windows import Arrays, FringeWindow, FringeWindowWork, window_of, without_frames

Progress = Callable[[str, int, int], None]

WINDOW = 24  # flashes: some fringes' worth of phase, and 200 MB of a camera of 2 Mpixel
MARGIN = 8  # cells beside a window's own, for what looks at neighbours
VAGUE_RAD = 0.25  # sigma of a phase: beyond it errors are no longer normal (track.MODULATED)
APART = 3.0  # times their sigma, from which it is said that two cameras differ
CHECKED_MIN = 100  # cells that two cameras see, to judge their sigma by
ODOMETER_SIGMA_MM = 0.05  # of a cable counter or a stage, where the frames' own texture decides nothing
SATURATED_MAX, UNTOLD_MAX = 0.001, 0.02  # shares from which it is said
MISFIT_MAX = 0.25  # of the swing: the frames do not show this slide
REASONS = {
    TOO_FEW: "seen in fewer than 3 frames, or saturated",
    UNMODULATED: "too little of the fringes on it",
    UNDETERMINED: "no phase shift",
    UNSETTLED: "frames that do not fit one another",
    AMBIGUOUS: "order of the fringe open",
}
NO_TEXTURE = "no texture that both cameras see, or phases that do not agree there"  # AMBIGUOUS, by cameras
REACH = 0.05  # of the distance: how far a plate may stand from it, by cameras; twice that has 0.15 % gross errors


def _curve(job: FringeJob) -> FringeJob:
    """The same with the curve whose light fits the slide's waveform best, of those in the calibration and the usual
    ones: another curve has other harmonics."""
    named = [*job.head.transfer.values()] or [Transfer()]
    usual = [Transfer(sensor, named[0].black) for sensor in ("linear", "srgb")]
    one = max(job.head.cameras, key=lambda one: sum(one.id in seen for _, seen in job.flashes[:WINDOW]))
    odometer = np.array([x for x, seen in job.flashes[:WINDOW] if one.id in seen])
    if len(odometer) < 3:
        return replace(job, curve=named[0])
    box, step = _box(job, one, odometer), COARSE * cell_mm(job)
    coarse = Points.plate(np.arange(*box[0], step), np.arange(*box[1], step), job.distance_mm)
    view = FringeView.of(one, job.projector, odometer[:, None] * np.array(job.head.motion))
    misfits = []
    for curve in dict.fromkeys([*named, *usual]):
        images, _ = _WindowFrames(replace(job, curve=curve), _first(job), {}).of(one)
        misfits.append((_misfit(heights(view, images, coarse, drift_sigma=DRIFT, residuals=True)), curve))
    misfit, best = min(misfits, key=lambda one: one[0])
    text = (
        f'the calibration names no transfer curve for a scan called "{job.scan.path.resolve().name}": taken as '
        f"{best.sensor}, black {best.black:g}, for that fits the slide's wave best ({misfit:.3f} of the swing is left, "
        f"{max(misfit for misfit, _ in misfits):.3f} with the worst)"
    )
    return replace(job, curve=best, findings=(*job.findings, Finding("transfer", text)))


def reconstruct_fringe(
    job: FringeJob, progress: Progress | None = None, executor: Executor = in_process, place: StoragePath | None = None
) -> Plate:
    """The heights of the plate. place : where windows are kept, and found again. AnnulusError where nothing can be
    measured."""
    started = time.perf_counter()
    report = progress or (lambda stage, done, total: None)
    count = len(job.flashes)
    if job.curve is None:
        job = _curve(job)
    last = max(count - WINDOW, 0)
    starts = [*range(0, last, WINDOW // 2), last]
    report("fringes", 0, count)
    if job.by == "cameras":
        job = _phased(job)
    work = FringeWindowWork(without_frames(job), measured_window, _PlatePart.of, place)
    parts: list[_PlatePart] = []
    made = 0
    for k, start in enumerate(starts):
        low = -math.inf if k == 0 else (starts[k] + starts[k - 1] + WINDOW - 1) / 2
        high = math.inf if k + 1 == len(starts) else (starts[k + 1] + starts[k] + WINDOW - 1) / 2
        known: dict[str, Any] = {"start": start, "share": (low, high)}
        if parts:
            before = parts[-1]
            known["before_mm"] = before.place_mm[start - before.start :]
        window = window_of(job.scan, k, job.flashes[start : start + WINDOW], lambda flash: [*flash[1].values()], known)
        part, new = work.of(executor, window)
        parts.append(part)
        made += new
        report("fringes", min(start + WINDOW, count), count)
    return replace(_joined(job, parts, started), windows=len(starts), made=made)


class _WindowFrames:
    """Splines of the frames of one window, read once each, dropped when the window has gone on. held : (spline,
    saturated pixels) by index and camera, which the next window of this process takes over."""

    def __init__(self, job: FringeJob, window: FringeWindow, held: dict[Any, Any]) -> None:
        self._job, self._window, self._held = job, window, held
        frames = window.part.frames
        wanted = {(frames[i].index, camera) for _, seen in window.flashes for camera, i in seen.items()}
        for gone in [key for key in held if key not in wanted]:
            del held[gone]

    def of(self, one: HeadCamera) -> tuple[Float32Array, IntArray]:
        """(N, H, W) of a camera, and which flashes of the window they are. AnnulusError for another size."""
        which = [k for k, (_, frames) in enumerate(self._window.flashes) if one.id in frames]
        images = [self._spline(self._window.flashes[k][1][one.id], one) for k in which]
        return np.array(images, np.float32), np.array(which, dtype=np.int64)

    def saturated(self) -> IntArray:
        """(M, 4): index and camera of each frame, its saturated pixels and all of them."""
        rows = [(*key, lost, image.size) for key, (image, lost) in sorted(self._held.items())]
        return np.array(rows, np.int64).reshape(-1, 4)

    def _spline(self, i: int, one: HeadCamera) -> Float32Array:
        part = self._window.part
        key = part.frames[i].index, one.id
        if key not in self._held:
            light = light_of(part.read(i), one, self._job.curve or Transfer(), part.frames[i].where)
            self._held[key] = spline(light[None])[0], int(np.isnan(light).sum())
        out: Float32Array = self._held[key][0]
        return out


def _first(job: FringeJob) -> FringeWindow:
    """The first window, for what is decided once for a scan."""
    return window_of(job.scan, 0, job.flashes[:WINDOW], lambda flash: [*flash[1].values()], {})


@dataclass(frozen=True, slots=True)
class _PlatePart:
    """What one window says: where its frames stand, the heights of its cells, node (i, j) at (i, j) cell mm."""

    start: int
    place_mm: FloatArray
    sigma_mm: FloatArray
    slipped: BoolArray
    i: IntArray
    j: IntArray
    found: Heights | None  # None where the slide lit nothing
    scale: float = 1.0  # of the motion over x_mm, where the frames contradict x_mm beyond chance
    apart: float = 1.0  # how many times their sigma two cameras differ
    saturated: IntArray = field(default_factory=lambda: np.empty((0, 4), np.int64))  # see _WindowFrames.saturated

    def arrays(self) -> Arrays:
        own = {name: getattr(self, name) for name in _PART}
        return own if self.found is None else own | {f"found.{name}": getattr(self.found, name) for name in _HEIGHTS}

    @staticmethod
    def of(job: FringeJob, arrays: Arrays) -> "_PlatePart":
        own = {name: arrays[name] if arrays[name].ndim else arrays[name].item() for name in _PART}
        lit = "found.flag" in arrays
        if (
            len({len(own[name]) for name in ("place_mm", "sigma_mm", "slipped")}) != 1
            or own["i"].shape != own["j"].shape
        ):
            raise ValueError("columns of different lengths")
        found = Heights(**{name: arrays[f"found.{name}"] for name in _HEIGHTS}) if lit else None
        return _PlatePart(**own, found=found)


_PART = tuple(one.name for one in fields(_PlatePart) if one.name != "found")
_HEIGHTS = tuple(one.name for one in fields(Heights))


def measured_window(job: FringeJob, window: FringeWindow, beside: dict[str, Any]) -> _PlatePart:
    frames = _WindowFrames(job, window, beside)
    known = window.known
    part = _window(replace(job, flashes=window.flashes), frames, known["start"], known["share"], known.get("before_mm"))
    return replace(part, saturated=frames.saturated())


def _window(
    job: FringeJob, frames: _WindowFrames, start: int, share: tuple[float, float], before_mm: FloatArray | None
) -> _PlatePart:
    """job : of the window's flashes. before_mm : where the window before it has the frames that both have."""
    window = job.flashes
    odometer, ahead, cell = np.array([x for x, _ in window]), np.array(job.head.motion), cell_mm(job)
    cameras = [one for one in job.head.cameras if sum(one.id in seen for _, seen in window) >= 3]
    if not cameras:
        raise AnnulusError(f"{job.scan.path}: no camera has 3 frames among {len(window)} flashes beside one another")
    boxes = [_box(job, one, odometer) for one in cameras]
    places, weights = np.zeros(len(window)), np.zeros(len(window))
    slipped, taken, misfits, scale = np.zeros(len(window), bool), [], [], 1.0
    for one, box in zip(cameras, boxes, strict=True):
        images, which = frames.of(one)
        coarse = Points.plate(np.arange(*box[0], COARSE * cell), np.arange(*box[1], COARSE * cell), job.distance_mm)
        view = FringeView.of(one, job.projector, odometer[which, None] * ahead)
        misfits.append(_misfit(heights(view, images, coarse, drift_sigma=DRIFT, residuals=True)))
        taken.append((one, images, which, coarse))
        if misfits[-1] > MISFIT_MAX:
            raise AnnulusError(
                f"{job.scan.path}: its frames do not show the calibration's slide: what is left of the fit is "
                f"{misfits[-1]:.2f} of the fringes' swing, expected below {MISFIT_MAX:g}. Another slide (period), "
                "another distance, or x_mm that are wrong?"
            )
        try:
            steps = find_steps(
                one,
                job.projector,
                odometer[which],
                ahead,
                images,
                coarse,
                odometer_sigma_mm=ODOMETER_SIGMA_MM,
                drift_sigma=DRIFT,
            )
        except AnnulusError:  # no place is seen in all frames: the odometer is all there is
            continue
        weight = 1 / np.maximum(steps.sigma_mm, 1e-6) ** 2
        places[which] += weight * (steps.place_mm + odometer[which[0]])
        weights[which] += weight
        slipped[which] |= steps.slipped
        scale = steps.scale if steps.stretched else scale
    if start == 0 and job.by == "slide":
        check_order(job, [(one, images, odometer[which]) for one, images, which, _ in taken], boxes)
    place = np.where(weights > 0, places / np.maximum(weights, 1e-300), odometer)
    if before_mm is not None:
        place += float(np.mean(before_mm - place[: len(before_mm)]))
    measured, lit, noises = [], np.zeros((0, 3)), []
    for one, images, which, coarse in taken:
        view = FringeView.of(one, job.projector, place[which, None] * ahead)
        first = heights(view, images, coarse, drift_sigma=DRIFT)
        good = first.flag == GOOD
        lit = np.concatenate([lit, coarse.base[good]])
        noises.append(noise_of(first))
    sigma = np.where(weights > 0, np.maximum(weights, 1e-300) ** -0.5, ODOMETER_SIGMA_MM)
    axis = int(np.argmax(np.abs(ahead[:2])))
    none = np.empty(0, np.int64)
    if len(lit) < 9:
        return _PlatePart(start, place, sigma, slipped, none, none, None, scale)
    # nodes of this window's share along the motion, and some more for what looks at neighbours
    ends = [_at(share[k] - start, place) * ahead[axis] for k in (0, 1)]
    middle = float(np.mean([np.mean(box[axis]) for box in boxes]) - place.mean() * ahead[axis])
    low, high = sorted(end + middle for end in ends)
    reach = [(lit[:, k].min(), lit[:, k].max()) for k in (0, 1)]
    nodes = []
    for k, (least, most) in enumerate(reach):
        if k == axis:
            least, most = max(least, low - MARGIN * cell), min(most, high + MARGIN * cell)
        nodes.append(np.arange(math.ceil(least / cell), math.floor(most / cell) + 1))
    if min(map(len, nodes)) < 1:
        return _PlatePart(start, place, sigma, slipped, none, none, None, scale)
    grid = Points.plate(nodes[0] * cell, nodes[1] * cell, job.distance_mm)
    blurs = []
    if job.by == "cameras":
        noise = tuple(float(one) for one in np.mean(noises, axis=0))
        measured.append(_by_cameras(job, [one[:3] for one in taken], place, grid, (noise[0], noise[1], noise[2])))
        blurs.append(cell / 2)
    for (one, images, which, _), noise in zip(taken if job.by == "slide" else [], noises, strict=False):
        view = FringeView.of(one, job.projector, place[which, None] * ahead)
        found, blur = untextured(view, grid, heights(view, images, grid, noise=noise, drift_sigma=DRIFT))
        measured.append(_certain(view, grid, found, job.head.rms_rad))
        blurs.append(blur or cell / 2)
    both = merged(measured)
    apart = _apart(measured)
    both = replace(both, sigma_mm=both.sigma_mm * apart)
    both = edged(grid, both, float(np.mean(blurs)))
    i, j = (one.ravel() for one in np.meshgrid(nodes[0], nodes[1]))
    own = ((i, j)[axis] * cell >= low) & ((i, j)[axis] * cell < high)
    height, spread, dc, ac, misfit, used, flag = (
        np.asarray(getattr(both, name))[own] for name in ("height_mm", "sigma_mm", "dc", "ac", "misfit", "used", "flag")
    )
    share_of = Heights(height, spread, dc, ac, misfit, used, flag, np.empty((0, 0), np.float32))
    return _PlatePart(start, place, sigma, slipped, i[own], j[own], share_of, scale, apart)


def _phased(job: FringeJob) -> FringeJob:
    """The same, the slide's phase and period as the first window's cameras see them."""
    frames = _WindowFrames(job, _first(job), {})
    window = job.flashes[:WINDOW]
    odometer = np.array([x for x, _ in window])
    boxes = [_box(job, one, odometer) for one in job.head.cameras]
    low, high = np.max(boxes, axis=0)[:, 0], np.min(boxes, axis=0)[:, 1]
    step = COARSE * cell_mm(job)
    points = Points.plate(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step), job.distance_mm)
    pair, moved, images = _pair(job, [(one, *frames.of(one)) for one in job.head.cameras], odometer)
    try:
        return replace(job, projector=slide_seen(pair, job.projector, moved, images, points, _bounds(job)))
    except AnnulusError as error:
        raise AnnulusError(f"{job.scan.path}: {error}") from None


def _pair(
    job: FringeJob, taken: Sequence[tuple[HeadCamera, Float32Array, IntArray]], place: FloatArray
) -> tuple[tuple[HeadCamera, HeadCamera], FloatArray, tuple[Float32Array, Float32Array]]:
    """Two cameras, (N, 3) mm and (N, H, W) each of the flashes that both have. AnnulusError for fewer than 3."""
    if len(taken) < 2 or len(common := np.intersect1d(taken[0][2], taken[1][2])) < 3:
        raise AnnulusError(f"{job.scan.path}: no 3 of {len(place)} flashes in a row have both cameras' frames")
    (one, first, a), (other, second, b) = taken
    images = first[np.isin(a, common)], second[np.isin(b, common)]
    return (one, other), place[common, None] * np.array(job.head.motion), images


def _bounds(job: FringeJob) -> tuple[float, float]:
    return -REACH * job.distance_mm, REACH * job.distance_mm


def _by_cameras(
    job: FringeJob,
    taken: Sequence[tuple[HeadCamera, Float32Array, IntArray]],
    place: FloatArray,
    grid: Points,
    noise: tuple[float, float, float],
) -> Heights:
    pair, moved, images = _pair(job, taken, place)
    return stereo_heights(pair, job.projector, moved, images, grid, _bounds(job), noise=noise, drift_sigma=DRIFT)


def _misfit(found: Heights) -> float:
    """rms residual over the swing, the median of the points with a height; 0 where there are none."""
    good = found.flag == GOOD
    rest = np.nan_to_num(found.residual[:, good])
    share = np.sqrt((rest**2).sum(axis=0) / np.maximum(found.used[good], 1)) / found.ac[good]
    return float(np.median(share)) if len(share) else 0.0


def _certain(view: FringeView, grid: Points, found: Heights, rms_rad: float) -> Heights:
    """Without the heights that are none: farther than half a fringe from the plate where the fit began, or known to
    less than a phase is worth. Sigma has the calibration's own: what the slide's phase was off on the plate it was
    calibrated on lies as far about here, and no number of frames makes it less."""
    rate = np.abs(view.radians_per_mm(grid, np.zeros(len(grid.base))))
    with np.errstate(invalid="ignore"):
        far, vague = np.abs(found.height_mm) * rate > np.pi, found.sigma_mm * rate > VAGUE_RAD
    gone = found.flag == GOOD
    flag = np.where(gone & far, AMBIGUOUS, np.where(gone & vague, UNMODULATED, found.flag))
    lost = far | vague
    sigma = np.hypot(found.sigma_mm, rms_rad / np.maximum(rate, 1e-9))
    height, sigma = (np.where(lost, np.nan, one) for one in (found.height_mm, sigma))
    return replace(found, height_mm=height, sigma_mm=sigma, flag=flag.astype(float))


def _apart(measured: Sequence[Heights]) -> float:
    """How many times their sigma two cameras differ on the same cells, at least 1; nothing checks one camera alone."""
    out = [1.0]
    for a, b in itertools.pairwise(measured):
        gap = (a.height_mm - b.height_mm) / np.hypot(a.sigma_mm, b.sigma_mm)
        gap = gap[np.isfinite(gap)]
        if len(gap) >= CHECKED_MIN:
            out.append(robust_sigma(gap))
    return max(out)


def _at(k: float, place: FloatArray) -> float:
    """Where the head stood at the k-th flash, between two as well."""
    return k if math.isinf(k) else float(np.interp(k, np.arange(len(place)), place))


def _box(job: FringeJob, one: HeadCamera, odometer: FloatArray) -> Box:
    """Least and most x, y of the plate that a camera sees from these positions, mm."""
    width, height = one.camera.width, one.camera.height
    edge = np.array([(u, v) for u in np.linspace(0, width - 1, 9) for v in np.linspace(0, height - 1, 9)])
    turn = np.array(one.rotation)
    rays, eye = one.camera.rays(edge) @ turn, -turn.T @ np.array(one.translation_mm)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(rays[:, 2] > 0.05, (job.distance_mm - eye[2]) / rays[:, 2], np.nan)
    at = eye[:2] + rays[:, :2] * far[:, None]
    moved = np.outer([odometer.min(), odometer.max()], np.array(job.head.motion)[:2])
    low, high = np.nanmin(at, axis=0) + moved.min(axis=0), np.nanmax(at, axis=0) + moved.max(axis=0)
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def _joined(job: FringeJob, parts: Sequence[_PlatePart], started: float) -> Plate:
    some = [part for part in parts if part.found is not None]
    if not some:
        raise AnnulusError(f"{job.scan.path}: shows no fringes of this slide on the plate, nothing to measure")
    cell = cell_mm(job)
    i, j = (np.concatenate([getattr(part, name) for part in some]) for name in ("i", "j"))
    shape = (int(j.max() - j.min()) + 1, int(i.max() - i.min()) + 1)
    where = (j - j.min(), i - i.min())

    def grid(name: str, empty: float = math.nan) -> FloatArray:
        out = np.full(shape, empty)
        out[where] = np.concatenate([getattr(part.found, name) for part in some])
        return out

    flag = grid("flag", TOO_FEW)
    lit: BoolArray = ndimage.binary_fill_holes(
        ndimage.binary_closing(np.pad(flag == GOOD, COARSE), iterations=COARSE // 2)
    )
    lit = lit[COARSE:-COARSE, COARSE:-COARSE] | (flag == GOOD)
    counts = Counter(int(one) for one in flag[lit & (flag != GOOD)])
    reasons = {**REASONS, AMBIGUOUS: NO_TEXTURE} if job.by == "cameras" else REASONS
    untold = {reasons[kind]: n for kind, n in sorted(counts.items())}
    good = flag == GOOD
    dc, ac = grid("dc"), grid("ac")
    with np.errstate(divide="ignore", invalid="ignore"):
        modulation = np.where(good, ac / dc, np.nan)
    places = np.full(len(job.flashes), np.nan)
    sigma = np.full(len(job.flashes), np.nan)
    slipped = np.zeros(len(job.flashes), bool)
    for part in parts:
        inside = slice(part.start, part.start + len(part.place_mm))
        places[inside], sigma[inside] = part.place_mm, part.sigma_mm
        slipped[inside] |= part.slipped
    return Plate(
        (np.arange(shape[1]) + i.min()) * cell,
        (np.arange(shape[0]) + j.min()) * cell,
        np.where(good, grid("height_mm"), np.nan),
        np.where(good, grid("sigma_mm"), np.nan),
        np.where(good, dc, np.nan),
        modulation,
        lit,
        job.distance_mm,
        untold,
        tuple(job.scan.frames[next(iter(seen.values()))].index for _, seen in job.flashes),
        places,
        sigma,
        np.array([x for x, _ in job.flashes]),
        (*job.findings, *_findings(job, parts, slipped, untold, lit, some)),
        {"scan_to_heights": 1e3 * (time.perf_counter() - started)},
        job.by,
    )


def _findings(
    job: FringeJob,
    parts: Sequence[_PlatePart],
    slipped: BoolArray,
    untold: dict[str, int],
    lit: BoolArray,
    some: Sequence[_PlatePart],
) -> list[Finding]:
    out = []
    if slipped.any():
        indices = tuple(
            job.scan.frames[next(iter(seen.values()))].index
            for (_, seen), one in zip(job.flashes, slipped, strict=True)
            if one
        )
        named = first_few(indices)
        out.append(
            Finding(
                "slip",
                f"x_mm disagrees with the frames at {len(indices)} of them ({named}): the frames' places are used",
                indices,
            )
        )
    scales = [part.scale for part in some if part.scale != 1.0]
    if scales:
        far = f"{np.median(scales):.2f}"
        text = f"x_mm is wrong as a whole: by the frames the head went about {far} times as far, taken so"
        out.append(Finding("stretched", text))
    if (apart := max(part.apart for part in some)) > APART:
        text = (
            f"the cameras' heights differ by {apart:.1f} times their sigma, which is widened by that: is this the "
            "slide and are these the cameras of the calibration?"
        )
        out.append(Finding("cameras-apart", text))
    frames = {(index, camera): (lost, size) for part in parts for index, camera, lost, size in part.saturated.tolist()}
    saturated, pixels = (sum(one[k] for one in frames.values()) for k in (0, 1))
    if saturated > SATURATED_MAX * pixels:
        share = 100 * saturated / pixels
        out.append(Finding("saturated", f"{share:.1f} % of all pixels are saturated and say nothing: expose less"))
    if sum(untold.values()) > UNTOLD_MAX * lit.sum():
        reasons = ", ".join(f"{n} {reason}" for reason, n in untold.items())
        out.append(Finding("untold", f"{sum(untold.values())} of {int(lit.sum())} lit cells have no height: {reasons}"))
    return out
