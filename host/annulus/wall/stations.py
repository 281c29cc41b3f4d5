"""Diameters and ovality, station by station along the pipe."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from annulus.numeric.arrays import Float32Array, FloatArray
from annulus.numeric.rounding import ARC, DISTANCE, MEASURE, clock_face, said, span
from annulus.vocabulary import Finding
from annulus.wall.grid import Wall
from annulus.wall.indications import arc_of

if TYPE_CHECKING:  # features' clock faces are from here
    from annulus.wall.features import Feature

OVALITY_NAME = "ASTM F1216"
OVALITY_FORMULA = "100 · max(Dmax − Dmean, Dmean − Dmin) / Dmean"
# PAIRS_NEEDED is guarded upwards by test_grid.py; the benchmark topic diameter scores stations of STATION_MM.
NOT_ENOUGH = "not enough seen"  # kind of a finding
STATION_MM = 5.0  # length of a station
PAIRS_NEEDED = 0.5  # part of the diameters round the clock; with fewer a station has no figures


@dataclass(frozen=True, slots=True)
class Stations:
    """One entry a station; NaN where less than half of its diameters was measured.

    z_mm, diameter_min/max/mean_mm (as measured, local defects included), ovality_percent (ASTM F1216 from those three),
    shape_ovality_percent (ASTM F1216 of the pipe's fitted shape, local defects left out; NaN where too little was seen
    for it), valid_fraction (of the wall
    seen, 0..1), diameter_k2_mm (expanded uncertainty, k = 2, of one of those diameters; NaN where points say nothing of
    theirs). All (S,) float64.
    """

    z_mm: FloatArray
    diameter_min_mm: FloatArray
    diameter_max_mm: FloatArray
    diameter_mean_mm: FloatArray
    ovality_percent: FloatArray
    shape_ovality_percent: FloatArray
    valid_fraction: FloatArray
    diameter_k2_mm: FloatArray


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
            arc = f"{said(360.0 - known, ARC)} about clock {clock_face(middle)} {why}"
        what = "ovality" if not circle[rows].any() else "shape"
        out.append(
            Finding(
                NOT_ENOUGH,
                f"not enough seen from {span(first, last, DISTANCE)}: {arc}, so that the pipe's {what} is not known to "
                f"{said(wall.shape_limit_mm, MEASURE)} and nothing is measured from it there",
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


def measure_stations(wall: Wall, station_mm: float = STATION_MM) -> Stations:
    """Cut the wall into slices of about `station_mm` and measure every slice's diameters.

    A diameter is the sum of two opposite radii, so a centre that is off by a little does not matter. Radii are medians
    over the slice and over three neighbouring degrees: extremes of noise are not diameters. Two opposite radii may err
    alike, so the uncertainty of one counts twice; noise, which the extremes pick, is added as for independent ones.
    """
    rows = max(1, round(station_mm / wall.z_step_mm))
    columns = len(wall.clock_deg)
    shape = shape_ovality(wall)
    out = []
    for start in range(0, len(wall.z_mm), rows):
        part = slice(start, min(start + rows, len(wall.z_mm)))
        radius = _column_median(wall.radius_mm[part])
        diameter = radius[: columns // 2] + radius[columns // 2 :]
        valid = float(wall.seen[part].mean())
        stated = wall.sigma_mm[part][np.isfinite(wall.sigma_mm[part])]
        error = float(np.median(stated)) if len(stated) else np.nan
        k2 = 2.0 * np.sqrt((2.0 * error) ** 2 + 2.0 * float(wall.noise_mm[part].mean()) ** 2)
        z = float(wall.z_mm[part].mean())
        measured = diameter[np.isfinite(diameter)]
        if len(measured) < PAIRS_NEEDED * len(diameter):
            out.append((z, np.nan, np.nan, np.nan, float(shape[part].mean()), valid, np.nan))
            continue
        low, high, mean = float(measured.min()), float(measured.max()), float(measured.mean())
        out.append((z, low, high, mean, float(shape[part].mean()), valid, k2))
    z_mm, smallest, largest, means, fitted, seen, k2s = np.array(out, dtype=float).T
    return Stations(z_mm, smallest, largest, means, f1216(largest, smallest, means), fitted, seen, k2s)


def _column_median(rows: Float32Array) -> FloatArray:
    """(A,) median down the slice and over each column's two neighbours, round the clock; NaN where not seen."""
    stack = np.concatenate([np.roll(rows, shift, axis=1) for shift in (-1, 0, 1)]).astype(float)
    stack.sort(axis=0)
    n = np.isfinite(stack).sum(axis=0)
    low = np.take_along_axis(stack, (np.maximum(n - 1, 0) // 2)[None], axis=0)[0]
    high = np.take_along_axis(stack, np.minimum(n // 2, len(stack) - 1)[None], axis=0)[0]
    seen = np.isfinite(rows).any(axis=0)
    return np.where(seen, 0.5 * (low + high), np.nan)
