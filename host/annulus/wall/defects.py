"""The defect list: every indication measured, with its uncertainty, and stretches that are out of round."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from annulus.numeric.arrays import BoolArray, FloatArray, arc_of
from annulus.numeric.rounding import clock_face
from annulus.wall.extent import with_shadow, without_scraps
from annulus.wall.grid import Wall, smooth
from annulus.wall.grooves import groove_floor
from annulus.wall.indications import (
    BAND_ASPECT,
    BAND_EDGES,
    Indication,
    Kind,
    LabelArray,
    Limits,
    Scale,
    depth_of,
    find_indications,
    without_holes,
)
from annulus.wall.points import Points
from annulus.wall.stations import shape_ovality, swing_k2_mm

__all__ = ["Defect", "Detection", "Kind", "Limits", "clock_face", "find_defects"]

# Held as a whole by test_grid.py and the benchmark topic mirror; not tried one by one.
ALL_ROUND_DEG = 345.0  # an arc longer than this goes all round ..
MOST_ROUND_DEG = 270.0  # .. or one longer than this with sound wall in no more directions than that leaves
UNSURE = 0.6  # part of a depth: a place whose k = 2 uncertainty is larger is not known to be a defect
DEEP = 0.8  # part of its depth: the cells of a place that show how deep it is
# A place that is not known to be a defect, but so large, and seen by so many rings of so many frames, is told of.
LARGE_OF_RADIUS, LOOKS = 0.1, 8  # side of a square of its area, part of the radius; observations with points in it
WIDE_ENOUGH = 0.15  # part of its widest row: a row of a place that counts for its length


@dataclass(frozen=True, slots=True)
class Defect:
    """One line of the defect list. Positions are the middle of the extent; angles clockwise from 12 o'clock.

    depth_mm is never negative: how far the wall departs outwards (loss) or inwards (bump); for ovality the greater
    departure of a diameter from the mean diameter. clock_deg of an ovality is its long axis. Where floor_seen
    is False the bottom of a loss (or a bump's crest) lies in shadow or is too small, and depth_mm is a lower limit.
    depth_k2_mm is its expanded uncertainty, k = 2 (about 95 %); NaN where the points say nothing of theirs.
    shadowed_mm is how much of length_mm, typically, nobody saw: a rim or a crest keeps the light away (Eq. 3.24).
    """

    kind: Kind
    z_mm: float
    clock_deg: float
    length_mm: float
    arc_deg: float
    depth_mm: float
    area_mm2: float
    floor_seen: bool = True
    depth_k2_mm: float = math.nan
    shadowed_mm: float = 0.0

    @property
    def clock(self) -> str:
        return clock_face(self.clock_deg)

    @property
    def is_all_round(self) -> bool:
        """A loss all round is a groove, a bump a ridge."""
        return self.kind is not Kind.OVALITY and self.arc_deg >= ALL_ROUND_DEG

    @property
    def z_range_mm(self) -> tuple[float, float]:
        return self.z_mm - self.length_mm / 2, self.z_mm + self.length_mm / 2

    @property
    def clock_range(self) -> tuple[str, str]:
        """PACP's from-to, clockwise; the whole circle is 12:00 to 12:00."""
        if self.arc_deg >= ALL_ROUND_DEG:
            return "12:00", "12:00"
        return clock_face(self.clock_deg - self.arc_deg / 2), clock_face(self.clock_deg + self.arc_deg / 2)


@dataclass(frozen=True, slots=True)
class Detection:
    """Defects in order of distance, and which cell of the wall's grid belongs to which (0 none, i + 1 defects[i];
    what a defect hides is part of it).

    undecided : places that stand out, large and looked at many times, but less surely than a defect must: no claim that
    there is one, and none that there is not. unconfirmed_mm : where along the pipe are more that only one look or a few
    speak for.
    """

    defects: tuple[Defect, ...]
    label: LabelArray
    limits: Limits
    unconfirmed_mm: tuple[float, ...] = ()
    undecided: tuple[Defect, ...] = ()

    @property
    def unconfirmed(self) -> int:
        """How many they are."""
        return len(self.unconfirmed_mm)


def find_defects(
    wall: Wall,
    *,
    shadow_ratio: float,
    least_shadow_ratio: float | None = None,
    limits: Limits | None = None,
    features: BoolArray | None = None,
    points: Callable[[], Points] | None = None,
) -> Detection:
    """Losses, bumps and out-of-round stretches of the wall.

    Parameters
    ----------
    wall : the grid with its shape and noise.
    shadow_ratio : length hidden behind a step over the step's height, cot of the smallest ring half-angle
        (Alzuhiri 2022, Eq. 3.24). least_shadow_ratio : the same for the largest one; shadow_ratio if not given.
    limits : what counts; the defaults hold for any pipe.
    features : (Z, A) cells that a joint, an opening or the like explains; no defect is looked for there.
    points : gives the wall's, asked only where there is a groove, to tell its floor from its rims; without them its
        cells must do.

    Notes
    -----
    What lies unseen between two parts of one kind joins them; how much of what lies unseen just before a loss or behind
    a bump belongs to it, extent.py says. A place with a flat floor ends half-way up its walls, which a slit blurs as
    far in as out; any other where it departs by a quarter of its depth.
    """
    scale = Scale.of(wall, limits or Limits())
    limits = scale.limits
    unseen = ~wall.seen
    found: list[tuple[Defect, BoolArray]] = []
    undecided: list[Defect] = []
    indications, unconfirmed = find_indications(wall, scale, features)
    measured = wall.weighed_residual_mm()
    fine = smooth(measured)
    # a median over more than two slits' widths along the pipe takes the top off a crest
    coarse = 3 * wall.z_step_mm > 2 * scale.mm(limits.edge_of_radius)
    crests = smooth(measured, 1) if coarse else None
    for indication in indications:
        known, way = np.isfinite(indication.height), np.float32(1 if indication.kind is Kind.LOSS else -1)
        one = replace(indication, height=np.where(known, way * fine, np.float32(-np.inf)))
        depth, floor_seen, cells, flat = depth_of(one, scale, None if crests is None else way * crests)
        edge = (limits.extent_of_floor if flat else limits.extent_of_depth) * depth
        sound = known & (indication.height < limits.extent_of_depth * depth)
        core = without_scraps(without_holes(one.mask & (indication.height >= edge)), sound)
        deepest = depth if floor_seen else scale.mm(limits.unseen_depth_of_radius)
        ratios = (shadow_ratio if least_shadow_ratio is None else least_shadow_ratio, shadow_ratio)
        whole = with_shadow(replace(one, mask=core), unseen, ratios, scale, deepest)
        dark = (whole & unseen).sum(axis=0)[whole.any(axis=0)] * wall.z_step_mm
        footprint = [max(1, round(scale.mm(limits.edge_of_radius) / size)) for size in scale.cell_mm]
        form = max(depth - _over_footprint(one, cells, footprint), 0.0)
        k2 = math.hypot(_expanded(wall, cells & (one.height >= DEEP * depth)), 2.0 * form)
        position = _extent(whole, sound, wall)
        area = float(np.count_nonzero(whole) * scale.cell_mm[0] * scale.cell_mm[1])
        defect = Defect(one.kind, *position, depth, area, floor_seen, k2, float(np.median(dark)))
        if points is not None and _is_groove(defect, scale):
            floor = groove_floor(wall, points(), defect.z_range_mm, defect.clock_deg, defect.arc_deg, depth)
            if floor is not None:
                depth, k2 = floor
                defect = replace(defect, depth_mm=depth, depth_k2_mm=k2, floor_seen=True)
        if not k2 > UNSURE * depth:  # nor where nobody says
            found.append((defect, whole))
        elif area >= scale.mm(LARGE_OF_RADIUS) ** 2 and _looks(core, wall) >= LOOKS:
            undecided.append(defect)
        else:
            unconfirmed.append(defect.z_mm)
    oval, unsure = _oval_stretches(wall, limits)
    found += [(defect, np.zeros(unseen.shape, dtype=bool)) for defect in oval]
    undecided = sorted([*undecided, *unsure], key=lambda one: (one.z_mm, one.clock_deg))
    found.sort(key=lambda item: (item[0].z_mm, item[0].clock_deg))
    label = np.zeros(unseen.shape, dtype=np.int32)
    for i, (_, place) in enumerate(found):
        label[place] = i + 1
    return Detection(tuple(defect for defect, _ in found), label, limits, tuple(unconfirmed), tuple(undecided))


def _is_groove(one: Defect, scale: Scale) -> bool:
    """All round, or so short along the pipe that a slit hardly fits in, and many times as long across it."""
    if one.kind is not Kind.LOSS:
        return False
    short = one.length_mm <= BAND_EDGES * scale.mm(scale.limits.edge_of_radius)
    return one.is_all_round or (short and math.radians(one.arc_deg) * scale.radius_mm >= BAND_ASPECT * one.length_mm)


def _looks(place: BoolArray, wall: Wall) -> int:
    """How many observations have a point in a place."""
    return len(np.unique(wall.observations.number[place.ravel()[wall.observations.cell]]))


def _over_footprint(place: Indication, cells: BoolArray, footprint: Sequence[int]) -> float:
    """The greatest mean departure over what one slit covers, around any of the cells: what is deeper is finer than the
    method resolves, be it a crest or the swing beside a step."""
    known = np.isfinite(place.height)
    across = footprint[1] // 2 + 1

    def mean(field: FloatArray) -> FloatArray:
        wide = np.pad(field, ((0, 0), (across, across)), mode="wrap")
        return np.asarray(ndimage.uniform_filter(wide, footprint, mode="constant")[:, across:-across])

    seen = mean(known.astype(np.float64))
    value = mean(np.where(known, place.height, 0.0).astype(np.float64)) / np.maximum(seen, 1e-9)
    return float(value[cells & (seen > 0.5)].max(initial=0.0)) if (cells & (seen > 0.5)).any() else 0.0


def _expanded(wall: Wall, cells: BoolArray) -> float:
    """k = 2 uncertainty of a departure from the shape that some cells show: what their points may be off, which does
    not average away, the noise of a cell, for the deepest of noisy cells lie deeper than the wall, and the shape's."""
    stated = cells & np.isfinite(wall.sigma_mm)
    if not stated.any():
        return math.nan
    parts = wall.sigma_mm, wall.cell_noise_mm, wall.shape_sigma_mm()
    return 2.0 * math.hypot(*(float(np.median(part[stated])) for part in parts))


def _extent(whole: BoolArray, sound: BoolArray, wall: Wall) -> tuple[float, float, float, float]:
    """z_mm, clock_deg, length_mm and arc_deg of the cells of a defect; it goes all round where hardly a direction in
    its stations shows sound wall, however many a rod or its own rim hides."""
    wide = whole.sum(axis=1)
    rows = np.flatnonzero(wide >= WIDE_ENOUGH * wide.max())
    z0, z1 = wall.z_mm[rows[0]] - wall.z_step_mm / 2, wall.z_mm[rows[-1]] + wall.z_step_mm / 2
    start, arc = arc_of(np.asarray(whole.any(axis=0)), wall.clock_step_deg)
    middle = wide >= 0.5 * wide.max()
    against = sound[middle].sum(axis=0) > 0.5 * middle.sum()
    round_deg = 360.0 - wall.clock_step_deg * np.count_nonzero(against & ~whole.any(axis=0))
    if arc >= ALL_ROUND_DEG or (arc >= MOST_ROUND_DEG and round_deg >= ALL_ROUND_DEG):
        arc = 360.0  # what is left is a rod's shadow
    clock = (start + arc / 2) % 360.0 if arc < 360.0 else 0.0
    return float(z0 + z1) / 2, clock, float(z1 - z0), arc


def _oval_stretches(wall: Wall, limits: Limits) -> tuple[list[Defect], list[Defect]]:
    """Stretches whose fitted shape exceeds the limit, as far as it exceeds 70 % of it; short ones are passed over.
    Those that are not surely known to be out of round come second."""
    percent = shape_ovality(wall)
    swing = 2.0 * np.hypot(wall.shape_mm[:, 3], wall.shape_mm[:, 4])  # of a diameter
    label, n = ndimage.label(np.nan_to_num(percent) > 0.7 * limits.ovality_percent)
    k2s = swing_k2_mm(wall) if n else np.zeros(0)
    out: list[Defect] = []
    unsure: list[Defect] = []
    for i in range(1, n + 1):
        rows = np.flatnonzero(label == i)
        length = len(rows) * wall.z_step_mm
        if (
            percent[rows].max() <= limits.ovality_percent
            or length < limits.ovality_length_of_radius * wall.mean_radius_mm
        ):
            continue
        # where a groove or a step drags the shape about, it is known badly, and looks more oval than the pipe is
        k2 = k2s[rows]
        worst = int(np.argmax(swing[rows] - np.nan_to_num(k2)))
        mean, _, _, even, odd = wall.shape_mm[rows[worst]]
        long_axis = np.degrees(np.arctan2(odd, even)) / 2 % 180.0
        depth, z = float(swing[rows[worst]]), float(wall.z_mm[rows].mean())
        area = 2 * np.pi * float(mean) * length
        one = Defect(Kind.OVALITY, z, float(long_axis), length, 360.0, depth, area, True, float(k2[worst]))
        (unsure if k2[worst] > UNSURE * depth else out).append(one)
    return out, unsure
