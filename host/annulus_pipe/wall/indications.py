"""Where the wall stands out of the pipe's own shape: cells found, grown, joined and split into indications.

A place stands out when it departs from the shape by more than the noise of this scan and more than an inspector cares
about; both limits are written into every report. Nothing here knows which defects to expect.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, arc_of
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.wall.grid import SHAPE_UNSURE_OF_RADIUS, Wall, smooth
from annulus_pipe.wall.patches import closed, grown, label_around, without_holes

CORNERS = np.ones((3, 3), dtype=bool)
# BAND_OVERLAP, BAND_SOUND: unguarded; the other four have not been tried. Of the limits below test_grid.py notices
# seed_noise (upwards), seed_of_radius and observations (both ways); the rest it holds as a whole, by known defects.
BAND_OVERLAP = 0.6  # part of the longer one's stations that two places have in common, to be one band ..
BAND_SOUND = 0.35  # .. if less than this part of what lies between is sound wall
BAND_EDGES = 3.5  # edge blurs: what a band is long at most ..
BAND_ASPECT = 4.0  # .. and so many times as wide
RIPPLE_EDGES = 1.5  # how far from a step, and how long, its swing to the other side may be, in edge blurs
OBSERVATION_POINTS = 3  # points of one ring in one frame on a place, for it to be an observation of it
PLATEAU_NOISE = 4.0  # standard deviations of a cell: twice what its 98th percentile lies above a floor
CREST_SCATTER = 0.08  # part of a crest's height: how far its cells may scatter about a paraboloid
FLOOR_AGREES = 0.5  # part of a floor's cells, by weight, that lie within one standard deviation of its middle
LEVELS = 24  # slices: how finely the surface is sliced when asked whether a place is one defect or several


class Kind(StrEnum):
    LOSS = "loss"  # the wall is farther out than the pipe's shape
    BUMP = "bump"  # the wall stands into the pipe
    OVALITY = "ovality"


@dataclass(frozen=True, slots=True)
class Limits:
    """From when on a departure is a defect. `.._of_radius` are parts of the mean radius, so that they fit any pipe;
    `.._noise` are standard deviations of a cell."""

    seed_noise: float = 6.0  # a defect's core departs by this many standard deviations ..
    seed_of_radius: float = SHAPE_UNSURE_OF_RADIUS  # .. and this part of the radius: what certified profilers promise
    observations: int = 2  # .. and so many observations, each one ring in one frame, agree on it
    rim_noise: float = 3.0  # it reaches as far as the departure exceeds this many standard deviations ..
    rim_of_seed: float = 0.5  # .. and this part of the core's limit
    extent_of_depth: float = 0.25  # its extent is where it departs by this part of its depth: edges blur outwards ..
    extent_of_floor: float = 0.5  # .. and by this, where it has a flat floor: a step's blur reaches as far in as out
    size_of_radius: float = 0.04  # smaller than this both ways is not resolved (3 mm in a 6-inch pipe)
    edge_of_radius: float = 0.08  # along the pipe, what a step's edge is blurred over: a slit's width on the wall
    join_of_radius: float = 0.05  # places of a kind this close are one (4 mm)
    shadow_of_radius: float = 0.22  # .. and this close when what lies between was not seen (a rod's shadow)
    gap_of_radius: float = 0.44  # places side by side in the same stations join over a gap so wide without sound wall
    unseen_depth_of_radius: float = 0.07  # how deep a loss may be of which no floor was seen, for its shadow's length
    saddle: float = 0.35  # two peaks are two defects when the way between them falls below this part of the lesser
    ovality_percent: float = 0.75  # F1216; 0.5 % accuracy and twice 0.12 % repeatability of certified profilers
    ovality_length_of_radius: float = 0.2  # shorter stretches are not listed


@dataclass(frozen=True, slots=True, eq=False)
class Indication:
    """Cells (Z, A) that belong together, how far every cell of the grid departs that way (mm, -inf: not seen), the
    noise of that (mm, standard deviation), and what it may be off in all: noise, and what its points share."""

    kind: Kind
    mask: BoolArray
    height: Float32Array
    noise: Float32Array
    sigma: Float32Array


@dataclass(frozen=True, slots=True)
class Scale:
    """What lengths mean on one wall: a cell's size along the pipe and round it, the pipe's radius, the limits."""

    cell_mm: tuple[float, float]
    radius_mm: float
    limits: Limits

    @classmethod
    def of(cls, wall: Wall, limits: Limits) -> "Scale":
        radius = wall.mean_radius_mm
        return cls((wall.z_step_mm, np.radians(wall.clock_step_deg) * radius), radius, limits)

    def mm(self, of_radius: float) -> float:
        return of_radius * self.radius_mm

    def seed_and_rim(self, wall: Wall) -> tuple[FloatArray, FloatArray]:
        """(Z, A) mm: by how much a defect's core departs there at least, and how far down it reaches."""
        limits = self.limits
        noise = wall.cell_noise_mm.astype(np.float64)
        seed = np.maximum(limits.seed_noise * noise, self.mm(limits.seed_of_radius))
        return seed, np.maximum(limits.rim_noise * noise, limits.rim_of_seed * seed)

    def around(self, mask: BoolArray, mm: float) -> BoolArray:
        """A mask of the grid with all that lies so near to it, both ways."""
        rows, columns = (max(1, math.ceil(mm / size)) for size in self.cell_mm)
        return grown(mask, rows, columns)


def find_indications(
    wall: Wall, scale: Scale, features: BoolArray | None = None
) -> tuple[list[Indication], list[Indication]]:
    """Every place that stands out of the pipe's shape, whole, and more that too few observations speak for.

    Hysteresis: cores beyond the seed limit grow over the rim limit. What only lines the rim of a larger place is no
    indication of its own, and what no sound wall parts is one band. Cells of `features` (Z, A) are neither sound nor
    part of a place.
    """
    limits, residual = scale.limits, smooth(wall.residual_mm()).astype(np.float32)
    seed, rim = scale.seed_and_rim(wall)
    sure = wall.shape_sigma_mm() <= wall.shape_limit_mm  # beside a shape that is not known nothing stands out
    if features is not None:
        sure &= ~features
    sigma = np.hypot(wall.cell_noise_mm, np.nan_to_num(wall.sigma_mm))
    found: list[Indication] = []
    unconfirmed: list[Indication] = []
    for kind, height in ((Kind.LOSS, residual), (Kind.BUMP, -residual)):
        height = np.where(wall.seen & sure, height, np.float32(-np.inf))
        for mask in _cells_of(height, ~wall.seen, seed, rim, scale):
            one = Indication(kind, mask, height, wall.cell_noise_mm, sigma)
            enough = agreeing_observations(mask, kind, wall, rim) >= limits.observations
            (found if enough else unconfirmed).append(one)
    sound = wall.seen & sure & (np.abs(residual) < rim)
    return _across_gaps(_without_edges(found, wall.seen, scale), sound, scale), unconfirmed


def _cells_of(
    height: Float32Array, unseen: BoolArray, seed: FloatArray, rim: FloatArray, scale: Scale
) -> list[BoolArray]:
    """Cells of every place of one sign: grown from its core, joined over shadows, split at saddles, large enough."""
    mask = height > rim
    core = mask & (height > seed)
    joined, _ = label_around(_grow(mask, unseen, scale))
    out: list[BoolArray] = []
    for i in np.unique(joined[core]):
        if i == 0:
            continue
        whole = joined == i
        long, wide = (np.count_nonzero((whole & mask).any(axis=1 - axis)) * scale.cell_mm[axis] for axis in (0, 1))
        # Of a band so short, rims and what they hide leave nothing to tell peaks by.
        is_band = long <= BAND_EDGES * scale.mm(scale.limits.edge_of_radius) and wide >= BAND_ASPECT * long
        pieces = (
            [whole]
            if is_band
            else _split(np.where(whole, height, np.float32(-np.inf)), mask, whole, rim, scale.limits.saddle)
        )
        for part in pieces:
            place = without_holes(part & mask)
            if _is_resolved(place & core, scale, 0.5) and _is_resolved(place, scale, 1.0):
                out.append(place)
    return out


def agreeing_observations(place: BoolArray, kind: Kind, wall: Wall, rim: FloatArray) -> int:
    """How many observations see a place: half of their points there depart its way, beyond the limit of its rim."""
    here = place.ravel()[wall.observations.cell]
    cell = wall.observations.cell[here]
    departure = wall.observations.radius_mm[here] - wall.shape_radius_mm().ravel()[cell]
    beyond = (departure if kind is Kind.LOSS else -departure) > rim.ravel()[cell]
    _, own = np.unique(wall.observations.number[here], return_inverse=True)
    points, agree = np.bincount(own), np.bincount(own, weights=beyond)
    return int(np.count_nonzero((points >= OBSERVATION_POINTS) & (agree >= 0.5 * points)))


def _grow(mask: BoolArray, unseen: BoolArray, scale: Scale) -> BoolArray:
    """The mask with the narrow gaps between its parts closed; gaps nobody saw may be wider."""
    gap = scale.mm(scale.limits.join_of_radius) / 2
    joined = closed(mask, *(max(1, round(gap / size)) for size in scale.cell_mm))
    reach = scale.mm(scale.limits.shadow_of_radius) / 2
    spread, free = joined, unseen | joined
    for _ in range(max(1, round(reach / min(scale.cell_mm)))):
        before, spread = spread, grown(spread, 1, 1) & free
        if (spread == before).all():  # so does it stay
            break
    return spread


def _is_resolved(place: BoolArray, scale: Scale, part: float) -> bool:
    """Whether a place is larger both ways, and in area, than what the method resolves."""
    size = part * scale.mm(scale.limits.size_of_radius)
    long = np.count_nonzero(place.any(axis=1)) * scale.cell_mm[0] >= size
    wide = np.count_nonzero(place.any(axis=0)) * scale.cell_mm[1] >= size
    return bool(long and wide and np.count_nonzero(place) * scale.cell_mm[0] * scale.cell_mm[1] >= 0.6 * size * size)


def _split(height: Float32Array, mask: BoolArray, whole: BoolArray, rim: FloatArray, saddle: float) -> list[BoolArray]:
    """One joined place cut into its peaks, where the way between two peaks falls below a part of the lesser one.

    Slices the place from the top; a peak that meets a higher one while still tall for itself is the same defect.
    Cells the slices never claim (skirts, shadows) go to the nearest peak.
    """
    filled = _fill_shadow(height, whole)
    values = filled[whole & mask]
    top, bottom = float(np.percentile(values, 99.5)), float(rim.min())
    if top <= bottom:
        return [whole]
    peaks: list[BoolArray] = []
    heights: list[float] = []
    smallest = max(6, int(0.02 * np.count_nonzero(whole & mask)))
    for level in np.linspace(top, bottom, LEVELS):
        label, n = label_around(whole & (filled >= level))
        for i in range(1, n + 1):
            part = label == i
            if np.count_nonzero(part) < smallest:
                continue
            inside = [k for k, peak in enumerate(peaks) if (peak & part).any()]
            if not inside:
                peaks.append(part)
                heights.append(float(level))
                continue
            tallest = max(inside, key=lambda k: heights[k])
            merged = [k for k in inside if k != tallest and level >= saddle * heights[k]]
            if len(inside) - len(merged) == 1:
                peaks[tallest] = part  # grows while it is alone
            for k in sorted(merged, reverse=True):
                del peaks[k], heights[k]
    if len(peaks) < 2:
        return [whole]
    return _share(whole, peaks)


def _fill_shadow(height: Float32Array, whole: BoolArray) -> Float32Array:
    """Heights with the unseen cells of the place at the height of their nearest seen neighbour."""
    a = height.shape[1]
    wide_height = np.pad(height, ((0, 0), (a // 4, a // 4)), mode="wrap")
    index = ndimage.distance_transform_edt(~np.isfinite(wide_height), return_distances=False, return_indices=True)
    nearest = wide_height[tuple(index)][:, a // 4 : a // 4 + a]
    return np.where(whole, np.where(np.isfinite(height), height, nearest), np.float32(-np.inf))


def _share(whole: BoolArray, peaks: Sequence[BoolArray]) -> list[BoolArray]:
    a = whole.shape[1]
    marked = np.zeros(whole.shape, dtype=np.int32)
    for k, peak in enumerate(peaks):
        marked[peak & (marked == 0)] = k + 1
    wide = np.pad(marked, ((0, 0), (a // 4, a // 4)), mode="wrap")
    index = ndimage.distance_transform_edt(wide == 0, return_distances=False, return_indices=True)
    nearest = wide[tuple(index)][:, a // 4 : a // 4 + a]
    return [whole & (nearest == k + 1) for k in range(len(peaks))]


def _without_edges(parts: Sequence[Indication], seen: BoolArray, scale: Scale) -> list[Indication]:
    """Drops or joins places that only line the rim of a larger one or of its shadow.

    There a slit is half lit or bent and its centre is drawn aside. A real place stands in sound wall: at least half of
    what surrounds it. What is hemmed in by a larger place and by what that one hides is part of it, or, of the opposite
    sign, an artefact of its edge. The smallest go first.
    """
    near = max(2, round(scale.mm(scale.limits.size_of_radius) / max(scale.cell_mm)))
    far = max(near, round(RIPPLE_EDGES * scale.mm(scale.limits.edge_of_radius) / max(scale.cell_mm)))
    left = sorted(parts, key=lambda part: np.count_nonzero(part.mask))
    kept: list[Indication] = []
    while left:
        small, left = left[0], left[1:]
        halo = small.mask
        for _ in range(near):
            halo = grown(halo, 1, 1)
        around = halo
        for _ in range(far - near):
            around = grown(around, 1, 1)
        halo = halo & ~small.mask
        touching = [k for k, large in enumerate(left) if (large.mask & around).any()]
        larger = np.zeros_like(halo)
        for k in touching:
            larger |= left[k].mask
        sound = float((halo & seen & ~larger).sum()) / max(float(halo.sum()), 1.0)
        host = max(touching, key=lambda k: np.count_nonzero(left[k].mask & around), default=None)
        if host is None or (sound >= 0.5 and not _is_ripple(small, left[host], scale)):
            kept.append(small)
        elif left[host].kind is small.kind:
            left[host] = replace(small, mask=left[host].mask | small.mask)
    return kept


def _across_gaps(places: Sequence[Indication], sound: BoolArray, scale: Scale) -> list[Indication]:
    """Joins places of a kind side by side when what lies between them round the pipe is hardly anywhere sound wall.

    A shallow band that crosses a rod's shadow, or whose floor its own rim hides here and there, is one defect.
    """
    widest = round(scale.mm(scale.limits.gap_of_radius) / scale.cell_mm[1])
    left = list(places)
    joined = True
    while joined:
        joined = False
        for i, one in enumerate(left):
            for k, other in enumerate(left):
                if k != i and one.kind is other.kind and _is_one_band(one, other, sound, widest):
                    left[i] = replace(one, mask=one.mask | other.mask, height=np.maximum(one.height, other.height))
                    del left[k]
                    joined = True
                    break
            if joined:
                break
    return left


def _is_one_band(one: Indication, other: Indication, sound: BoolArray, widest: int) -> bool:
    """Whether `other` follows `one` clockwise in much the same stations with no sound wall between."""
    rows = [np.flatnonzero(place.mask.any(axis=1)) for place in (one, other)]
    first, last = max(rows[0][0], rows[1][0]), min(rows[0][-1], rows[1][-1])
    if last - first + 1 < BAND_OVERLAP * max(*(int(row[-1] - row[0]) for row in rows), 1):
        return False
    size = sound.shape[1]
    start, arc = arc_of(np.asarray(one.mask.any(axis=0)), 1.0)
    next_start, next_arc = arc_of(np.asarray(other.mask.any(axis=0)), 1.0)
    gap = int(next_start - start - arc) % size
    if gap > widest or min(arc, next_arc) < max(gap, 1):
        return False
    if gap == 0:
        return False  # touching: the saddle between their peaks has been looked at
    columns = (int(start + arc) + np.arange(gap)) % size
    return bool(sound[first : last + 1, columns].mean() < BAND_SOUND)


def _is_ripple(small: Indication, large: Indication, scale: Scale) -> bool:
    """Whether a place is the swing to the other side that a step leaves within a slit's width of its edge."""
    short = np.count_nonzero(small.mask.any(axis=1)) * scale.cell_mm[0] <= RIPPLE_EDGES * scale.mm(
        scale.limits.edge_of_radius
    )
    return bool(short and small.kind is not large.kind and depth_of(small, scale).mm < 0.6 * depth_of(large, scale).mm)


class Depth(NamedTuple):
    """Depth of a place, whether its floor or crest was seen, in which cells it shows, whether that floor is flat, and
    whether many cells say so together, a floor's or a crest's, or but the highest."""

    mm: float
    floor_seen: bool
    cells: BoolArray
    flat: bool
    fitted: bool


def depth_of(place: Indication, scale: Scale, crests: Float32Array | None = None) -> Depth:
    """How deep a place is where the surface is calm.

    Within a slit's width of a step the measured radius overshoots, so only cells count about which (5 x 3 cells) the
    height changes by less than a third of itself: a floor, a crest. Where a tenth of the place is not calm its floor
    was not seen; then all cells count.

    A floor is as deep as its middle, cells weighed by what they may be off: what is left beside a step is deeper, seen
    by one ring, and says itself how little it knows. Elsewhere the highest of many cells is high by its noise, too; so
    it is the middle of all within PLATEAU_NOISE standard deviations of the highest (the 98th percentile). The top of a
    crest is fitted, once it is known to be one, to the heights `crests` (Z, A) where there are others for it.
    """
    wide = np.pad(place.height, ((0, 0), (1, 1)), mode="wrap")
    missing = ~np.isfinite(wide)
    high = ndimage.maximum_filter(np.where(missing, -np.inf, wide), size=(5, 3), mode="nearest")[:, 1:-1]
    low = ndimage.minimum_filter(np.where(missing, np.inf, wide), size=(5, 3), mode="nearest")[:, 1:-1]
    measured = place.mask & np.isfinite(place.height)
    calm = measured.copy()
    calm[measured] = high[measured] - low[measured] < place.height[measured] / 3
    floor_seen = np.count_nonzero(calm) >= max(4, 0.1 * np.count_nonzero(measured))
    cells = calm if floor_seen else measured
    floor = _floor(place, cells, scale) if floor_seen else None
    if floor is not None:
        return Depth(floor, True, cells, True, True)
    values = place.height[cells]
    highest = float(np.percentile(values, 98)) if len(values) >= 50 else float(np.sort(values)[-2:].mean())
    plateau = PLATEAU_NOISE * float(np.median(place.noise[cells]))
    upper = measured & (place.height >= 0.5 * highest)
    crest = _crest(place, upper, highest, scale)
    if crest is not None:
        sharper = None if crests is None else _crest(replace(place, height=crests), upper, highest, scale)
        return Depth(crest if sharper is None else sharper, bool(floor_seen), cells, False, True)
    return Depth(float(np.median(values[values >= highest - plateau])), bool(floor_seen), cells, False, False)


def _crest(place: Indication, cells: BoolArray, highest: float, scale: Scale) -> float | None:
    """Top of the paraboloid through the upper half of a place; None where its cells do not lie on one."""
    row, column = np.nonzero(cells)
    if len(row) < 12:
        return None
    start, _ = arc_of(np.asarray(cells.any(axis=0)), 1.0)
    size = scale.mm(1.0)
    z, s = row * scale.cell_mm[0] / size, ((column - start) % cells.shape[1]) * scale.cell_mm[1] / size
    z, s = z - z.mean(), s - s.mean()
    terms = np.stack([np.ones_like(z), z, s, z * z, s * s, z * s], axis=1)
    height = place.height[cells].astype(np.float64)
    weight = 1.0 / place.sigma[cells].astype(np.float64)
    for _ in range(4):  # rings that err more than they say are let go
        fit, *_ = np.linalg.lstsq(terms * weight[:, None], height * weight, rcond=None)
        off = height - terms @ fit
        scatter = SIGMA_OF_MAD * float(np.median(np.abs(off)))
        weight = 1.0 / place.sigma[cells] / (1.0 + (off / max(2.0 * scatter, 1e-6)) ** 2)
    if fit[3] >= 0 or fit[4] >= 0 or scatter > CREST_SCATTER * highest:
        return None
    top = float((terms @ fit).max())
    return top if abs(top - highest) <= 0.3 * highest else None


def _floor(place: Indication, cells: BoolArray, scale: Scale) -> float | None:
    """How deep a flat floor is; None where there is none: where cells do not agree, or a pit in it is surely deeper."""
    height, weight, noise = place.height[cells], 1.0 / place.sigma[cells], float(np.median(place.noise[cells]))
    order = np.argsort(height)
    sums = np.cumsum(weight[order])
    middle = float(height[order][np.searchsorted(sums, 0.5 * sums[-1])])
    if weight[np.abs(height - middle) <= noise].sum() < FLOOR_AGREES * sums[-1]:
        return None
    pits, n = label_around(cells & (place.height - 2.0 * place.sigma > middle + PLATEAU_NOISE / 2 * noise))
    return None if any(_is_resolved(pits == i, scale, 1.0) for i in range(1, n + 1)) else middle
