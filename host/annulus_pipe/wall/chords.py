"""Where a chord cuts the pipe's round: stretches whose bottom is a line and no part of the slabs.

A level cuts the pipe's round by a chord: the wall goes round as ever down to both its corners, and between them points
lie along a line, inwards of where the wall must be. A dent has no corners, an oval no line, a bump no length.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.wall.shape import fit_shape, harmonics, spread

# Held as a whole by test_levels.py; not tried one by one.
DOWN_DEG = 180.0  # clock angle
HIDDEN_DEG = 80.0  # each side of the bottom: nothing there says at first where the wall is
LOOKED_DEG = 100.0  # each side of the bottom: where a level is looked for
LEAST_HALF_DEG = 12.0  # half of a level's arc: such a chord is 0.02 of the radius deep
MOST_HALF_DEG = 84.0  # .. at most: a pipe nearly half full
LEAST_OF_RADIUS = 0.008  # of the radius: half of what the middle of the least chord stands inwards, through water
BESIDE_DEG = 15.0  # of wall beside a level's corners that is judged with it
CAP_OF_RADIUS = 0.15  # of the radius: a cell that is farther off than this is just off
AS_IT_LOOKS = (1.0, 0.8, 0.6)  # parts of its depth that what lies below a level may seem cut off: less, through water
EXPLAINED = 0.65  # part of what a slab departs from the wall, that its chord explains: each slab's ..
EXPLAINED_USUAL = 0.8  # .. and the median slab's
SEEN_LEAST = 0.2  # part of a level's arc, each side of its middle, that has cells: deep down no ring is believed
LENGTH_OF_RADIUS = 1.0  # of the radius: a shorter one is a heap, a bump or the rim of a tee
STEP_OF_RADIUS = 0.05  # of the radius: a level goes on if the next slab's is so near
END_SLABS = 5  # whose arc is held against the slabs beyond them
INNER = 0.8  # part of a level's arc that shows whether it goes on
ON_WALL = 0.3  # part of what a chord cuts off: what is less far inwards is wall; and part of the cells that must be


@dataclass(frozen=True, slots=True, eq=False)
class Slabs:
    """Radii (Z, A) in mm of short slabs of pipe, NaN where nothing was seen; where their middles (Z,) and columns (A,)
    lie."""

    radius_mm: FloatArray
    z_mm: FloatArray
    clock_deg: FloatArray

    @property
    def clock_step_deg(self) -> float:
        return 360.0 / len(self.clock_deg)

    @property
    def z_step_mm(self) -> float:
        return float(self.z_mm[1] - self.z_mm[0])


@dataclass(frozen=True, slots=True, eq=False)
class Chord:
    """A stretch cut off by a line: which slabs, the clock angle of its middle; half of its arc in degrees and the
    wall's radius below it (S,); how well that is known, standard deviation in mm."""

    rows: slice
    clock_deg: float
    half_deg: FloatArray
    radius_mm: FloatArray
    radius_sigma_mm: float


def turn_from(clock_deg: FloatArray | float, other_deg: float) -> FloatArray:
    """Degrees from one clock angle to others, clockwise, -180..180."""
    return (np.asarray(clock_deg) - other_deg + 180.0) % 360.0 - 180.0


def find_chords(slabs: Slabs, off_deg: float) -> list[Chord]:
    """Stretches of the wall that a chord explains, its middle at most `off_deg` off the bottom.

    First no part of the bottom says where the wall is, then all that is not below what was found.
    """
    hidden = np.broadcast_to(np.abs(turn_from(slabs.clock_deg, DOWN_DEG)) < HIDDEN_DEG, slabs.radius_mm.shape)
    found: list[Chord] = []
    for _ in range(2):
        found = _stretches(slabs, hidden, off_deg)
        if not found:
            break
        hidden = np.zeros(slabs.radius_mm.shape, np.bool_)
        for chord in found:
            away = np.abs(turn_from(slabs.clock_deg, chord.clock_deg))
            hidden[chord.rows] |= away <= chord.half_deg[:, None] + slabs.clock_step_deg
    return found


def _stretches(slabs: Slabs, hidden: BoolArray, off_deg: float) -> list[Chord]:
    shape, covariance = fit_shape(np.where(hidden, np.nan, slabs.radius_mm), slabs.z_mm, slabs.clock_deg)
    radius = shape @ harmonics(slabs.clock_deg).T
    sigma = spread(covariance, harmonics(slabs.clock_deg))
    size = float(np.median(shape[:, 0]))
    inwards = radius - slabs.radius_mm
    fits = [_best(slabs, sunk, line, off_deg) for sunk, line in zip(inwards, radius, strict=True)]
    good = np.array([fit is not None for fit in fits])
    good |= ndimage.binary_closing(np.pad(good, 2), np.ones(3))[2:-2]
    label, count = ndimage.label(good)
    out = []
    for n in range(1, count + 1):
        mine = np.flatnonzero(label == n)
        at = np.array([i for i in mine if fits[i] is not None])
        halves, turn, explained = np.array([fits[i] for i in at]).T
        clock = DOWN_DEG + float(np.median(turn))
        column = int(np.argmin(np.abs(turn_from(slabs.clock_deg, clock))))
        steps = np.abs(np.diff(radius[at, column] * np.cos(np.radians(halves))))
        if (
            len(mine) * slabs.z_step_mm < LENGTH_OF_RADIUS * size
            or np.median(explained) < EXPLAINED_USUAL
            or np.percentile(steps, 90) > STEP_OF_RADIUS * size
            or not _cornered(slabs, nan_median(inwards[at]), radius[at].mean(axis=0), clock, float(np.median(halves)))
        ):
            continue
        first, last = (_goes_on(slabs, inwards, radius, clock, halves, at, step) for step in (-1, 1))
        rows = slice(first, last + 1)
        half = np.interp(np.arange(first, last + 1), at, halves)
        error = float(np.median(sigma[at, column]))
        out.append(Chord(rows, clock, half, radius[rows, column], error))
    return out


def _cornered(slabs: Slabs, inwards: FloatArray, radius: FloatArray, clock: float, half: float) -> bool:
    """Whether a stretch looks more like a chord, which has corners, than like any dent, which has none.

    inwards, radius (A,): how far the stretch lies inwards of the wall, and the wall.
    """
    least = []
    for middle in clock + np.arange(-2.0, 2.5, 0.5):  # chords were looked for in steps of two degrees
        away = np.abs(turn_from(slabs.clock_deg, middle))
        judged = np.isfinite(inwards) & (away <= half + BESIDE_DEG)
        away, value, wall = away[judged], inwards[judged], radius[judged]
        wide = np.arange(0.7, 1.3, 0.02)[:, None] * half
        along = np.cos(np.radians(np.minimum(away, LOOKED_DEG - BESIDE_DEG)))
        chords = np.maximum(wall * (1.0 - np.cos(np.radians(wide)) / along), 0.0)
        wide = np.arange(0.7, 2.5, 0.05)[:, None] * half
        dents = np.cos(np.radians(90.0 * np.minimum(away / wide, 1.0))) ** 2
        least.append([_left_by(forms, value) for forms in (chords, dents)])
    by_chord, by_dent = np.min(least, axis=0)
    return bool(by_chord < by_dent)


def _left_by(forms: FloatArray, value: FloatArray) -> float:
    """What the best of forms (F, N), each scaled as it likes, leaves of values (N,): the sum of absolute values."""
    scale = (forms * value).sum(axis=1) / np.maximum((forms**2).sum(axis=1), 1e-9)
    return float(np.abs(value - scale[:, None] * forms).sum(axis=1).min())


def _goes_on(
    slabs: Slabs,
    inwards: FloatArray,
    radius: FloatArray,
    clock: float,
    halves: FloatArray,
    at: NDArray[np.int64],
    step: int,
) -> int:
    """The last slab, in one direction, before the wall is seen again where a chord cuts it off. A slab that shows too
    little to be told by itself does not end a level, and slabs that show nothing do not prolong it unless they are the
    scan's last."""
    i = last = int(at[0] if step < 0 else at[-1])
    half = float(np.median(halves[:END_SLABS] if step < 0 else halves[-END_SLABS:]))
    away = turn_from(slabs.clock_deg, clock)
    along = np.cos(np.radians(np.minimum(np.abs(away), half)))
    while 0 <= i + step < len(radius):
        i += step
        chord = radius[i] * (1.0 - np.cos(np.radians(half)) / along)
        judged = np.isfinite(inwards[i]) & (np.abs(away) <= INNER * half)
        if np.count_nonzero(judged & (inwards[i] < ON_WALL * chord)) > ON_WALL * np.count_nonzero(judged):
            return last
        if judged.any():
            last = i
    return i if abs(i - last) * slabs.z_step_mm <= LENGTH_OF_RADIUS * radius[last].mean() else last


def _best(slabs: Slabs, inwards: FloatArray, radius: FloatArray, off_deg: float) -> tuple[float, float, float] | None:
    """Half of its arc, turn from the bottom (both in degrees), and explained part of the chord that explains a slab
    best; None where none explains enough.

    inwards, radius (A,): how far the slab lies inwards of the wall, NaN where not seen, and the wall.
    """
    off, size = turn_from(slabs.clock_deg, DOWN_DEG), float(radius.mean())
    near = np.isfinite(inwards) & (np.abs(off) < LOOKED_DEG)
    sunk = near & (inwards > LEAST_OF_RADIUS * size)
    if np.count_nonzero(sunk) * slabs.clock_step_deg < LEAST_HALF_DEG:
        return None
    off, value, round_ = off[near], inwards[near], radius[near]
    cap = CAP_OF_RADIUS * size
    nothing = np.minimum(np.abs(value), cap)
    halves = np.arange(LEAST_HALF_DEG, MOST_HALF_DEG + 1.0)
    best, half, turn = 0.0, 0.0, 0.0
    for middle in np.arange(-off_deg, off_deg + 1.0, 2.0):
        along = np.cos(np.radians(off - middle))
        height = float(np.interp(middle, off, round_)) * np.cos(np.radians(halves))[:, None]
        chord = np.where(along > 0.05, np.maximum(round_ - height / np.maximum(along, 0.05), 0.0), 0.0)
        for part in AS_IT_LOOKS:
            gain = (nothing - np.minimum(np.abs(value - part * chord), cap)).sum(axis=1)
            i = int(np.argmax(gain))
            if gain[i] > best:
                best, half, turn = float(gain[i]), float(halves[i]), float(middle)
    away = off - turn
    sides = [np.count_nonzero((side >= 0) & (side <= half)) * slabs.clock_step_deg for side in (away, -away)]
    explained = best / max(float(nothing[np.abs(away) <= half + BESIDE_DEG].sum()), 1e-9)
    return (half, turn, explained) if min(sides) >= SEEN_LEAST * half and explained >= EXPLAINED else None
