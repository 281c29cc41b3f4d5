"""What a wall map has of the wall, apart from what it has of the head.

A head sits off the axis, shakes, and its scale is another every year: that is even round the pipe (order 0), one wave
(order 1) or, with the pipe's own ovality, two (order 2), and changes slowly along it. What is left when it is taken
out, texture, defects and beads, is the wall's own and says where along the pipe and how turned a row is; ovality says
how turned it is, but for 180 degrees.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.numeric.arrays import BoolArray, ComplexArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY, biweight

ORDERS = 3  # 0, 1 and 2
COLUMNS = 180  # at most, of what is laid over each other
EVEN_MM = 60.0  # median of order 0 along the pipe, which leaves a bead alone
WAVES_MM = 240.0  # .. and of orders 1 and 2: they are the head's and the pipe's, and change slowly
BEAD_MM = 0.1  # of order 0 in a row: less may be the head that shakes, and would lay its shaking on the other year's
IMU_MM = 200.0  # median of the roll: 0.3 degrees a row are 0.05, and a jump stays one
SEEN_MIN = 0.5  # of a row, for waves to be fitted to it
NEAR_CELLS = 4.0  # sigma, rows and columns: over which it is asked whether a map shows anything
DOUBT = 1.5  # times the square of its noise that may stand where there is nothing
_ROUNDS = 6  # of Tukey's weights: a row's fit has then settled
_CHUNK = 4096  # rows fitted at once; bounds memory


@dataclass(frozen=True, slots=True)
class Detail:
    """Of one map, on N columns from 12 o'clock on.

    plain (Z, N) mm: the wall less orders 0 to 2, row by row. own (Z, N) mm: with beads, which are order 0, put back.
    oval (Z,) mm: order 2, slow, as the c of Re(c exp(2i clock)). roll_deg (Z,): the sensor's, calm; None where it said
    nothing.
    """

    own: Float32Array
    plain: Float32Array
    oval: ComplexArray
    roll_deg: FloatArray | None


def detail_of(wall: WallMap, columns: int) -> Detail:
    field = on_columns(wall.deviation_mm, wall.first_deg, columns)
    waves = waves_of(field)
    slow = np.stack([calmed(waves[:, k], WAVES_MM, wall.step_mm) for k in (1, 2)], axis=1)
    waves = waves_of(field, slow=slow)
    plain = field - drawn(waves, columns)
    bump = waves[:, 0].real - calmed(waves[:, 0], EVEN_MM, wall.step_mm).real
    bump = np.where(np.abs(bump) > BEAD_MM, bump, 0.0).astype(np.float32)
    oval = calmed(waves[:, 2], WAVES_MM, wall.step_mm)
    return Detail((plain + bump[:, None]).astype(np.float32), plain, oval, calm_roll(wall.imu_roll_deg, wall.step_mm))


def on_columns(field: Float32Array, first_deg: float, columns: int) -> Float32Array:
    """(Z, A) to (Z, columns) with a column's middle at 0: means over what of each cell lies in it; NaN where less than
    half of it was seen."""
    count = field.shape[1]
    from_deg = first_deg + (np.arange(count) - 0.5) * 360.0 / count
    begin = (np.arange(columns) - 0.5) * 360.0 / columns
    share = np.zeros((count, columns), np.float32)
    for turn in (-720, -360, 0, 360, 720):
        low = np.maximum(from_deg[:, None] + turn, begin[None])
        high = np.minimum(from_deg[:, None] + 360.0 / count + turn, begin[None] + 360.0 / columns)
        share += np.maximum(high - low, 0.0).astype(np.float32) * columns / 360.0
    seen = np.isfinite(field)
    weight = seen.astype(np.float32) @ share
    total = np.where(seen, field, np.float32(0)) @ share
    return np.where(weight >= SEEN_MIN - 1e-4, total / np.maximum(weight, 1e-6), np.float32(np.nan))


def waves_of(field: Float32Array, weight: Float32Array | None = None, slow: ComplexArray | None = None) -> ComplexArray:
    """(Z, ORDERS) c of Re(c exp(i order clock)) in each row, defects left out (Tukey); NaN of a row half unseen.

    weight (Z, columns): how much a cell says. slow (Z, 2): orders 1 and 2 to begin with, from the rows around: two deep
    defects across from each other are nearly a wave of order 2, and of themselves draw their row's fit after them.
    """
    columns = field.shape[1]
    clock = 2 * np.pi * np.arange(columns) / columns
    design = np.stack([np.ones(columns), np.cos(clock), -np.sin(clock), np.cos(2 * clock), -np.sin(2 * clock)], axis=1)
    out = np.full((len(field), ORDERS), np.nan, np.complex128)
    for begin in range(0, len(field), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        given = None if weight is None else weight[part].astype(np.float64)
        start = None
        if slow is not None:
            start = np.stack([slow[part, 0].real, slow[part, 0].imag, slow[part, 1].real, slow[part, 1].imag], axis=1)
        fitted = _rows_fitted(field[part].astype(np.float64), design, given, start)
        out[part, 0] = fitted[:, 0]
        out[part, 1] = fitted[:, 1] + 1j * fitted[:, 2]
        out[part, 2] = fitted[:, 3] + 1j * fitted[:, 4]
    return out


def _rows_fitted(
    rows: FloatArray, design: FloatArray, given: FloatArray | None, start: FloatArray | None
) -> FloatArray:
    seen = np.isfinite(rows)
    value = np.where(seen, rows, 0.0)
    base = seen.astype(np.float64) if given is None else np.where(seen, given, 0.0)
    has_say = base > 0
    weight: Any = base
    products = (design[:, :, None] * design[:, None, :]).reshape(len(design), -1)
    ridge = 1e-9 * max(float(base.max(initial=1)), 1e-9) * np.eye(design.shape[1])
    fitted = np.zeros((len(rows), design.shape[1]))
    for k in range(_ROUNDS):
        if k == 0 and start is not None:
            fitted[:, 1:] = start
            fitted[:, 0] = _medians(value - start @ design[:, 1:].T, has_say)
        else:
            normal = (weight @ products).reshape(len(rows), *ridge.shape) + ridge
            fitted = np.linalg.solve(normal, ((weight * value) @ design)[..., None])[..., 0]
        left = value - fitted @ design.T
        sigma = np.maximum(SIGMA_OF_MAD * _medians(np.abs(left), has_say), 1e-6)
        weight = base * biweight(left / (TUKEY * sigma[:, None]))
    fitted[seen.mean(axis=1) < SEEN_MIN] = np.nan
    return fitted


def _medians(rows: FloatArray, counted: BoolArray) -> FloatArray:
    """(Z,) median of the counted values of each row; 0 where none is counted."""
    ordered = np.sort(np.where(counted, rows, np.nan), axis=1)
    return np.asarray(np.nan_to_num(ordered[np.arange(len(rows)), np.maximum(counted.sum(axis=1) - 1, 0) // 2]))


def drawn(waves: ComplexArray, columns: int) -> Float32Array:
    """(Z, columns) mm of `waves_of`."""
    clock = 2 * np.pi * np.arange(columns) / columns
    turning = np.exp(1j * np.arange(ORDERS)[:, None] * clock[None])
    return np.asarray((waves.real @ turning.real - waves.imag @ turning.imag).astype(np.float32))


def calmed(series: ComplexArray, median_mm: float, step_mm: float) -> ComplexArray:
    whole = _filled(series.real) + 1j * _filled(series.imag)
    rows = max(2 * round(median_mm / step_mm / 2) + 1, 3)
    parts = [
        ndimage.gaussian_filter1d(ndimage.median_filter(part, rows, mode="nearest"), rows / 6, mode="nearest")
        for part in (whole.real, whole.imag)
    ]
    return np.asarray(parts[0] + 1j * parts[1])


def calm_roll(roll_deg: FloatArray, step_mm: float) -> FloatArray | None:
    """(Z,) the sensor's roll without its noise, continuous over 180 degrees. None where less than half was said."""
    known = np.isfinite(roll_deg)
    if known.mean() < SEEN_MIN:
        return None
    rolled = np.full(len(roll_deg), np.nan)
    rolled[known] = np.unwrap(roll_deg[known], period=360.0)
    rows = max(2 * round(IMU_MM / step_mm / 2) + 1, 3)
    return np.asarray(ndimage.median_filter(_filled(rolled), rows, mode="nearest"))


def _filled(series: FloatArray) -> FloatArray:
    known = np.isfinite(series)
    if not known.any():
        return np.zeros(len(series))
    return np.asarray(np.interp(np.arange(len(series)), np.flatnonzero(known), series[known]))


def smoothed(field: Float32Array, sigma: tuple[float, float]) -> Float32Array:
    """A field with NaN, smoothed by a normal curve over rows and, round the pipe, columns; NaN of what was unseen."""
    seen = np.isfinite(field)
    mode = ("nearest", "wrap")
    weight = ndimage.gaussian_filter(seen.astype(np.float32), sigma, mode=mode)
    total = ndimage.gaussian_filter(np.where(seen, field, np.float32(0)), sigma, mode=mode)
    return np.where(weight > SEEN_MIN, total / np.maximum(weight, 1e-6), np.float32(np.nan))


def believed(calm: Float32Array, raw: Float32Array, alike_cells: float) -> Float32Array:
    """The smoothed map shrunk where it is no more than its noise: what has nothing to show must not vote.

    raw: before the smoothing, which makes one of `alike_cells` cells; its noise is what neighbours round the
    pipe differ by.
    """
    bends = np.roll(raw, 1, axis=1) - 2 * raw + np.roll(raw, -1, axis=1)
    bends = bends[np.isfinite(bends)]
    noise = SIGMA_OF_MAD * float(np.median(np.abs(bends))) / np.sqrt(6.0 * alike_cells) if bends.size else 0.0
    power = ndimage.gaussian_filter(np.square(np.nan_to_num(calm)), (NEAR_CELLS, NEAR_CELLS), mode=("nearest", "wrap"))
    return np.asarray(calm * np.maximum(1 - np.float32(DOUBT * noise**2) / np.maximum(power, 1e-12), 0), np.float32)
