"""How far a place reaches: what it hides from a sensor that looks along +z is part of it, as far as its rims tell."""

import math

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.wall.indications import Indication, Kind, Scale
from annulus_pipe.wall.patches import label_around, opened

IntArray = NDArray[np.intp]
# Held by test_extent.py (both ways) and the lengths of the benchmark `scenes`.
SCRAP = 0.15  # of the largest of a place's connected parts: a smaller one is a scrap of it, and is left out where ..
SCRAP_SOUND = 0.35  # .. more than this part of what lies between is sound
RIM_COLUMNS = 4  # each side: a rim is as straight as the middle of its neighbours


def without_scraps(core: BoolArray, sound: BoolArray) -> BoolArray:
    """A place without what is small beside it and lies before or behind it across sound wall: wrong points in its
    shadow. What nobody saw between two parts parts nothing."""
    label, n = label_around(core)
    size = np.bincount(label.ravel(), minlength=n + 1)
    size[0] = 0
    kept = np.asarray((size >= SCRAP * size.max())[label] & core)
    rows = np.arange(len(core))[:, None]
    begin, end = (np.where(kept.any(axis=0), side(kept), -1) for side in (_first, _last))
    for i in np.flatnonzero((size > 0) & (size < SCRAP * size.max())):
        part = label == i
        beside = part.any(axis=0) & (begin >= 0)
        low, high = np.minimum(_last(part), end), np.maximum(_first(part), begin)
        between = (rows > low) & (rows < high) & beside
        if np.count_nonzero(between & sound) <= SCRAP_SOUND * np.count_nonzero(between):
            kept |= part
    return kept


def _first(mask: BoolArray) -> IntArray:
    return np.asarray(mask.argmax(axis=0))


def _last(mask: BoolArray) -> IntArray:
    return np.asarray(len(mask) - 1 - mask[::-1].argmax(axis=0))


def goes_on(place: BoolArray, dark: BoolArray, scale: Scale) -> BoolArray:
    """(Z, A) cells beside a place in which it may go on: dark ones, where they line it over the smallest defect."""
    beside = scale.around(place, scale.mm(scale.limits.join_of_radius)) & dark & ~place
    long = np.count_nonzero(beside.any(axis=1)) * scale.cell_mm[0]
    return beside if long >= scale.mm(scale.limits.size_of_radius) else np.zeros_like(beside)


def as_large(mask: BoolArray, scale: Scale) -> BoolArray:
    """What of a mask is as large as the smallest defect, both ways."""
    rows, columns = (max(1, math.ceil(scale.mm(scale.limits.size_of_radius) / size)) for size in scale.cell_mm)
    wide = np.pad(mask, ((columns, columns), (0, 0)), mode="edge")
    return opened(wide, rows, columns)[columns:-columns]


def with_shadow(
    place: Indication, unseen: BoolArray, shadow_ratios: tuple[float, float], scale: Scale, deepest_mm: float
) -> BoolArray:
    """The place with what it hides.

    shadow_ratios : length hidden behind a step over its height, for the widest and the narrowest ring. deepest_mm : how
    deep a loss may be. Its measured height when its floor was seen; more when only its far edge was.
    """
    whole = place.mask.copy()
    columns = np.flatnonzero(whole.any(axis=0))
    for column in columns:  # what lies unseen between two parts of it belongs to it
        rows = np.flatnonzero(place.mask[:, column])
        whole[rows[0] : rows[-1], column] |= unseen[rows[0] : rows[-1], column]
    if place.kind is Kind.LOSS:
        _before(whole, place, unseen, shadow_ratios, scale, deepest_mm)
    else:
        _behind(whole, place, unseen)
    return whole


def _before(
    whole: BoolArray, place: Indication, unseen: BoolArray, ratios: tuple[float, float], scale: Scale, deepest_mm: float
) -> None:
    """A loss begins where its near rim stands in the light of its floor.

    A slit has a width: wall is seen up to half of it before the rim, whatever the depth. That place is taken, but the
    widest ring that reaches the floor comes over the rim, so the rim lies at least that ring's shadow before it. What
    is unseen over more than the narrowest ring's shadow, a slit's width and a gap between frames is no shadow of this
    rim alone (a rod, the end of the scan): there the rim is where its neighbours have it, or where shadows of rings in
    between would put it.
    """
    step, slit = scale.cell_mm[0], scale.mm(scale.limits.edge_of_radius)
    columns = np.flatnonzero(whole.any(axis=0))
    first = np.array([np.flatnonzero(whole[:, column])[0] for column in columns])
    depth = np.maximum(
        [place.height[whole[:, column] & place.mask[:, column], column].max() for column in columns], 0.0
    )
    before = np.zeros(len(columns))
    lost = np.zeros(len(columns), dtype=bool)
    for i, column in enumerate(columns):
        reach = math.ceil((max(depth[i], deepest_mm) * ratios[1] + 2.0 * slit) / step)
        run = unseen[max(0, first[i] - reach) : first[i], column][::-1]
        lost[i] = len(run) > 0 and bool(run.all())
        gap = len(run) if lost[i] else int(np.argmin(run)) if len(run) else 0
        lit = depth[i] * ratios[0] / step
        before[i] = min(max(gap - slit / 2 / step, lit), gap)
        if lost[i]:
            before[i] = min((depth[i] * (ratios[0] + ratios[1]) / 2 + slit / 2) / step, gap)
    rim = np.where(lost & ~lost.all(), np.nan, first - before)
    rim = _straight(rim, columns.astype(np.float64), whole.shape[1])
    for i, column in enumerate(columns):
        hidden = slice(max(round(float(min(rim[i], first[i]))), 0), first[i])
        run = unseen[hidden, column][::-1]
        whole[first[i] - (len(run) if run.all() else int(np.argmin(run))) : first[i], column] = True


def _straight(rim: FloatArray, columns: FloatArray, around: int) -> FloatArray:
    """The middle of every column's rim and its neighbours', NaN aside; of all where none is near."""
    apart = np.abs((columns[:, None] - columns[None, :] + around // 2) % around - around // 2)
    near = np.where(apart <= RIM_COLUMNS, rim[None, :], np.nan)
    known = np.isfinite(near).any(axis=1)
    out = np.full(len(rim), np.nanmedian(rim))
    out[known] = np.nanmedian(near[known], axis=1)
    return out


def _behind(whole: BoolArray, place: Indication, unseen: BoolArray) -> None:
    """What lies unseen just behind a bump is its shadow, taken as far as the bump is long before its crest."""
    if place.height[place.mask].max() <= 0.0:  # weighed by what its points may be off nothing stands out
        return
    crest = np.flatnonzero((place.mask & (place.height >= 0.9 * place.height[place.mask].max())).any(axis=1)).mean()
    mirrored = round(2 * crest) - int(np.flatnonzero(place.mask.any(axis=1))[0])
    for column in np.flatnonzero(place.mask.any(axis=0)):
        last = int(np.flatnonzero(place.mask[:, column])[-1])
        behind = unseen[last + 1 : max(mirrored, last) + 1, column]
        hidden = int(np.argmin(behind)) if not behind.all() else len(behind)
        whole[last + 1 : last + 1 + hidden, column] = True
