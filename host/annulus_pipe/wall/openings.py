"""Openings in the wall: branches, and tees whose rim stands into the pipe.

Where light that should have passed the surface (`looks`) comes back from nothing, or from a face that falls steeply
away along a circle, with sound wall all about, the wall is open. A pocket has a floor: the light is found inside its
outline. A rod or a dead column has no end along the pipe. Dirt that swallows all light has no face. So a face or a
rim is asked for; a dark patch with neither is not named.

An opening is a bore at right angles to the pipe. The far half of it is lit through the hole, so its points lie on the
circle within a tenth of a millimetre. The sides and the near half are where rings end. A slit has a width, so on the
near side rings end early or late: by how much, the same for all of them, is fitted with the circle.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import BoolArray, FloatArray, arc_of
from annulus_pipe.numeric.late import ndimage, optimize
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.grid import ALIKE, Wall
from annulus_pipe.wall.looks import COLUMNS, LookPoints, Looks, looks_of
from annulus_pipe.wall.patches import grown, label_around
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.shape import harmonics

# Parts of the radius unless said otherwise. Guarded as a whole by test_openings.py.
STARTS = 0.0, 0.05, 0.1  # how far a rim may stand into the pipe, to start from
SMALLER = 1.0, 0.65, 0.5  # parts of its patch, not of the radius: a rim's flank is part of a patch, too
ABOUT = 0.4  # what is looked at about an opening, beyond twice its radius
LEVEL = 0.02  # this near to a surface is that surface (1.5 mm in a 6-inch pipe)
CELL = 0.026  # length of a cell of places of passage along the pipe
MISSING = 0.75  # part of the looks that found no wall, that makes a cell one of a patch ..
LOOKS_LEAST = 3  # .. if there were so many looks
FULL = 0.25  # part of the box about a patch that it fills: a disc fills three quarters, a crescent of it a half
ROD = 0.2  # over so much that nobody looked at, a rod's shadow, a patch goes on
SIZE_LEAST = 0.12  # of a patch and of a diameter: less is a slit's width
SIZE_MOST = 1.6  # .. and more is no opening but an end
GATES = 0.08, 0.06, 0.04, 0.03  # how far from the circle a face may lie, in one round of the fit after the other
SLIT = 0.04  # half a slit's width on the wall: how early or late rings may end, standard deviation
RIM_WIDTH = 0.15  # of a tee's rim, at most
RIMS = 0.04, 0.08, 0.12  # widths of a rim, to start from
RIM_LEAST = 0.03  # of a rim's height, to start from it: lower ones hide too little to lead a patch astray
EDGE = 0.013  # standard deviation: where a ring ends
LEAST_MM = 1e-9  # from a circle's centre: nearer there is no direction to it
FACE = 0.0013  # standard deviation of a face, at least
# Standard deviations of what all of a circle, or a rim, have in common. Blind seeds 1 to 6: k = 2 of 36 diameters held
# for 89 % without the first; the rims of 17 tees were off by 0.0058 rms.
CIRCLE = 0.003  # of a circle's radius
RIM = 0.006  # of a rim's height
ROUND = 0.01  # a face that is farther from its circle is none, rms
OPEN_LEAST = 0.6  # of the looks inside, part that found nothing
FLOOR_MOST = 0.05  # points inside for each look inside: with more it has a floor ..
FLOOR_LOOKS = (
    0.35  # .. if so large a part of the looks has any: a floor sends all of them back; and no face tells a bore
)
SOUND_LEAST = 0.6  # of the looks about it, part that found wall, in three of four of its sides
# Only its circle shows that it is a branch: it is listed as one where the circle is known. Of nine branches of the
# blind seeds 1 to 6 the diameter's k = 2 was 0.03 to 0.07 of it, of three that were bumps and pockets 0.09, 0.15, 0.22.
CIRCLE_KNOWN = 0.08  # part of its diameter
FACE_LOOKS = 2  # what makes a face: so many looks that saw it ..
FACE_ARC_DEG = 60.0  # .. over so much of the circle
RIM_SIDES = 0.5  # part of the sides at which a rim stands, for a tee
CLOCK_DEG: FloatArray = (np.arange(COLUMNS, dtype=np.float64) + 0.5) * (360.0 / COLUMNS)
SIDES = 8  # a circle is looked at in so many parts


_ring_ends = door(
    "ring_ends",
    "i8[m] first",
    "f8[n] angle",
    "i8[n] column",
    "f8[n]! room",
    "b1[l,a] inside",
    "b1[l,a] open_ended",
    "i8[a] order",
    "i8[e,2]! at",
    "f8[e]! end",
    returns="i8",
)


@dataclass(frozen=True, slots=True)
class _Bore:
    """A bore at right angles to the pipe: its axis' place, its radius, how far its rim stands in and reaches out."""

    clock_deg: float
    z_mm: float
    radius_mm: float
    wall_mm: float  # radius of the pipe's shape where it is
    stands_mm: float = 0.0  # 0 for a branch
    stands_sigma_mm: float = 0.0
    rim_mm: float = 0.0  # the rim's outer radius
    may_stand: bool = False  # some of its rim stands in, and not enough of it to measure
    late_mm: float = 0.0
    sigma_mm: float = np.inf  # of the radius
    scatter_mm: float = np.inf  # of the face about the circle
    looks: int = 0  # that saw a face
    arc_deg: float = 0.0  # covered by it

    def aside(self, clock_deg: FloatArray) -> FloatArray:
        """Angle round the pipe from the bore's axis, radians."""
        return np.radians((clock_deg - self.clock_deg + 180.0) % 360.0 - 180.0)


def find_openings(
    wall: Wall, profiles: Sequence[Profile], calibration: Calibration, seen: tuple[LookPoints, Looks] | None = None
) -> tuple[tuple[Feature, ...], BoolArray]:
    """Branches and tees, and (Z, A) the cells of the wall they explain: inside there is no wall.

    Parameters
    ----------
    profiles : aligned, all their points: what other frames contradict is, in an opening, its face. seen : their
        `looks_of`, where it is known already.

    Notes
    -----
    Place and inner_d_mm are of the circle, seen along the bore's axis. Of a tee, protrusion_mm is how far its rim, cut
    square, stands into the pipe, and length and arc are those of the rim's outside. A rim cut square stands out before
    and behind a wide bore only: a branch with some of that has a protrusion_mm of NaN.
    """
    explained = np.zeros(wall.radius_mm.shape, dtype=bool)
    if not len(calibration.rings) or not any(p.pose is not None and len(p.points_mm) for p in profiles):
        return (), explained
    points, looks = looks_of(profiles, wall, calibration) if seen is None else seen
    found: list[_Bore] = []
    size = wall.mean_radius_mm
    for start, begins, by_rim in _starts(wall, looks, size):
        if any(_within(start, bore) for bore in found):
            continue
        seen = _about(start, points, looks, size)
        for begin in begins:
            bore = _fitted(begin, *seen, size)
            if bore is None or any(_within(bore, other) for other in found):
                continue
            if _is_open(bore, *seen, size, face_only=by_rim):
                found.append(bore)
                break
    for bore in found:
        explained |= _cells(bore, wall)
    return tuple(_feature(bore, wall.point_mm(), wall.scale_part) for bore in found), explained


def _starts(wall: Wall, looks: Looks, size: float) -> Iterator[tuple[_Bore, list[_Bore], bool]]:
    """Where an opening may be, the bores to begin with there, and whether it is what stands in, which may be a rim."""
    for stands in STARTS:
        for start in _patches(looks, wall, stands * size):
            begins = []
            for part in SMALLER:
                shorter = (1.0 - part) * start.radius_mm if stands else 0.0  # the flank lies before the bore
                begins.append(replace(start, z_mm=start.z_mm + shorter, radius_mm=part * start.radius_mm))
            yield start, begins, False
    for start in _standing(wall, size):
        yield start, [replace(start, radius_mm=start.radius_mm - rim * size) for rim in RIMS], True


def _standing(wall: Wall, size: float) -> Iterator[_Bore]:
    """What stands in, as the outside of a rim. A high rim's own shadow makes a patch far longer than its bore: only
    its sides and its near end are seen."""
    high = wall.seen & (-wall.residual_mm() > RIM_LEAST * size)
    cells = [max(1, round(RIM_WIDTH * size / one)) for one in (wall.z_step_mm, np.radians(wall.clock_step_deg) * size)]
    label, n = label_around(grown(high, *(one // 2 for one in cells), closes=False))
    for i in range(1, n + 1):
        rows, columns = np.nonzero(high & (label == i))
        if not len(rows):
            continue
        start, arc = arc_of(np.bincount(columns, minlength=high.shape[1]) > 0, wall.clock_step_deg)
        outside = size * float(np.sin(np.radians(min(arc, 180.0) / 2)))
        if not SIZE_LEAST * size < 2 * outside < SIZE_MOST * size:
            continue
        middle, clock = float(wall.z_mm[rows.min()]) - wall.z_step_mm / 2 + outside, (start + arc / 2) % 360.0
        shape = np.array([np.interp(middle, wall.z_mm, part) for part in wall.shape_mm.T])
        radius = float((shape * harmonics(np.array([clock]))[0]).sum())
        stands = float(np.percentile(-wall.residual_mm()[rows, columns], 75))
        yield _Bore(clock, middle, outside, radius, stands)


def _within(bore: _Bore, other: _Bore) -> bool:
    """Whether the middle of one lies in the other."""
    across = other.wall_mm * float(np.sin(other.aside(np.array([bore.clock_deg]))[0]))
    return float(np.hypot(across, bore.z_mm - other.z_mm)) < other.radius_mm


def _about(bore: _Bore, points: LookPoints, looks: Looks, size: float) -> tuple[LookPoints, Looks]:
    """The points and looks of it and of the wall around it."""
    reach = 2 * bore.radius_mm + ABOUT * size
    some = np.flatnonzero(np.abs(points.z_mm - bore.z_mm) < reach)
    some = some[np.abs(bore.aside(points.clock_deg[some])) < reach / size]
    near = np.abs(looks.z_mm[:, :: COLUMNS // 12] - bore.z_mm).min(axis=1) < reach
    number = np.cumsum(near) - 1
    some = some[near[points.look[some]]]
    number = number[points.look[some]]
    kept = LookPoints(
        points.radius_mm[some], points.clock_deg[some], points.z_mm[some], points.departure_mm[some], number
    )
    return kept, Looks(looks.z_mm[near], looks.run[near], looks.departure_mm[near], looks.lit[near], looks.view[near])


def _patches(looks: Looks, wall: Wall, stands_mm: float) -> list[_Bore]:
    """Where looks that pass a surface so far inside the pipe found no wall, one beside another: what to start from."""
    size, first = wall.mean_radius_mm, float(wall.z_mm[0])
    step = CELL * size
    rows = int((wall.z_mm[-1] - first) / step) + 1
    row = (looks.z_mm - stands_mm * looks.run - first) / step
    inside = looks.lit & (row >= 0) & (row < rows)
    cell = np.floor(row).astype(np.int64) * COLUMNS + np.arange(COLUMNS)

    part = 1.0 / np.bincount(looks.view)[looks.view]

    def around(which: BoolArray) -> FloatArray:
        some = inside & which
        # frames from one place look once: each counts for its part of that look
        count = (
            np.bincount(cell[some], np.broadcast_to(part[:, None], some.shape)[some], rows * COLUMNS)
            .reshape(rows, COLUMNS)
            .astype(np.float64)
        )
        wide = np.pad(count, ((0, 0), (1, 1)), mode="wrap")
        return np.asarray(ndimage.convolve(wide, np.ones((3, 3)), mode="constant")[:, 1:-1])

    wall_met = looks.departure_mm <= LEVEL * size
    if stands_mm:  # what is met between wall and rim may be the face of the bore
        off = np.abs(looks.departure_mm)
        wall_met = (off <= LEVEL * size) | (np.abs(off - stands_mm) <= 0.5 * STARTS[1] * size)
    every, missed = around(looks.lit), around(~wall_met)
    patch = (missed >= MISSING * every) & (every >= LOOKS_LEAST)
    reach = round(ROD / 2 / (2 * np.pi) * COLUMNS)  # each side of a rod's shadow
    joined = ndimage.binary_closing(
        np.pad(patch, ((0, 0), (2 * reach, 2 * reach)), mode="wrap"), np.ones((1, 2 * reach + 1), dtype=bool)
    )
    label, n = label_around(patch | (joined[:, 2 * reach : -2 * reach] & (every < LOOKS_LEAST)))
    wide_mm = 2 * np.pi * size / COLUMNS
    rows_, columns = np.nonzero(label)
    number = label[rows_, columns]
    order = np.argsort(number, kind="stable")
    ends = np.cumsum(np.bincount(number, minlength=n + 1))
    out = []
    for begin, end in pairwise(ends):
        r, c = rows_[order[begin:end]], columns[order[begin:end]]
        long, wide = len(np.unique(r)) * step, len(np.unique(c)) * wide_mm
        if min(long, wide) < SIZE_LEAST * size or max(long, wide) > SIZE_MOST * size:
            continue
        if (end - begin) * step * wide_mm < FULL * long * wide:
            continue
        clock = np.degrees(np.angle(np.exp(2j * np.pi * (c + 0.5) / COLUMNS).mean())) % 360.0
        middle = first + step * (float(r.mean()) + 0.5)
        shape = np.array([np.interp(middle, wall.z_mm, part) for part in wall.shape_mm.T])
        radius = float((shape * harmonics(np.array([clock]))[0]).sum())
        out.append(_Bore(float(clock), middle, 0.25 * (long + wide), radius, stands_mm))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Circle:
    """What says where a bore's circle is: ends (E, 2) of rings, faces at across and along (F,), which scatter by
    `each`. Its numbers are along, across, radius and how late rings end."""

    ends: FloatArray
    across: FloatArray
    along: FloatArray
    each: float
    size: float

    def left(self, v: FloatArray) -> FloatArray:
        """Of the circle, in standard deviations."""
        at = np.maximum(np.abs(self.ends[:, 1] - v[0]) + v[3], 0.0)
        of_ends = (np.hypot(self.ends[:, 0] - v[1], at) - v[2]) / (EDGE * self.size)
        of_faces = (np.hypot(self.across - v[1], self.along - v[0]) - v[2]) / self.each
        return np.concatenate([of_ends, of_faces, [v[3] / (SLIT * self.size)]])

    def slopes(self, v: FloatArray) -> FloatArray:
        """(E + F + 1, 4) of that."""
        aside, ahead = self.ends[:, 0] - v[1], self.ends[:, 1] - v[0]
        at = np.maximum(np.abs(ahead) + v[3], 0.0)
        far = np.maximum(np.hypot(aside, at), LEAST_MM)
        x, z = self.across - v[1], self.along - v[0]
        away = np.maximum(np.hypot(x, z), LEAST_MM)
        of_ends = np.stack([-at * np.sign(ahead) / far, -aside / far, -np.ones(len(far)), at / far], axis=1)
        of_faces = np.stack([-z / away, -x / away, -np.ones(len(away)), np.zeros(len(away))], axis=1)
        of_late = [[0.0, 0.0, 0.0, 1.0 / (SLIT * self.size)]]
        return np.concatenate([of_ends / (EDGE * self.size), of_faces / self.each, of_late])


def _fitted(bore: _Bore, points: LookPoints, looks: Looks, size: float) -> _Bore | None:
    """The circle through faces and ends of rings; None where it runs away."""
    for gate in GATES:
        angle = bore.aside(points.clock_deg)
        rim = _rim(bore, points, looks, size, angle)
        bore = rim if rim.stands_mm or gate < GATES[0] else bore
        ends = _ends(bore, points, looks, size, angle)
        along = points.z_mm - bore.z_mm
        near = np.flatnonzero((along > 0.1 * bore.radius_mm) & (along < bore.radius_mm + gate * size))
        angle, along, departure = angle[near], along[near], points.departure_mm[near]
        across = points.radius_mm[near] * np.sin(angle)
        off = np.hypot(across, along) - bore.radius_mm
        face = (np.cos(angle) > 0) & (np.abs(off) < gate * size) & (departure > _level(bore, angle) + LEVEL * size)
        if bore.stands_mm:  # the wall beside a narrow rim is no face
            face &= np.abs(departure) > LEVEL * size
        across, along, number = across[face], along[face], looks.view[points.look[near[face]]]
        if len(ends) + len(across) < 8:
            return None
        scatter = max(robust_sigma(off[face] - np.median(off[face])), FACE * size) if face.any() else FACE * size
        each = scatter * np.sqrt(max(len(number) / max(len(np.unique(number)), 1), 1.0))  # one look errs as one

        seen = _Circle(ends, across, along, each, size)
        start = np.array([0.0, 0.0, bore.radius_mm, bore.late_mm])
        fit = optimize.least_squares(seen.left, start, jac=seen.slopes, loss="soft_l1")
        moved, aside, radius, late = (float(value) for value in fit.x)
        if not SIZE_LEAST / 2 * size < radius < SIZE_MOST / 2 * size or max(abs(moved), abs(aside)) > bore.radius_mm:
            return None
        covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
        rest = np.hypot(across - aside, along - moved) - radius
        bore = replace(
            bore,
            clock_deg=(bore.clock_deg + float(np.degrees(np.arcsin(aside / bore.wall_mm)))) % 360.0,
            z_mm=bore.z_mm + moved,
            radius_mm=radius,
            late_mm=late,
            sigma_mm=float(np.sqrt(covariance[2, 2])),
            scatter_mm=float(np.sqrt(np.mean(rest**2))) if len(rest) else np.inf,
            looks=len(np.unique(number)),
            arc_deg=float(np.degrees(np.ptp(np.arctan2(across, along)))) if len(across) else 0.0,
        )
    return bore


def _level(bore: _Bore, angle: FloatArray) -> FloatArray:
    """Departure from the pipe's shape of the surface the opening is in: the wall, or a rim cut square."""
    if not bore.stands_mm:
        return np.zeros_like(angle)
    return np.asarray(np.minimum((bore.wall_mm - bore.stands_mm) / np.maximum(np.cos(angle), 0.2) - bore.wall_mm, 0.0))


def _rim(bore: _Bore, points: LookPoints, looks: Looks, size: float, angle: FloatArray) -> _Bore:
    """The bore with the rim that stands about it, or without. angle (N,) : of the points, aside from the bore.

    Its height is taken at the sides, where it runs along the pipe and a slit's width blurs nothing.
    """
    across, along = points.radius_mm * np.sin(angle), points.z_mm - bore.z_mm
    away = np.hypot(across, along)
    near = (np.cos(angle) > 0) & (away > 0.9 * bore.radius_mm)
    inwards = near & (points.departure_mm < -LEVEL * size)
    about = near & (away < bore.radius_mm + LEVEL * 3 * size)
    standing = [float(inwards[part].mean()) >= 0.5 for part in _sides(about, across, along) if len(part) > 5]
    beside = inwards & (np.abs(along) < 0.7 * bore.radius_mm) & (away < bore.radius_mm + RIM_WIDTH * size)
    if sum(standing) < RIM_SIDES * SIDES or np.count_nonzero(beside) < 10:
        return replace(bore, stands_mm=0.0, rim_mm=0.0, may_stand=any(standing))
    height = bore.wall_mm - points.radius_mm * np.cos(angle)
    high = beside & (height > 0.85 * np.percentile(height[beside], 75))
    sigma = robust_sigma(height[high] - np.median(height[high])) / np.sqrt(
        len(np.unique(looks.view[points.look[high]]))
    )
    outside = float(np.percentile(away[high], 97))
    stands = float(np.median(height[high]))
    return replace(bore, stands_mm=stands, stands_sigma_mm=float(sigma), rim_mm=outside, may_stand=False)


def _sides(which: BoolArray, across: FloatArray, along: FloatArray) -> list[NDArray[np.intp]]:
    """Indices of those in each of SIDES parts of the circle."""
    index = np.flatnonzero(which)
    part = ((np.arctan2(across[index], along[index]) / (2 * np.pi) + 0.5) * SIDES).astype(np.int64) % SIDES
    return [index[part == k] for k in range(SIDES)]


def _passing(bore: _Bore, looks: Looks, size: float) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Where looks pass the surface the opening is in, across (A,) and along (L, A) from its centre, mm; whether they
    found no surface there (L, A), and whether it is known (L, A)."""
    angle = bore.aside(CLOCK_DEG)
    level = _level(bore, angle)
    across = (bore.wall_mm + level) * np.sin(angle)
    along = looks.z_mm + level * looks.run - bore.z_mm
    away = np.hypot(across, along)
    limit = np.where(away < bore.radius_mm + SLIT * size, level, 0.0) + LEVEL * size  # about a rim the wall is lower
    missed = ~(looks.departure_mm <= limit)
    return across, along, missed, looks.lit & (np.cos(angle) > 0.3)


def _ends(bore: _Bore, points: LookPoints, looks: Looks, size: float, angle: FloatArray) -> FloatArray:
    """(E, 2) across and along, from the centre, where rings end at the sides and the near half of the opening: half a
    direction beyond their last points."""
    across, along, missed, known = _passing(bore, looks, size)
    order = np.roll(np.arange(COLUMNS), COLUMNS // 2 - int(bore.clock_deg / 360.0 * COLUMNS))  # the axis in the middle
    along, missed, known = along[:, order], missed[:, order], known[:, order]
    inside = missed & known & (np.hypot(across[order], along) < bore.radius_mm + SLIT * size)
    column = np.minimum((points.clock_deg * (COLUMNS / 360.0)).astype(np.int64), COLUMNS - 1)
    by_look = np.argsort(points.look, kind="stable")
    first = np.searchsorted(points.look[by_look], np.arange(len(inside) + 1))
    at, end = np.empty((2 * len(inside), 2), np.int64), np.empty(2 * len(inside))
    sorted_by_look = angle[by_look], column[by_look], np.empty(len(by_look))
    there = np.ascontiguousarray(inside), np.ascontiguousarray(~known | missed), order
    count = _ring_ends(first, *sorted_by_look, *there, at, end)
    (look, last), end = at[:count].T, end[:count]
    found = np.stack([(bore.wall_mm + _level(bore, end)) * np.sin(end), along[look, last]], axis=1)
    return found[found[:, 1] < 0.1 * bore.radius_mm]


def _is_open(bore: _Bore, points: LookPoints, looks: Looks, size: float, *, face_only: bool = False) -> bool:
    """Whether nothing is inside, sound wall or rim about it, and a round face or a rim to show for it. face_only : what
    it was begun with stands in anyhow, as a bump or a heap of silt does, whose shadow is dark as well."""
    across, along, missed, known = _passing(bore, looks, size)
    away = np.hypot(across, along)
    # what passes just before the face meets it at the level of the wall
    inside = known & (
        np.hypot(across, np.maximum(along, along + 0.05 * size * (along > 0))) < bore.radius_mm - 0.05 * size
    )
    passed = np.count_nonzero(inside)
    if (
        passed < 10
        or len(np.unique(looks.view[inside.any(axis=1)])) < LOOKS_LEAST
        or missed[inside].mean() < OPEN_LEAST
    ):
        return False
    angle = bore.aside(points.clock_deg)
    within = np.hypot(points.radius_mm * np.sin(angle), points.z_mm - bore.z_mm) < bore.radius_mm - 0.05 * size
    within &= np.cos(angle) > 0
    by_looks = len(np.unique(points.look[within])) / np.count_nonzero(inside.any(axis=1))
    has_floor = np.count_nonzero(within) > FLOOR_MOST * passed
    if has_floor and by_looks > FLOOR_LOOKS:
        return False
    about = known & (away > bore.radius_mm + 0.06 * size) & (away < bore.radius_mm + 0.25 * size)
    wide = np.broadcast_to(across, away.shape)
    sides = _sides(about.ravel(), wide.ravel(), along.ravel())
    sound = [float(1.0 - missed.ravel()[part].mean()) >= SOUND_LEAST for part in sides if len(part) > 5]
    if sum(sound) < 0.75 * SIDES:
        return False
    if not bore.stands_mm and 2 * bore.sigma_mm > CIRCLE_KNOWN * bore.radius_mm:
        return False
    face = bore.looks >= FACE_LOOKS and bore.arc_deg >= FACE_ARC_DEG and bore.scatter_mm < ROUND * size
    return bool(face or (bore.stands_mm and not (face_only or has_floor)))


def _feature(bore: _Bore, point_mm: float, scale_part: float) -> Feature:
    """point_mm : what a point of the wall may be off; half of it is common to all points of a rim. scale_part : of
    the radius, what all of the scan's may be off alike."""
    reach = bore.rim_mm if bore.stands_mm else bore.radius_mm
    arc = 2 * float(np.degrees(np.arcsin(min(reach / bore.wall_mm, 1.0))))
    radius_sigma = np.linalg.norm([bore.sigma_mm, CIRCLE * bore.wall_mm, scale_part * bore.radius_mm])
    measures = [FeatureMeasure("inner_d_mm", 2 * bore.radius_mm, 2 * 2 * float(radius_sigma))]
    if bore.stands_mm:
        sigma = np.linalg.norm([bore.stands_sigma_mm, RIM * bore.wall_mm, ALIKE * point_mm])
        measures.append(FeatureMeasure("protrusion_mm", bore.stands_mm, 2 * float(sigma)))
    elif bore.may_stand:
        measures.append(FeatureMeasure("protrusion_mm", math.nan))
    kind = FeatureKind.TEE if bore.stands_mm else FeatureKind.BRANCH
    return Feature(kind, bore.z_mm, 2 * reach, bore.clock_deg, arc, tuple(measures))


def _cells(bore: _Bore, wall: Wall) -> BoolArray:
    """(Z, A) the opening, its rim, and as far along the pipe as a slit's width blurs them."""
    size = wall.mean_radius_mm
    angle = bore.aside(wall.clock_deg)
    along = np.maximum(np.abs(wall.z_mm - bore.z_mm) - 2 * SLIT * size, 0.0)
    reach = max(bore.radius_mm, bore.rim_mm) + LEVEL * size
    return np.asarray((np.cos(angle) > 0) & (np.hypot(bore.wall_mm * np.sin(angle), along[:, None]) < reach))
