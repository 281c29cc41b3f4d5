"""Where a limit may be broken although nothing listed breaks it: what was not seen, and what nothing was concluded of.

A limit is kept where it was judged, and nowhere else. So every place where it was not is named: a hole in the map that
is larger than the smallest defect, one as large between rings that the map goes over, a place that stands out and was
not confirmed, a defect that goes on where nobody saw, a stretch whose shape or diameters are not known, a joint's own
zone.

Some of them every scan has: a rod hides a strip, rings end raggedly and lie apart, a step throws a shadow. They are
`usual`: the verdict speaks of the wall that was seen, and names them. In all other such places it says that nothing is
established there.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, arc_of
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.rounding import DISTANCE, clock_face, span
from annulus_pipe.wall.apart import Apart
from annulus_pipe.wall.chords import turn_from
from annulus_pipe.wall.defects import Defect, Detection, Kind
from annulus_pipe.wall.extent import as_large, goes_on
from annulus_pipe.wall.features import GAP_OR_GROOVE, Feature, FeatureKind
from annulus_pipe.wall.grid import BRIDGE_OF_RADIUS, Wall
from annulus_pipe.wall.indications import Scale
from annulus_pipe.wall.looks import Looks
from annulus_pipe.wall.patches import label_around, opened, runs
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.stations import GAP_MAX_DEG, STATION_MM, shape_ovality, station_medians, swing_k2_mm
from annulus_pipe.wall.unseen import END_OF_RADIUS, find_holes

# Held by test_never_flattered.py. Set with its draws 1 to 61 and 301 to 325 in view; the others are held out.
ASIDE_OF_RADIUS = 0.08  # nearer to an end of the scan a joint has wall on one side only: 6 mm of a 6-inch pipe
ROUND_LEAST = 0.6  # of the circle: of rows that show less a joint or a level is not told
SAMPLES = 3  # steps in the smallest defect: finer would find no larger patch
FINE_ROWS_MAX = 40_000  # bounds memory
LISTED_MAX = 400  # places of a kind and reason; more are told as one
OF_WALL = ("loss", "bump")
OF_HOLES = (*OF_WALL, "bore", "tee")
OF_ROWS = ("joint", "gap", "water", "deposit")


@dataclass(frozen=True, slots=True)
class Unjudged:
    """One place. kinds : of limits (sections of limits.toml) that were not judged there. clock_deg : its middle. most :
    what there may be, mm of depth or percent of ovality; infinite where nothing says. usual : every scan has such.
    more : how many places it stands for that are too many to list; its ends are those of all, and most lies between."""

    kinds: tuple[str, ...]
    reason: str
    z_from_mm: float
    z_to_mm: float
    clock_deg: float = 0.0
    arc_deg: float = 360.0
    most: float = math.inf
    usual: bool = False
    more: int = 0

    @property
    def is_hole(self) -> bool:
        """Whether it is a hole in the map, where nothing was seen."""
        return self.kinds == OF_HOLES

    @property
    def clock_range(self) -> tuple[str, str]:
        """From-to, clockwise; the whole circle is 12:00 to 12:00."""
        if self.arc_deg >= 360.0:
            return "12:00", "12:00"
        return clock_face(self.clock_deg - self.arc_deg / 2), clock_face(self.clock_deg + self.arc_deg / 2)

    @property
    def words(self) -> str:
        """Where, and why: for one line."""
        clock = "all round" if self.arc_deg >= 360.0 else "clock {} to {}".format(*self.clock_range)
        return f"{span(self.z_from_mm, self.z_to_mm, DISTANCE)}, {clock}: {self.reason}"

    def may_reach(self, kind: str, limit: float) -> bool:
        """Whether a limit of a kind (mm, percent) may be broken there; NaN, where none is named, never is."""
        return kind in self.kinds and self.most >= limit


def find_unjudged(
    wall: Wall,
    detection: Detection,
    *,
    explained: BoolArray,
    joints: BoolArray,
    shadowed: BoolArray,
    no_wall: BoolArray | None,
    looks: Looks | None,
    rings: int,
    apart: Sequence[Apart],
    profiles: Sequence[Profile] = (),
) -> tuple[Unjudged, ...]:
    """Every such place of a wall, in order of distance.

    Parameters
    ----------
    explained : (Z, A) cells of joints, openings and levels, where no defect was looked for. joints : (Z,) their rows.
    shadowed : (Z, A) what steps hide. no_wall : (Z, A) cells of openings. looks : where light passed the wall, None
    where nobody knows. rings : of the pattern; fewer than three tell no joint. apart : where no sound
    wall goes all round. profiles : whose points the wall is of; none where every pixel measures.
    """
    scale = Scale.of(wall, detection.limits)
    sure = wall.shape_sigma_mm() <= wall.shape_limit_mm
    listed = detection.label > 0
    unseen = ~wall.seen & ~explained & ~listed
    hidden = ~wall.seen & ~listed & (~explained | joints[:, None])
    holes = as_large(unseen, scale)
    found = [
        Unjudged(OF_HOLES, reason, *_span(wall, part, rows.start), usual=usual)
        for rows, part, reason, usual in find_holes(wall, hidden, shadowed, looks, listed | explained, joints, scale)
    ]
    doubtful = as_large(wall.seen & ~sure & ~explained, scale)
    found += _parts(
        wall, doubtful, OF_WALL, "the pipe's own shape is not known there, so that nothing stands out of it"
    )
    if profiles:
        found += _between_rings(wall, profiles, unseen | explained | listed, scale)
    dark = holes & ~shadowed
    found += _going_on(wall, detection, dark, scale)
    found += _parts(
        wall, explained, OF_WALL, "a joint, an opening or a level: no defect is looked for in it", usual=True
    )
    found += _ovality(wall, detection, no_wall, scale)
    found += _bore(wall, no_wall)
    found += _rows(wall, rings, scale)
    found += _gaps(apart, wall.z_mm[joints])
    return _bounded(found)


def nameless(features: Sequence[Feature]) -> tuple[Unjudged, ...]:
    """Places where something goes all round that has no name: a joint, a gap or a groove there was held against no
    limit."""
    return tuple(
        Unjudged(
            ("joint", "gap", "loss") if one.remark == GAP_OR_GROOVE else ("joint", "gap"),
            f"{one.remark}: not established",
            *one.z_range_mm,
        )
        for one in features
        if one.kind is FeatureKind.NAMELESS
    )


def wider(features: Sequence[Feature], first_mm: float, last_mm: float) -> tuple[Unjudged, ...]:
    """Stretches wider than the pipe on the other side of a joint, up to the next one or an end of the scan: another
    pipe, a socket, or a loss all round whose other end was not seen. Nothing tells which."""
    joints = [one for one in features if one.kind in (FeatureKind.JOINT, FeatureKind.GAP, FeatureKind.NAMELESS)]
    joints.sort(key=lambda one: one.z_mm)
    ends = [first_mm, *(one.z_mm for one in joints), last_mm]
    out = []
    for i, joint in enumerate(joints):
        step = next((one for one in joint.measures if one.name == "step_mm"), None)
        if step is None or not math.isfinite(step.value):
            continue
        stretch = (joint.z_mm, ends[i + 2]) if step.value > 0 else (ends[i], joint.z_mm)
        most = (abs(step.value) + float(np.nan_to_num(step.k2))) / 2
        reason = "wider than the pipe on the other side of a joint: another pipe, or a loss all round to where it ends"
        out.append(Unjudged(("loss",), reason, *stretch, most=most))
    return tuple(out)


def in_one(stretches: Sequence[Sequence[Unjudged]], touch_mm: float) -> tuple[Unjudged, ...]:
    """Those of several stretches of a pipe, one after the other: what goes on over a cut is one place."""
    out: list[Unjudged] = []
    open_ends: list[int] = []  # of the stretch before, in `out`
    for many in stretches:
        before, open_ends = [(i, out[i]) for i in open_ends], []
        for one in sorted(many, key=lambda one: one.z_from_mm):
            i = next((i for i, was in before if _goes_on(was, one, touch_mm)), None)
            if i is None:
                out.append(one)
                open_ends.append(len(out) - 1)
            else:
                out[i] = _both(out[i], one)
                open_ends.append(i)
    return _bounded(out)


def _goes_on(was: Unjudged, one: Unjudged, touch_mm: float) -> bool:
    aside = abs(float(turn_from(one.clock_deg, was.clock_deg)))
    is_alike = (was.kinds, was.reason, was.usual) == (one.kinds, one.reason, one.usual)
    return is_alike and one.z_from_mm - was.z_to_mm <= touch_mm and aside <= min(one.arc_deg, was.arc_deg) / 2


def _both(was: Unjudged, one: Unjudged) -> Unjudged:
    """One place that holds two."""
    aside = float(turn_from(one.clock_deg, was.clock_deg))
    low = min(-was.arc_deg / 2, aside - one.arc_deg / 2)
    arc = max(was.arc_deg / 2, aside + one.arc_deg / 2) - low
    clock = (was.clock_deg + low + arc / 2) % 360.0 if arc < 360.0 else 0.0
    return replace(
        was,
        z_from_mm=min(was.z_from_mm, one.z_from_mm),
        z_to_mm=max(was.z_to_mm, one.z_to_mm),
        clock_deg=clock,
        arc_deg=min(arc, 360.0),
        most=max(was.most, one.most),
    )


def _cells(mm: float, size: float) -> int:
    return max(1, math.ceil(mm / size))


def _span(wall: Wall, part: BoolArray, first: int = 0) -> tuple[float, float, float, float]:
    """Of cells of the rows from `first` on."""
    rows = first + np.flatnonzero(part.any(axis=1))
    half = wall.z_step_mm / 2
    return float(wall.z_mm[rows[0]]) - half, float(wall.z_mm[rows[-1]]) + half, *_around(wall, part)


def _around(wall: Wall, part: BoolArray) -> tuple[float, float]:
    """Middle and length, degrees, of the arc that holds all marked columns."""
    start, arc = arc_of(np.asarray(part.any(axis=0)), wall.clock_step_deg)
    return 0.0 if arc >= 360.0 else (start + arc / 2) % 360.0, arc


def _pieces(mask: BoolArray) -> Iterator[BoolArray]:
    label, n = label_around(mask)
    for i in range(1, n + 1):
        yield label == i


def _parts(
    wall: Wall, mask: BoolArray, kinds: tuple[str, ...], reason: str, *, usual: bool = False
) -> Iterator[Unjudged]:
    for part in _pieces(mask):
        yield Unjudged(kinds, reason, *_span(wall, part), usual=usual)


def _between_rings(wall: Wall, profiles: Sequence[Profile], besides: BoolArray, scale: Scale) -> Iterator[Unjudged]:
    """Patches as large as the smallest defect that no point lies in, and over which the map was interpolated."""
    size = scale.mm(scale.limits.size_of_radius)
    first, last = wall.extent[:2]
    fine = max(size / SAMPLES, (last - first) / FINE_ROWS_MAX)  # mm
    columns = len(wall.clock_deg)
    hit = np.zeros((math.ceil((last - first) / fine), columns), bool)
    for one in profiles:
        x, y, z = one.points_mm.T
        row = np.floor((z - first) / fine)
        inside = (row >= 0) & (row < len(hit))
        column = np.floor(np.degrees(np.arctan2(x, -y))[inside] / wall.clock_step_deg).astype(np.intp) % columns
        hit[row[inside].astype(np.intp), column] = True
    empty = opened(~hit, max(1, round(size / fine)), _cells(size, scale.cell_mm[1]))
    at = np.minimum(((np.arange(len(hit)) + 0.5) * fine / wall.z_step_mm).astype(np.intp), len(wall.z_mm) - 1)
    label, _ = label_around(empty & ~besides[at])
    tall = np.array([0.0, *((rows.stop - rows.start) * fine for rows, _ in ndimage.find_objects(label))])
    reason = "the map goes on between rings there, and a small defect may lie between them"
    # six rows are as long as what the map is bridged over: not for the last bit of a radius to decide
    is_usual = tall <= BRIDGE_OF_RADIUS * wall.mean_radius_mm + fine / 2
    for usual in (False, True):
        patches = (label > 0) & (is_usual[label] == usual)
        rows = ndimage.binary_dilation(
            patches.any(axis=1), iterations=_cells(scale.mm(scale.limits.join_of_radius), fine)
        )
        for (near,) in ndimage.find_objects(ndimage.label(rows)[0]):  # one place for people
            part = patches[near]
            mine = near.start + np.flatnonzero(part.any(axis=1))
            begins, ends = first + int(mine[0]) * fine, first + (int(mine[-1]) + 1) * fine
            yield Unjudged(OF_WALL, reason, begins, ends, *_around(wall, part), usual=usual)


def _going_on(wall: Wall, detection: Detection, dark: BoolArray, scale: Scale) -> Iterator[Unjudged]:
    """Defects and undecided places that end where nobody saw: their deepest point may lie in the unseen wall."""
    listed = [(one, detection.label == i) for i, one in enumerate(detection.defects, 1)]
    listed += [(one, _box(wall, one)) for one in detection.undecided]
    for one, cells in listed:
        if one.kind is Kind.OVALITY or not cells.any():
            continue
        beside = goes_on(cells, dark, scale)
        if not beside.any():
            continue
        reason = f"the {one.kind} there goes on where nobody saw, and may be deeper"
        yield Unjudged((str(one.kind),), reason, *_span(wall, cells | beside))


def _box(wall: Wall, one: Defect) -> BoolArray:
    first, last = one.z_range_mm
    away = np.abs((wall.clock_deg - one.clock_deg + 180.0) % 360.0 - 180.0)
    return np.asarray(((wall.z_mm >= first) & (wall.z_mm <= last))[:, None] & (away <= one.arc_deg / 2)[None, :])


def _stretches(
    wall: Wall, rows: BoolArray, kinds: tuple[str, ...], reason: str, least_mm: float, end_mm: float = 0.0
) -> Iterator[Unjudged]:
    """Runs of rows, shorter ones than `least_mm` left out; such as lie within `end_mm` of an end are usual."""
    label, n = ndimage.label(rows)
    half = wall.z_step_mm / 2
    for i in range(1, n + 1):
        mine = np.flatnonzero(label == i)
        first, last = float(wall.z_mm[mine[0]]) - half, float(wall.z_mm[mine[-1]]) + half
        if last - first >= least_mm:
            usual = last <= wall.extent[0] + end_mm or first >= wall.extent[1] - end_mm
            yield Unjudged(kinds, reason, first, last, usual=usual)


def _ovality(wall: Wall, detection: Detection, no_wall: BoolArray | None, scale: Scale) -> Iterator[Unjudged]:
    """Where the shape is not known, and where diameters themselves are farther out of round than it."""
    limits = detection.limits
    percent = shape_ovality(wall)
    long = scale.mm(limits.ovality_length_of_radius)
    yield from _stretches(wall, ~np.isfinite(percent), ("ovality",), "the pipe's shape is not known there", long)
    sound = wall.seen & (detection.label == 0)
    if no_wall is not None:
        sound &= ~no_wall
    own = np.nan_to_num(percent) + np.nan_to_num(50.0 * swing_k2_mm(wall) / wall.shape_mm[:, 0])
    rows = max(1, round(STATION_MM / wall.z_step_mm))
    half = len(wall.clock_deg) // 2
    across_percent = np.zeros(len(wall.z_mm))
    middle = station_medians(np.where(sound, wall.radius_mm, np.float32(np.nan)), rows, 0)
    for i, line in enumerate(
        station_medians(middle.astype(np.float32), 1, 2).astype(np.float32)
    ):  # evened out over five columns
        part = slice(i * rows, (i + 1) * rows)
        across = line[:half] + line[half:]
        known = across[np.isfinite(across)]
        if len(known) < half / 4:
            continue
        mean = 2.0 * float(np.median(wall.shape_mm[part, 0]))
        noise = 400.0 * float(np.median(wall.noise_mm[part])) / mean
        across_percent[part] = 100.0 * max(known.max() - mean, mean - known.min()) / mean + noise
    label, n = ndimage.label(across_percent > own)
    for i in range(1, n + 1):
        mine = np.flatnonzero(label == i)
        step = wall.z_step_mm / 2
        if len(mine) * wall.z_step_mm >= long:
            first, last = float(wall.z_mm[mine[0]]) - step, float(wall.z_mm[mine[-1]]) + step
            reason = "diameters there are farther out of round than the oval that was fitted"
            yield Unjudged(("ovality",), reason, first, last, most=float(across_percent[mine].max()))


def _bore(wall: Wall, no_wall: BoolArray | None) -> Iterator[Unjudged]:
    """Where so wide an arc was not seen that the least or the greatest diameter may end in it."""
    unseen = ~wall.seen if no_wall is None else ~wall.seen & ~no_wall
    rows = runs(unseen).max(axis=1) * wall.clock_step_deg > GAP_MAX_DEG
    end = END_OF_RADIUS * wall.mean_radius_mm
    yield from _stretches(wall, rows, ("bore",), "too wide an arc was not seen for its diameters", STATION_MM, end)


def _rows(wall: Wall, rings: int, scale: Scale) -> Iterator[Unjudged]:
    """Where too little of the circle was seen for what goes all round."""
    if rings < 3:
        yield Unjudged(("joint",), "fewer than three rings tell no joint's step or angle", *wall.extent[:2])
    first, last = wall.extent[:2]
    side = scale.mm(ASIDE_OF_RADIUS)
    for start, stop in ((first, min(first + side, last)), (max(last - side, first), last)):
        yield Unjudged(
            ("joint",), "an end of the scan: a joint shows with wall on both sides of it", start, stop, usual=True
        )
    few = wall.seen.mean(axis=1) < ROUND_LEAST
    least, end = scale.mm(scale.limits.edge_of_radius), scale.mm(END_OF_RADIUS)
    yield from _stretches(wall, few, OF_ROWS, "too little of the circle was seen", least, end)


def _gaps(apart: Sequence[Apart], joints_mm: FloatArray) -> Iterator[Unjudged]:
    """Where a gap may be that no joint tells, and how wide at most. Where one was found it may be a groove instead, and
    where none was, two pipes may meet as they like."""
    plain = max((one.most_mm for one in apart if one.is_plain), default=0.0)
    for one in apart:
        where = one.from_mm, one.to_mm
        if one.is_plain:
            reason = "a gap so short may lie between two rings"
            yield Unjudged(("gap",), reason, *where, most=one.most_mm, usual=True)
            continue
        found = ((joints_mm > one.from_mm) & (joints_mm < one.to_mm)).any()
        reason = "no sound wall goes all round there: how wide a gap it may be was not told"
        yield Unjudged(("gap",), reason, *where, most=one.most_mm)
        if not found and math.isfinite(one.most_mm):  # at an end of the scan no joint is judged anyhow
            yield Unjudged(("joint",), "whether two pipes meet there was not told", *where)
        elif one.most_mm - one.hidden_mm > plain:
            yield Unjudged(("loss",), "a joint there is not told from a groove", *where)


def _bounded(found: Sequence[Unjudged]) -> tuple[Unjudged, ...]:
    """In order of distance; of what is too much of one sort the largest, and one place that has the rest."""
    sorts: dict[tuple[tuple[str, ...], str, bool], list[Unjudged]] = {}
    for one in found:
        sorts.setdefault((one.kinds, one.reason, one.usual), []).append(one)
    out = []
    for many in sorts.values():
        many.sort(key=lambda one: -(one.z_to_mm - one.z_from_mm) * one.arc_deg)
        out += many[:LISTED_MAX]
        if rest := many[LISTED_MAX:]:
            out.append(
                replace(
                    rest[0],
                    reason=f"{rest[0].reason}; {len(rest)} more such",
                    clock_deg=0.0,
                    arc_deg=360.0,
                    z_from_mm=min(one.z_from_mm for one in rest),
                    z_to_mm=max(one.z_to_mm for one in rest),
                    most=max(one.most for one in rest),
                    more=len(rest),
                )
            )
    return tuple(sorted(out, key=lambda one: (one.z_from_mm, one.clock_deg)))
