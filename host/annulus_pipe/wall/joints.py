"""Joints: what stands between two pipes, from the wall about it and from how the centre line goes on.

The centre line tells hi-lo, angle and step; the wall whether a bead stands in between, a gap gapes, or nothing shows. A
bead that neither jumps nor turns is a joint, too. The sensor looks forward: it sees a bead's near flank and crest, and
its far flank hardly ever.

A name needs its form. A bead stands inwards of the wall on both sides of it, all round; a gap lies outwards of both;
what lies between the two goes over from one radius to the other: a reducer, where they differ by more than two pipes of
one size do. A bead that is no surer than its k = 2, or whose flank nobody saw, has no name. A line that surely jumps
without any of these is a joint whose kind is not established. One that only turns, and by more than pipes that were
joined straight, may be a short bend: that has no name, nor has what too little was seen of.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, nan_median
from annulus_pipe.wall.adjustment import OFFSET, RADIUS, TURN
from annulus_pipe.wall.axis import OFFSET_OF_RADIUS, RADIUS_STEP, Axis, Begins
from annulus_pipe.wall.beads import measure_bead
from annulus_pipe.wall.bends import REDUCER, SURE, is_sure
from annulus_pipe.wall.features import GAP_OR_GROOVE, NOT_TOLD, Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.grid import ALIKE, Wall
from annulus_pipe.wall.indications import Limits
from annulus_pipe.wall.points import ROW_MM, SECTORS, SOUND, WallPoints
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.shadow import SLIT_OF_RADIUS

REACH_OF_RADIUS = 0.3  # how far each side of where two pipes meet the joint may reach
NEAR_OF_RADIUS = 0.1  # how far from a bend's end the bead of its weld may be
LONGEST_OF_RADIUS = 0.5  # what is longer is no joint
OFF_COLUMNS = 12  # of a row: so many depart, and it is not sound
ROUND = 0.7  # part of what is seen of a row that must depart alike, for a bead all round
SEEN = 0.3  # part of the circle, for a row to say anything
ASIDE_OF_RADIUS = 0.08  # before and behind a gap: sound wall
GAP_SECTORS = 12  # of the circle, each with its own ends
GAP_POINTS = 3  # of a row of one, that say something
# Of half a slit. One that half passes an edge may still be bright enough, so that an end loses between nothing and all
# of it, and both ends alike. Six gaps of the blind seeds 1 to 5 were 0.036 of the radius short when all was taken off;
# guarded by test_gaps.py, where all of it is lost, and test_gaps_never_flattered.py.
SLIT_LOST = 0.8  # of half a slit, the mean, at either end
SLIT_KNOWN = 0.7  # of half a slit, the standard deviation of both together
ROUND_LEAST = 0.6  # of the circle, for a row to say where the pipe's axis is: as `axis` asks before it begins a piece
BESIDE_OF_RADIUS = 1.0  # of the radius: so far beside a joint the line is held against the wall ..
BESIDE_LEAST = 0.15  # .. and so much of that must be sound: over less an axis turns as the errors of its rings will
# Of the sectors that show anything but wall: so many show a bead, or a gap, all round; in fewer it is something else.
# Guarded by tests/regression/{reducer_called_butt_fusion,narrow_bead_called_a_gap,pocket_called_a_weld}.
SHOWS = 0.7
JUMPS = ("hilo_mm", "step_mm", "angle_deg")  # of a line: what no groove makes
# A bead that no jump of the line goes with is a joint where its height is known to this part of it, k = 2. Of 54 welds
# of the blind seeds 1 to 6 one such was known worse; three places that were none, 0.63 to 0.98.
BEAD_KNOWN = 0.6
SOCKET_OF_RADIUS = 0.02  # and by less than this, two pipes of one size
# A turn alone is a joint up to here: what turns more within half a radius may be a short bend as well. Pipes that are
# joined straight lie within 2 degrees of each other; an elbow of 1 D has 14 degrees on half a radius.
KINK_MOST = math.radians(3.0)


@dataclass(frozen=True, slots=True)
class Joint:
    """A feature, and the rows of the wall it takes. hidden_mm : of those, behind its step outwards, from every ring."""

    feature: Feature
    from_mm: float
    to_mm: float
    is_gap: bool
    hidden_mm: float = 0.0

    @property
    def measures_gap(self) -> bool:
        """Whether it says how wide a gap is: of a bead, that there is none."""
        return self.is_gap or not math.isnan(self.feature.measured("height_mm"))


def find_joints(wall: Wall, profiles: Sequence[Profile], axis: Axis, shadow_ratios: FloatArray) -> tuple[Joint, ...]:
    """Every joint, in order of distance. profiles : in pipe coordinates, those the wall was made of.
    shadow_ratios : (K,) length hidden behind a step over its height, of every ring (Alzuhiri 2022, Eq. 3.24).

    Notes
    -----
    A gap is what lies between the last and the first row that is sound wall, and is more than what the wall's own step
    outwards hides behind its lip.
    """
    limits = Limits()
    limit = max(limits.seed_noise * float(np.median(wall.noise_mm)), limits.seed_of_radius * wall.mean_radius_mm)
    rows = _WallRows.of(wall, limit)
    starts = [piece.start_mm for piece in axis.centreline.pieces]
    zones = [(rows.zone(starts[i]), i) for i, kind in enumerate(axis.begins) if kind is Begins.JOINT]
    welds: list[tuple[float, float]] = []
    for i, kind in enumerate(axis.begins):  # a bend is welded to its pipes; of those beads little may be seen
        after_bend = kind is Begins.STRAIGHT and i > 0 and axis.begins[i - 1] is Begins.BEND
        if (kind is Begins.BEND or after_bend) and rows.disturbed(starts[i]):
            welds.append(rows.zone(starts[i]))
    beads = rows.beads()
    if not zones and not welds and not beads:
        return ()
    points, least_shadow_ratio = WallPoints.of(wall, profiles, shadow_ratios), float(shadow_ratios.min())
    tried = [_joint(wall, points, rows, zone, limit, axis, i, least_shadow_ratio) for zone, i in zones]
    tried += [_joint(wall, points, rows, zone, limit, axis, None, least_shadow_ratio) for zone in welds]
    found = [joint for joint in tried if joint is not None]
    for start, end in beads:
        if all(not joint.from_mm - end < 0 < joint.to_mm - start for joint in found):
            zone = rows.zone((start + end) / 2)
            joint = _joint(wall, points, rows, zone, limit, axis, None, least_shadow_ratio)
            found += [] if joint is None else [joint]
    return tuple(sorted(found, key=lambda joint: joint.from_mm))


def taken(wall: Wall, joints: Sequence[Joint], shadow_ratio: float) -> BoolArray:
    """(Z, A) bool: what joints explain, and where a bead's shadow cuts slits in half.

    shadow_ratio : length hidden behind a step over its height, of the narrowest ring (Alzuhiri 2022, Eq. 3.24).
    """
    out = np.zeros(wall.radius_mm.shape, np.bool_)
    margin = SLIT_OF_RADIUS * wall.mean_radius_mm
    for joint in joints:
        if joint.feature.kind is FeatureKind.NAMELESS and joint.feature.remark != GAP_OR_GROOVE:
            continue
        height = joint.feature.measured("height_mm")
        height = 0.0 if math.isnan(height) else height
        end = max(joint.to_mm, joint.feature.z_range_mm[1] + height * shadow_ratio) + margin
        out[(wall.z_mm > joint.from_mm - margin) & (wall.z_mm < end)] = True
    return out


def without_hidden(
    profiles: Sequence[Profile], joints: Sequence[Joint], least_shadow_ratio: float
) -> tuple[Profile, ...]:
    """The profiles less the points in gaps, and where beads keep the light of every ring away: what seems to be seen
    there is a slit cut in half. Counted as rejected["joint"]."""
    spans = []
    for joint in joints:
        height = joint.feature.measured("height_mm")
        if joint.is_gap:
            spans.append((joint.from_mm, joint.to_mm))
        elif height > 0:
            end = joint.feature.z_range_mm[1]
            spans.append((end, end + height * least_shadow_ratio))
    out = []
    for profile in profiles:
        z = profile.points_mm[:, 2]
        lost = np.zeros(len(z), np.bool_)
        for first, last in spans:
            lost |= (z > first) & (z < last)
        out.append(profile.without(lost, "joint") if lost.any() else profile)
    return tuple(out)


@dataclass(frozen=True, slots=True)
class _Off:
    """How far the wall beside a joint is off the line: of the offset, mm, the turn, radians, the radius, mm. lever_mm :
    how far from where it is told the line may turn."""

    offset_mm: float
    turn: float
    radius_mm: float
    lever_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class _WallRows:
    """Of each row of the wall: whether it is sound, and how far it departs all round (mm, NaN where it does not)."""

    z_mm: FloatArray
    step_mm: float
    radius_mm: float
    sound: BoolArray
    round: BoolArray  # enough of it was seen to say where the axis is
    off: BoolArray  # some of it departs
    inwards: BoolArray

    @classmethod
    def of(cls, wall: Wall, limit: float) -> "_WallRows":
        seen = wall.seen & (wall.count > 0)  # what was filled in between two lips is no wall
        height = np.where(seen, wall.residual_mm(), np.nan).astype(np.float64)
        count = np.maximum(seen.sum(axis=1), 1)
        enough = seen.mean(axis=1) >= SEEN
        with np.errstate(invalid="ignore"):
            near = (np.abs(height) < limit).sum(axis=1) / count
            inwards = (height < -limit).sum(axis=1) / count
            off = (np.abs(height) > limit).sum(axis=1) >= OFF_COLUMNS
        inwards = (inwards >= ROUND) & (count >= OFF_COLUMNS)
        sound, all_round = enough & (near >= SOUND), seen.mean(axis=1) >= ROUND_LEAST
        return cls(wall.z_mm, wall.z_step_mm, wall.mean_radius_mm, sound, all_round, off, inwards)

    def zone(self, at_mm: float) -> tuple[float, float]:
        """From the last sound row before to the first one after a place, no farther than a joint reaches."""
        reach = REACH_OF_RADIUS * self.radius_mm
        near = np.abs(self.z_mm - at_mm) <= reach
        unsound = np.flatnonzero(near & ~self.sound)
        if not len(unsound):  # rows may be longer than what disturbs them; its points tell where it ends
            near_mm = NEAR_OF_RADIUS * self.radius_mm if self.disturbed(at_mm) else 0.0
            return at_mm - near_mm, at_mm + near_mm
        middle = unsound[np.argmin(np.abs(self.z_mm[unsound] - at_mm))]
        gap = max(2, round(0.04 * self.radius_mm / self.step_mm))  # a sound row or two within a joint are chance
        first = last = middle
        for k in unsound[unsound < middle][::-1]:
            if first - k > gap:
                break
            first = k
        for k in unsound[unsound > middle]:
            if k - last > gap:
                break
            last = k
        half = self.step_mm / 2
        return float(self.z_mm[first]) - half, float(self.z_mm[last]) + half

    def disturbed(self, at_mm: float) -> bool:
        """Whether something stands out near a place, all round or not."""
        near = np.abs(self.z_mm - at_mm) <= NEAR_OF_RADIUS * self.radius_mm
        return bool((near & self.off).any())

    def line_off(
        self, wall: Wall, axis: Axis, piece: int, zone: tuple[float, float], middle_mm: float, length_mm: float
    ) -> _Off | None:
        """What sound wall on both sides of a joint says otherwise than the line; None where there is too little of it.

        Each piece is held against its own wall, what is next to the joint and what is farther off: between two joints
        that are near each other, or where what rings have in common is taken for a turn, there is no line to go by.
        Where the wall winds about it (heads that lean, a pipe that undulates), the joint may lie where it winds. Nor is
        it known where in the joint's zone, beside its bead or gap, the line turns.
        """
        pieces, reach = axis.centreline.pieces, BESIDE_OF_RADIUS * self.radius_mm
        first = max(pieces[piece - 1].start_mm, zone[0] - reach)
        last = min(pieces[piece + 1].start_mm if piece + 1 < len(pieces) else math.inf, zone[1] + reach)
        good, offs, winds = self.sound & self.round, [], np.zeros(3)
        for side in ((self.z_mm > first) & (self.z_mm < zone[0]), (self.z_mm > zone[1]) & (self.z_mm < last)):
            at = np.flatnonzero(side & good)
            if len(at) < 2 or len(at) * self.step_mm < BESIDE_LEAST * self.radius_mm:
                return None
            radius = wall.radius_mm[at] - axis.centreline.radius_at(self.z_mm[at])[:, None]
            off = np.column_stack([wall.shape_mm[at, 1:3], nan_median(np.where(wall.seen[at], radius, np.nan).T)])
            winds += off.var(axis=0)
            split = min(math.ceil(BESIDE_LEAST * self.radius_mm / self.step_mm), len(at) // 2)
            near, far = np.split(off if self.z_mm[at[0]] > zone[1] else off[::-1], [split])
            length = float(self.z_mm[at[-1]] - self.z_mm[at[0]]) / 2
            offs.append((np.median(near, axis=0), (np.median(far, axis=0) - np.median(near, axis=0)) / length))
        (before, back), (after, ahead) = offs
        jump, turn = after - before, ahead + back  # ahead of the joint farther off is forward, before it back
        # a radius that goes on changing along its own pipe makes a step of what is none
        grows = reach / 2 * math.hypot(ahead[2], back[2])
        aside, grows = math.sqrt(winds[0] + winds[1]), math.hypot(grows, math.sqrt(winds[2]))
        # somewhere in its zone it turns, and not surely in its bead
        away = max(abs(pieces[piece].start_mm - middle_mm), (zone[1] - zone[0] - length_mm) / 2)
        astray = away * float(np.hypot(*pieces[piece].turn))
        return _Off(
            math.hypot(*jump[:2], astray, aside),
            math.hypot(*turn[:2]),
            math.hypot(jump[2], grows),
            max(away, length_mm / 2),
        )

    def beads(self) -> list[tuple[float, float]]:
        """Runs of rows that stand inwards all round, short enough for a joint."""
        marked = np.flatnonzero(self.inwards)
        return [
            (float(self.z_mm[run[0]]), float(self.z_mm[run[-1]]))
            for run in np.split(marked, np.flatnonzero(np.diff(marked) > 3) + 1)
            if len(run) and (run[-1] - run[0] + 1) * self.step_mm <= LONGEST_OF_RADIUS * self.radius_mm
        ]


def _joint(
    wall: Wall,
    points: WallPoints,
    rows: _WallRows,
    zone: tuple[float, float],
    limit: float,
    axis: Axis,
    piece: int | None,
    least_shadow_ratio: float,
) -> Joint | None:
    """What a zone shows, and the line in it where it begins a `piece` there; None where that is no joint."""
    form = _form(wall, points, zone, limit)
    first, last = points.trimmed(zone, limit)
    measures: list[FeatureMeasure] = []
    middle, length = (first + last) / 2, last - first
    bead = measure_bead(wall, points, (first, last)) if form is _Form.BEAD else None
    if bead is not None and bead.is_none:
        form, bead = _Form.BETWEEN, None
    if bead is not None and bead.is_sure:
        end = bead.start_mm + bead.width_mm
        first, last = min(first, bead.start_mm), max(last, end)
        middle, length = (bead.start_mm + end) / 2, bead.width_mm
    of_line: list[FeatureMeasure] = []
    if piece is not None and axis.adjusted is not None:
        off = rows.line_off(wall, axis, piece, (first, last), middle, length)
        if off is not None:
            of_line = _of_line(axis, piece, middle, off, common_mm(wall, last), wall.point_mm())
    hidden = least_shadow_ratio * _outwards(axis, piece, middle)
    gap, gap_k2 = 0.0, math.inf
    is_open = piece is not None and form in (_Form.GAP, _Form.UNSEEN)
    if is_open and length - hidden > 2.0 * SLIT_OF_RADIUS * wall.mean_radius_mm:
        gap, gap_k2 = _gap(wall, points, (first, last), limit)
    jumps = any(_is_sure(one) for one in of_line if one.name in JUMPS)
    if bead is not None and bead.is_sure and (jumps or not bead.height_k2_mm > BEAD_KNOWN * bead.height_mm):
        kind, remark = FeatureKind.JOINT, "butt fusion"
        width = math.nan if math.isnan(bead.width_k2_mm) else bead.width_mm
        measures.append(FeatureMeasure("height_mm", bead.height_mm, bead.height_k2_mm))
        measures.append(FeatureMeasure("width_mm", width, bead.width_k2_mm))
    elif gap > gap_k2 and not jumps:
        kind, remark = FeatureKind.NAMELESS, GAP_OR_GROOVE
        of_line = []
    elif gap > gap_k2:  # what may be none is not called one: slits about a step read as much
        kind, remark, length = FeatureKind.GAP, "coupling", gap
        measures.append(FeatureMeasure("gap_mm", gap, gap_k2))
    else:
        # where a line without a name ends is no more sure
        by_line = piece is not None and is_sure(axis, piece - 1)
        named = _of_what_line(of_line, wall.mean_radius_mm, rows.disturbed(middle)) if by_line else None
        if named is None and bead is not None:
            named = FeatureKind.NAMELESS, "a bead, or nothing"
        if named is None:
            return None
        kind, remark = named
        if kind is FeatureKind.REDUCER:
            of_line = _of_reducer(of_line)
        elif kind is FeatureKind.NAMELESS:
            of_line = [one for one in of_line if one.name == "angle_deg" and _is_sure(one)]
    length = max(length, 2 * wall.z_step_mm)
    feature = Feature(kind, middle, length, measures=(*measures, *of_line), remark=remark)
    return Joint(feature, first, last, kind is FeatureKind.GAP, hidden)


class _Form(Enum):
    """What stands in a zone between two pipes, all round."""

    BEAD = "inwards of both"
    GAP = "outwards of both"
    BETWEEN = "neither"
    UNSEEN = "hardly anything but wall"


def _form(wall: Wall, points: WallPoints, zone: tuple[float, float], limit: float) -> _Form:
    """Sector by sector, by most of the points that lie on neither wall."""
    points = points.between(*zone)
    aside = wall.z_step_mm
    either = np.stack([points.over(wall, zone[0] - aside), points.over(wall, zone[1] + aside)])
    least, most = either.min(axis=0), either.max(axis=0)
    inwards, outwards, off = (
        np.bincount(points.sector, weights=which, minlength=SECTORS)
        for which in (least > limit, most < -limit, np.abs(either).min(axis=0) > limit)
    )
    says = off >= GAP_POINTS
    if np.count_nonzero(says) < SEEN * SECTORS:
        return _Form.UNSEEN
    if (inwards > 0.5 * off)[says].mean() >= SHOWS:
        return _Form.BEAD
    return _Form.GAP if (outwards > 0.5 * off)[says].mean() >= SHOWS else _Form.BETWEEN


def _is_sure(one: FeatureMeasure) -> bool:
    """Of the line, as surely as `axis` asks before it begins a piece."""
    return abs(one.value) > SURE * one.k2


def _of_what_line(
    of_line: Sequence[FeatureMeasure], radius_mm: float, disturbed: bool
) -> tuple[FeatureKind, str] | None:
    """What a line that jumps, turns or steps is where the wall shows neither bead nor gap; None where it is nothing."""
    if not of_line:
        return FeatureKind.NAMELESS, "a joint, or what else changes the pipe's line: too little wall was seen beside it"
    least = {"hilo_mm": OFFSET_OF_RADIUS * radius_mm, "step_mm": 2.0 * RADIUS_STEP * radius_mm, "angle_deg": 0.0}
    sure = {one.name: one.value for one in of_line if _is_sure(one) and abs(one.value) > least.get(one.name, math.inf)}
    step = abs(sure.get("step_mm", 0.0)) / 2.0
    if step > REDUCER * radius_mm:
        return FeatureKind.REDUCER, ""
    if step > SOCKET_OF_RADIUS * radius_mm:
        return FeatureKind.JOINT, "socket"
    if step or "hilo_mm" in sure or 0.0 < sure.get("angle_deg", 0.0) <= math.degrees(KINK_MOST):
        return FeatureKind.JOINT, f"{NOT_TOLD}: neither a bead nor a gap was seen"
    if sure:
        return FeatureKind.NAMELESS, "a joint or a short bend"
    return (FeatureKind.NAMELESS, "a joint, or nothing") if disturbed else None


def _of_reducer(of_line: Sequence[FeatureMeasure]) -> list[FeatureMeasure]:
    """A reducer's measures, of those of the line at it."""
    step, after = (next(one for one in of_line if one.name == name) for name in ("step_mm", "radius_after_mm"))
    before_k2 = math.hypot(after.k2, step.k2 / 2.0)
    return [FeatureMeasure("radius_before_mm", after.value - step.value / 2.0, before_k2), after]


def _gap(wall: Wall, points: WallPoints, zone: tuple[float, float], limit: float) -> tuple[float, float]:
    """mm between the ends of two pipes, and its k = 2: in each sector what is not sound about the zone's middle, less
    what a slit adds at either end. Pipes that meet at an angle have their ends askew: rows all round would read long.

    An end lies between the last row that is sound wall and the first that surely is none: off by `limit`, mm, which is
    more than noise. Frames lie as far apart in every sector, so that no mean over sectors makes that way shorter.
    """
    aside = ASIDE_OF_RADIUS * wall.mean_radius_mm
    first, last = zone[0] - aside, zone[1] + aside
    points = points.between(first, last)
    before, after = points.over(wall, first), points.over(wall, last)
    off = np.abs(np.where(points.z_mm < (zone[0] + zone[1]) / 2, before, after))
    is_sound, is_off = off <= Limits().seed_of_radius * wall.mean_radius_mm, off > limit
    row = np.floor((points.z_mm - first) / ROW_MM).astype(np.intp)
    ends = []
    for k in range(GAP_SECTORS):
        mine = points.sector * GAP_SECTORS // SECTORS == k
        count, good, bad = (
            np.bincount(row[mine], weights=which[mine], minlength=math.ceil((last - first) / ROW_MM))
            for which in (np.ones(len(row)), is_sound, is_off)
        )
        broken, sound = (np.flatnonzero((count >= GAP_POINTS) & (2.0 * which > count)) for which in (bad, good))
        if not len(broken):
            continue
        middle = broken[len(broken) // 2]
        low = max(sound[sound < middle], default=-1) + 1
        high = min(sound[sound > middle], default=len(count))
        inside = broken[(broken >= low) & (broken < high)]
        ends.append((low, inside[0], inside[-1] + 1, high))
    slit = float(np.median(points.slit_mm))
    if not ends:
        return max(zone[1] - zone[0] - 2.0 * slit, 0.0), 2.0 * math.hypot(slit, wall.z_step_mm / math.sqrt(6))
    sound_ends, begins, stops, sound_begins = np.array(ends).T * ROW_MM
    length = (sound_begins + stops - begins - sound_ends) / 2
    scatter = SIGMA_OF_MAD * float(np.median(np.abs(length - np.median(length))))
    ways = [float(np.median(one)) + ROW_MM for one in (begins - sound_ends, sound_begins - stops)]
    sigma = np.linalg.norm([scatter / math.sqrt(len(ends)), SLIT_KNOWN * slit, *(way / math.sqrt(12) for way in ways)])
    gap = float(np.median(stops + sound_begins) - np.median(begins + sound_ends)) / 2 - 2.0 * SLIT_LOST * slit
    return max(gap, 0.0), 2.0 * float(sigma)


def _outwards(axis: Axis, piece: int | None, at_mm: float) -> float:
    """mm by which the wall steps outwards at a joint, where it does so most round the clock; 0 or more."""
    if piece is None or axis.adjusted is None:
        return 0.0
    row, start = axis.adjusted.state.pieces[piece], axis.centreline.pieces[piece].start_mm
    hilo = float(np.hypot(*(row[OFFSET] + (at_mm - start) * row[TURN])))
    return max(float(row[RADIUS]) + hilo, 0.0)


def common_mm(wall: Wall, behind_mm: float = -math.inf) -> float:
    """What the radii of the wall behind a place may all be off alike: what points state, and what the scan's scale
    leaves."""
    return math.hypot(wall.point_mm(behind_mm), wall.scale_part * wall.mean_radius_mm)


def _of_line(
    axis: Axis, piece: int, at_mm: float, off: _Off, common_mm: float, point_mm: float
) -> list[FeatureMeasure]:
    """Hi-lo, its clock, angle, step of diameter and the radius after, with the adjustment's uncertainty, and what the
    wall beside the joint is off the line. common_mm : what all radii may be off alike, which a step has nothing of.
    point_mm : what one of the wall's points may be off: of that half is in where the line lies on either side."""
    assert axis.adjusted is not None
    row, start = axis.adjusted.state.pieces[piece], axis.centreline.pieces[piece].start_mm
    offset = row[OFFSET] + (at_mm - start) * row[TURN]
    hilo, angle = float(np.hypot(*offset)), math.degrees(float(np.hypot(*row[TURN])))
    sigma = [axis.adjusted.sigma(piece, k) for k in range(4)]
    turn_sigma = math.hypot(sigma[2], sigma[3], off.turn)
    radius_sigma = math.hypot(axis.adjusted.sigma(piece, RADIUS), off.radius_mm)
    hilo_k2 = 2.0 * math.hypot(sigma[0], sigma[1], off.lever_mm * turn_sigma, off.offset_mm, ALIKE * point_mm)
    return [
        FeatureMeasure("hilo_mm", hilo, hilo_k2),
        FeatureMeasure("hilo_clock_deg", math.degrees(math.atan2(offset[0], -offset[1])) % 360.0),
        FeatureMeasure("angle_deg", angle, 2.0 * math.degrees(turn_sigma)),
        FeatureMeasure("angle_clock_deg", math.degrees(math.atan2(row[TURN][0], -row[TURN][1])) % 360.0),
        FeatureMeasure("step_mm", 2.0 * float(row[RADIUS]), 4.0 * radius_sigma),
        FeatureMeasure(
            "radius_after_mm", axis.centreline.pieces[piece].radius_mm, 2.0 * math.hypot(radius_sigma, common_mm)
        ),
    ]
