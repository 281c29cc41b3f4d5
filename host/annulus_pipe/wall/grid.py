"""The wall from all profiles: a grid of radii over clock angle and distance, and the pipe's shape under its defects.

Grid rows are stations along the pipe, columns are clock angles (0 = 12 o'clock, clockwise looking forward). A cell
nobody saw is NaN, for ever: the only cells filled in lie between two measured ones no farther apart than the sampling.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, nan_median
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.cylinder import points_of, round_clock
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.rests import places_of
from annulus_pipe.wall.shadow import STEP_MM, between_levels
from annulus_pipe.wall.shape import fit_shape, harmonics, spread

# ANGLE_STEP_DEG is guarded by test_grid.py; all together by the benchmark topics diameter, artefacts and mirror, which
# measure whole walls.
ANGLE_STEP_DEG = 1.0  # a column ..
COLUMNS = round(360.0 / ANGLE_STEP_DEG)  # .. round the clock, and where they lie:
CLOCK_DEG = np.asarray((np.arange(COLUMNS) + 0.5) * ANGLE_STEP_DEG, dtype=np.float64)
Z_STEPS_MM = (0.5, 1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 50.0)  # what a row may be, the first that is dense enough
POINTS_A_CELL = 1.5  # points wanted on average: fewer leave holes by chance, more waste resolution
ROWS_MAX = 40_000  # rows of one grid, 40 000 x 360 cells: bounds memory where points lie far apart
BRIDGE_OF_RADIUS = 0.08  # of the radius: longest sampling gap interpolated over (6 mm in a 6-inch pipe)
STATION_SEEN = 0.5  # part of the circle seen where the scan starts and ends: tilted rings leave ragged ends
AROUND_CELLS = 2.5  # columns: the widest gap round the clock interpolated over, one cell
BRIDGE_STEP_MM = 0.75  # a greater step in radius across a gap is an edge, not a sampling gap
NOISE_FLOOR_MM = 0.02  # standard deviation of a cell; no instrument of this kind is better
NOISE_LAG = 8  # columns; noise is alike over a few degrees, for lines are averaged with their neighbours
SHAPE_UNSURE_OF_RADIUS = 0.005  # of the radius: a shape known no better than the least departure listed
OBSERVATION_SMOOTHED = 0.7  # part of a ring's noise that smoothing over three degrees leaves: neighbours share theirs
# Of what a point may be off, what all points of one side, rim or crest have in common: no mean of theirs is surer.
# Blind bench, the kept results of seed 1: k = 2 of hi-lo and openings held for 29 of 38, with it for 34.
ALIKE = 0.5
HALF_SLACK = 1e-9  # of a cell's weight: sums round, and half of it is reached by either of two
LANES = 16  # columns beyond the grid's, that a loop may work on

_cell_medians = door(
    "cell_medians",
    "i8[n] cell",
    "f8[n] values",
    "f8[n]? weights",
    "f8 slack",
    "i8[c]! ends",
    "f8[2,n]! laid",
    "f8[c]! medians",
    "i4[c]! count",
)
_cell_observations = door(
    "cell_observations",
    "i8[n] cell",
    "i4[n] number",
    "f8[k] square",
    "i8[c]! ends",
    "i4[n]! laid",
    "f8[c]! times",
    "f8[c]! squares",
)
_smoothed = door("smoothed", "f4[z,a] field", "i8 rows", "f4[9,b]! line", "f4[z,a]! out")
_neighbour_extremes = door("neighbour_extremes", "f8[z,a] grid", "f8[2,b]! line", "f8[z,a]! low", "f8[z,a]! high")
_bridged = door("bridged", "f8[z,a] grid", "f8 cells", "f8 fall", "f8 rise", "b1 along_rows", "f8[z,a]! out")


@dataclass(frozen=True, slots=True)
class WallObservations:
    """Every point of the wall with who measured it: one ring from one place is one observation, wrong or right as a
    whole, in however many frames.

    cell (N,): index into the flattened grid. number (N,): the same for all points of one
    observation. sigma_mm (N,): what each point said it may be off; NaN where nobody said. seen_by (N,): as
    `Profile.seen_by`.
    """

    cell: NDArray[np.int64]
    number: NDArray[np.int32]
    radius_mm: Float32Array
    sigma_mm: Float32Array
    seen_by: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Wall:
    """Measured wall on a grid, rows along the pipe, columns clockwise from 12 o'clock.

    z_mm (Z,), clock_deg (A,): cell centres. radius_mm (Z, A) float32, NaN where not seen. count (Z, A) int32: points
    in the cell; 0 with a radius means interpolated between measured neighbours. shape_mm (Z, 5): the pipe under its
    defects, r = s0 + s1 cos t + s2 sin t + s3 cos 2t + s4 sin 2t (t = clock angle): mean radius over about two
    diameters, left-over centring, ovality. shape_covariance (Z, 5, 5) mm^2: how well those five are known; infinite
    where too little was seen to say. noise_mm (Z,): robust standard deviation of a cell about that shape.
    cell_noise_mm (Z, A) float32: never less than that, and more where only rings look that are noisier than most.
    sigma_mm (Z, A) float32: what one of the cell's points may be off (`Profile.sigma_mm`, the median); NaN where nobody
    said. Averaging does not make it less: a part of it all points of a ring have in common. scale_part, oval_part : of
    the radius, standard deviations of what every radius of the scan has in common, and of the long one's excess: of
    absolute lengths only, and in none of the above (`scale.Scale`).
    """

    z_mm: FloatArray
    clock_deg: FloatArray
    radius_mm: Float32Array
    count: NDArray[np.int32]
    shape_mm: FloatArray
    shape_covariance: FloatArray
    noise_mm: FloatArray
    cell_noise_mm: Float32Array
    observations: WallObservations
    sigma_mm: Float32Array
    scale_part: float = 0.0
    oval_part: float = 0.0

    @property
    def z_step_mm(self) -> float:
        return float(self.z_mm[1] - self.z_mm[0]) if len(self.z_mm) > 1 else Z_STEPS_MM[0]

    @property
    def clock_step_deg(self) -> float:
        return 360.0 / len(self.clock_deg)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Where the grid's edges lie, z (mm) and clock (deg): `imshow(wall.deviation_mm().T, extent=wall.extent)`."""
        half = self.z_step_mm / 2
        return float(self.z_mm[0]) - half, float(self.z_mm[-1]) + half, 360.0, 0.0

    @property
    def seen(self) -> BoolArray:
        return np.isfinite(self.radius_mm)

    def point_mm(self, behind_mm: float = -np.inf) -> float:
        """What a point of the wall behind a place may be off, in the median; 0 where nobody says."""
        stated = self.sigma_mm[self.z_mm > behind_mm]
        stated = stated[np.isfinite(stated)]
        return float(np.median(stated)) if len(stated) else 0.0

    @property
    def mean_radius_mm(self) -> float:
        return float(np.median(self.shape_mm[:, 0]))

    def shape_radius_mm(self) -> Float32Array:
        """(Z, A) radius of the pipe's shape."""
        return np.asarray(self.shape_mm @ harmonics(self.clock_deg).T, dtype=np.float32)

    def residual_mm(self) -> Float32Array:
        """(Z, A) radius minus the pipe's shape, ovality taken out: what local defects are looked for in."""
        return np.asarray(self.radius_mm - self.shape_mm @ harmonics(self.clock_deg).T, dtype=np.float32)

    def weighed_residual_mm(self) -> Float32Array:
        """(Z, A) the same for measuring: each cell's median weighs its points by what they may be off.

        Near an edge rings err alike, and the inner ones eight times as much as the outer. But one wrong ring that is
        sure of itself would win a cell, so what is looked for is looked for without weights.
        """
        seen = self.observations
        stated = np.isfinite(seen.sigma_mm) & (seen.sigma_mm > 0)
        if not stated.any():
            return self.residual_mm()
        weight = 1.0 / np.where(stated, seen.sigma_mm, np.median(seen.sigma_mm[stated])).astype(np.float64)
        radius, count = cell_medians(seen.cell, seen.radius_mm.astype(np.float64), self.radius_mm.shape, weight)
        radius = np.where(self.seen & (count > 0), radius, self.radius_mm)
        return np.asarray(radius - self.shape_mm @ harmonics(self.clock_deg).T, dtype=np.float32)

    def shape_sigma_mm(self) -> Float32Array:
        """(Z, A) standard deviation of the shape's radius; grows over arcs that nobody saw."""
        return spread(self.shape_covariance, harmonics(self.clock_deg))

    @property
    def shape_limit_mm(self) -> float:
        """A shape that is less sure than this is none to measure from."""
        return SHAPE_UNSURE_OF_RADIUS * self.mean_radius_mm

    def deviation_mm(self) -> Float32Array:
        """(Z, A) radius minus the mean circle about the pipe's own centre: what the map shows, ovality included. NaN
        where nothing was seen, or too little of the way round to know that circle to `shape_limit_mm`."""
        basis = harmonics(self.clock_deg)[:, :3]
        sure = spread(self.shape_covariance[:, :3, :3], basis) <= self.shape_limit_mm
        departure = self.radius_mm - self.shape_mm[:, :3] @ basis.T
        return np.where(sure, departure, np.nan).astype(np.float32)

    def seen_by(self, cameras: int) -> NDArray[np.uint8]:
        """(Z, A) of a head of several: 0 not seen, n by the n-th alone, cameras + 1 by more than one, be it one
        after the other. A cell between measured ones is theirs that measured the nearest."""
        at, who = self.observations.cell, self.observations.seen_by
        by = np.zeros((cameras, self.radius_mm.size), bool)
        for n in range(cameras):
            by[n, at[(who == n) | (who >= cameras)]] = True
        alone = np.where(by.sum(axis=0) > 1, cameras + 1, (by * np.arange(1, cameras + 1)[:, None]).sum(axis=0))
        wide = np.pad(alone.reshape(self.radius_mm.shape), ((0, 0), (8, 8)), mode="wrap")
        if wide.any():
            row, column = ndimage.distance_transform_edt(wide == 0, return_distances=False, return_indices=True)
            wide = wide[row, column]
        return np.where(self.seen, wide[:, 8:-8], 0).astype(np.uint8)

    def filled_mm(self) -> Float32Array:
        """(Z, A) radius with the pipe's shape where nothing was seen; for placing texture, never for measuring."""
        return np.where(self.seen, self.radius_mm, (self.shape_mm @ harmonics(self.clock_deg).T).astype(np.float32))


@dataclass(frozen=True, slots=True)
class _Gridded:
    """Points in cells. used : the profiles they are of; counted (M,) which of all their points lie on the grid, cell
    and radius_mm (N,) of those, and keep (N,), which have a say; likely (N,), which had one before gaps were closed.
    first : number of the first row, of `step` mm each. grid, count (Z, A) : of what has a say, bridged."""

    used: list[Profile]
    counted: BoolArray
    cell: NDArray[np.int64]
    radius_mm: FloatArray
    keep: BoolArray
    likely: BoolArray
    first: int
    step: float
    sampling: float  # rows
    grid: FloatArray
    count: NDArray[np.int32]

    @classmethod
    def of(cls, profiles: Sequence[Profile], z_step_mm: float | None, rise: float | None) -> "_Gridded":
        used = [p for p in profiles if p.pose is not None and len(p.points_mm)]
        if not used:
            raise AnnulusError("no wall: not one of the frames gave a point. Do calibration and scan belong together?")
        points = points_of(used)
        counted = np.asarray(np.isfinite(points).all(axis=1))
        radius, clock, z = round_clock(points if counted.all() else points[counted])
        del points  # on a window of two million points each array is what a worker has no room for
        low, high = np.percentile(z, [0.05, 99.95])  # a stray point far away must not stretch the grid
        step = z_step_mm or z_step_of(len(z), float(high - low), ROWS_MAX)
        first = int(np.floor(low / step))
        rows = int(np.floor(high / step)) - first + 1
        row = np.floor(z / step).astype(np.int64) - first
        del z
        inside = (row >= 0) & (row < rows)
        radius, row = radius[inside], row[inside]
        cell = row * COLUMNS + np.minimum((clock[inside] / ANGLE_STEP_DEG).astype(np.int64), COLUMNS - 1)
        counted[counted] = inside
        grid, count = cell_medians(cell, radius, (rows, COLUMNS))
        keep = _supported(grid, cell, radius)
        _without(grid, count, cell, radius, ~keep, keep)
        if rise is not None:
            gone = np.asarray(keep & between_levels(grid, step, rise).ravel()[cell])
            keep = np.asarray(keep & ~gone)
            _without(grid, count, cell, radius, gone, keep)
        sampling = _sampling_gap(used, step, float(np.median(radius))) / step
        grid, likely = _bridge(grid, sampling), keep
        if rise is not None:  # once more: with its gaps closed a false floor shows its edges
            false = between_levels(grid, step, rise)
            grid[false], count[false] = np.nan, 0
            keep, likely = keep & ~false.ravel()[cell], keep
        return cls(used, counted, cell, radius, keep, likely, first, step, sampling, grid, count)

    def ends(self) -> tuple[int, int]:
        """The first and behind the last row that is a station. AnnulusError where there is none."""
        seen = np.isfinite(self.grid).mean(axis=1)
        stations = np.flatnonzero(seen >= STATION_SEEN)
        if not len(stations):
            raise AnnulusError(
                f"no wall: {np.count_nonzero(self.counted)} points are too few to make one station of the pipe; of "
                f"none more than {360.0 * float(seen.max()):.0f} of 360 degrees was seen, expected "
                f"{360 * STATION_SEEN:.0f}"
            )
        return int(stations[0]), int(stations[-1]) + 1

    def z_mm(self, ends: tuple[int, int]) -> FloatArray:
        return np.asarray((np.arange(self.first + ends[0], self.first + ends[1]) + 0.5) * self.step, dtype=np.float64)

    def of_points(self, name: str) -> NDArray[Any]:
        """(N,) of the points on the grid."""
        return np.concatenate([getattr(p, name) for p in self.used])[self.counted]


def pipe_shape(profiles: Sequence[Profile], z_step_mm: float | None = None) -> tuple[FloatArray, FloatArray]:
    """(Z,) mm and (Z, 5) of the wall that `build_wall` makes of one straight pipe: its rows, and its shape."""
    of = _Gridded.of(profiles, z_step_mm, None)
    ends = of.ends()
    z_mm = of.z_mm(ends)
    return z_mm, fit_shape(of.grid[slice(*ends)], z_mm, CLOCK_DEG)[0]


def build_wall(
    profiles: Sequence[Profile],
    *,
    z_step_mm: float | None = None,
    rise: float | None = None,
    centreline: Centreline | None = None,
) -> Wall:
    """Grid the points of all profiles and fit the pipe's own shape.

    Parameters
    ----------
    profiles : any order; those without a pose or points are passed over.
    z_step_mm : row length; chosen from the density of points when not given.
    rise : tangent of the widest ring's half-angle, so that what a step hides is told from what lies behind it.
    centreline : whose radius the shape's mean radius follows, its steps and tapers; one straight pipe if not given.

    Raises
    ------
    AnnulusError when no profile has a point.

    Notes
    -----
    A cell's radius is the median of its points after lone outliers went (a point beyond all its neighbour cells by
    six times the noise). The shape is fitted with redescending weights on windows of 20 mm, so that a defect pulls
    neither centre nor ovality; its mean radius is a median over two diameters, so that a groove around the whole
    pipe stands out against its neighbourhood instead of becoming the pipe.
    """
    of = _Gridded.of(profiles, z_step_mm, rise)
    used, cell, radius, keep = of.used, of.cell, of.radius_mm, of.keep
    place = np.repeat(places_of(used, float(np.median(radius))), [len(p.points_mm) for p in used])[of.counted]
    rings = 1 + max(int(p.ring.max()) for p in used)
    number = (place * rings + of.of_points("ring")).astype(np.int32)
    sigma, seen_by = of.of_points("sigma_mm").astype(np.float64), of.of_points("seen_by")
    stated = of.likely & np.isfinite(sigma)
    errors = _bridge(cell_medians(cell[stated], sigma[stated], of.grid.shape)[0], of.sampling)
    ends = of.ends()
    grid, count = of.grid[slice(*ends)], of.count[slice(*ends)]
    stated_sigma = np.where(np.isfinite(grid), errors[slice(*ends)], np.nan).astype(np.float32)
    z_rows = of.z_mm(ends)
    course = np.zeros(len(z_rows))
    if centreline is not None and not centreline.is_even:
        course = centreline.radius_at(z_rows) - centreline.pieces[0].radius_mm
    shape, covariance = fit_shape(grid - course[:, None], z_rows, CLOCK_DEG)
    shape[:, 0] += course
    cell = cell - ends[0] * COLUMNS
    keep = keep & (cell >= 0) & (cell < grid.size)
    observations = WallObservations(
        cell[keep], number[keep], radius[keep].astype(np.float32), sigma[keep].astype(np.float32), seen_by[keep]
    )
    measured = grid.astype(np.float32)
    unknown = np.zeros(grid.shape, dtype=np.float32)
    still = np.zeros(len(z_rows))
    bare = Wall(z_rows, CLOCK_DEG, measured, count, shape, covariance, still, unknown, observations, stated_sigma)
    noise = row_noise(bare)
    cell_noise = np.maximum(_cell_noise(bare, rings, int(of.sampling) + 1), noise[:, None]).astype(np.float32)
    return replace(bare, noise_mm=noise, cell_noise_mm=cell_noise)


def smooth(field: Float32Array, rows: int = 3) -> Float32Array:
    """Median over each cell's `rows` (3 or 1) x 3 seen neighbours (itself included), NaN where the cell itself was not
    seen."""
    out = np.empty(field.shape, np.float32)
    width = field.shape[1] + LANES
    _smoothed(np.ascontiguousarray(field, np.float32), rows, np.full((9, width), np.inf, np.float32), out)
    return out


def z_step_of(points: int, span_mm: float, rows_max: float = math.inf) -> float:
    """Length of a row, mm, of a wall of so many points over so much of its length."""
    density = points / max(span_mm, 1.0) / (360.0 / ANGLE_STEP_DEG)
    enough = [s for s in Z_STEPS_MM if s * density >= POINTS_A_CELL and span_mm / s <= rows_max]
    return enough[0] if enough else max(5.0, span_mm / rows_max)


def _sampling_gap(profiles: Sequence[Profile], step: float, radius: float) -> float:
    """Longest gap (mm) that is sampling and not shadow: one step between frames, a lost or LED frame included."""
    steps = np.diff(np.unique([p.z_mm for p in profiles]))
    regular = 1.25 * float(np.percentile(steps, 90)) if len(steps) else 0.0
    return min(max(regular, 2.5 * step), max(BRIDGE_OF_RADIUS * radius, 2.5 * step))


def cell_medians(
    cell: NDArray[np.int64], value: FloatArray, shape: tuple[int, int], weight: FloatArray | None = None
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Median of each cell's values, NaN without any, and how many they are.

    weight : of each; 1 / sigma leaves a median the least variance: it is a value's density at its own middle.
    """
    medians, count = np.empty(shape), np.empty(shape, np.int32)
    room = np.empty(medians.size, np.int64), np.empty((2, len(cell)))
    _cell_medians(cell, np.ascontiguousarray(value), weight, HALF_SLACK, *room, medians.ravel(), count.ravel())
    return medians, count


def _without(
    grid: FloatArray,
    count: NDArray[np.int32],
    cell: NDArray[np.int64],
    radius: FloatArray,
    gone: BoolArray,
    keep: BoolArray,
) -> None:
    """Medians and numbers of the cells that lost a point, from what they keep; the others stay."""
    if not gone.any():
        return
    some = np.zeros(grid.size, bool)
    some[cell[gone]] = True
    left = np.flatnonzero(some[cell] & keep)
    medians, counts = cell_medians(cell[left], radius[left], (grid.shape[0], grid.shape[1]))
    grid.ravel()[some], count.ravel()[some] = medians.ravel()[some], counts.ravel()[some]


def _supported(grid: FloatArray, cell: NDArray[np.int64], radius: FloatArray) -> BoolArray:
    """Which points lie in the range of their neighbour cells, give or take six times the noise (at least 0.3 mm)."""
    low, high = np.empty_like(grid), np.empty_like(grid)
    _neighbour_extremes(grid, np.empty((2, grid.shape[1] + 4)), low, high)
    step = np.diff(grid, axis=1)
    steps = np.abs(step[np.isfinite(step)])
    slack = max(0.3, 6 * SIGMA_OF_MAD * float(np.median(steps)) / np.sqrt(2)) if len(steps) else 0.3
    # where no neighbour contradicts it (infinite the wrong way round) it stays out, nothing vouches for it
    return np.asarray((radius >= (low - slack).ravel()[cell]) & (radius <= (high + slack).ravel()[cell]))


def _bridge(grid: FloatArray, sampling: float) -> FloatArray:
    """Linear interpolation over gaps round the clock, then down the columns over `sampling` rows at most, with a small
    step across them."""
    around, out = grid.copy(), grid.copy()
    _bridged(grid, AROUND_CELLS, -BRIDGE_STEP_MM, BRIDGE_STEP_MM, True, around)
    out[:] = around
    _bridged(around, sampling, -BRIDGE_STEP_MM, STEP_MM, False, out)  # light comes along the pipe
    return out


def row_noise(wall: Wall) -> FloatArray:
    """(Z,) robust standard deviation of the smoothed residual: the larger of what the neighbourhood and the row say.

    The neighbourhood (a diameter of pipe): spread of each row about its own median, for a groove lifts a whole row and
    must not count as noise; then the median over rows, so that no defect sets it. The row itself: differences between
    cells some columns apart, which share neither smoothing nor the patches that noise comes in; this follows
    where fewer rings look, at the ends of a scan.
    """
    residual = smooth(wall.residual_mm()).astype(np.float64)
    spread = SIGMA_OF_MAD * nan_median(np.abs(residual - nan_median(residual.T)[:, None]).T)
    steps = SIGMA_OF_MAD / np.sqrt(2) * nan_median(np.abs(residual - np.roll(residual, NOISE_LAG, axis=1)).T)
    wide = _running_median(spread, max(int(wall.mean_radius_mm / wall.z_step_mm), 1))
    return np.maximum(np.maximum(wide, _running_median(steps, 4)), NOISE_FLOOR_MM)


def _cell_noise(wall: Wall, rings: int, reach: int) -> FloatArray:
    """(Z, A) what the errors of the rings that looked leave of a smoothed cell's radius, mm; 0 where nobody looked.

    An observation errs alike over a smoothed cell's width, so a cell gains by how many it has and not by their
    points.
    A cell interpolated along the pipe is as good as the worst measured one within `reach` rows.
    """
    seen = wall.observations
    departure = np.abs(seen.radius_mm - wall.shape_radius_mm().ravel()[seen.cell])
    ring = seen.number % rings
    spread = np.array([float(np.median(departure[ring == k])) if (ring == k).any() else 0.0 for k in range(rings)])
    square = (OBSERVATION_SMOOTHED * SIGMA_OF_MAD * spread) ** 2
    times, squares = np.empty(wall.radius_mm.shape), np.empty(wall.radius_mm.shape)
    room = np.empty(times.size, np.int64), np.empty(len(seen.cell), np.int32)
    _cell_observations(seen.cell, seen.number, square, *room, times.ravel(), squares.ravel())
    # Down the column observations add; across it they are the same again: their number is the mean of who has any.
    columns = np.ones((1, 3))
    rows = np.ones((3, 1))
    times, squares = (ndimage.convolve(field, rows, mode="constant") for field in (times, squares))
    across = ndimage.convolve((times > 0).astype(np.float64), columns, mode="wrap")
    times, squares = (ndimage.convolve(field, columns, mode="wrap") for field in (times, squares))
    measured = across > 0.5
    noise = np.where(measured, np.sqrt(squares * across) / np.maximum(times, 1e-9), 0.0)
    return np.where(measured, noise, ndimage.maximum_filter1d(noise, 2 * reach + 1, axis=0, mode="constant"))


def _running_median(values: FloatArray, reach: int) -> FloatArray:
    """Median over `reach` neighbours each side, NaN passed over; the whole line's where a neighbourhood has nothing."""
    known = values[np.isfinite(values)]
    fallback = float(np.median(known)) if len(known) else NOISE_FLOOR_MM
    padded = np.pad(values, reach, constant_values=np.nan)
    out = np.empty_like(values)
    for start in range(0, len(values), 1024):  # blocks bound the copy on long scans
        stop = min(start + 1024, len(values))
        windows = np.lib.stride_tricks.sliding_window_view(padded[start : stop + 2 * reach], 2 * reach + 1)
        out[start:stop] = nan_median(windows.T)
    return np.where(np.isfinite(out), out, fallback)
