"""Which numbers of a capacitive log are readings: what a wall cannot give, a chip or a wire gave.

Four signs, each by what a reading is. Air, water, contact and lift-off bound it. Electrodes as long as these smooth it
along the pipe. Every true reading has noise, so that one which repeats while the head moves comes of a chip that froze.
And what leaves its neighbours again and again comes of a loose wire. What is no reading is unseen, by sector, and its
neighbours with it: a chip that fails, or a wire that comes loose, does so some readings before it is plain.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import robust_sigma

SECTORS = 3
OFF = 6.0  # standard deviations at which a reading is no part of what is beside it
SPIKE_ROWS = 3  # to either side of a reading: a spike is one or two rows
# Of the field (`crossbore.field`): a sector that touches the wall under water reads 3.0 swings from air to soil, or
# 0.85 pF, over air; the twin's lift-off 1.35 pF. One that stands as far off as the pipe lets it, in air behind a
# coupling, 0.39 pF under it. A head whose air reads k times as much has k times the room.
UNDER_AIR, OVER_AIR = 600.0 / 4575.0, 1500.0 / 4575.0
LOSS_OF_OVER = 0.5  # a wall in series with soil loses at most half of what it can add
# Of an edge's height, in 15 mm: 0.36 by the field of water behind air, the sharpest there is, 0.22 by the twin; an
# odometer that slips by 8 mm makes 0.55 of the first.
EDGE_PART, EDGE_OVER_MM, EDGE_MM = 0.7, 15.0, 40.0
JUMP_FF = 15.0  # a head that is kicked by 0.2 mm; less than any bore takes off
REFERENCE_PART = 0.03  # a fixed capacitor moves by 100 ppm a kelvin at most
STILL = 0.1  # of the readings' own scatter: what changes by less has no noise
STILL_ROWS, STILL_TIMES = 8, 5.0  # so many rows, and so many times what this log's readings repeat anyhow
STILL_MM = 20.0  # that the head moved meanwhile
COARSE_STILL_MM = 3000.0  # the same where steps of the log hide the noise: no soil is so even
QUIET, QUIET_SIGMAS = 0.2, 0.2533  # of a normal noise so many are within so many standard deviations
LOOSE_ROWS, LOOSE_PART = 15, 0.4  # a bead takes up six rows at most, a spike two
NOISE_MOST_FF = 5.0  # eight times the chip's; what scatters by more all along is loose all along


class NoReadingReason(StrEnum):
    """Why a number is no reading."""

    NONE = "no number"
    RANGE = "more or less than it can read"
    STUCK = "the reading stood still while the head moved"
    LOOSE = "readings that jump to and fro"
    JUMP = "a jump faster than electrodes so long can see"


WHYS = tuple(NoReadingReason)


@dataclass(frozen=True, slots=True)
class CapacitiveHead:
    """What a head reads, told once on the bench. Those of the simulated 2.4-inch head in a 3-inch pipe of SDR 11.

    air_ff : a sector's reading in a pipe in air. sector_deg : how wide a sector looks. coupling_ff, coupling_mm : what
    a coupling takes off every sector, and over what length at half of that.
    """

    air_ff: float = 4575.0
    sector_deg: float = 110.0
    coupling_ff: float = 113.0
    coupling_mm: float = 130.0

    @property
    def range_ff(self) -> tuple[float, float]:
        """What a wall, whatever is behind it, can make of a sector."""
        return self.air_ff * (1 - UNDER_AIR), self.air_ff * (1 + OVER_AIR)


HEAD = CapacitiveHead()


@dataclass(frozen=True, slots=True)
class Gap:
    """A stretch without readings. sectors : from 1; 0 is the reference, without which a place is seen all the same."""

    sectors: tuple[int, ...]
    from_mm: float
    to_mm: float
    why: NoReadingReason

    def __str__(self) -> str:
        who = " and ".join("reference" if k == 0 else f"sector {k}" for k in self.sectors)
        if len(self.sectors) == SECTORS:
            who = "all sectors"
        return f"{who} from {self.from_mm / 1000:.2f} to {self.to_mm / 1000:.2f} m: {self.why}"


def doubted(values: FloatArray, z_mm: FloatArray, low: float, high: float, noise_most: float) -> IntArray:
    """(N, K) 0 for a reading, else 1 + the place in WHYS of why it is none. values : (N, K), in time; a bead, which all
    columns see at once, is a reading. noise_most : scatter beyond which nothing is a reading."""
    why = np.zeros(values.shape, np.int64)
    why[(values < low) | (values > high)] = _code(NoReadingReason.RANGE)
    why[~np.isfinite(values)] = _code(NoReadingReason.NONE)
    for k, column in enumerate(values.T):
        known = why[:, k] == 0
        if known.sum() > LOOSE_ROWS:
            why[_stuck(np.where(known, column, np.nan), z_mm), k] = _code(NoReadingReason.STUCK)
    filled = np.stack([_bridged(column, why[:, k] == 0) for k, column in enumerate(values.T)], axis=1)
    often = ndimage.uniform_filter1d(spikes(filled, noise_most).astype(float), LOOSE_ROWS, axis=0, mode="nearest")
    loose = ndimage.maximum_filter1d(often > LOOSE_PART, 2 * LOOSE_ROWS + 1, axis=0)
    failed = (why > 0) & (why != _code(NoReadingReason.NONE))
    beside = ndimage.maximum_filter1d(failed.astype(np.int8), 2 * SPIKE_ROWS + 1, axis=0) > 0
    why[beside & (why == 0)] = _nearest(why, failed)[beside & (why == 0)]
    why[loose & (why == 0)] = _code(NoReadingReason.LOOSE)
    return why


def spikes(c: FloatArray, noise_most: float = NOISE_MOST_FF) -> BoolArray:
    """(N, K): a reading that stands alone; where all rise it is a bead. c : fF.

    What readings usually scatter by is also what they differ by one after the other: a head that swings between the
    walls leaves its median at the ends of each swing only.
    """
    off = c - ndimage.median_filter(c, (2 * SPIKE_ROWS + 1, 1), mode="nearest")
    usual = max(robust_sigma(off), robust_sigma(np.diff(c, axis=0)) / math.sqrt(2.0), 0.3)
    least = OFF * min(max(usual, *(_step(column) for column in c.T)), noise_most)
    bead = (off > least).all(axis=1) if c.shape[1] > 1 else np.zeros(len(c), bool)
    return np.asarray((np.abs(off) > least) & ~bead[:, None])


def stretches(why: IntArray, z_mm: FloatArray) -> list[Gap]:
    """Where readings are doubted, along the pipe, why most of them are, and of sectors alike in one. why : (N, 3)."""
    found: list[Gap] = []
    for k, column in enumerate(why.T):
        rows = np.flatnonzero(column)
        for part in np.split(rows, np.flatnonzero(np.diff(rows) > LOOSE_ROWS) + 1) if len(rows) else ():
            z = z_mm[part]
            mostly = WHYS[int(np.bincount(column[part]).argmax()) - 1]
            found.append(Gap((k + 1,), float(z.min()), float(z.max()), mostly))
    return joined(found)


def joined(gaps: list[Gap]) -> list[Gap]:
    """Of one reason and place in several sectors one; in order."""
    kept: list[Gap] = []
    for one in sorted(gaps, key=lambda gap: (gap.from_mm, gap.sectors)):
        same = [n for n, old in enumerate(kept) if old.why is one.why and old.to_mm >= one.from_mm]
        if not same:
            kept.append(one)
            continue
        old = kept[same[-1]]
        kept[same[-1]] = Gap(
            tuple(sorted({*old.sectors, *one.sectors})), old.from_mm, max(old.to_mm, one.to_mm), one.why
        )
    return kept


def jumps(smooth: FloatArray, seen: BoolArray, step_mm: float, uneven_ff: float) -> BoolArray:
    """(G, K) where a sector changes faster along the pipe than its electrodes let any wall; both sides of the edge.

    smooth : (G, K) fF each step, without beads; seen : (G, K) that were read. uneven_ff : of one sector
    against the others: a head that wanders while it stands, or comes back, jumps by as much. Electrodes see what lies
    along their length at once: they take so long from one side of the sharpest edge to the other, whatever its height.
    A jump is over in a step.
    """
    over = round(EDGE_OVER_MM / step_mm)  # one that is over in a step may lie in two, with nothing read between
    change = smooth[over:] - smooth[:-over]
    near = 2 * round(EDGE_MM / step_mm) + 1
    height = ndimage.maximum_filter1d(smooth, near, axis=0) - ndimage.minimum_filter1d(smooth, near, axis=0)
    least = JUMP_FF + uneven_ff + OFF * min(robust_sigma(change), NOISE_MOST_FF)
    edge = np.abs(change) > np.maximum(least, EDGE_PART * np.minimum(height[over:], height[:-over]))
    edge &= seen[over:] & seen[:-over]
    end = near // 2  # of a log: how high the edge is there nobody knows yet
    edge[:end] = edge[max(len(edge) - end, 0) :] = False
    out = np.zeros(smooth.shape, bool)
    for k in range(over + 1):
        out[k : len(out) - over + k] |= edge
    return out


def _code(why: NoReadingReason) -> int:
    return 1 + WHYS.index(why)


def _stuck(column: FloatArray, z_mm: FloatArray) -> BoolArray:
    """(N,) runs of readings on one value, or on a straight line that somebody drew over a hole; NaN ends a run."""
    bend = np.abs(np.diff(column, 2))
    if not np.isfinite(bend).any():
        return np.zeros(len(column), bool)
    # By the quietest fifth: of a log whose wire is loose for half of its way it is the chip's own all the same.
    scatter = float(np.nanquantile(bend, QUIET)) / QUIET_SIGMAS
    moved = STILL_MM if scatter > 0.5 * _step(column) else COARSE_STILL_MM
    still = np.concatenate([[False], bend <= STILL * scatter, [False]])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2] - 1
    out = np.zeros(len(column), bool)
    if not len(first):
        return out
    length = last - first + 1
    # Of all runs, those of no length among them: a log in coarse steps repeats itself, and so does one that is read
    # more often than its chip converts.
    runs = np.concatenate([length, np.zeros(np.count_nonzero(~still), int)])
    least = max(STILL_ROWS, STILL_TIMES * float(np.percentile(runs, 95, method="lower")))
    for a, b in zip(first[length >= least] - 1, last[length >= least] + 1, strict=True):
        out[a : b + 1] = np.ptp(z_mm[a : b + 1]) > moved
    return out


def _step(column: FloatArray) -> float:
    """In which a log writes its readings, or finer: the least by which two after each other differ."""
    change = np.abs(np.diff(column))
    change = change[change > 1e-6 * np.nanmax(np.abs(column))]
    return float(change.min()) if len(change) else 0.0


def _bridged(column: FloatArray, known: BoolArray) -> FloatArray:
    if not known.any():
        return np.zeros(len(column))
    at = np.arange(len(column))
    return np.asarray(np.interp(at, at[known], column[known]))


def _nearest(why: IntArray, failed: BoolArray) -> IntArray:
    """(N, K) the reason of what is next to a reading, within a spike's rows."""
    return np.asarray(ndimage.maximum_filter1d(np.where(failed, why, 0), 2 * SPIKE_ROWS + 1, axis=0))
