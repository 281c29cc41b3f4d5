"""Two walls of one pipe on one grid: the backward one turned about and taken to the forward one's rows and columns, and
what both make together. Arrays in, arrays out; `facing` has the surveys."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.wall.grid import Wall, WallObservations, smooth
from annulus_pipe.wall.shadow import STEP_MM
from annulus_pipe.wall.shape import harmonics

TOO_FAR = 3.0  # sigma by which two views of one cell may differ; both ways by tests/unit/archive/test_there_and_back.py


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Where the backward view's rows lie on the forward one's wall: column c of row i at z_mm[i], clock
    roll_deg[i] - c; z falls. (Z2,), NaN where nobody knows; sigmas k = 1. slips : rows before which its cable slipped.
    matched : whether the wall said so, and not the mounting."""

    z_mm: FloatArray
    roll_deg: FloatArray
    sigma_z_mm: FloatArray
    sigma_roll_deg: FloatArray
    slips: tuple[int, ...] = ()
    matched: bool = True

    def rows_at(self, z_mm: FloatArray) -> FloatArray:
        """(Z,) the row, and part of one, that lies at each place; NaN beyond its ends and across a slip."""
        ends = [0, *sorted(self.slips), len(self.z_mm)]
        at = np.full(len(z_mm), np.nan)
        for begin, end in pairwise(ends):
            known = begin + np.flatnonzero(np.isfinite(self.z_mm[begin:end]))
            if len(known) > 1:
                falling = np.minimum.accumulate(self.z_mm[known])[::-1]
                inside = (z_mm >= falling[0]) & (z_mm <= falling[-1]) & ~np.isfinite(at)
                at[inside] = np.interp(z_mm[inside], falling, known[::-1])
        return at


class Taken:
    """Fields of the backward wall (Z2, A2), taken to the forward one's rows and columns (Z, A)."""

    def __init__(self, wall: Wall, placed: Placed, z_mm: FloatArray, clock_deg: FloatArray) -> None:
        at = placed.rows_at(z_mm)
        self.seen = np.isfinite(at)
        rows = np.arange(len(placed.z_mm))
        known = np.isfinite(placed.roll_deg)
        roll = np.unwrap(placed.roll_deg[known], period=360.0)
        self.at = np.where(self.seen, at, 0.0)
        self.roll_deg = np.interp(self.at, rows[known], roll)
        self.sigma_z_mm, self.sigma_roll_deg = (
            np.interp(self.at, rows[known], one[known]) for one in (placed.sigma_z_mm, placed.sigma_roll_deg)
        )
        count = len(wall.clock_deg)
        column = (self.roll_deg[:, None] - clock_deg[None] - wall.clock_deg[0]) / wall.clock_step_deg
        self.columns = column % count
        self.count = count

    def even(self, field: Float32Array | FloatArray) -> Float32Array:
        """Between those of four cells that are known; NaN where the nearest is not: nothing is seen beyond a cell."""
        low = np.minimum(self.at.astype(np.int64), len(field) - 2)[:, None]
        left = np.floor(self.columns).astype(np.int64)
        along, aside = self.at[:, None] - low, self.columns - left
        total, out = np.zeros(left.shape), np.zeros(left.shape)
        for row, of_row in ((low, 1 - along), (low + 1, along)):
            for column, of_column in ((left, 1 - aside), (left + 1, aside)):
                value = field[row, column % self.count]
                weight = np.where(np.isfinite(value), of_row * of_column, 0.0)
                out += weight * np.where(weight > 0, value, 0.0)
                total += weight
        known = self.nearest(np.isfinite(field)) & (total > 0)
        return np.where(known, out / np.maximum(total, 1e-9), np.nan).astype(np.float32)

    def nearest(self, field: NDArray[Any]) -> NDArray[Any]:
        """The nearest cell's; nothing where there are no rows."""
        row = np.rint(self.at).astype(np.int64)[:, None]
        out = field[row, np.rint(self.columns).astype(np.int64) % self.count]
        out[~self.seen] = 0
        return np.asarray(out)


@dataclass(frozen=True, slots=True, eq=False)
class GridView:
    """One view on the common grid, all (Z, A) mm: what departs from its shape, and the shape; what a point may be off,
    a cell's noise, and what its place may be off there, k = 1."""

    residual: FloatArray
    shape: FloatArray
    point: FloatArray
    noise: FloatArray
    placed: FloatArray

    @property
    def seen(self) -> BoolArray:
        return np.isfinite(self.residual)

    @property
    def variance(self) -> FloatArray:
        return np.asarray(np.nan_to_num(self.point) ** 2 + self.noise**2 + self.placed**2)


def middle(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def common_rows(wall: Wall, placed: Placed) -> tuple[FloatArray, slice]:
    """(Z,) rows that hold both walls, and which of them are the forward one's."""
    step = wall.z_step_mm
    known = placed.z_mm[np.isfinite(placed.z_mm)]
    before = max(0, math.floor((wall.z_mm[0] - known.min()) / step))
    behind = max(0, math.floor((known.max() - wall.z_mm[-1]) / step))
    z_mm = wall.z_mm[0] + step * np.arange(-before, len(wall.z_mm) + behind)
    return z_mm, slice(before, before + len(wall.z_mm))


def view_of_fore(wall: Wall, count: int, rows: slice) -> GridView:
    def wide(field: Float32Array | FloatArray, beyond: float) -> FloatArray:
        out = np.full((count, field.shape[1]), beyond)
        out[rows] = field
        return out

    return GridView(
        wide(wall.residual_mm(), np.nan),
        wide(wall.shape_radius_mm(), np.nan),
        wide(wall.sigma_mm, np.nan),
        wide(wall.cell_noise_mm, np.nan),
        wide(np.zeros_like(wall.radius_mm), 0.0),
    )


def view_of_aft(wall: Wall, taken: Taken, first: Wall) -> GridView:
    residual = taken.even(wall.residual_mm()).astype(np.float64)
    # how steep it is says what a place that is off makes of a radius: mm a mm, and mm a column
    calm = smooth(residual.astype(np.float32)).astype(np.float64)
    step = np.abs(np.diff(calm, axis=0))
    edge = np.full((1, step.shape[1]), np.nan)
    steep = np.nan_to_num(np.fmax(np.concatenate([step, edge]), np.concatenate([edge, step])))
    around = np.fmax(*(np.abs(calm - np.roll(calm, way, axis=1)) for way in (-1, 1)))
    placed = np.hypot(
        steep / first.z_step_mm * taken.sigma_z_mm[:, None],
        np.nan_to_num(around) / first.clock_step_deg * taken.sigma_roll_deg[:, None],
    )
    reach = 2 * math.ceil(float(np.median(taken.sigma_z_mm)) / first.z_step_mm) + 1
    placed = ndimage.maximum_filter(placed, (reach, 3), mode=("nearest", "wrap"))  # an edge may lie so far beside
    return GridView(
        residual,
        taken.even(wall.shape_radius_mm()).astype(np.float64),
        taken.even(wall.sigma_mm).astype(np.float64),
        taken.even(wall.cell_noise_mm).astype(np.float64),
        placed,
    )


def common_shape(mine: GridView, theirs: GridView, clock_deg: FloatArray) -> FloatArray:
    """(Z, A) the pipe's shape: the mean of both where both know it; off-centre as the forward one has it, whose frame
    this is."""
    known = np.isfinite(mine.shape[:, 0]), np.isfinite(theirs.shape[:, 0])
    basis = harmonics(clock_deg)
    with np.errstate(invalid="ignore"):
        shape = np.where(known[0][:, None], mine.shape, theirs.shape)
        away = (theirs.shape - mine.shape) @ basis / (basis**2).sum(axis=0)  # whole circles: these are orthogonal
    away[:, 1:3] = 0.0
    both = known[0] & known[1]
    shape[both] += 0.5 * away[both] @ basis.T
    return shape


def combined(
    mine: GridView, theirs: GridView, shape: FloatArray, one_head: bool
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """(Z, A) radius, what a point may be off, noise, and where both views differ by more than they may."""
    one, other = mine.seen, theirs.seen
    both = one & other
    with np.errstate(invalid="ignore", divide="ignore"):
        weights = [np.where(view.seen, 1.0 / view.variance, 0.0) for view in (mine, theirs)]
        total = weights[0] + weights[1]
        share = [np.where(total > 0, weight / total, 0.0) for weight in weights]
    value = [np.nan_to_num(view.residual) for view in (mine, theirs)]
    radius = np.where(one | other, shape + share[0] * value[0] + share[1] * value[1], np.nan)
    points = [share[i] * np.nan_to_num(view.point) for i, view in enumerate((mine, theirs))]
    point = points[0] + points[1] if one_head else np.hypot(*points)
    point = np.where((one & np.isfinite(mine.point)) | (other & np.isfinite(theirs.point)), point, np.nan)
    noise = np.hypot(
        share[0] * np.nan_to_num(mine.noise), share[1] * np.hypot(np.nan_to_num(theirs.noise), theirs.placed)
    )
    away = np.where(both, value[1] - value[0], np.nan)
    calm = smooth(away.astype(np.float32))
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(mine.variance + theirs.variance)
        apart = both & (np.abs(calm) > TOO_FAR * sigma) & (np.abs(calm) > STEP_MM)
    noise = np.where(apart, np.hypot(noise, np.nan_to_num(away) / 2.0), noise)
    return radius, point, np.where(one | other, noise, 0.0), np.asarray(apart)


def observations_of(
    fore: Wall,
    aft: Wall,
    taken: Taken,
    placed: Placed,
    rows: slice,
    moved: tuple[FloatArray, FloatArray],
    z_mm: FloatArray,
    seen: BoolArray,
) -> WallObservations:
    """Of both, on the common grid and about the common shape, as far as it was seen. seen_by: 0 forward, 1 backward."""
    columns = seen.shape[1]
    mine = fore.observations
    at = mine.cell + rows.start * columns
    theirs = aft.observations
    row, column = np.divmod(theirs.cell, len(aft.clock_deg))
    place, roll = placed.z_mm[row], placed.roll_deg[row]
    known = np.isfinite(place) & np.isfinite(roll)
    there = np.rint((np.where(known, place, 0.0) - z_mm[0]) / fore.z_step_mm).astype(np.int64)
    clock = (np.where(known, roll, 0.0) - aft.clock_deg[column] - fore.clock_deg[0]) / fore.clock_step_deg
    known &= (there >= 0) & (there < len(seen))
    to = np.where(known, there, 0) * columns + np.rint(clock).astype(np.int64) % columns
    cell = np.concatenate([at, to])
    shift = np.concatenate([moved[0].ravel()[at], moved[1].ravel()[to]])
    kept = np.concatenate([np.ones(len(at), bool), known]) & seen.ravel()[cell] & np.isfinite(shift)
    first = int(mine.number.max(initial=-1)) + 1
    order = np.flatnonzero(kept)
    return WallObservations(
        cell[order],
        np.concatenate([mine.number, theirs.number + first])[order].astype(np.int32),
        (np.concatenate([mine.radius_mm, theirs.radius_mm]) + shift)[order].astype(np.float32),
        np.concatenate([mine.sigma_mm, theirs.sigma_mm])[order],
        np.repeat(np.array([0, 1], np.uint8), [len(at), len(to)])[order],
    )
