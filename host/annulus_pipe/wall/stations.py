"""Diameters, ovality, circumference and area, station by station along the pipe."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, arc_of
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.numeric.rounding import ARC, DISTANCE, MEASURE, clock_face, quoted, span
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.shadow import SLIT_OF_RADIUS
from annulus_pipe.wall.shape import harmonics

if TYPE_CHECKING:  # features' clock faces are from here
    from annulus_pipe.wall.features import Feature

OVALITY_NAME = "ASTM F1216"
OVALITY_FORMULA = "100 · max(Dmax − Dmean, Dmean − Dmin) / Dmean"
# PAIRS_NEEDED is guarded upwards by test_grid.py; the benchmark topic diameter scores stations of STATION_MM.
NOT_ENOUGH = "not enough seen"  # kind of a finding
STATION_MM = 5.0  # length of a station
PAIRS_NEEDED = 0.5  # part of the diameters round the clock; with fewer a station has no figures
# What is joined to a closed line; guarded by test_stations.py. A rod hides 6 degrees in most heads.
GAP_MAX_DEG = 20.0  # the widest arc that nobody saw
GAPS_MAX = 0.1  # all of them together, part of the way round
# A pocket's rim is half seen, and its floor is not: an extreme diameter must not end on it, nor be sure beside it.
# Blind bench, seeds 1 to 4, 6 and what was worst of 5: k = 2 of the greatest beside joints held for 93.9 % of 1091, now
# for 96.5.
END_SEEN = 0.5  # part of a station's cells at the end of an extreme diameter
END_DEG = 3.0  # either side of it: what of that nobody saw may lie as far from the shape as the end does
HAND_DEG = 2.5  # either side of an hour, in which both radii about the end of a diameter must lie
ROW_SEEN = 0.5  # part of the circle: a row of which less was seen may lie as deep as either neighbour
EVEN_DEG = 5.0  # radii are evened out over so much before the line is measured: noise makes it longer, never shorter

_station_medians = door("station_medians", "f4[z,a] field", "i8 rows", "i8 beside", "f8[m]! values", "f8[s,a]! out")
_closed_lines = door(
    "closed_lines",
    "f8[s,a] radii",
    "f8[s,a] usual",
    "f8 unseen_most",
    "f8 gap_most",
    "i8 even",
    "f8 chord",
    "f8 cosine",
    "f8 angle",
    "f8[a]! line",
    "f8[a]! even_line",
    "f8[s,2]! out",
)


@dataclass(frozen=True, slots=True)
class Stations:
    """One entry a station; NaN where less than half of its diameters was measured.

    z_mm; diameter_min/max_mm, of those both of whose ends were seen over half the station, local defects included;
    diameter_min_k2_mm, diameter_max_k2_mm, their expanded uncertainties (k = 2): more than of the mean one where their
    ends' own points are less sure than most, or lie off the shape beside what nobody saw; diameter_mean_mm, the length
    of the pipe's fitted shape over pi, as a tape has it, and what the seen wall departs from it on the average: never a
    mean of what happened to be seen, NaN where the shape is not known. ovality_percent (ASTM F1216 from those three: at
    least so much, where an arc was not seen), shape_ovality_percent (ASTM F1216 of the pipe's fitted shape, local
    defects left out; NaN where too little was seen for it), valid_fraction (of the wall seen, 0..1), diameter_k2_mm
    (expanded uncertainty, k = 2, of the mean one, with what the shape may be off where nobody saw, and of the next two;
    NaN where points say nothing of theirs). diameter_x_mm, diameter_y_mm: horizontal and vertical, through the middle
    of the pipe's shape; they need their own four ends only. circumference_mm, area_mm2: of
    the inner wall as measured, local defects included; NaN where an arc of more than 20 degrees, or a tenth of the way
    round, was not seen, for narrower ones are crossed in the course of the pipe's shape. circumference_k2_mm,
    area_k2_mm2: their expanded uncertainty; what may lie in an arc that nobody saw is not in it. All (S,) float64.
    """

    z_mm: FloatArray
    diameter_min_mm: FloatArray
    diameter_max_mm: FloatArray
    diameter_mean_mm: FloatArray
    ovality_percent: FloatArray
    shape_ovality_percent: FloatArray
    valid_fraction: FloatArray
    diameter_k2_mm: FloatArray
    diameter_min_k2_mm: FloatArray
    diameter_max_k2_mm: FloatArray
    diameter_x_mm: FloatArray
    diameter_y_mm: FloatArray
    circumference_mm: FloatArray
    circumference_k2_mm: FloatArray
    area_mm2: FloatArray
    area_k2_mm2: FloatArray

    @property
    def any_diameter_k2_mm(self) -> FloatArray:
        """(S,) of any of a station's diameters: the greatest of the three."""
        return np.fmax(self.diameter_k2_mm, np.fmax(self.diameter_min_k2_mm, self.diameter_max_k2_mm))


def f1216(largest: FloatArray, smallest: FloatArray, mean: FloatArray) -> FloatArray:
    """Ovality in percent after ASTM F1216: the greater departure from the mean diameter, over the mean diameter."""
    return np.asarray(100.0 * np.maximum(largest - mean, mean - smallest) / mean)


def shape_ovality(wall: Wall) -> FloatArray:
    """(Z,) F1216 ovality in percent of the pipe's fitted shape: mean diameter 2 s0, long axis 2 (s0 + |(s3, s4)|). NaN
    where too little was seen to know it to `wall.shape_limit_mm`."""
    half_swing = np.hypot(wall.shape_mm[:, 3], wall.shape_mm[:, 4])
    return np.where(swing_sigma(wall) <= wall.shape_limit_mm, 100.0 * half_swing / wall.shape_mm[:, 0], np.nan)


def not_enough_seen(wall: Wall, features: "Sequence[Feature]" = ()) -> tuple[Finding, ...]:
    """One line for each stretch in which the pipe's circle or its ovality is not known, with the arc nobody saw, be it
    below one of the features or not."""
    swing = swing_sigma(wall) > wall.shape_limit_mm
    circle = ~np.isfinite(wall.deviation_mm()) & wall.seen
    label, n = ndimage.label(swing | circle.any(axis=1))
    out = []
    for i in range(1, n + 1):
        rows = np.flatnonzero(label == i)
        first, last = wall.z_mm[rows[0]] - wall.z_step_mm / 2, wall.z_mm[rows[-1]] + wall.z_step_mm / 2
        seen = wall.seen[rows].mean(axis=0) >= 0.5
        if seen.all():
            arc = "the wall departs from an oval"
        else:
            start, known = arc_of(seen, wall.clock_step_deg) if seen.any() else (0.0, 0.0)
            middle = start + known + (360.0 - known) / 2
            why = next((f"lie below {f.kind}" for f in features if _below(f, first, last, middle)), "were not seen")
            arc = f"{quoted(360.0 - known, ARC)} about clock {clock_face(middle)} {why}"
        what = "ovality" if not circle[rows].any() else "shape"
        out.append(
            Finding(
                NOT_ENOUGH,
                f"not enough seen from {span(first, last, DISTANCE)}: {arc}, so that the pipe's {what} is not known to "
                f"{quoted(wall.shape_limit_mm, MEASURE)} and nothing is measured from it there",
            )
        )
    return tuple(out)


def _below(feature: "Feature", first_mm: float, last_mm: float, clock_deg: float) -> bool:
    """Whether a level covers the middle of an arc over most of a stretch."""
    start, end = feature.z_range_mm
    most = min(end, last_mm) - max(start, first_mm) > 0.5 * (last_mm - first_mm)
    away = abs((clock_deg - feature.clock_deg + 180.0) % 360.0 - 180.0)
    return feature.kind in ("water", "deposit") and most and away < 0.25 * feature.arc_deg


def swing_sigma(wall: Wall) -> FloatArray:
    """(Z,) mm, standard deviation of the long radius' excess over the mean, |(s3, s4)|, in its own direction."""
    even, odd = wall.shape_mm[:, 3], wall.shape_mm[:, 4]
    swing = np.maximum(np.hypot(even, odd), 1e-9)
    way = np.stack([even / swing, odd / swing], axis=1)
    a, b, c = (wall.shape_covariance[:, i, j] for i, j in ((3, 3), (4, 4), (3, 4)))
    with np.errstate(invalid="ignore"):
        square = way[:, 0] ** 2 * a + way[:, 1] ** 2 * b + 2 * way[:, 0] * way[:, 1] * c
    return np.where(np.isfinite(square), np.sqrt(np.maximum(square, 0.0)), np.inf)


def swing_k2_mm(wall: Wall) -> FloatArray:
    """(Z,) mm, expanded uncertainty (k = 2) of the departure of the long diameter from the mean one; NaN where points
    say nothing of theirs. A diameter errs by what its points and the shape may be off at both ends."""
    stated = wall.seen & np.isfinite(wall.sigma_mm)
    parts = (wall.sigma_mm, wall.cell_noise_mm, wall.shape_sigma_mm())
    points = [nan_median(np.where(stated, part, np.nan).T.astype(np.float64)) for part in parts]
    alike = 2.0 * wall.oval_part * wall.shape_mm[:, 0]
    return np.asarray(2.0 * np.linalg.norm([*(2.0 * one for one in points), 2.0 * swing_sigma(wall), alike], axis=0))


def measure_stations(wall: Wall, station_mm: float = STATION_MM) -> Stations:
    """Cut the wall into slices of about `station_mm` and measure every slice's diameters.

    A diameter is the sum of two opposite radii, so a centre that is off by a little does not matter. Radii are medians
    over the slice and over three neighbouring degrees: extremes of noise are not diameters. Two opposite radii may err
    alike, so the uncertainty of one counts twice; noise, which the extremes pick, is added as for independent ones. All
    radii of a station may err alike, too, by that of one point: a circumference by 2 pi times as much, an area by the
    circumference times as much. What the whole scan's scale may be off is of each of these. So may they where rows of
    the pipe and of a bead or a gap meet in one station: which of them are its middle is known no better than a row's
    place, to a slit, nor than the rows nobody saw.
    """
    rows = max(1, round(station_mm / wall.z_step_mm))
    columns, scale = len(wall.clock_deg), np.hypot(wall.scale_part, wall.oval_part)
    shape, fitted_mm, basis = shape_ovality(wall), wall.shape_radius_mm(), harmonics(wall.clock_deg)
    # by so much an ellipse, or a pipe between plates, departs from a shape of two waves
    bent = (wall.shape_mm[:, 3] ** 2 + wall.shape_mm[:, 4] ** 2) / np.maximum(wall.shape_mm[:, 0], 1.0)
    out, mixed_mm, seen = [], _mixed_mm(wall, fitted_mm, rows), wall.seen
    parts = [slice(start, min(start + rows, len(seen))) for start in range(0, len(seen), rows)]
    lines, sigmas = station_medians(wall.radius_mm, rows, 1), station_medians(wall.sigma_mm, rows, 1)
    outlines = np.array([fitted_mm[part].mean(axis=0, dtype=float) for part in parts])
    round_it, of_shape = around_mm(lines, outlines), around_mm(outlines, outlines)[:, 0]
    ends = _Ends.of(np.array([seen[part].mean(axis=0) for part in parts]), lines, lines - outlines, sigmas)
    for i, part in enumerate(parts):
        radius, outline = lines[i], outlines[i]
        diameter = radius[: columns // 2] + radius[columns // 2 :]
        valid = float(seen[part].mean())
        stated = wall.sigma_mm[part][np.isfinite(wall.sigma_mm[part])]
        point = error = float(np.median(stated)) if len(stated) else np.nan
        of_unseen = (basis * ~np.isfinite(radius)[:, None]).mean(axis=0)
        middle = wall.shape_covariance[part.start + (part.stop - part.start) // 2]
        is_known = bool(np.isfinite(middle).all()) or not of_unseen.any()
        guessed = 2.0 * np.sqrt(max(of_unseen @ middle @ of_unseen, 0.0)) if is_known and of_unseen.any() else 0.0
        guessed += 2.0 * of_unseen[0] * float(bent[part].mean())
        alike = 2.0 * scale * float(wall.shape_mm[part, 0].mean())
        k2 = 2.0 * np.sqrt((2.0 * error) ** 2 + alike**2 + 2.0 * float(wall.noise_mm[part].mean()) ** 2 + guessed**2)
        mixed = mixed_mm[i]
        k2, error = float(np.hypot(k2, 2.0 * mixed)), float(np.hypot(error, mixed / 2.0))
        (low, low_k2), (high, high_k2) = ends.extremes(i, point, k2)
        z = float(wall.z_mm[part].mean())
        measured = diameter[np.isfinite(diameter)]
        across = across_mm(radius, wall.shape_mm[part].mean(axis=0), wall.clock_deg)
        length, area = (float(one) for one in round_it[i])
        wide = np.hypot(error, wall.scale_part * float(wall.shape_mm[part, 0].mean()))
        sizes = (*across, length, 4 * np.pi * wide if length > 0 else np.nan, area, 2 * length * wide)
        if len(measured) < PAIRS_NEEDED * len(diameter):
            known = np.isfinite(across).any()
            k2 = k2 if known else np.nan
            out.append((z, np.nan, np.nan, np.nan, float(shape[part].mean()), valid, k2, np.nan, np.nan, *sizes))
            continue
        mean = of_shape[i] / np.pi + 2.0 * float(np.nan_to_num(radius - outline).mean()) if is_known else np.nan
        out.append((z, low, high, mean, float(shape[part].mean()), valid, k2, low_k2, high_k2, *sizes))
    z_mm, smallest, largest, means, fitted, fraction, *more = np.array(out, dtype=float).T
    return Stations(z_mm, smallest, largest, means, f1216(largest, smallest, means), fitted, fraction, *more)


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """Where diameters of stations may end. (S, A / 2) by the first of their two ends: diameter, NaN where not seen;
    among, those an extreme may be of. (S, A): what the wall may be off where nobody saw it, mm; sigma_mm of a point."""

    diameter_mm: FloatArray
    among: BoolArray
    unseen_mm: FloatArray
    sigma_mm: FloatArray

    @classmethod
    def of(cls, seen: FloatArray, radius_mm: FloatArray, departure_mm: FloatArray, sigma_mm: FloatArray) -> "_Ends":
        """seen (S, A) part of a station's cells; radius_mm, NaN where not seen, its departure from the pipe's shape."""
        half, reach = seen.shape[1] // 2, round(END_DEG * seen.shape[1] / 360.0)
        near = ndimage.uniform_filter1d(seen, 3, mode="wrap") >= END_SEEN - 1e-9  # sums round
        diameter = radius_mm[:, :half] + radius_mm[:, half:]
        known = np.isfinite(diameter)
        among = known & near[:, :half] & near[:, half:]
        among = np.where(among.any(axis=1)[:, None], among, known)
        unseen = 1.0 - ndimage.uniform_filter1d(seen, 2 * reach + 1, mode="wrap")
        return cls(diameter, among, unseen * departure_mm, sigma_mm)

    def extremes(self, station: int, point_mm: float, k2_mm: float) -> FloatArray:
        """(2, 2) mm: the least and the greatest diameter of a station, each with its k2; NaN where none was seen.

        point_mm, what one of the station's points may be off in the median; k2_mm of a diameter of such points.
        """
        among = np.flatnonzero(self.among[station])
        if not len(among):
            return np.full((2, 2), np.nan)
        diameter = self.diameter_mm[station]
        ends = among[[np.argmin(diameter[among]), np.argmax(diameter[among])]]
        both = np.stack([ends, ends + len(diameter)])  # of each its two ends
        more = np.sqrt(np.nan_to_num(np.maximum(self.sigma_mm[station][both] ** 2 - point_mm**2, 0.0)))
        unsure = np.linalg.norm(np.hypot(self.unseen_mm[station][both], more), axis=0)
        return np.stack([diameter[ends], np.hypot(k2_mm, 2.0 * unsure)], axis=1)


def _mixed_mm(wall: Wall, fitted_mm: Float32Array, rows: int) -> FloatArray:
    """(S,) mm by which all radii of a station may err alike, for its rows do not lie alike: how much its middle row
    changes if every row lies a slit before or behind, and those hardly seen as deep as either neighbour."""
    measured = wall.seen & (wall.count > 0)  # what lies between two rows is as uncertain as what nobody saw
    level = nan_median(np.where(measured, wall.radius_mm - fitted_mm, np.nan).T)
    known = np.isfinite(level) & (measured.mean(axis=1) >= ROW_SEEN)
    index = np.flatnonzero(known)
    starts = range(0, len(level), rows)
    if not len(index):
        return np.zeros(len(starts))
    at = np.arange(len(level))
    before = index[np.maximum(np.searchsorted(index, at, side="right") - 1, 0)]
    after = index[np.minimum(np.searchsorted(index, at), len(index) - 1)]
    shift = SLIT_OF_RADIUS * wall.mean_radius_mm / wall.z_step_mm
    lines = [
        np.interp(at + aside, at, either(level[before], level[after]))
        for aside in (-shift, 0.0, shift)
        for either in (np.minimum, np.maximum)
    ]
    whole = len(level) // rows * rows
    middles = np.median(np.array(lines)[:, :whole].reshape(len(lines), -1, rows), axis=2)
    if whole < len(level):
        middles = np.column_stack([middles, [np.median(line[whole:]) for line in lines]])
    seeming = middles[2:4].mean(axis=0)  # with every row where it seems to lie
    return np.asarray(np.abs(middles - seeming).max(axis=0))


def across_mm(radius_mm: FloatArray, shape_mm: FloatArray, clock_deg: FloatArray) -> tuple[float, float]:
    """The horizontal and the vertical diameter through the shape's middle; NaN where one of its ends was not seen.

    radius_mm (A,), NaN where not seen; shape_mm (5,), as `Wall.shape_mm`.
    """
    t = np.radians(clock_deg)
    right, down = radius_mm * np.sin(t) - shape_mm[2], -radius_mm * np.cos(t) + shape_mm[1]
    ends = []
    for ahead, aside in ((-down, right), (right, down), (down, -right), (-right, -down)):  # 12, 3, 6 and 9 o'clock
        off, reach = np.degrees(np.arctan2(aside, ahead)), np.hypot(ahead, aside)
        near = np.flatnonzero(np.abs(off) <= HAND_DEG)  # NaN is not
        before, after = near[off[near] <= 0], near[off[near] > 0]
        if len(before) and len(after):
            both = [before[np.argmax(off[before])], after[np.argmin(off[after])]]
            ends.append(float(np.interp(0.0, off[both], reach[both])))
        else:
            ends.append(np.nan)
    return ends[1] + ends[3], ends[0] + ends[2]


def around_mm(radius_mm: FloatArray, shape_mm: FloatArray) -> FloatArray:
    """(S, 2) length of the wall's closed line, mm, and the area in it, mm^2; NaN where too wide an arc was not seen.

    radius_mm (S, A), NaN where not seen; shape_mm (S, A) the pipe's radii, in whose course a narrow arc is crossed.
    Noise is evened out.
    """
    n = radius_mm.shape[1]
    out, turn = np.empty((len(radius_mm), 2)), 2 * np.pi / n
    # a chord is shorter than the arc that its two radii stand for: a circle of n corners is a circle again
    of_arc = (turn / 2) / np.sin(turn / 2), np.cos(turn), turn
    limits = GAPS_MAX * n, GAP_MAX_DEG * n / 360.0, max(1, round(EVEN_DEG * n / 360.0))
    _closed_lines(radius_mm, shape_mm, *limits, *of_arc, np.empty(n), np.empty(n), out)
    return out


def station_medians(field: Float32Array, rows: int, beside: int) -> FloatArray:
    """(S, A) medians over so many rows and columns beside on either side, round the clock; NaN where not seen."""
    stations = -(-len(field) // rows)
    out = np.empty((stations, field.shape[1]))
    _station_medians(np.ascontiguousarray(field, np.float32), rows, beside, np.empty(rows * (2 * beside + 1)), out)
    return out
