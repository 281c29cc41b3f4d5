"""A capacitive log on an even grid along the pipe: spikes, beads, drift and backwards runs taken out, lift-off by pose.

Three sectors look through the wall, sector k towards 120 k + roll degrees, a fixed capacitor beside them on the same
chip. They are read one after the other while the head moves, now and then backwards, while the odometer slips and rows
are lost: what was read at one place is averaged, and a place where nothing was read stays unknown.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, median_filter, uniform_filter1d

from annulus.numeric.arrays import BoolArray, FloatArray
from annulus.numeric.robust import TUKEY, biweight, robust_sigma
from annulus.vocabulary import AnnulusError

SECTORS = 3
STEP_MM = 5.0
MUX_S = 0.006  # from one sector's reading to the next one's
SPIKE_ROWS = 3  # to either side of a reading: a spike is one or two rows
NARROW_MM = 35.0  # to either side of a place: what is narrower than that, a bead, is no bore
OFF = 6.0  # standard deviations at which a reading is no part of what is beside it
BRIDGED_MM = 60.0  # a hole so long is drawn over; the head's own electrodes are as long
SPEED_ROWS = 20  # over which the speed is taken
LONG_MM = 1500.0  # lift-off is told from what changes within it
POSE_MM = 2.5  # over which a pose is smoothed: with 10 a head that wobbles every 30 mm keeps half of its lift-off
ROWS_MIN = 200
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
class Grid:
    """Along the pipe, z_mm (G,) by the odometer. c_ff : (G, 3) capacitance, fF, without drift, spikes and lift-off.

    Places that were not seen are False in `seen` (G,), and drawn over. roll_deg : (G,), not wrapped. speed_mm_s : (G,).
    raised : (G, 3) how far beads and spikes stood over what is beside them, fF. spikes : readings left out;
    unread : rows with a number missing.
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

    def looks_deg(self, index: int) -> FloatArray:
        """(3,) where the sectors look at this place; 90 is the invert."""
        return np.asarray((120.0 * np.arange(SECTORS) + self.roll_deg[index]) % 360)


def on_grid(log: Log) -> Grid:
    """Raises AnnulusError where a log is too short, or never moves."""
    log, unread = _read(log)
    rows = len(log.t_s)
    if rows < ROWS_MIN:
        raise AnnulusError(f"{rows} rows, expected at least {ROWS_MIN}")
    span = float(np.ptp(log.odometer_mm))
    if not SPAN_MM[0] <= span <= SPAN_MM[1]:
        raise AnnulusError(f"the odometer covers {span:.0f} mm, expected {SPAN_MM[0]:.0f} to {SPAN_MM[1]:.0f}")
    dt = np.maximum(np.diff(log.t_s, prepend=log.t_s[0]), 1e-3)
    speed = uniform_filter1d(np.diff(log.odometer_mm, prepend=log.odometer_mm[0]) / dt, SPEED_ROWS, mode="nearest")
    drift = log.reference_pf - np.median(log.reference_pf)
    drift = uniform_filter1d(median_filter(drift, 2 * SPIKE_ROWS + 1, mode="nearest"), 200, mode="nearest")
    c = 1000 * (log.c_pf * (1 - drift / np.median(log.reference_pf))[:, None])
    spiky = _spikes(c)
    first = STEP_MM * math.floor(float(log.odometer_mm.min()) / STEP_MM)
    z = np.arange(first, float(log.odometer_mm.max()) + STEP_MM, STEP_MM)
    place = [log.odometer_mm + speed * MUX_S * k for k in range(SECTORS)]
    c_grid = np.stack([_binned(z, place[k][~spiky[:, k]], c[~spiky[:, k], k]) for k in range(SECTORS)], axis=1)
    seen = np.isfinite(c_grid).all(axis=1)
    roll = _filled(_binned(z, log.odometer_mm, np.degrees(np.unwrap(np.radians(log.roll_deg)))))
    loss = None
    if log.loss_ff is not None:
        loss = np.stack([_filled(_binned(z, place[k], log.loss_ff[:, k])) for k in range(SECTORS)], axis=1)
    hole = ~seen
    c_grid = np.stack([_filled(column) for column in c_grid.T], axis=1)
    wide = uniform_filter1d(hole.astype(float), max(1, round(BRIDGED_MM / STEP_MM)), mode="nearest") > 1 - 1e-9
    lift = None
    if log.offset_mm is not None:
        off = np.stack([_filled(_binned(z, log.odometer_mm, log.offset_mm[:, k])) for k in range(2)], axis=1)
        c_grid, lift = _without_lift_off(c_grid, off, roll)
    half = round(NARROW_MM / STEP_MM)
    smooth = median_filter(c_grid, (2 * half + 1, 1), mode="nearest")
    raised = c_grid - smooth
    sigma = max(robust_sigma(raised), 0.3)
    narrow = np.abs(raised) > OFF * sigma
    c_grid = np.where(narrow, smooth, c_grid)
    grid_speed = _filled(_binned(z, log.odometer_mm, speed))
    apart = c_grid - c_grid.mean(axis=1, keepdims=True)
    uneven = robust_sigma(apart - gaussian_filter1d(apart, LONG_MM / STEP_MM / 6, axis=0, mode="nearest"))
    return Grid(z, c_grid, loss, roll, ~wide, raised, grid_speed, int(spiky.sum()), unread, lift, uneven)


def _read(log: Log) -> tuple[Log, int]:
    """Rows with every number there, and how many were without."""
    whole = np.ones(len(log.t_s), bool)
    for column in (getattr(log, name) for name in Log.__slots__):
        if column is not None:
            whole &= np.isfinite(column).reshape(len(whole), -1).all(axis=1)
    loss, offset = (None if column is None else column[whole] for column in (log.loss_ff, log.offset_mm))
    kept = Log(
        log.t_s[whole], log.odometer_mm[whole], log.c_pf[whole], log.reference_pf[whole], log.roll_deg[whole], loss,
        offset,
    )  # fmt: skip
    return kept, int((~whole).sum())


def _spikes(c: FloatArray) -> BoolArray:
    """(N, 3): a reading that stands alone; where all three sectors rise it is a bead. c : fF."""
    off = c - median_filter(c, (2 * SPIKE_ROWS + 1, 1), mode="nearest")
    least = OFF * max(robust_sigma(off), 0.3)
    return np.asarray((np.abs(off) > least) & ~(off > least).all(axis=1)[:, None])


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
    nearer = gaussian_filter1d(off[:, :1] * np.cos(angle) + off[:, 1:] * np.sin(angle), POSE_MM / STEP_MM, axis=0)
    terms = np.stack([nearer, nearer**2, nearer**3], axis=2)  # steeper the nearer it comes
    long = LONG_MM / STEP_MM / 6

    def quick(value: FloatArray) -> FloatArray:
        return np.asarray(value - gaussian_filter1d(value, long, axis=0, mode="nearest"))

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
