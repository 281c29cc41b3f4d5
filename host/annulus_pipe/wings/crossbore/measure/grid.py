"""A capacitive log on an even grid along the pipe: spikes, beads, drift and backwards runs taken out, lift-off by pose.

Three sectors look through the wall, sector k towards 120 k + roll degrees, a fixed capacitor beside them on the same
chip. They are read one after the other while the head moves, now and then backwards, while the odometer slips and rows
are lost: what was read at one place is averaged, and a place where nothing was read stays unknown.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import TUKEY, biweight, robust_sigma
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.measure.readings import (
    HEAD,
    LOSS_OF_OVER,
    NOISE_MOST_FF,
    OFF,
    OVER_AIR,
    REFERENCE_PART,
    SECTORS,
    SPIKE_ROWS,
    CapacitiveHead,
    Gap,
    NoReadingReason,
    doubted,
    joined,
    jumps,
    spikes,
    stretches,
)

STEP_MM = 5.0
MUX_S = 0.006  # from one sector's reading to the next one's
NARROW_MM = 35.0  # to either side of a place: what is narrower than that, a bead, is no bore
BRIDGED_MM = 60.0  # a hole so long is drawn over; the head's own electrodes are as long
SPEED_ROWS = 20  # over which the speed is taken
LONG_MM = 1500.0  # lift-off is told from what changes within it
POSE_MM = 2.5  # over which a pose is smoothed: with 10 a head that wobbles every 30 mm keeps half of its lift-off
ROWS_MIN = 200
LOSS_NOISE_MOST_FF = 15.0  # ten times the chip's, as of readings
LOSS_MISSING_MOST = 0.5  # of a sector's rows: with fewer the log has no loss
LIFTED_MM = 1200.0  # two jumps of a sector nearer than this: what lies between is judged against what lies beyond
SPAN_MM = (500.0, 2e7)  # less says nothing; 20 km are 4 million places


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """Rows of a head's log, each (N,) or (N, 3) by sector; loss (conductance over omega) and offset where it has them.

    offset_mm : (N, 2) of the head from the pipe's axis, x to the right, y down, as a camera knows it.
    """

    t_s: FloatArray
    odometer_mm: FloatArray
    c_pf: FloatArray
    reference_pf: FloatArray
    roll_deg: FloatArray
    loss_ff: FloatArray | None = None
    offset_mm: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PipeGrid:
    """Along the pipe, z_mm (G,) by the odometer. c_ff : (G, 3) capacitance, fF, without drift, spikes and lift-off.

    Places that were not seen are False in `seen` (G,), and drawn over. roll_deg : (G,), not wrapped. speed_mm_s : (G,).
    raised : (G, 3) how far beads and spikes stood over what is beside them, fF. spikes : readings left out;
    unread : rows with a number missing. gaps : stretches without readings that left places unseen, or the reference.
    lift_ff_mm : what a millimetre towards the wall adds, where the pose says it. uneven_ff : of one sector against the
    others, over some metres: what soil, and a head that wanders, leave.
    """

    z_mm: FloatArray
    c_ff: FloatArray
    loss_ff: FloatArray | None
    roll_deg: FloatArray
    seen: BoolArray
    raised: FloatArray
    speed_mm_s: FloatArray
    spikes: int
    unread: int
    lift_ff_mm: float | None
    uneven_ff: float = 0.0
    gaps: tuple[Gap, ...] = ()

    def looks_deg(self, index: int) -> FloatArray:
        """(3,) where the sectors look at this place; 90 is the invert."""
        return np.asarray((120.0 * np.arange(SECTORS) + self.roll_deg[index]) % 360)


def on_grid(log: Log, head: CapacitiveHead = HEAD) -> PipeGrid:
    """Raises AnnulusError where a log is too short, never moves, or a sector gives no readings."""
    unread = int(
        np.count_nonzero(~np.isfinite(np.column_stack([c for c in _columns(log) if c is not None])).all(axis=1))
    )
    log = _placed(log)
    rows = len(log.t_s)
    if rows < ROWS_MIN:
        raise AnnulusError(f"{rows} rows, expected at least {ROWS_MIN}")
    span = float(np.ptp(log.odometer_mm))
    if not SPAN_MM[0] <= span <= SPAN_MM[1]:
        raise AnnulusError(f"the odometer covers {span:.0f} mm, expected {SPAN_MM[0]:.0f} to {SPAN_MM[1]:.0f}")
    why, log = _why(log, head)
    dt = np.maximum(np.diff(log.t_s, prepend=log.t_s[0]), 1e-3)
    speed = ndimage.uniform_filter1d(
        np.diff(log.odometer_mm, prepend=log.odometer_mm[0]) / dt, SPEED_ROWS, mode="nearest"
    )
    drift, gaps = _drift(log)
    sound = why == 0
    c = np.stack([_filled(np.where(sound[:, k], 1000 * log.c_pf[:, k], np.nan)) for k in range(SECTORS)], axis=1)
    c *= (1 - drift)[:, None]
    spiky = spikes(c) & sound
    first = STEP_MM * math.floor(float(log.odometer_mm.min()) / STEP_MM)
    z = np.arange(first, float(log.odometer_mm.max()) + STEP_MM, STEP_MM)
    place = [log.odometer_mm + speed * MUX_S * k for k in range(SECTORS)]
    used = sound & ~spiky
    c_grid = np.stack([_binned(z, place[k][used[:, k]], c[used[:, k], k]) for k in range(SECTORS)], axis=1)
    seen = np.isfinite(c_grid)
    roll = _filled(_binned(z, log.odometer_mm, np.degrees(np.unwrap(np.radians(log.roll_deg)))))
    loss = None
    if log.loss_ff is not None:
        loss = np.stack(
            [_filled(_binned(z, place[k][sound[:, k]], log.loss_ff[sound[:, k], k])) for k in range(SECTORS)], axis=1
        )
    c_grid = np.stack([_filled(column) for column in c_grid.T], axis=1)
    lift = None
    if log.offset_mm is not None:
        off = np.stack([_filled(_binned(z, log.odometer_mm, log.offset_mm[:, k])) for k in range(2)], axis=1)
        c_grid, lift = _without_lift_off(c_grid, off, roll)
    half = round(NARROW_MM / STEP_MM)
    smooth = ndimage.median_filter(c_grid, (2 * half + 1, 1), mode="nearest")
    # Each sector by itself: a head that reads every 12 mm leaves no place with readings of all three.
    blank = ndimage.uniform_filter1d((~seen).astype(float), max(1, round(BRIDGED_MM / STEP_MM)), axis=0, mode="nearest")
    apart = smooth - smooth.mean(axis=1, keepdims=True)
    uneven = robust_sigma(apart - ndimage.gaussian_filter1d(apart, LONG_MM / STEP_MM / 6, axis=0, mode="nearest"))
    # With what was taken for spikes: beside a jump on a slope readings look like some, and a step less is left of it.
    whole = np.stack([_binned(z, place[k][sound[:, k]], c[sound[:, k], k]) for k in range(SECTORS)], axis=1)
    rough = ndimage.median_filter(
        np.stack([_filled(column) for column in whole.T], axis=1), (2 * half + 1, 1), mode="nearest"
    )
    lifted = _between_jumps(jumps(rough, np.isfinite(whole), STEP_MM, uneven))
    unseen = (blank > 1 - 1e-9).any(axis=1) | lifted.any(axis=1)
    gaps += joined([gap for gap in stretches(why, log.odometer_mm) if _leaves_unseen(gap, z, unseen)])
    gaps += stretches(np.where(lifted, 1 + list(NoReadingReason).index(NoReadingReason.JUMP), 0), z)
    raised = c_grid - smooth
    sigma = max(robust_sigma(raised), 0.3)
    narrow = np.abs(raised) > OFF * sigma
    c_grid = np.where(narrow, smooth, c_grid)
    grid_speed = _filled(_binned(z, log.odometer_mm, speed))
    raised = np.where(unseen[:, None], 0.0, raised)
    return PipeGrid(
        z, c_grid, loss, roll, ~unseen, raised, grid_speed, int(spiky.sum()), unread, lift, uneven, tuple(gaps)
    )


def _columns(log: Log) -> list[FloatArray | None]:
    return [getattr(log, name) for name in Log.__slots__]


def _placed(log: Log) -> Log:
    """Rows whose time, place, roll and pose are known."""
    whole = np.ones(len(log.t_s), bool)
    for column in (log.t_s, log.odometer_mm, log.roll_deg, log.offset_mm):
        if column is not None:
            whole &= np.isfinite(column).reshape(len(whole), -1).all(axis=1)
    return Log(*(None if column is None else column[whole] for column in _columns(log)))  # type: ignore[arg-type]


def _why(log: Log, head: CapacitiveHead) -> tuple[IntArray, Log]:
    """(N, 3) 0 for a reading, else why it is none (`readings.doubted`); without the loss where that mostly fails."""
    low, high = head.range_ff
    why = doubted(1000 * log.c_pf, log.odometer_mm, low, high, NOISE_MOST_FF)
    if log.loss_ff is not None:
        most = LOSS_OF_OVER * OVER_AIR * head.air_ff
        lost = doubted(log.loss_ff, log.odometer_mm, -most, most, LOSS_NOISE_MOST_FF)
        if np.mean(lost > 0, axis=0).max() > LOSS_MISSING_MOST:
            log = replace(log, loss_ff=None)
        else:
            why = np.where(why > 0, why, lost)
    for k, column in enumerate(why.T):
        if np.count_nonzero(column == 0) < ROWS_MIN:
            usual = list(NoReadingReason)[int(np.bincount(column[column > 0]).argmax()) - 1]
            finite = log.c_pf[np.isfinite(log.c_pf[:, k]), k]
            middle = f"{np.median(finite):.4g} pF in the middle" if len(finite) else "no number at all"
            raise AnnulusError(
                f"sector {k + 1} gives no readings ({usual}): {middle}, expected {low / 1000:.2f} to "
                f"{high / 1000:.2f} pF of a head that reads {head.air_ff / 1000:.3f} pF in air"
            )
    return why, log


def _drift(log: Log) -> tuple[FloatArray, list[Gap]]:
    """(N,) of the chip, as a part of what it reads, and where the reference said nothing of it."""
    reference = 1000 * log.reference_pf
    middle = float(np.nanmedian(reference)) if np.isfinite(reference).any() else 0.0
    part = REFERENCE_PART * abs(middle)
    why = doubted(reference[:, None], log.odometer_mm, middle - part, middle + part, NOISE_MOST_FF)[:, 0]
    gaps = [Gap((0,), gap.from_mm, gap.to_mm, gap.why) for gap in stretches(why[:, None], log.odometer_mm)]
    gaps = [gap for gap in gaps if gap.to_mm - gap.from_mm > BRIDGED_MM]
    if middle <= 0 or np.count_nonzero(why == 0) < ROWS_MIN:
        return np.zeros(len(reference)), gaps  # a chip drifts by some fF in minutes, a bore is over in seconds
    drift = _filled(np.where(why == 0, reference, np.nan)) - middle
    drift = ndimage.uniform_filter1d(
        ndimage.median_filter(drift, 2 * SPIKE_ROWS + 1, mode="nearest"), 200, mode="nearest"
    )
    return np.asarray(drift / middle), gaps


def _between_jumps(jumped: BoolArray) -> BoolArray:
    """(G, K) places that a jump makes unknown: beside it, and up to the next one, where it may jump back."""
    out: BoolArray = np.asarray(ndimage.maximum_filter1d(jumped, 2 * round(NARROW_MM / STEP_MM) + 1, axis=0))
    for k, column in enumerate(jumped.T):
        at = np.flatnonzero(column)
        for a, b in pairwise(at):
            if (b - a) * STEP_MM <= LIFTED_MM:
                out[a : b + 1, k] = True
    return out


def _leaves_unseen(gap: Gap, z: FloatArray, unseen: BoolArray) -> bool:
    return bool(unseen[(z >= gap.from_mm - STEP_MM) & (z <= gap.to_mm + STEP_MM)].any())


def _binned(z: FloatArray, place: FloatArray, value: FloatArray) -> FloatArray:
    """(G,) mean of what was read within half a step of each z; NaN where nothing was."""
    index = np.clip(np.round((place - z[0]) / STEP_MM).astype(int), 0, len(z) - 1)
    count = np.bincount(index, minlength=len(z))
    total = np.bincount(index, value, minlength=len(z))
    return np.asarray(np.divide(total, count, out=np.full(len(z), np.nan), where=count > 0))


def _filled(value: FloatArray) -> FloatArray:
    known = np.isfinite(value)
    if not known.any():
        raise AnnulusError("a column holds no number, expected readings")
    at = np.arange(len(value))
    return np.asarray(np.interp(at, at[known], value[known]))


def _without_lift_off(c: FloatArray, off: FloatArray, roll_deg: FloatArray) -> tuple[FloatArray, float]:
    """Sectors as on the axis, and fF a mm towards the wall there: told from all places where only the head moved."""
    angle = np.radians(roll_deg[:, None] + 120.0 * np.arange(SECTORS))
    nearer = ndimage.gaussian_filter1d(
        off[:, :1] * np.cos(angle) + off[:, 1:] * np.sin(angle), POSE_MM / STEP_MM, axis=0
    )
    terms = np.stack([nearer, nearer**2, nearer**3], axis=2)  # steeper the nearer it comes
    long = LONG_MM / STEP_MM / 6

    def quick(value: FloatArray) -> FloatArray:
        return np.asarray(value - ndimage.gaussian_filter1d(value, long, axis=0, mode="nearest"))

    apart = quick(c)
    x = quick(terms).reshape(-1, 3)
    y = apart.ravel()
    weight = np.ones(len(y))
    fit: FloatArray = np.zeros(3)
    for _ in range(12):
        fit = np.asarray(np.linalg.lstsq(x * np.sqrt(weight)[:, None], y * np.sqrt(weight), rcond=None)[0], float)
        residual = y - x @ fit
        weight = biweight(residual / (TUKEY * max(robust_sigma(residual), 0.3)))
    return np.asarray(c - terms @ fit), float(fit[0])
