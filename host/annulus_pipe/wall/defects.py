"""The defect list: every indication measured, with its uncertainty, and stretches that are out of round."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, LabelArray, arc_of
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.rounding import clock_face
from annulus_pipe.wall.chords import turn_from
from annulus_pipe.wall.extent import as_large, with_shadow, without_scraps
from annulus_pipe.wall.grid import Wall, smooth
from annulus_pipe.wall.grooves import groove_floor
from annulus_pipe.wall.indications import (
    BAND_ASPECT,
    BAND_EDGES,
    CORNERS,
    OBSERVATION_POINTS,
    Indication,
    Kind,
    Limits,
    Scale,
    depth_of,
    find_indications,
)
from annulus_pipe.wall.levels import OFF_DEG
from annulus_pipe.wall.patches import without_holes
from annulus_pipe.wall.points import WallPoints
from annulus_pipe.wall.shadow import shadowed
from annulus_pipe.wall.standing import (
    END_WHY,
    FEW,
    HOLLOW_WHY,
    LEVEL_WHY,
    NOISE_WHY,
    ROUND_WHY,
    SHALLOW_WHY,
    TALL_WHY,
    THROUGH_WHY,
    UNSURE_WHY,
    depth_limit_mm,
    left_standing,
)
from annulus_pipe.wall.stations import shape_ovality, swing_k2_mm

__all__ = ["Defect", "Detection", "Kind", "Limits", "clock_face", "find_defects"]

# Held as a whole by test_grid.py and the benchmark topic mirror; not tried one by one.
ALL_ROUND_DEG = 345.0  # an arc longer than this goes all round ..
MOST_ROUND_DEG = 270.0  # .. or one longer than this with sound wall in no more directions than that leaves
UNSURE = 0.6  # part of a depth: a place whose k = 2 uncertainty is larger is not known to be a defect
# A level is a chord: its depth says how wide it is. Of what its arc was seen as, corners lost: nine levels of the blind
# bench 0.88 to 0.96.
CHORD_LEAST = 0.83  # domes at the bottom reach 0.59 to 0.79
CHORD_MOST = 1.08  # dents begin at 1.25
CHORD_LONG = 0.5  # of the radius: levels are 0.7 long and more
# What has a name stands by itself in sound wall, and its outline was seen. Set on blind seeds 1 and 3: of 200 losses
# and bumps that were there six had less sound wall round the pipe, all pieces of grooves, and of 29 that were joints,
# gaps or nothing 16; the outlines of all bumps but one were seen over more than half, of two tees' rims over 0.36.
ALONE = 0.5  # part of the rest of the circle, in its stations: less sound wall, and it may go all round
ALONE_LONG = 0.3  # of the radius: what is longer is no joint's
ASIDE_DEG = 3.0  # of its own edge, which is no rest of the circle
HIDDEN = 0.25  # part of the scan elsewhere in which a direction was seen: less, and a rod hides it
THIN_OF_RADIUS = 0.077  # walls of pipes that bear a load: SDR 26, a 26th of the diameter; of the radius
LIGHT_LOST = 0.25  # part of a loss's outline that is dark and no rim's shadow: as much, and light went through
OUTLINE_SEEN = 0.5  # part of a bump's outline that was seen: less, and it may be a rim about what was not seen
DEEP = 0.8  # part of its depth: the cells of a place that show how deep it is
BORDERING = 0.6  # part of those cells that border on unknown wall: more, and what is deepest may lie where nobody saw
MANY = 6  # places near each other where only rings differ: more of them share one line of the report
CUT_OFF = 0.5  # part of a side of them that is lined by what was not seen: as much, and the floor may go on there
AGREED_OF = 0.1  # part of a look's points in a place: the deepest so many are noise
WIDE_ENOUGH = 0.15  # part of its widest row: a row of a place that counts for its length


@dataclass(frozen=True, slots=True)
class Defect:
    """One line of the defect list. Positions are the middle of the extent; angles clockwise from 12 o'clock.

    depth_mm is never negative: how far the wall departs outwards (loss) or inwards (bump); for ovality the greater
    departure of a diameter from the mean diameter. clock_deg of an ovality is its long axis. Where floor_seen
    is False the bottom of a loss (or a bump's crest) lies in shadow or is too small, and depth_mm is a lower limit.
    depth_k2_mm is its expanded uncertainty, k = 2 (about 95 %); NaN where the points say nothing of theirs.
    shadowed_mm is how much of length_mm, typically, nobody saw: a rim or a crest keeps the light away (Eq. 3.24).
    why is said of an undecided place only: for what reason it is not surely a defect.
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
    why: str = ""

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

    undecided : all else that stands out over the limits, less surely than a defect must, each with why: no claim that
    there is one, and none that there is not.
    """

    defects: tuple[Defect, ...]
    label: LabelArray
    limits: Limits
    undecided: tuple[Defect, ...] = ()


def find_defects(
    wall: Wall,
    *,
    shadow_ratio: float,
    least_shadow_ratio: float | None = None,
    limits: Limits | None = None,
    features: BoolArray | None = None,
    joints: BoolArray | None = None,
    points: Callable[[], WallPoints] | None = None,
) -> Detection:
    """Losses, bumps and out-of-round stretches of the wall.

    Parameters
    ----------
    wall : the grid with its shape and noise.
    shadow_ratio : length hidden behind a step over the step's height, cot of the smallest ring half-angle
        (Alzuhiri 2022, Eq. 3.24). least_shadow_ratio : the same for the largest one; shadow_ratio if not given.
    limits : what counts; the defaults hold for any pipe.
    features : (Z, A) cells that a joint, an opening or the like explains; no defect is looked for there. joints : (Z,)
        rows of joints; what stands out of them is undecided.
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
    ratios = (shadow_ratio if least_shadow_ratio is None else least_shadow_ratio, shadow_ratio)
    measured = wall.weighed_residual_mm()
    fine = smooth(measured)
    # a median over more than two slits' widths along the pipe takes the top off a crest
    coarse = 3 * wall.z_step_mm > 2 * scale.mm(limits.edge_of_radius)
    crests = smooth(measured, 1) if coarse else None
    dark = as_large(~wall.seen, scale) & ~shadowed(wall.radius_mm.astype(np.float64), wall.z_step_mm, 1 / shadow_ratio)
    if joints is not None:  # what comes back from there is the joint's
        dark |= joints[:, None]
    found: list[tuple[Defect, BoolArray]] = []
    doubted: list[tuple[Defect, BoolArray]] = []
    indications, few = find_indications(wall, scale, features)
    # what was filled in between two lips is no wall
    sound = wall.seen & (wall.count > 0) & (np.abs(wall.residual_mm()) < scale.seed_and_rim(wall)[1])
    standing = sum((one.mask.astype(np.intp) for one in indications), np.zeros(sound.shape, np.intp))
    for i, indication in enumerate((*indications, *few)):
        known, way = np.isfinite(indication.height), np.float32(1 if indication.kind is Kind.LOSS else -1)
        one = replace(indication, height=np.where(known, way * fine, np.float32(-np.inf)))
        crest = None if crests is None else way * crests
        defect, whole = _measured(indication, one, wall, scale, ratios, dark, crest, points)
        if i >= len(indications) or defect.why:
            doubted.append((replace(defect, why=FEW), whole))
        elif _only_at_an_end(indication.mask, scale):
            doubted.append((replace(defect, why=END_WHY), whole))
        elif why := _nameless(defect, indication.mask, wall, sound, standing > indication.mask, dark):
            doubted.append((replace(defect, why=why), whole))
        elif defect.depth_k2_mm > UNSURE * defect.depth_mm:  # nor where nobody says
            doubted.append((replace(defect, why=UNSURE_WHY), whole))
        else:
            found.append((defect, whole))
    listed = []
    for defect, whole in (*found, *doubted):  # as far as its line says
        first, last = defect.z_range_mm
        listed.append((defect.depth_mm, whole & ((wall.z_mm > first) & (wall.z_mm < last))[:, None]))
    for one, why in left_standing(wall, scale, listed, features, joints):
        defect, whole = _measured(one, one, wall, scale, ratios, dark, None, None)
        if why != SHALLOW_WHY or _may_reach(defect, depth_limit_mm(wall, scale)):
            doubted.append((replace(defect, why=why), whole))
    doubted = _folded(doubted, wall, scale)
    oval, unsure = _oval_stretches(wall, limits)
    found += [(defect, np.zeros(wall.seen.shape, dtype=bool)) for defect in oval]
    undecided = sorted([*(defect for defect, _ in doubted), *unsure], key=lambda one: (one.z_mm, one.clock_deg))
    found.sort(key=lambda item: (item[0].z_mm, item[0].clock_deg))
    label = np.zeros(wall.seen.shape, dtype=np.int32)
    for i, (_, place) in enumerate(found):
        label[place] = i + 1
    return Detection(tuple(defect for defect, _ in found), label, limits, tuple(undecided))


def _nameless(
    defect: Defect, place: BoolArray, wall: Wall, sound: BoolArray, others: BoolArray, dark: BoolArray
) -> str:
    """Why a place that surely stands out is not surely what its kind says; nothing where it is. place : (Z, A) what was
    seen of it. sound : (Z, A) wall. others : (Z, A) places beside it; what lies between tells whether they are one.
    dark : (Z, A) what was not seen and no rim's shadow explains."""
    first, last = defect.z_range_mm
    inside = (wall.z_mm > first) & (wall.z_mm < last)
    rows = inside & place.any(axis=1)
    away = np.abs(turn_from(wall.clock_deg, defect.clock_deg))
    if not defect.is_all_round and defect.length_mm <= ALONE_LONG * wall.mean_radius_mm:
        rest = (away > defect.arc_deg / 2 + ASIDE_DEG) & ~others[rows]
        if rest.any() and sound[rows][rest].mean() < ALONE:
            return ROUND_WHY
    if defect.kind is not Kind.BUMP:
        lost = dark[inside][:, away <= defect.arc_deg / 2]
        is_deep = not defect.floor_seen and defect.depth_mm > THIN_OF_RADIUS * wall.mean_radius_mm
        return THROUGH_WHY if is_deep and lost.size and lost.mean() >= LIGHT_LOST else ""
    if _may_be_level(defect, wall):
        return LEVEL_WHY
    seen = wall.seen & (wall.count > 0)
    elsewhere = seen[(wall.z_mm < 2 * first - last) | (wall.z_mm > 2 * last - first)]
    by_rod = elsewhere.mean(axis=0) < HIDDEN if len(elsewhere) else np.zeros(len(away), bool)
    outline = seen[inside][:, (away <= defect.arc_deg / 2) & ~by_rod]
    if outline.size and outline.mean() < OUTLINE_SEEN:
        return HOLLOW_WHY
    width = math.radians(min(defect.arc_deg + wall.clock_step_deg, 180.0)) * wall.mean_radius_mm
    at_least = defect.depth_mm - float(np.nan_to_num(defect.depth_k2_mm))
    return TALL_WHY if at_least > min(defect.length_mm + wall.z_step_mm, width) else ""


def _may_be_level(defect: Defect, wall: Wall) -> bool:
    """Whether it may be a level seen from above: along some of the pipe as wide as a chord of its height at the bottom,
    which no dome is."""
    radius = wall.mean_radius_mm
    if defect.kind is not Kind.BUMP or abs(defect.clock_deg - 180.0) > OFF_DEG or not 0.0 < defect.depth_mm < radius:
        return False
    chord_deg = 2.0 * math.degrees(math.acos(1.0 - defect.depth_mm / radius))
    as_wide = CHORD_LEAST <= defect.arc_deg / chord_deg <= CHORD_MOST
    return as_wide and defect.length_mm >= CHORD_LONG * radius


def _measured(
    indication: Indication,
    one: Indication,
    wall: Wall,
    scale: Scale,
    ratios: tuple[float, float],
    dark: BoolArray,
    crests: Float32Array | None,
    points: Callable[[], WallPoints] | None,
) -> tuple[Defect, BoolArray]:
    """A place as a line of the list, and its cells (Z, A) with what it hides. one : the same with its cells weighed by
    what they may be off, for measuring. ratios : of shadows, the widest ring's and the narrowest's. dark : (Z, A)
    what was not seen and no rim's shadow explains."""
    limits, unseen, known = scale.limits, ~wall.seen, np.isfinite(indication.height)
    depth, floor_seen, cells, flat, fitted = depth_of(one, scale, crests)
    edge = (limits.extent_of_floor if flat else limits.extent_of_depth) * depth
    sound = known & (indication.height < limits.extent_of_depth * depth)
    core = without_scraps(without_holes(one.mask & (indication.height >= edge)), sound)
    deepest = depth if floor_seen else scale.mm(limits.unseen_depth_of_radius)
    whole = with_shadow(replace(one, mask=core), unseen, ratios, scale, deepest)
    hidden = (whole & unseen).sum(axis=0)[whole.any(axis=0)] * wall.z_step_mm
    deepest_cells = one.mask & (one.height >= DEEP * depth)
    edge_only = _is_cut_off(deepest_cells, one.kind, dark, scale) or _borders(deepest_cells, ~known) > BORDERING
    footprint = [max(1, round(scale.mm(limits.edge_of_radius) / size)) for size in scale.cell_mm]
    form = max(depth - _over_footprint(one, cells, footprint), 0.0)
    k2 = math.hypot(_expanded(wall, cells & (one.height >= DEEP * depth)), 2.0 * form)
    agreed, own = (math.inf, 0.0) if fitted or one is indication else _agreed(indication, wall, limits.observations)
    why = FEW if agreed < depth_limit_mm(wall, scale) else ""
    if depth > agreed and not why:
        depth, edge_only = agreed, True  # a lower limit, which what one look says does not make less sure, nor surer
        k2 = max(k2, 2.0 * own)
    position = _extent(whole, sound, wall)
    area = float(np.count_nonzero(whole) * scale.cell_mm[0] * scale.cell_mm[1])
    own_shadow = depth * ratios[1] + scale.mm(limits.size_of_radius)
    goes_on = _dark_run(core, unseen, one.kind) * wall.z_step_mm > own_shadow
    seen = floor_seen and not edge_only and not goes_on
    defect = Defect(one.kind, *position, max(depth, 0.0), area, seen, k2, float(np.median(hidden)), why)
    if points is not None and _is_groove(defect, scale):
        floor = groove_floor(wall, points(), defect.z_range_mm, defect.clock_deg, defect.arc_deg, depth)
        if floor is not None:
            depth, k2 = floor
            defect = replace(defect, depth_mm=max(depth, 0.0), depth_k2_mm=k2, floor_seen=True)
    return defect, whole


def _folded(doubted: Sequence[tuple[Defect, BoolArray]], wall: Wall, scale: Scale) -> list[tuple[Defect, BoolArray]]:
    """The undecided places; of many of a kind near each other whose k = 2 is all of their depth, one line: where rings
    differ by so much there are always some."""
    out = [(one, place) for one, place in doubted if not one.depth_k2_mm > one.depth_mm]
    apart = scale.mm(scale.limits.shadow_of_radius)
    for kind in (Kind.LOSS, Kind.BUMP):
        left = sorted(
            (pair for pair in doubted if pair[0].kind is kind and pair[0].depth_k2_mm > pair[0].depth_mm),
            key=lambda pair: pair[0].z_mm,
        )
        while left:
            many = 1
            while many < len(left) and left[many][0].z_mm - left[many - 1][0].z_mm <= apart:
                many += 1
            near, left = left[:many], left[many:]
            if many <= MANY:
                out += near
                continue
            cells = np.logical_or.reduce([place for _, place in near])
            deepest = max((one for one, _ in near), key=lambda one: one.depth_mm)
            z, clock, length, arc = _extent(cells, np.zeros_like(cells), wall, part=0.0)
            area = sum(one.area_mm2 for one, _ in near)
            why = f"{many} places up to so much: {NOISE_WHY}"
            one = replace(
                deepest, z_mm=z, clock_deg=clock, length_mm=length, arc_deg=arc, area_mm2=area, floor_seen=True, why=why
            )
            out.append((one, cells))
    return out


def _may_reach(one: Defect, limit_mm: float) -> bool:
    """Whether a place surely stands out, though maybe less than by what is listed."""
    return one.depth_mm > one.depth_k2_mm >= limit_mm - one.depth_mm


def _only_at_an_end(place: BoolArray, scale: Scale) -> bool:
    """Whether a place lies within a slit's width of an end of the scan, or in its last row: no wall beyond holds a ring
    there to the pipe's shape."""
    last = max(1, math.ceil(scale.mm(scale.limits.edge_of_radius) / scale.cell_mm[0]))
    rows = np.flatnonzero(place.any(axis=1))
    return bool(rows[-1] < last or rows[0] >= len(place) - last)


def _is_cut_off(deepest: BoolArray, kind: Kind, dark: BoolArray, scale: Scale) -> bool:
    """Whether the deepest cells of a place are lined by dark ones along most of a side, over the smallest defect. Not
    where its own rim throws its shadow: before a loss, behind a bump."""
    size = scale.mm(scale.limits.size_of_radius)
    far = [max(1, math.ceil(size / 2 / cell)) for cell in scale.cell_mm]
    ahead = np.zeros((2 * far[0] + 1, 1), bool)
    ahead[far[0] :] = True
    around = np.pad(deepest, ((0, 0), (far[1], far[1])), mode="wrap")
    beside = ndimage.binary_dilation(around, np.ones((1, 2 * far[1] + 1), bool))[:, far[1] : -far[1]]
    beyond = ndimage.binary_dilation(deepest, ahead if kind is Kind.LOSS else ahead[::-1])
    for axis, lining in ((0, beside), (1, beyond)):
        long = deepest.any(axis=1 - axis)
        lined = np.count_nonzero(long & (lining & dark & ~deepest).any(axis=1 - axis))
        if lined * scale.cell_mm[axis] >= size and lined > CUT_OFF * np.count_nonzero(long):
            return True
    return False


def _dark_run(place: BoolArray, unseen: BoolArray, kind: Kind) -> float:
    """Rows that nobody saw on the side where a place's own rim throws its shadow, before a loss and behind a bump, from
    its own first ones on: the median over its columns."""
    columns = place.any(axis=0)
    mine, dark = (mask[:, columns] if kind is Kind.LOSS else mask[::-1, columns] for mask in (place, unseen))
    before = np.arange(len(mine))[:, None] < mine.argmax(axis=0)
    ends = np.where(before & ~dark, np.arange(len(mine))[:, None], -1).max(axis=0)  # the last that was seen
    return float(np.median(mine.argmax(axis=0) - 1 - ends))


def _borders(deepest: BoolArray, unknown: BoolArray) -> float:
    """Part of the deepest cells of a place that border on cells where nothing is known, or on an end of the scan."""
    wide = np.pad(np.pad(unknown, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), constant_values=True)
    near = ndimage.binary_dilation(wide, CORNERS)[1:-1, 1:-1]
    return float(near[deepest].mean()) if deepest.any() else 0.0


def _agreed(place: Indication, wall: Wall, observations: int) -> tuple[float, float]:
    """mm, the depth of a place that so many looks reach, each by most of its deepest points, and what the last of them
    may be off (k = 1; 0 where nobody says); what but one of them says is deeper may be that one's error."""
    seen = wall.observations
    here = np.flatnonzero(place.mask.ravel()[seen.cell])
    if not len(here):
        return math.inf, 0.0
    departure = seen.radius_mm[here] - wall.shape_radius_mm().ravel()[seen.cell[here]]
    _, own = np.unique(seen.number[here], return_inverse=True)
    height = departure if place.kind is Kind.LOSS else -departure
    order = np.lexsort((height, own))
    ends = np.cumsum(np.bincount(own))
    counts = np.bincount(own)
    deepest = height[order][ends - 1 - np.round(AGREED_OF * (counts - 1)).astype(np.intp)]
    enough = np.flatnonzero(counts >= OBSERVATION_POINTS)
    if len(enough) < observations:
        return math.inf, 0.0
    last = enough[np.argsort(deepest[enough])[-observations]]
    stated = seen.sigma_mm[here[own == last]]
    stated = stated[np.isfinite(stated)]
    return float(deepest[last]), float(np.median(stated)) if len(stated) else 0.0


def _is_groove(one: Defect, scale: Scale) -> bool:
    """All round, or so short along the pipe that a slit hardly fits in, and many times as long across it."""
    if one.kind is not Kind.LOSS:
        return False
    short = one.length_mm <= BAND_EDGES * scale.mm(scale.limits.edge_of_radius)
    return one.is_all_round or (short and math.radians(one.arc_deg) * scale.radius_mm >= BAND_ASPECT * one.length_mm)


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


def _extent(
    whole: BoolArray, sound: BoolArray, wall: Wall, part: float = WIDE_ENOUGH
) -> tuple[float, float, float, float]:
    """z_mm, clock_deg, length_mm and arc_deg of the cells of a defect; it goes all round where hardly a direction in
    its stations shows sound wall, however many a rod or its own rim hides."""
    wide = whole.sum(axis=1)
    rows = np.flatnonzero(wide >= max(part * float(wide.max()), 1.0))
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
        if k2[worst] > UNSURE * depth:
            unsure.append(replace(one, why=UNSURE_WHY))
        else:
            out.append(one)
    return out, unsure
