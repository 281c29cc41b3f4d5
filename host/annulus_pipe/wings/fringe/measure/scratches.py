"""Scratches, pockets and bumps of a pipe's wall, from its map: a matched filter over what a scratch may look like.

A scratch is long and narrow, so its depth is averaged over strips of SHAPES in every direction, in units of what such
an average scatters by on this wall; where one stands out by SEED the cells that do belong to a defect. Which averages
scatter how is asked of the wall itself, robustly: errors of neighbours are alike, and their own sigma does not say so.
The wall's own form (centre, ovality, taper) is taken out first, as one smooth shape over the whole map. Wrong where
more than half the wall is damaged.
"""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY, biweight, robust_sigma
from annulus_pipe.wall.defects import UNSURE, Defect, Kind
from annulus_pipe.wings.fringe.measure.pipe import PipeMap
from annulus_pipe.wings.fringe.measure.track import ROBUST_FROM

TURNS_DEG = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0)
SHAPES = ((9, 1), (9, 3), (3, 3))  # cells: length and width of a strip
FILLED = 0.6  # of a strip that has to be known
SEED = 7.0  # robust sigma of a strip's mean: one in 1e11 by chance
CELL = 3.0  # sigma of a cell that belongs to a defect
LEAST_OF_RADIUS = 4e-4  # of a strip's mean: what calibration leaves of a wall's form is of that size
CELLS_MIN = 8
SHAPE_ROUNDS = 6
RIPPLE_ROWS = 4  # so near a step its blur leaves a ripple to the other side ..
RIPPLE_DEPTH = 0.5  # .. of this part of its depth at most
UPPER = 0.75  # quantile of its cells' depth from which on they show its floor


def find_scratches(seen: PipeMap) -> list[Defect]:
    """Losses and bumps as the report lists them, in order of distance; z along the pipe, clock from 12 (-y). A loss
    whose floor was not seen says so, and its depth is a lower limit."""
    off, sigma = deviation_mm(seen), seen.sigma_mm
    known = np.isfinite(off) & (
        seen.frames >= min(ROBUST_FROM, len(seen.head.poses))
    )  # fewer cannot outvote a wrong one
    if not known.any():
        return []
    value = np.where(known, off, 0.0)
    least = LEAST_OF_RADIUS * seen.head.radius_mm
    scatter = np.maximum(sigma, robust_sigma(off[known]))
    found: list[tuple[Defect, BoolArray]] = []
    for sign, kind in ((1.0, Kind.LOSS), (-1.0, Kind.BUMP)):
        core = np.zeros(known.shape, bool)
        for strip in _strips():
            share = _wrapped(known.astype(float), strip)
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = np.where(share > FILLED, _wrapped(sign * value, strip) / share, np.nan)
            usual = SIGMA_OF_MAD * float(np.nanmedian(np.abs(mean - np.nanmedian(mean))))
            few = np.maximum(1.0, np.where(known, sigma, 1.0) / np.nanmedian(sigma))  # cells that few frames saw
            core |= np.nan_to_num(mean, nan=-1.0) > np.maximum(SEED * usual * few, least)
        cells = known & (sign * value > CELL * scatter)
        dark = seen.at_least & ~np.isfinite(seen.radius_mm) & (sign > 0)
        found += [(_measured(seen, kind, place, sign * off), place) for place in _places(cells, core, dark)]
    sure = [(one, place) for one, place in found if one.depth_k2_mm <= UNSURE * one.depth_mm]
    whole = [one for one, place in sure if not _is_ripple(one, place, sure)]
    return sorted(whole, key=lambda one: (one.z_mm, one.clock_deg))


def _is_ripple(one: Defect, place: BoolArray, found: list[tuple[Defect, BoolArray]]) -> bool:
    """Whether a place is the swing to the other side that the blur of a deeper one's edge leaves beside it."""
    if np.count_nonzero(place.any(axis=1)) > RIPPLE_ROWS:
        return False
    wide = ndimage.binary_dilation(place, np.ones((3, 3)), iterations=RIPPLE_ROWS)
    return any(
        other.kind is not one.kind and one.depth_mm < RIPPLE_DEPTH * other.depth_mm and bool((wide & cells).any())
        for other, cells in found
    )


def deviation_mm(seen: PipeMap) -> FloatArray:
    """(Z, A) of the radius from the wall's smooth form; outwards positive."""
    phi = np.radians(seen.phi_deg)
    t = (seen.z_mm - seen.z_mm.mean()) / np.ptp(seen.z_mm)
    around = np.stack([np.ones_like(phi), np.cos(phi), np.sin(phi), np.cos(2 * phi), np.sin(2 * phi)], axis=1)
    along = np.stack([np.ones_like(t), t, t * t], axis=1)
    known = np.isfinite(seen.radius_mm) & np.isfinite(seen.sigma_mm)
    row, column = np.nonzero(known)
    if not len(row):
        return np.full(seen.radius_mm.shape, np.nan)
    some = slice(None, None, max(len(row) // 20000, 1))
    terms = (along[row[some], :, None] * around[column[some], None, :]).reshape(len(row[some]), -1)
    height = seen.radius_mm[known][some]
    off = height - np.median(height)
    for _ in range(SHAPE_ROUNDS):
        weight = np.sqrt(biweight(off / max(TUKEY * robust_sigma(off - np.median(off)), 1e-9)))
        fit = np.linalg.lstsq(terms * weight[:, None], height * weight, rcond=None)[0]
        off = height - terms @ fit
    form = along @ fit.reshape(along.shape[1], -1) @ around.T
    return np.where(known, seen.radius_mm - form, np.nan)


def _strips() -> list[FloatArray]:
    """Kernels that sum to 1."""
    out = []
    for length, width in SHAPES:
        half = length // 2 + 1
        y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
        for turn in np.radians(TURNS_DEG if length > width else TURNS_DEG[:1]):
            a, b = x * np.cos(turn) + y * np.sin(turn), -x * np.sin(turn) + y * np.cos(turn)
            strip = (np.abs(a) <= length / 2) & (np.abs(b) <= width / 2)
            out.append(strip / strip.sum())
    return out


def _wrapped(field: FloatArray, kernel: FloatArray) -> FloatArray:
    wide = kernel.shape[1] // 2
    padded = np.pad(field, ((0, 0), (wide, wide)), mode="wrap")
    return np.asarray(ndimage.convolve(padded, kernel, mode="constant")[:, wide:-wide])


def _places(cells: BoolArray, core: BoolArray, dark: BoolArray) -> list[BoolArray]:
    """Joined cells around cores, also across what lies in the dark of their rims; what touches the seam of the map goes
    on at its other side."""
    joined = ndimage.binary_closing(cells, np.ones((3, 3))) | cells | dark
    marks, count = ndimage.label(joined, structure=np.ones((3, 3)))
    for j in range(len(marks)):
        for i in (j - 1, j, j + 1):
            if 0 <= i < len(marks) and marks[j, 0] and marks[i, -1] and marks[j, 0] != marks[i, -1]:
                marks[marks == marks[i, -1]] = marks[j, 0]
    inside = np.bincount(marks.ravel(), weights=(core & cells).ravel(), minlength=count + 1)
    size = np.bincount(marks.ravel(), weights=cells.ravel(), minlength=count + 1)
    return [(marks == k) & cells for k in range(1, count + 1) if inside[k] >= CELLS_MIN / 2 and size[k] >= CELLS_MIN]


def _measured(seen: PipeMap, kind: Kind, place: BoolArray, depth: FloatArray) -> Defect:
    along, across = seen.cell_mm
    rows, columns = np.flatnonzero(place.any(axis=1)), np.flatnonzero(place.any(axis=0))
    gaps = np.diff(np.append(columns, columns[0] + place.shape[1]))
    widest = int(np.argmax(gaps))
    step = 360.0 / place.shape[1]
    arc = (place.shape[1] - gaps[widest] + 1) * step
    start = seen.phi_deg[columns[(widest + 1) % len(columns)]] - step / 2
    upper = place & (depth >= np.quantile(depth[place], UPPER))
    deep = float(np.median(depth[upper]))
    k2 = 2 * float(np.hypot(np.median(seen.sigma_mm[upper]), np.std(depth[upper])))
    z0, z1 = seen.z_mm[rows[0]] - along / 2, seen.z_mm[rows[-1]] + along / 2
    floor = kind is not Kind.LOSS or not seen.at_least[upper].mean() > 0.5
    return Defect(
        kind,
        float(z0 + z1) / 2,
        float((start + arc / 2 + 90.0) % 360.0),
        float(z1 - z0),
        float(arc),
        deep,
        float(place.sum() * along * across),
        bool(floor),
        k2,
    )
