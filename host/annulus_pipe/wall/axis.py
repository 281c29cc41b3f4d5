"""The pipe's own axis: where it jumps, turns, bends and changes its radius, found from the frames that saw it.

One straight cylinder is adjusted to all frames. Where a joint, a bend or a taper that begins at some place would
explain more of what is left than errors do, and more than an inspector passes over, a new piece begins: from the near
end on, one after the other, each of the kind that explains its stretch best. Then all is adjusted once more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.adjustment import (
    BIAS,
    CURVATURE,
    HEAD,
    OFFSET,
    PIECE,
    RADIUS,
    SHAPE,
    START,
    TAPER,
    TURN,
    Adjusted,
    AdjustmentState,
    Sightings,
    adjust,
    by_head,
    cost_of,
    locate,
    sightings,
    unmodelled,
)
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.footprint import centred, slit_angles
from annulus_pipe.wall.gyro import NO_TURNS, Turns, weigh
from annulus_pipe.wall.profile import Profile

# Guarded by tests/unit/wall/test_axis.py (pipes with and without) and by the scenes of tests/scenes.
STEP_OF_RADIUS = 0.05  # of the radius: between places that are tried
SHOWN = 100.0  # chi-square that a piece's beginning must explain ..
ENDS = 25.0  # .. and the end of a bend or a taper, which ends somewhere
# What an inspector passes over, and what calibrations leave: sound straight scans show a tenth of it.
OFFSET_OF_RADIUS = 0.002  # of the radius: hi-lo
TURN_LEAST = 0.0025  # radians
RADIUS_STEP = 0.0015  # of the radius
# Standard deviations of a joint's hi-lo, turn or step: a swing in the pipe's ovality looks like 2.6 of a turn.
SURE = 4.0
BEND_OF_RADIUS = 0.012  # radians a radius; a bend wider than 80 radii is a straight pipe's sag
TAPER_LEAST = 0.003  # mm a mm
AHEAD_OF_RADIUS = 2.0  # of the radius: how far past its beginning a piece is looked at before its kind is decided
BACK_OF_RADIUS = 6.0  # of the radius: heads this far back see what is decided
GROSS_OF_RADIUS = 0.01  # of the radius: what is farther off both walls is of neither
JOINT_OF_RADIUS = 0.15  # of the radius: how far a joint reaches each way
JOINT_STEP_MM = 1.0  # between places tried for a joint
SHORTEST_OF_RADIUS = 0.5  # of the radius: a bend or taper
OVER_OF_RADIUS = 0.03  # of the radius: what a reducer changes it by at least; a flank comes back to within a step
NUMBER_COST = 10.0  # chi-square that one more number must explain
PIECES_MOST = 256
COARSE = 24  # sectors of a ring, to search with
FINE = 72  # .. and to measure with ..
FRAMES_FINE = 1000  # .. as long as there are no more frames; bounds memory
BLOCK = 64  # places looked at before it is asked whether something began
SIGHTINGS_LEAST = 20  # of a frame
RINGS_LEAST = 3  # fewer do not tell how a pipe goes on within one frame
ROUND_LEAST = 0.6  # of the circle seen before and behind a place, for anything to begin there: an arc misleads poses
ROUND_OF_RADIUS = 0.5  # of the radius: so far before and behind it
HELD = (1e-3, 1e-3, 1e-6, 1e-6, 1e9)  # added to a head's normal equations, of radians and mm: the roll stays
LANES = 8  # points that a loop may work on beyond a frame's last

_SEEN = "f8[n] z", "f8[n,2] direction", "f8[n] weight", "f8[n] residual", "f8[n,5] lean"
_begin_normals = door(
    "begin_normals",
    "i8[f] first",
    "f8[f] low",
    "f8[f] high",
    *_SEEN,
    "f8[5] held_by",
    "f8[g] places",
    "f8[f,5,5]! heads",
    "f8[f,5]! pull",
    "f8[22,m]! room",
    "f8[g,8,8]! normals",
    "f8[g,8]! rights",
)


class Begins(StrEnum):
    """What begins with a piece."""

    STRAIGHT = "straight"  # the scan, or the end of a bend or taper
    JOINT = "joint"
    BEND = "bend"
    TAPER = "taper"


KINDS = (Begins.JOINT, Begins.BEND, Begins.TAPER)
# of the eight numbers of `explained`: offset 2, turn 2, curvature 2, radius, taper
NUMBERS = {Begins.JOINT: [0, 1, 2, 3, 6], Begins.BEND: [4, 5], Begins.TAPER: [7]}


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """`profiles` in pipe coordinates, each pose against the centre line where its head is; the centre line; what began
    with each of its pieces; the adjustment, for its uncertainties, None where the pipe is one straight piece; what of
    the sensors was not believed."""

    profiles: tuple[Profile, ...]
    centreline: Centreline
    begins: tuple[Begins, ...]
    adjusted: Adjusted | None
    findings: tuple[Finding, ...] = ()


def find_axis(profiles: Sequence[Profile], cones: Sequence[Cone], turns: Turns = NO_TURNS) -> Axis:
    """The centre line of the pipe that all frames saw.

    Parameters
    ----------
    profiles : each in the frame of its own pose, a straight pipe assumed. cones : of the rings, in the camera frame.
    turns : what a gyroscope said, of every frame of the scan; asked where the pipe bends.

    Notes
    -----
    A scan of a straight, even pipe comes back unchanged, to the bit. So does one of fewer than three rings, which
    cannot tell a kink from a lean.
    """
    seen = sightings(profiles, cones, COARSE)
    as_it_was = Axis(
        tuple(profiles), Centreline([Piece(0.0, seen.radius_mm if seen else 1.0)]), (Begins.STRAIGHT,), None
    )
    if seen is None or seen.rings < RINGS_LEAST or len(seen.first) < 2:
        return as_it_was
    found, begins = _search(seen)
    if len(begins) == 1:
        return as_it_was
    fine = sightings(profiles, cones, FINE if len(seen.first) <= FRAMES_FINE else COARSE)
    assert fine is not None
    found = adjust(fine, found.state, _free(begins), scales_mm=(1.0, 0.5))
    for i in (i for i, kind in enumerate(begins) if kind is Begins.JOINT):
        found = adjust(fine, _placed(fine, found.state, i), _free(begins))
    found, begins = _pruned(fine, found, begins)
    if len(begins) == 1:
        return as_it_was
    found, begins = _ended(fine, found, begins)
    profiles, fine, found = _centred(profiles, cones, fine, found, _free(begins))
    findings: tuple[Finding, ...] = ()
    if any(piece.is_bent for piece in found.state.centreline().pieces):
        found = replace(found, covariance=found.covariance + unmodelled(fine, found))
        found, findings = weigh(fine, found, np.array([profiles[i].frame for i in fine.which]), turns)
    return Axis(_moved(profiles, fine, found.state), found.state.centreline(), tuple(begins), found, findings)


def _centred(
    profiles: Sequence[Profile], cones: Sequence[Cone], seen: Sightings, found: Adjusted, free: BoolArray
) -> tuple[Sequence[Profile], Sightings, Adjusted]:
    """All three, points where the middles of their slits are on the wall that was found. Once: the wall changes by less
    than a hundredth of what moves them."""
    of_rings = slit_angles(profiles, seen.rings)
    if not of_rings.any():
        return profiles, seen, found
    moved = centred(seen, found.state, cones, seen.points_mm, seen.frame, seen.ring, of_rings[seen.ring])
    out = list(profiles)
    for number, i in enumerate(seen.which):
        one = profiles[i]
        assert one.pose is not None
        camera, ring = one.pose.to_camera(one.points_mm.astype(np.float64), one.z_mm), one.ring.astype(np.intp)
        frame = np.full(len(ring), number)
        points = centred(seen, found.state, cones, camera, frame, ring, of_rings[ring])
        out[i] = replace(one, points_mm=one.pose.to_pipe(points, one.z_mm).astype(np.float32))
    seen = replace(seen, points_mm=moved)
    return out, seen, adjust(seen, found.state, free)


def explained(
    seen: Sightings, now: Adjusted, lean: FloatArray, at_mm: FloatArray, upto_mm: float = np.inf
) -> tuple[FloatArray, FloatArray]:
    """Chi-square (G, 3) that a joint, bend or taper beginning at each of some places would explain of what is left, and
    how large it would be: (G, 8) offset 2, turn 2, curvature 2, radius, taper, in mm and radians.

    Linear, about where all is now: heads may follow, and are eliminated. lean : (N, HEAD) what those do, of `by_head`.
    """
    z = now.where.chainage_mm
    weight = np.where(z < upto_mm, now.weight, 0.0) / now.unit**2
    low, high = np.minimum.reduceat(z, seen.first), np.minimum(np.maximum.reduceat(z, seen.first), upto_mm)
    frames, size = len(seen.first), len(at_mm)
    most = int(np.diff(seen.first, append=len(z)).max())
    room = np.empty((frames, HEAD, HEAD)), np.empty((frames, HEAD)), np.empty((22, most + LANES))
    normal, right = np.empty((size, 8, 8)), np.empty((size, 8))
    of_points = (z, now.where.direction, weight, now.where.residual_mm, lean)
    _begin_normals(seen.first, low, high, *of_points, np.array(HELD), at_mm, *room, normal, right)
    gain, sizes = np.zeros((size, 3)), np.zeros((size, 8))
    rows = np.flatnonzero(((high > at_mm[:, None]) & (low < at_mm[:, None])).any(axis=1))
    for j, kind in enumerate(KINDS):
        pick = NUMBERS[kind]
        own = normal[rows][:, pick][:, :, pick]
        own = own + 1e-6 * own * np.eye(len(pick)) + 1e-9 * np.eye(len(pick))
        found = np.linalg.solve(own, -right[rows][:, pick, None])[:, :, 0]
        sizes[rows[:, None], pick] = found
        gain[rows, j] = -(right[rows][:, pick] * found).sum(axis=1)
    return gain, sizes


def _matters(size: FloatArray, radius: float) -> BoolArray:
    """(G, 3) whether a joint, a bend, a taper of that size is one an inspector would name."""
    joint = (
        (np.hypot(size[:, 0], size[:, 1]) > OFFSET_OF_RADIUS * radius)
        | (np.hypot(size[:, 2], size[:, 3]) > TURN_LEAST)
        | (np.abs(size[:, 6]) > RADIUS_STEP * radius)
    )
    bend = np.hypot(size[:, 4], size[:, 5]) * radius > BEND_OF_RADIUS
    return np.stack([joint, bend, np.abs(size[:, 7]) > TAPER_LEAST], axis=1)


def _pruned(seen: Sightings, found: Adjusted, begins: list[Begins]) -> tuple[Adjusted, list[Begins]]:
    """Without pieces that explain nothing: with which nothing begins that matters, or so short that what is before and
    after them does as well."""
    i = 1
    while i < len(begins):
        fewer = [*begins[:i], *begins[i + 1 :]]
        short = _lengths(found)[i] < SHORTEST_OF_RADIUS * seen.radius_mm
        # a bend that began where enough was seen ends somewhere, however little was seen behind its end
        round_it = begins[i] is Begins.STRAIGHT or _seen_round(seen, found, found.state.pieces[i : i + 1, START])[0]
        if round_it and not short and _begins_something(found, i, begins[i], seen.radius_mm):
            i += 1
            continue
        without = adjust(seen, _less(found.state, i), _free(fewer), scales_mm=(5.0, 2.0, 1.0, 0.5))
        # a bead's, which comes back; a reducer does not, and no pipe bends so shortly
        flank = short and (begins[i] is Begins.BEND or (begins[i] is Begins.TAPER and not _goes_over(found, i)))
        if round_it and short and not flank and without.cost > found.cost + SHOWN:
            i += 1
            continue
        found, begins, i = without, fewer, 1
    return found, begins


def _ended(seen: Sightings, found: Adjusted, begins: list[Begins]) -> tuple[Adjusted, list[Begins]]:
    """With the end of a bend or taper for a joint at which it ends, where that explains as much: a turn a little before
    the end is what is left of the bend."""
    for i, kind in enumerate(begins):
        if kind is not Begins.JOINT or not (found.state.pieces[i - 1, [*range(8)[CURVATURE], TAPER]] != 0).any():
            continue
        fewer = [*begins[:i], Begins.STRAIGHT, *begins[i + 1 :]]
        pieces = found.state.pieces.copy()
        pieces[i, OFFSET] = pieces[i, TURN] = pieces[i, RADIUS] = 0.0
        without = adjust(seen, replace(found.state, pieces=pieces), _free(fewer), scales_mm=(1.0, 0.5))
        if without.cost <= found.cost + NUMBER_COST * len(NUMBERS[Begins.JOINT]):
            found, begins = without, fewer
    return found, begins


def _lengths(found: Adjusted) -> FloatArray:
    return np.append(np.diff(found.state.pieces[:, START]), np.inf)


def _goes_over(found: Adjusted, i: int) -> bool:
    """Whether the radius behind a piece stays another one than before it, by more than two pipes of one size differ."""
    line, begins, ends = found.state.centreline(), *np.cumsum([found.state.pieces[i, START], _lengths(found)[i]])
    radius = line.radius_at(np.array([begins, ends + SHORTEST_OF_RADIUS * line.pieces[i].radius_mm]))
    return bool(abs(radius[1] - radius[0]) > OVER_OF_RADIUS * radius[0])


def _begins_something(found: Adjusted, i: int, kind: Begins, radius: float) -> bool:
    """Whether a piece differs enough from the one before it; at a joint, by more than its uncertainty."""
    pieces = found.state.pieces
    size = np.concatenate(
        [
            pieces[i, OFFSET],
            pieces[i, TURN],
            pieces[i, CURVATURE] - pieces[i - 1, CURVATURE],
            [pieces[i, RADIUS], pieces[i, TAPER] - pieces[i - 1, TAPER]],
        ]
    )
    if kind is Begins.JOINT:
        for numbers in ([0, 1], [2, 3], [6]):
            sigma = float(np.linalg.norm([found.sigma(i, k) for k in numbers]))
            if np.linalg.norm(size[numbers]) < SURE * sigma:
                size[numbers] = 0.0
    return bool(_matters(size[None], radius).any())


def _less(state: AdjustmentState, piece: int) -> AdjustmentState:
    """The state without a piece; what comes after it keeps its radius."""
    radii, pieces = state.radii_mm(), np.delete(state.pieces, piece, axis=0)
    if piece < len(pieces):
        before = state.pieces[piece - 1]
        length = state.pieces[piece + 1, START] - before[START]
        pieces[piece, RADIUS] = radii[piece + 1] - radii[piece - 1] - before[TAPER] * length
    return replace(state, pieces=pieces)


def _search(seen: Sightings) -> tuple[Adjusted, list[Begins]]:
    step = STEP_OF_RADIUS * seen.radius_mm
    row = np.zeros((1, PIECE))
    row[0, RADIUS], row[0, START] = seen.radius_mm, seen.chainage_mm[0] - seen.radius_mm
    begins = [Begins.STRAIGHT]
    now = adjust(seen, AdjustmentState(row, np.zeros((seen.rings, BIAS)), seen.heads), _free(begins))
    near_mm = float(np.percentile(now.where.chainage_mm, 1)) + ROUND_OF_RADIUS * seen.radius_mm
    part, heads = _up_to(seen, now, near_mm)
    near = adjust(part, replace(now.state, heads=now.state.heads[heads]), _free(begins))
    if abs(near.state.pieces[0, RADIUS] - now.state.pieces[0, RADIUS]) > OVER_OF_RADIUS * seen.radius_mm:
        # most of the scan shows another pipe than it began in: from the near end on, as all else
        everywhere = now.state.heads.copy()
        everywhere[heads] = near.state.heads
        state = replace(near.state, heads=everywhere)
        now = adjust(seen, state, np.zeros((1, PIECE), np.bool_), scales_mm=(5.0, 2.0))
    since = -np.inf
    while len(begins) < PIECES_MOST:
        low, high = np.percentile(now.where.chainage_mm, [1, 99]) + np.array([2 * step, -2 * step])
        places = np.arange(max(low, since), high, step)
        places = places[_seen_round(seen, now, places)]
        if not len(places):
            break
        needed = [ENDS if begins[-1] is kind and kind is not Begins.JOINT else SHOWN for kind in KINDS]
        first = _first(seen, now, places, np.array(needed))
        if first is None:
            break
        began = _begun(seen, now, begins, first, float(high))
        if began is None:
            since = first + step
            continue
        begins = [*begins, began[1]]
        # what lies beyond is another piece's business: only its heads follow
        now = adjust(seen, began[0], np.zeros((len(begins), PIECE), np.bool_), scales_mm=(5.0, 2.0))
        since = float(now.state.pieces[-1, START]) + step
    return now, begins


def _seen_round(seen: Sightings, now: Adjusted, at_mm: FloatArray) -> BoolArray:
    """(G,) whether enough of the circle was seen both before and behind each of some places."""
    z, (right, down) = now.where.chainage_mm, now.where.direction.T
    sector = np.floor(np.arctan2(right, -down) * (COARSE / (2 * np.pi))).astype(np.intp) % COARSE
    reach = ROUND_OF_RADIUS * seen.radius_mm
    order = np.argsort(z)
    z, sector = z[order], sector[order]
    out = np.empty(len(at_mm), np.bool_)
    for i, at in enumerate(at_mm):
        a, b, c = np.searchsorted(z, [at - reach, at, at + reach])
        out[i] = min(len(np.unique(sector[a:b])), len(np.unique(sector[b:c]))) >= ROUND_LEAST * COARSE
    return out


def _first(seen: Sightings, now: Adjusted, places: FloatArray, needed: FloatArray) -> float | None:
    """The nearest of some places at which something begins; None where nothing does."""
    lean = by_head(seen, now.state, now.where)
    for i in range(0, len(places), BLOCK):
        gain, size = explained(seen, now, lean, places[i : i + BLOCK])
        shown = ((gain > needed) & _matters(size, seen.radius_mm)).any(axis=1)
        if shown.any():
            return float(places[i + np.argmax(shown)])
    return None


def _begun(
    seen: Sightings, now: Adjusted, begins: Sequence[Begins], first: float, high: float
) -> tuple[AdjustmentState, Begins] | None:
    """The kind of piece that explains best what begins at `first` or soon after, and the state with it."""
    step, reach = STEP_OF_RADIUS * seen.radius_mm, AHEAD_OF_RADIUS * seen.radius_mm
    places = np.arange(first, min(first + 0.75 * reach, high), step)
    gain, size = explained(seen, now, by_head(seen, now.state, now.where), places, first + reach)
    part, heads = _up_to(seen, now, first + reach)
    start = replace(now.state, heads=now.state.heads[heads])
    tries = [(kind, kind) for kind in KINDS]
    if begins[-1] in (Begins.BEND, Begins.TAPER):
        tries.append((begins[-1], Begins.STRAIGHT))
    best: tuple[float, AdjustmentState, Begins] | None = None
    for shown_by, kind in tries:
        shown = gain[:, KINDS.index(shown_by)]
        if shown.max() < ENDS / 2:
            continue
        # what begins finds its own beginning, from not too far
        for i in sorted({int(np.argmax(shown)), 0, len(places) // 3, 2 * len(places) // 3}):
            tried = _with(part, start, begins, kind, float(places[i]), size[i])
            if kind is Begins.JOINT:
                held = _free([*begins, kind])
                held[:-2] = False
                for _ in range(2):
                    tried = adjust(part, _placed(part, tried.state, len(begins)), held, rounds=3)
            cost = tried.cost + NUMBER_COST * len(tried.free)
            if best is None or cost < best[0]:
                best = cost, tried.state, kind
    if best is None:
        return None
    everywhere = now.state.heads.copy()
    everywhere[heads] = best[1].heads
    return replace(best[1], heads=everywhere), best[2]


def _placed(seen: Sightings, state: AdjustmentState, piece: int) -> AdjustmentState:
    """The state with a joint where it costs least, within a radius of where it was; its two pipes stay."""
    was = float(state.pieces[piece, START])
    low = state.pieces[piece - 1, START] + 1.0
    high = state.pieces[piece + 1, START] - 1.0 if piece + 1 < len(state.pieces) else np.inf
    tried = []
    for at in np.clip(was + np.arange(-seen.radius_mm, seen.radius_mm, JOINT_STEP_MM), low, high):
        pieces = state.pieces.copy()
        pieces[piece, START] = at
        pieces[piece, OFFSET] += (at - was) * pieces[piece, TURN]
        moved = replace(state, pieces=pieces)
        tried.append((cost_of(locate(seen, moved).residual_mm, seen.sigma_mm), moved))
    least = min(cost for cost, _ in tried)
    good = [moved for cost, moved in tried if cost <= least + ENDS]
    best = good[len(good) // 2]  # the middle of what a bead hides
    # a bead or a gap is neither pipe's wall: the joint is in its midst
    where, at = locate(seen, best), float(best.pieces[piece, START])
    gross = np.abs(where.residual_mm) > GROSS_OF_RADIUS * seen.radius_mm
    gross &= np.abs(where.chainage_mm - at) < JOINT_OF_RADIUS * seen.radius_mm
    round_the_clock = np.floor(np.arctan2(where.direction[gross, 0], where.direction[gross, 1]) * (12 / np.pi))
    if len(np.unique(round_the_clock)) < 12:
        return best
    ends = np.percentile(where.chainage_mm[gross], [10, 90])
    pieces = best.pieces.copy()
    pieces[piece, START] = float(np.clip(ends.mean(), low, high))
    pieces[piece, OFFSET] += (pieces[piece, START] - at) * pieces[piece, TURN]
    return replace(best, pieces=pieces)


def _with(
    seen: Sightings, state: AdjustmentState, begins: Sequence[Begins], kind: Begins, at_mm: float, size: FloatArray
) -> Adjusted:
    """One more piece from a place on, adjusted with the one before it."""
    last = state.pieces[-1]
    row = np.zeros(PIECE)
    row[START], row[SHAPE] = at_mm, last[SHAPE]
    if kind is Begins.JOINT:
        row[OFFSET], row[TURN], row[RADIUS] = size[0:2], size[2:4], size[6]
    elif kind is Begins.BEND:
        row[CURVATURE] = last[CURVATURE] + size[4:6]
    elif kind is Begins.TAPER:
        row[CURVATURE], row[TAPER] = last[CURVATURE], last[TAPER] + size[7]
    free = np.zeros((len(begins) + 1, PIECE), np.bool_)
    free[-2:] = _free([*begins, kind])[-2:]
    return adjust(
        seen, replace(state, pieces=np.vstack([state.pieces, row])), free, scales_mm=(5.0, 2.0, 0.5), rounds=3
    )


def _free(begins: Sequence[Begins]) -> BoolArray:
    """(P, PIECE) which numbers of each piece may change. A joint's place is not among them: beads hide it."""
    free = np.zeros((len(begins), PIECE), np.bool_)
    free[0, RADIUS] = True
    free[:, SHAPE] = True
    for i, kind in enumerate(begins):
        if kind is Begins.JOINT:
            free[i, OFFSET] = free[i, TURN] = free[i, RADIUS] = True
        elif kind is Begins.BEND:
            free[i, CURVATURE] = free[i, START] = True
        elif kind is Begins.TAPER:
            free[i, TAPER] = free[i, START] = True
        elif i:
            free[i, START] = True
    return free


def _up_to(seen: Sightings, now: Adjusted, upto_mm: float) -> tuple[Sightings, NDArray[np.intp]]:
    """The observations up to a place, of heads that see it; and which heads."""
    keep = now.where.chainage_mm < upto_mm
    count = np.add.reduceat(keep.astype(np.intp), seen.first)
    back = upto_mm - BACK_OF_RADIUS * seen.radius_mm
    heads = np.flatnonzero((count > SIGHTINGS_LEAST) & (seen.chainage_mm > back))
    keep &= np.isin(seen.frame, heads)
    frame = np.searchsorted(heads, seen.frame[keep])
    part = replace(
        seen,
        points_mm=seen.points_mm[keep],
        sigma_mm=seen.sigma_mm[keep],
        frame=frame,
        ring=seen.ring[keep],
        first=np.searchsorted(frame, np.arange(len(heads))),
        chainage_mm=seen.chainage_mm[heads],
        heads=seen.heads[heads],
        roll_known=seen.roll_known[heads],
        which=seen.which[heads],
        ways=seen.ways[keep],
        slide_mm=seen.slide_mm[keep],
    )
    return part, heads


def _moved(profiles: Sequence[Profile], seen: Sightings, state: AdjustmentState) -> tuple[Profile, ...]:
    """The profiles in pipe coordinates."""
    out = list(profiles)
    line = state.centreline()
    for i, head, chainage in zip(seen.which, state.heads, seen.chainage_mm, strict=True):
        was = profiles[i]
        assert was.pose is not None
        rx, ry, tx, ty, roll = (float(v) for v in head)
        pose = Pose(rx, ry, tx, ty, None if was.pose.roll is None else roll)
        camera = was.pose.to_camera(was.points_mm.astype(np.float64), was.z_mm)
        points = line.from_head(pose.to_pipe(camera), float(chainage))
        out[i] = replace(was, pose=pose, points_mm=points.astype(np.float32))
    return tuple(out)
