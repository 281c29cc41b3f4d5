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

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import rotation_z
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import TUKEY, biweight, nan_median, robust_sigma
from annulus_pipe.wall.chords import DOWN_DEG, Chord, Slabs, find_chords, turn_from
from annulus_pipe.wall.cylinder import round_clock
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.grid import cell_medians
from annulus_pipe.wall.pose import fit_pose
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.refraction import surface_heights

# Held as a whole by test_levels.py; not tried one by one.
SLAB_OF_RADIUS = 0.1  # of the radius: length of pipe in which a level is looked for
SLABS_MOST = 20_000  # bounds time and memory on very long scans
COLUMN_DEG = 2.0
OFF_DEG = 24.0  # a level's middle off the bottom at most: a head turns ..
OFF_ROLL_KNOWN_DEG = 6.0  # .. and where its roll is known the sensor errs
MARGIN_OF_RADIUS = 0.01  # of the radius: this far above the level there is no surface left
FLAT_OF_RADIUS = 0.01  # of the radius: half of the range of heights, 5 to 95 %, of what is called flat
UNEVEN_MOST = 0.4  # of its depth: what is more uneven is no level
MIDDLE = 0.75  # part of a level's arc that it is measured on ..
CORNER_DEG = 8.0  # .. or all but its corners, which are partly wall, where that is more
POINTS_MOST = 120  # of a frame and ring that a level is measured with
LEAN_MOST_DEG = 6.0  # of a surface against the chord's own middle
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

    How many points went is added to each profile's `rejected["below level"]`.
    """
    levels = _find(profiles, calibration)
    if not levels:
        return tuple(profiles), ()
    # what lay below pulled on the poses, and the level was measured from these
    posed = [_posed(levels, profile, calibration.pipe_radius_mm) for profile in profiles]
    levels = _find(posed, calibration)
    return tuple(_above(levels, profile) for profile in posed), levels


def _find(profiles: Sequence[Profile], calibration: Calibration) -> tuple[Level, ...]:
    slabs = _cut(profiles, SLAB_OF_RADIUS * calibration.pipe_radius_mm)
    if slabs is None:
        return ()
    rolls = [profile.pose.roll for profile in profiles if profile.pose is not None]
    chords = find_chords(slabs, OFF_DEG if None in rolls else OFF_ROLL_KNOWN_DEG)
    found = (_level(chord, slabs, profiles, calibration) for chord in chords)
    return tuple(level for level in found if level is not None)


def _posed(levels: Sequence[Level], profile: Profile, radius_mm: float) -> Profile:
    """The profile about the pipe that what lies above the levels makes; as it was where that makes none."""
    above = _above(levels, profile)
    old = profile.pose
    if old is None or above is profile:
        return profile
    sigma = np.where(np.isfinite(above.sigma_mm), above.sigma_mm, SIGMA_UNSAID_OF_RADIUS * radius_mm)
    camera = old.to_camera(above.points_mm.astype(np.float64), profile.z_mm)
    fit = fit_pose(camera, radius_mm, sigma.astype(np.float64), old, one_ring=len(np.unique(above.ring)) < 2)
    if fit is None:
        return profile
    pose = replace(fit.pose, roll=old.roll)
    everything = old.to_camera(profile.points_mm.astype(np.float64), profile.z_mm)
    moved = pose.to_pipe(everything, profile.z_mm).astype(np.float32)
    return replace(profile, pose=pose, points_mm=moved, lean_sigma_deg=fit.lean_sigma_deg)


def covered(levels: Iterable[Level], clock_deg: FloatArray, z_mm: FloatArray) -> BoolArray:
    """Which of the places lie below any of the levels; arrays broadcast."""
    out = np.zeros(np.broadcast(clock_deg, z_mm).shape, np.bool_)
    for level in levels:
        out |= level.covers(clock_deg, z_mm)
    return out


def _above(levels: Sequence[Level], profile: Profile) -> Profile:
    x, y, z = profile.points_mm.astype(np.float64).T
    below = covered(levels, np.degrees(np.arctan2(x, -y)), z)
    return profile.without(below, "below level") if below.any() else profile


def _cut(profiles: Sequence[Profile], length_mm: float) -> Slabs | None:
    """Slabs of the pipe; None where not two can be made."""
    points = [profile.points_mm for profile in profiles if len(profile.points_mm)]
    if not points:
        return None
    radius, clock, z = round_clock(np.concatenate(points))
    low, high = np.percentile(z, [0.05, 99.95])  # a stray point far away must not stretch the grid
    rows, columns = min(round((high - low) / length_mm), SLABS_MOST), round(360.0 / COLUMN_DEG)
    if rows < 2:
        return None
    step = (high - low) / rows
    row = np.floor((z - low) / step).astype(np.int64)
    column = (clock / COLUMN_DEG).astype(np.int64) % columns
    inside = (row >= 0) & (row < rows)
    medians, _ = cell_medians((row * columns + column)[inside], radius[inside], (rows, columns))
    middles = np.asarray(low + (np.arange(rows) + 0.5) * step, dtype=np.float64)
    return Slabs(medians, middles, np.asarray((np.arange(columns) + 0.5) * COLUMN_DEG, dtype=np.float64))


def _level(chord: Chord, slabs: Slabs, profiles: Sequence[Profile], calibration: Calibration) -> Level | None:
    z_mm, step = slabs.z_mm[chord.rows], slabs.z_step_mm
    edges = float(z_mm[0] - step / 2), float(z_mm[-1] + step / 2)
    size = bottom = float(np.median(chord.radius_mm))
    clock = chord.clock_deg
    sight = _look(chord, slabs, profiles, calibration)
    clock += _lean_deg(sight.points_mm @ _straight(clock))  # says where the middle is better than the corners do
    opaque, water, sigma = _heights(sight, clock, chord, len(calibration.rings))
    kind, heights, error = _told_apart(opaque, water, sigma, size, chord.radius_sigma_mm)
    level = float(np.nanmedian(heights))
    by_slab = nan_median(heights.T)
    known = np.isfinite(by_slab)
    course = np.asarray(np.polynomial.Polynomial.fit(z_mm[known], by_slab[known], 1)(z_mm))
    low, high = np.nanpercentile(heights - course[:, None], [5, 95])
    if (high - low) / 2 > UNEVEN_MOST * (bottom - level) or not math.isfinite(error + chord.radius_sigma_mm):
        return None
    flat = (high - low) / 2 <= FLAT_OF_RADIUS * size
    if not flat:  # nowhere above what was seen of it
        course = ndimage.minimum_filter1d(np.interp(z_mm, z_mm[known], by_slab[known]), 3, mode="nearest")
    half = _half_deg(course - MARGIN_OF_RADIUS * size - 2.0 * error, chord.radius_mm)
    begins, ends = chord.rows.start > 1, chord.rows.stop < len(slabs.z_mm) - 1
    reach = edges[0] - step if begins else -math.inf, edges[1] + step if ends else math.inf
    first = edges[0] if begins else float(slabs.z_mm[0] - step / 2)
    last = edges[1] if ends else float(slabs.z_mm[-1] + step / 2)
    remark = "flat" if flat else f"uneven by {(high - low) / 2:.1f} mm up and down"
    measures = (
        FeatureMeasure("level_mm", level, 2.0 * error),
        FeatureMeasure("depth_mm", bottom - level, 2.0 * math.hypot(error, chord.radius_sigma_mm)),
        FeatureMeasure("height_percent", 50.0 * (1.0 - level / bottom), 100.0 * error / bottom),
    )
    feature = Feature(
        kind or FeatureKind.DEPOSIT,
        (first + last) / 2,
        last - first,
        clock % 360.0,
        2.0 * float(_half_deg(np.array([level]), np.array([bottom]))[0]),
        measures,
        remark if kind else f"{remark}; water or deposit not told",
    )
    return Level(feature, z_mm, half, reach)


def _half_deg(height_mm: FloatArray, radius_mm: FloatArray) -> FloatArray:
    return np.asarray(np.degrees(np.arccos(np.clip(height_mm / radius_mm, -1.0, 1.0))))


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """Points on a surface, pipe frame: where they lie, where their rays and cones start and the cones' axes, (N, 3);
    the slab of the chord, ring and sigma of each, (N,)."""

    points_mm: FloatArray
    eyes_mm: FloatArray
    lamps_mm: FloatArray
    axes: FloatArray
    slab: NDArray[np.int64]
    ring: NDArray[np.int64]
    sigma_mm: FloatArray


def _look(chord: Chord, slabs: Slabs, profiles: Sequence[Profile], calibration: Calibration) -> _Sight:
    camera, rings = calibration.camera, calibration.rings
    lamp, axis = (np.array([getattr(cone, name) for cone in rings]) for name in ("vertex_mm", "axis"))
    half = np.maximum(MIDDLE * chord.half_deg, chord.half_deg - CORNER_DEG)
    start = slabs.z_mm[chord.rows][0] - slabs.z_step_mm / 2
    parts = []
    for profile in profiles:
        pose = profile.pose
        if pose is None or not len(profile.points_mm):
            continue
        points = profile.points_mm.astype(np.float64)
        slab = np.floor((points[:, 2] - start) / slabs.z_step_mm).astype(np.int64)
        inside = (slab >= 0) & (slab < len(half)) & (profile.ring < len(rings))
        off = np.abs(turn_from(np.degrees(np.arctan2(points[:, 0], -points[:, 1])), chord.clock_deg))
        chosen = np.flatnonzero(inside & (off <= half[slab.clip(0, len(half) - 1)]))
        chosen = chosen[:: 1 + len(chosen) // (POINTS_MOST * len(rings))]
        ring = profile.ring[chosen].astype(np.int64)
        seen = pose.to_camera(points[chosen], profile.z_mm)
        eyes = np.zeros_like(seen) if camera.central else camera.lines(camera.project(seen))[0]
        eyes, lamps = (pose.to_pipe(starts, profile.z_mm) for starts in (eyes, lamp[ring]))
        axes = axis[ring] @ pose.rotation
        parts.append((points[chosen], eyes, lamps, axes, slab[chosen], ring, profile.sigma_mm[chosen].astype(float)))
    return _Sight(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _lean_deg(points_mm: FloatArray) -> float:
    """How much a surface across y goes down to the right as it looks. Water looks deeper in its middle: a bend is
    fitted along."""
    x, y, z = points_mm.T
    design = np.column_stack([np.ones_like(x), x, x * x, z - z.mean()])
    fit = np.array([float(np.median(y)), 0.0, 0.0, 0.0])
    for _ in range(8):
        left = y - design @ fit
        weight = biweight(left / (TUKEY * max(robust_sigma(left), 1e-3)))
        weighted = design * weight[:, None]
        fit = np.linalg.lstsq(weighted.T @ design, weighted.T @ y, rcond=None)[0]
    return float(np.clip(math.degrees(math.atan(fit[1])), -LEAN_MOST_DEG, LEAN_MOST_DEG))


def _heights(sight: _Sight, clock_deg: float, chord: Chord, rings: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the surface, by slab, column of the clock and ring (S, C, K), NaN where not seen: if nothing is seen through
    it and if it is water. And sigma of each ring (K,)."""
    straight = _straight(clock_deg)
    points = sight.points_mm @ straight
    eyes, lamps, axes = sight.eyes_mm @ straight, sight.lamps_mm @ straight, sight.axes @ straight
    water = surface_heights(points, eyes, lamps, axes, chord.radius_mm[sight.slab])
    half = float(chord.half_deg.max()) + LEAN_MOST_DEG
    columns = 1 + int(2 * half / CELL_DEG)
    across = np.degrees(np.arctan2(points[:, 0], points[:, 1]))
    column = np.clip(((across + half) / CELL_DEG).astype(np.int64), 0, columns - 1)
    shape = len(chord.half_deg), columns, rings
    cell = (sight.slab * columns + column) * rings + sight.ring
    known, stated = np.isfinite(water), np.isfinite(sight.sigma_mm)
    flat = math.prod(shape[:2]), rings
    opaque, through = cell_medians(cell, points[:, 1], flat)[0], cell_medians(cell[known], water[known], flat)[0]
    sigma = cell_medians(sight.ring[stated], sight.sigma_mm[stated], (1, rings))[0][0]
    return opaque.reshape(shape), through.reshape(shape), sigma


def _straight(clock_deg: float) -> FloatArray:
    """(3, 3) that points (N, 3) are multiplied by so that a clock angle is down."""
    return rotation_z(math.radians(clock_deg - DOWN_DEG))


def _told_apart(
    opaque_mm: FloatArray, water_mm: FloatArray, sigma_mm: FloatArray, size: float, radius_sigma_mm: float
) -> tuple[FeatureKind | None, FloatArray, float]:
    """What the surface is, None where nobody can say; (S, C) its height, NaN where not seen; that height's standard
    deviation."""
    unsaid, least = SIGMA_UNSAID_OF_RADIUS * size, SIGMA_LEAST_OF_RADIUS * size
    sigma = np.maximum(np.where(np.isfinite(sigma_mm), sigma_mm, unsaid), least)
    opaque, off_opaque = _levelled(opaque_mm, sigma)
    water, off_water = _levelled(water_mm, sigma)
    rings = np.isfinite(opaque_mm).sum(axis=2)
    possible = np.isfinite(water).sum() >= 0.5 * np.isfinite(opaque).sum()
    expected = np.where(np.isfinite(off_water), off_opaque - off_water, 0.0)
    weight = np.where(np.isfinite(off_water), sigma**-2.0, 0.0)
    known = float((weight * expected**2).sum())
    kind = None
    if possible and known > 0.0 and np.count_nonzero(rings > 1) >= OVERLAP * np.count_nonzero(rings):
        share = float((weight * expected * np.nan_to_num(off_opaque)).sum()) / known
        if abs(share - TOLD) > 2.0 / math.sqrt(known):
            kind = FeatureKind.WATER if share > TOLD else FeatureKind.DEPOSIT
    if not possible:
        kind = FeatureKind.DEPOSIT
    common = float(np.median(sigma[np.isfinite(off_opaque)]))
    if kind is FeatureKind.WATER:
        disagree = _disagreement(off_water, sigma)
        return kind, water, math.hypot(THROUGH_WATER * common, disagree, (THROUGH_WATER - 1.0) * radius_sigma_mm)
    disagree = _disagreement(off_opaque, sigma)
    if kind is None:  # between the two that it may be
        middle = 0.5 * (opaque + np.where(np.isfinite(water), water, opaque))
        return None, middle, math.hypot(common, disagree, float(np.nanmedian(opaque - middle)))
    return kind, opaque, math.hypot(common, disagree)


def _disagreement(offset: FloatArray, sigma: FloatArray) -> float:
    """What rings that disagree by (K,) leave open of their mean, standard deviation."""
    there = np.isfinite(offset)
    weight = sigma[there] ** -2.0
    return math.sqrt(float((weight * offset[there] ** 2).sum() / weight.sum()) / len(weight))


def _levelled(table: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(S, C) the surface that rings see, (S, C, K), and how far each sees it below that, (K,); NaN where none does."""
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
