"""The bottom of a pipe that is no wall: water or deposit (silt), found, told apart, measured and taken out.

What is found (`chords`) is told apart by how the rings disagree: an opaque surface shows all rings at one height, clear
water each ring lower than the one within it (`refraction`). Of the disagreement that water would make, the share that
there is decides: all of it is water, none a deposit; where rings are too few or too noisy to tell, a remark says so.
What lies below goes before poses are aligned and a shape is fitted. A bottom that nobody saw stays unseen: mirror-like
or black water is not told from a shadow.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from annulus.geometry.calibration import Calibration
from annulus.geometry.pose import rotation_z
from annulus.numeric.arrays import BoolArray, FloatArray
from annulus.numeric.robust import TUKEY, biweight, nan_median, robust_sigma
from annulus.wall.chords import DOWN_DEG, Chord, find_chords, turn_from
from annulus.wall.features import Feature, FeatureKind, Measure
from annulus.wall.grid import Wall, build_wall
from annulus.wall.profile import Profile
from annulus.wall.refraction import surface_heights

# Held as a whole by test_levels.py; not tried one by one.
SLAB_OF_RADIUS = 0.1  # of the radius: length of pipe in which a level is looked for
OFF_DEG, OFF_ROLL_KNOWN_DEG = 24.0, 6.0  # a level's middle off the bottom: a head turns, and sensors err
MARGIN_OF_RADIUS = 0.01  # of the radius: this far above the level there is no surface left
FLAT_OF_RADIUS = 0.01  # of the radius: half of the range of heights, 5 to 95 %, of what is called flat
MIDDLE = 0.75  # part of a level's arc that it is measured on: its corners are partly wall
POINTS_MOST = 400  # of a frame and ring that a level is measured with
CELL_DEG = 4.0  # of the clock, by a slab's length: where rings see one piece of surface
OVERLAP = 0.5  # part of those cells that two rings or more must see, or nothing is told apart
SIGMA_UNSAID_OF_RADIUS = 0.002  # of the radius: of a ring, where points say nothing of theirs
SIGMA_LEAST_OF_RADIUS = 0.0005  # of the radius: what all points of a ring may have in common
TOLD = 0.5  # of the disagreement water would make: more is water, less is not, if it is by two sigma
THROUGH_WATER = 1.5  # how many times a point's error is one of the surface it is seen through, at most


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A level: the feature, and what lies below it along the pipe.

    z_mm, half_deg (S,): half of the arc of what is no wall, about `feature.clock_deg`, at stations along the pipe.
    z_range_mm : from where to where; infinite where the level goes on beyond the scan.
    """

    feature: Feature
    z_mm: FloatArray
    half_deg: FloatArray
    z_range_mm: tuple[float, float]

    def covers(self, clock_deg: FloatArray, z_mm: FloatArray) -> BoolArray:
        """Which of the places lie below it, corners included; arrays broadcast."""
        half = np.interp(z_mm, self.z_mm, self.half_deg)
        below = (z_mm >= self.z_range_mm[0]) & (z_mm <= self.z_range_mm[1])
        return np.asarray(below & (np.abs(turn_from(clock_deg, self.feature.clock_deg)) <= half))


def without_levels(
    profiles: Sequence[Profile], calibration: Calibration
) -> tuple[tuple[Profile, ...], tuple[Level, ...]]:
    """The profiles less what lies below a level, and the levels in order of distance.

    How many points went is added to each profile's `rejected["below level"]`. Raises AnnulusError as `build_wall` does.
    """
    wall = build_wall(profiles, z_step_mm=SLAB_OF_RADIUS * calibration.pipe_radius_mm)
    rolls = [profile.pose.roll for profile in profiles if profile.pose is not None]
    chords = find_chords(wall, OFF_DEG if None in rolls else OFF_ROLL_KNOWN_DEG)
    levels = tuple(_level(chord, wall, profiles, calibration) for chord in chords)
    return (tuple(_above(levels, profile) for profile in profiles) if levels else tuple(profiles)), levels


def covered(levels: Iterable[Level], clock_deg: FloatArray, z_mm: FloatArray) -> BoolArray:
    """Which of the places lie below any of the levels; arrays broadcast."""
    out = np.zeros(np.broadcast(clock_deg, z_mm).shape, np.bool_)
    for level in levels:
        out |= level.covers(clock_deg, z_mm)
    return out


def _above(levels: Sequence[Level], profile: Profile) -> Profile:
    x, y, z = profile.points_mm.astype(np.float64).T
    kept = ~covered(levels, np.degrees(np.arctan2(x, -y)), z)
    if kept.all():
        return profile
    return replace(
        profile, points_mm=profile.points_mm[kept], colour=profile.colour[kept], ring=profile.ring[kept],
        direction=profile.direction[kept], sigma_mm=profile.sigma_mm[kept],
        rejected={**profile.rejected, "below level": int(np.count_nonzero(~kept))},
    )  # fmt: skip


def _level(chord: Chord, wall: Wall, profiles: Sequence[Profile], calibration: Calibration) -> Level:
    size, z_mm = wall.mean_radius_mm, wall.z_mm[chord.rows]
    edges = float(z_mm[0] - wall.z_step_mm / 2), float(z_mm[-1] + wall.z_step_mm / 2)
    bottom = float(np.median(chord.radius_mm))
    clock = chord.clock_deg
    sight = _look(chord, clock, edges, profiles, calibration, bottom)
    for _ in range(3):  # the surface's own lean says where its middle is, better than its corners
        lean = math.degrees(math.atan(_slope(sight)))
        clock += lean
        sight = _look(chord, clock, edges, profiles, calibration, bottom)
        if abs(lean) < 0.02:
            break
    told, heights, error = _told_apart(sight, size, chord.radius_sigma_mm)
    level = float(np.nanmedian(heights))
    slabs = nan_median(heights.T)
    known = np.isfinite(slabs)
    course = np.polynomial.Polynomial.fit(z_mm[known], slabs[known], min(1, np.count_nonzero(known) - 1))(z_mm)
    low, high = np.nanpercentile(heights - course[:, None], [5, 95])
    flat = (high - low) / 2 <= FLAT_OF_RADIUS * size
    if not flat:  # nowhere above what was seen of it
        course = ndimage.minimum_filter1d(np.interp(z_mm, z_mm[known], slabs[known]), 3, mode="nearest")
    half = _half_deg(course - MARGIN_OF_RADIUS * size, chord.radius_mm)
    begins, ends = chord.rows.start > 1, chord.rows.stop < len(wall.z_mm) - 1
    reach = edges[0] - wall.z_step_mm if begins else -math.inf, edges[1] + wall.z_step_mm if ends else math.inf
    first, last = edges[0] if begins else wall.extent[0], edges[1] if ends else wall.extent[1]
    remark = "flat" if flat else f"uneven by {(high - low) / 2:.1f} mm up and down"
    measures = (
        Measure("level_mm", level, 2.0 * error),
        Measure("depth_mm", bottom - level, 2.0 * math.hypot(error, chord.radius_sigma_mm)),
        Measure("height_percent", 50.0 * (1.0 - level / bottom), 100.0 * error / bottom),
    )
    feature = Feature(
        told or FeatureKind.DEPOSIT, (first + last) / 2, last - first, clock % 360.0,
        2.0 * float(_half_deg(np.array([level]), np.array([bottom]))[0]), measures,
        remark if told else f"{remark}; water or deposit not told",
    )  # fmt: skip
    return Level(feature, z_mm, half, reach)


def _half_deg(height_mm: FloatArray, radius_mm: FloatArray) -> FloatArray:
    return np.asarray(np.degrees(np.arccos(np.clip(height_mm / radius_mm, -1.0, 1.0))))


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """What the rings see of a surface, in a frame whose y goes straight down to it.

    x_mm, z_mm, opaque_mm (N,): points, `opaque_mm` their y. Of the surface's height by row of the wall, column of the
    clock and ring: `opaque` (S, C, K) if nothing is seen through it, `water` if it is water; NaN where not seen.
    sigma_mm (K,).
    """

    x_mm: FloatArray
    z_mm: FloatArray
    opaque_mm: FloatArray
    opaque: FloatArray
    water: FloatArray
    sigma_mm: FloatArray


def _look(
    chord: Chord, clock_deg: float, edges: tuple[float, float], profiles: Sequence[Profile], calibration: Calibration,
    bottom_mm: float,
) -> _Sight:  # fmt: skip
    straight = rotation_z(-math.radians(clock_deg - DOWN_DEG)).T
    camera, rings = calibration.camera, len(calibration.rings)
    half = MIDDLE * chord.half_deg
    parts = []
    for profile in profiles:
        pose = profile.pose
        if pose is None or not len(profile.points_mm):
            continue
        points = profile.points_mm.astype(np.float64)
        x, y, z = points.T
        off = np.abs(turn_from(np.degrees(np.arctan2(x, -y)), clock_deg))
        row = ((z - edges[0]) / (edges[1] - edges[0]) * len(half)).astype(np.int64)
        inside = (z >= edges[0]) & (z < edges[1]) & (profile.ring < rings)
        chosen = np.flatnonzero(inside & (off <= half[np.clip(row, 0, len(half) - 1)]))
        chosen = chosen[:: 1 + len(chosen) // (POINTS_MOST * rings)]
        points, ring, row = points[chosen], profile.ring[chosen].astype(np.int64), row[chosen]
        seen = pose.to_camera(points, profile.z_mm)
        eyes = np.zeros_like(seen) if camera.central else camera.lines(camera.project(seen))[0]
        cones = [calibration.rings[k] for k in ring]
        lamps = np.array([cone.vertex_mm for cone in cones]).reshape(-1, 3)
        axes = np.array([cone.axis for cone in cones]).reshape(-1, 3) @ pose.rotation @ straight
        points = points @ straight
        water = surface_heights(
            points, pose.to_pipe(eyes, profile.z_mm) @ straight, pose.to_pipe(lamps, profile.z_mm) @ straight, axes,
            np.full(len(points), bottom_mm),
        )  # fmt: skip
        parts.append(np.column_stack([points, water, profile.sigma_mm[chosen], ring, row]))
    x, y, z, water, sigma, ring, row = np.concatenate(parts).T
    columns = 1 + int(2 * half.max() / CELL_DEG)
    column = np.clip((np.degrees(np.arctan2(x, y)) / CELL_DEG + columns / 2).astype(np.int64), 0, columns - 1)
    cell = (row.astype(np.int64) * columns + column) * rings + ring.astype(np.int64)
    tables = [_medians(cell, value, (len(half), columns, rings)) for value in (y, water)]
    said = _medians(ring.astype(np.int64), sigma, (rings,))
    return _Sight(x, z, y, tables[0], tables[1], said)


def _medians(cell: NDArray[np.int64], value: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Median of the finite values of each cell, NaN where there is none."""
    out = np.full(math.prod(shape), np.nan)
    known = np.isfinite(value)
    order = np.lexsort((value[known], cell[known]))
    value = value[known][order]
    count = np.bincount(cell[known], minlength=len(out))
    full = count > 0
    start = (np.cumsum(count) - count)[full]
    out[full] = 0.5 * (value[start + (count[full] - 1) // 2] + value[start + count[full] // 2])
    return out.reshape(shape)


def _slope(sight: _Sight) -> float:
    """How much a surface goes down to the right, as it looks; water looks deeper in the middle."""
    x, z = sight.x_mm, sight.z_mm
    design = np.column_stack([np.ones_like(x), x, x * x, z - z.mean()])
    fit = np.array([float(np.median(sight.opaque_mm)), 0.0, 0.0, 0.0])
    for _ in range(8):
        left = sight.opaque_mm - design @ fit
        weight = biweight(left / (TUKEY * max(robust_sigma(left), 1e-3)))
        weighted = design * weight[:, None]
        fit = np.linalg.lstsq(weighted.T @ design, weighted.T @ sight.opaque_mm, rcond=None)[0]
    return float(fit[1])


def _told_apart(sight: _Sight, size: float, radius_sigma_mm: float) -> tuple[FeatureKind | None, FloatArray, float]:
    """What the surface is, None where nobody can say; (S, C) its height, NaN where not seen; that height's standard
    deviation."""
    unsaid, least = SIGMA_UNSAID_OF_RADIUS * size, SIGMA_LEAST_OF_RADIUS * size
    sigma = np.maximum(np.where(np.isfinite(sight.sigma_mm), sight.sigma_mm, unsaid), least)
    opaque, off_opaque = _levelled(sight.opaque, sigma)
    water, off_water = _levelled(sight.water, sigma)
    rings = np.isfinite(sight.opaque).sum(axis=2)
    possible = np.isfinite(water).sum() >= 0.5 * np.isfinite(opaque).sum()
    expected = np.where(np.isfinite(off_water), off_opaque - off_water, 0.0)
    weight = np.where(np.isfinite(off_water), sigma**-2.0, 0.0)
    known = float((weight * expected**2).sum())
    told = None
    if possible and known > 0.0 and np.count_nonzero(rings > 1) >= OVERLAP * np.count_nonzero(rings):
        share = float((weight * expected * np.nan_to_num(off_opaque)).sum()) / known
        if abs(share - TOLD) > 2.0 / math.sqrt(known):
            told = FeatureKind.WATER if share > TOLD else FeatureKind.DEPOSIT
    if not possible:
        told = FeatureKind.DEPOSIT
    there = np.isfinite(off_opaque)
    common = float(np.median(sigma[there]))
    if told is FeatureKind.WATER:
        disagree = float(np.nanstd(off_water)) / math.sqrt(np.count_nonzero(there))
        return told, water, math.hypot(THROUGH_WATER * common, disagree, (THROUGH_WATER - 1.0) * radius_sigma_mm)
    disagree = float(np.nanstd(off_opaque)) / math.sqrt(np.count_nonzero(there))
    unknown = 0.0 if told else float(np.nanmedian(opaque) - np.nanmedian(water)) if possible else 0.0
    return told, opaque, math.hypot(common, disagree, unknown / 2.0)


def _levelled(table: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(S, C) the surface that (S, C, K) rings see, and (K,) how far each ring sees it below that; NaN where none does."""
    weight = np.where(np.isfinite(table), sigma**-2.0, 0.0)
    offset = np.zeros(len(sigma))
    value = np.nan_to_num(table)
    there = weight.sum(axis=(0, 1)) > 0
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(20):
            surface = (weight * (value - offset)).sum(axis=2) / weight.sum(axis=2)
            left = np.where(weight > 0, table - surface[:, :, None], np.nan)
            offset = np.nan_to_num(nan_median(left.reshape(-1, len(sigma))))
            offset -= np.average(offset, weights=np.where(there, sigma**-2.0, 0.0)) if there.any() else 0.0
        surface = (weight * (value - offset)).sum(axis=2) / weight.sum(axis=2)
    return surface, np.where(there, offset, np.nan)
