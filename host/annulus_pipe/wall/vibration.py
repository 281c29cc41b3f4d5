"""Periodic errors along the pipe that the head's shaking left in the points, found in the frequency domain.

What shakes with the head is wrong alike in all rings of a frame, but the rings of a frame lie on different places of
the wall. So every frame is compared with what the other frames saw at the same places: of a defect, or of a wall that
is really corrugated, nothing is left in that, of the head's shaking most. Only lines that stand out of the noise, in
every third of the section, are taken out; how much of them, the wall of every patch left free, is least squares.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, biweight, robust_sigma
from annulus_pipe.wall.profile import Profile

MODES = ("radius", "shift", "lean", "oval")  # what shakes: cosine and sine of the clock but for the first
MEMBERS = ((0,), (1, 2), (3, 4), (5, 6))  # columns of `_Observations.basis`
# FRAMES_LEAST and CYCLES_LEAST (upwards) are guarded by test_vibration.py; OVERSAMPLED and LINES_MOST: unguarded. The
# benchmark topic artefacts holds all together (0.3 mm of shaking at three periods, and a groove).
FRAMES_LEAST = 24  # frames along the pipe
CYCLES_LEAST = 3.0  # cycles over the section; what is slower is the pipe's course
OVERSAMPLED = 5.0  # steps of frequency in the width of a line
LINES_MOST = 8  # lines taken out
FALSE_ALARM = 1e-4  # probability that noise alone makes a line anywhere in the spectrum
AMPLITUDE_MM = 0.02  # on the wall; of no interest below
MINOR = 0.2  # a mode with less than this part of the strongest one's amplitude is left in
THIRDS = 0.4  # a line has this part of its amplitude in each third of the section, in step
PATCHES = 36  # patches round the pipe: a ring of a frame is one observation of each
PATCH_OF_RADIUS = 0.02  # of the radius: length of a patch along the pipe, at least; else the way between two frames
POINTS_LEAST = 4  # points in an observation
WILD = 5.0  # robust standard deviations: an observation so far off its frame's others sees an edge of the wall


@dataclass(frozen=True, slots=True)
class VibrationLine:
    """One frequency that was taken out. hertz is None where the frame rate is not known. mm: amplitude on the wall by
    mode (see MODES), the worst place round the clock; amplitude_mm of all together."""

    cycles_per_m: float
    hertz: float | None
    mm: tuple[tuple[str, float], ...]

    @property
    def amplitude_mm(self) -> float:
        return math.sqrt(sum(value * value for _, value in self.mm))


@dataclass(frozen=True, slots=True)
class Vibration:
    """What was looked for and what was found. rms_mm: of the frames' common departures, before and after. why: where
    nothing could be looked for."""

    lines: tuple[VibrationLine, ...]
    rms_mm: tuple[float, float]
    why: str = ""


def without_vibration(profiles: Sequence[Profile], fps: float | None = None) -> tuple[tuple[Profile, ...], Vibration]:
    """The same profiles, registered ones best, with what shakes periodically in step with the head taken out.

    fps : frames a second, lost ones counted; only to say frequencies in hertz. Profiles without a pose come back as
    they are; a section too short to tell comes back whole.
    """
    current = list(profiles)
    used = [i for i, p in enumerate(current) if p.pose is not None and len(p.ring)]
    used.sort(key=lambda i: current[i].z_mm)
    z = np.array([current[i].z_mm for i in used])
    length = float(np.ptp(z)) if len(used) else 0.0
    if len(used) < FRAMES_LEAST or length <= 0:
        why = f"{len(used)} frames, at least {FRAMES_LEAST} along the pipe are needed"
        return tuple(current), Vibration((), (math.nan, math.nan), why)
    step = float(np.median(np.diff(np.unique(z))))
    grid = np.arange(CYCLES_LEAST / length, 0.5 / step, 1.0 / (OVERSAMPLED * length))  # cycles a mm
    seen = _observations([current[i] for i in used], step)
    frames = np.array([current[i].frame for i in used], float)
    pace = length / float(np.ptp(frames)) if np.ptp(frames) > 0 else math.nan  # mm a frame
    found: list[tuple[float, FloatArray]] = []
    before = after = math.nan
    while True:
        series, good = _departures(seen, len(used))
        after = float(np.sqrt(np.mean((series - np.median(series, axis=0)) ** 2)))
        before = after if not found else before
        f = _line(z, series, grid, [f for f, _ in found]) if len(found) < LINES_MOST else None
        if f is None:
            break
        weights = _fit(seen, good, z, f)
        found.append((f, weights))
        seen = replace(seen, radius=seen.radius - _shaken(seen, z, f, weights))
    for f, weights in found:
        for i in used:
            current[i] = _less(current[i], _wave(current[i].z_mm, f) @ weights, seen.reach_mm)
    lines = [
        VibrationLine(1e3 * f, None if fps is None or math.isnan(pace) else f * pace * fps, _amplitudes(weights))
        for f, weights in found
    ]
    lines = sorted((line for line in lines if line.mm), key=lambda line: -line.amplitude_mm)
    return tuple(current), Vibration(tuple(lines), (before, after))


@dataclass(frozen=True, slots=True, eq=False)
class _Observations:
    """One ring of one frame at one patch of the wall: which patch, which frame (in order of z), the radius there, and
    what a mm of each mode does to it."""

    patch: NDArray[np.int64]
    frame: NDArray[np.int64]
    radius: FloatArray
    basis: FloatArray  # (S, 7)
    reach_mm: float  # distance ahead at which a lean of 1 is 1 mm


def _basis(points: FloatArray, ahead: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, 7) what each mode does to each point's radius, and the radius; `ahead` is 1 where a lean is in full."""
    x, y = points[:, 0], points[:, 1]
    radius = np.hypot(x, y)
    c, s = x / radius, y / radius
    return np.stack([np.ones_like(c), c, s, ahead * c, ahead * s, c * c - s * s, 2 * c * s], axis=1), radius


def _observations(profiles: Sequence[Profile], step_mm: float) -> _Observations:
    points = np.concatenate([p.points_mm for p in profiles]).astype(np.float64)
    frame = np.repeat(np.arange(len(profiles)), [len(p.ring) for p in profiles])
    ring = np.concatenate([p.ring for p in profiles]).astype(np.int64)
    ahead = points[:, 2] - np.array([p.z_mm for p in profiles])[frame]
    reach = float(np.abs(ahead).max())
    basis, radius = _basis(points, ahead / reach)
    size = max(PATCH_OF_RADIUS * float(np.median(radius)), 1.05 * step_mm)
    clock = np.floor(np.arctan2(points[:, 1], points[:, 0]) * (PATCHES / (2 * math.pi))).astype(np.int64) % PATCHES
    row = np.floor((points[:, 2] - points[:, 2].min()) / size).astype(np.int64)
    rings = int(ring.max()) + 1
    # A tilted ring may cross two rows of a column: those are two.
    _, own, count = np.unique(
        ((row * PATCHES + clock) * len(profiles) + frame) * rings + ring, return_inverse=True, return_counts=True
    )

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(own, weights=values) / count)

    enough = count >= POINTS_LEAST
    return _Observations(
        mean((row * PATCHES + clock).astype(float))[enough].astype(np.int64),
        mean(frame.astype(float))[enough].astype(np.int64),
        mean(radius)[enough],
        np.stack([mean(column) for column in basis.T], axis=1)[enough],
        reach,
    )


def _departures(seen: _Observations, frames: int) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(F, 7) mm: each frame's amplitude of each mode against what the other frames saw; and which observations were
    no outliers, as those at an edge are."""
    _, patch = np.unique(seen.patch, return_inverse=True)
    _, mine = np.unique(patch * frames + seen.frame, return_inverse=True)
    own, own_count = np.bincount(mine, weights=seen.radius)[mine], np.bincount(mine)[mine]
    others = np.bincount(patch)[patch] - own_count
    with np.errstate(invalid="ignore", divide="ignore"):
        off = seen.radius - (np.bincount(patch, weights=seen.radius)[patch] - own) / others
    shared = others > 0
    good = shared.copy()
    out = np.zeros((frames, 7))
    order = np.argsort(seen.frame, kind="stable")
    for members in np.split(order, np.searchsorted(seen.frame[order], np.arange(1, frames))):
        mine = members[shared[members]]
        if len(mine) < 3 * PATCHES // 2:
            good[mine] = False
            continue
        basis, value = seen.basis[mine], off[mine]
        fit: FloatArray = np.zeros(7)
        for _ in range(5):
            left = value - basis @ fit
            u = left / (WILD * max(robust_sigma(left), 0.01))
            weighted = basis * biweight(u)[:, None]
            fit = np.asarray(np.linalg.solve(weighted.T @ basis + 1e-6 * len(value) * np.eye(7), weighted.T @ value))
        good[mine] = np.abs(u) < 1
        out[seen.frame[mine[0]]] = fit
    return out, good


def _wave(z: FloatArray | float, f: float) -> FloatArray:
    """(.., 2) cosine and sine of one frequency."""
    return np.stack([np.cos(2 * math.pi * f * np.asarray(z)), np.sin(2 * math.pi * f * np.asarray(z))], axis=-1)


def _shaken(seen: _Observations, z: FloatArray, f: float, weights: FloatArray) -> FloatArray:
    return np.asarray((seen.basis * (_wave(z, f) @ weights)[seen.frame]).sum(axis=1))


def _fit(seen: _Observations, good: NDArray[np.bool_], z: FloatArray, f: float) -> FloatArray:
    """(2, 7) mm of cosine and sine of every mode, the wall's own radius in every patch free."""
    _, patch = np.unique(seen.patch[good], return_inverse=True)
    count = np.bincount(patch)
    wave = _wave(z, f)[seen.frame[good]]
    columns = [wave[:, i] * seen.basis[good, j] for i in range(2) for j in range(7)]
    design, value = (
        np.stack([c - (np.bincount(patch, weights=c) / count)[patch] for c in some], axis=1)
        for some in (columns, [seen.radius[good]])
    )
    # A little ridge: what shifts the whole wall alike, whichever frame looks, cannot be told from it.
    normal = design.T @ design + 1e-3 * len(design) * np.eye(14)
    weights = np.linalg.solve(normal, design.T @ value[:, 0]).reshape(2, 7)
    sizes = [float(np.linalg.norm(weights[:, list(members)])) for members in MEMBERS]
    for members, size in zip(MEMBERS, sizes, strict=True):
        if size < max(0.5 * AMPLITUDE_MM, MINOR * max(sizes)):
            weights[:, list(members)] = 0.0
    return np.asarray(weights)


def _line(z: FloatArray, series: FloatArray, grid: FloatArray, known: Sequence[float]) -> float | None:
    """The frequency that stands out most and goes through the whole section."""
    if not len(grid):
        return None
    left = series - np.median(series, axis=0)
    spread = np.maximum(SIGMA_OF_MAD * np.median(np.abs(left), axis=0), 1e-3)
    left = np.clip(left, -4 * spread, 4 * spread)  # a frame that went wrong is no line
    width = 1.0 / float(np.ptp(z))
    part = 2 / len(z) * np.stack([((_wave(z, f).T @ left) ** 2).sum(axis=0) for f in grid]) / (left**2).sum(axis=0)
    score = (-0.5 * len(z) * np.log1p(-np.clip(part, 0.0, 0.999))).max(axis=1)  # log likelihood gained
    for f in known:
        score[np.abs(grid - f) < width] = 0.0
    level = math.log(len(grid) * 7 / FALSE_ALARM)
    for _ in range(LINES_MOST):
        top = int(score.argmax())
        if score[top] < level:
            return None
        tries = grid[top] + np.linspace(-1, 1, 21) * width / OVERSAMPLED
        f = float(tries[int(np.argmax([((_wave(z, t).T @ left) ** 2).sum() for t in tries]))])
        if _stands(z, left, f):
            return f
        score[np.abs(grid - f) < width] = 0.0
    return None


def _stands(z: FloatArray, series: FloatArray, f: float) -> bool:
    """Whether each third of the section has the line's amplitude, in step."""
    wave = np.concatenate([np.ones((len(z), 1)), _wave(z, f)], axis=1)
    whole = np.linalg.lstsq(wave, series, rcond=None)[0][1:]
    if float(np.linalg.norm(whole)) < AMPLITUDE_MM:
        return False
    for part in np.array_split(np.arange(len(z)), 3):
        here = np.linalg.lstsq(wave[part], series[part], rcond=None)[0][1:]
        if float((here * whole).sum()) < THIRDS * float((whole * whole).sum()):
            return False
    return True


def _amplitudes(weights: FloatArray) -> tuple[tuple[str, float], ...]:
    """Of one line (2, 7): mm by mode, those that were taken out; of two in turn the longer half-axis."""
    sizes = [(name, float(np.linalg.norm(weights[:, list(m)], 2))) for name, m in zip(MODES, MEMBERS, strict=True)]
    return tuple((name, size) for name, size in sizes if size > 0)


def _less(profile: Profile, shaken: FloatArray, reach_mm: float) -> Profile:
    points = profile.points_mm.astype(np.float64)
    basis, radius = _basis(points, (points[:, 2] - profile.z_mm) / reach_mm)
    points[:, :2] *= (1.0 - (basis @ shaken) / radius)[:, None]
    return replace(profile, points_mm=points.astype(np.float32))
