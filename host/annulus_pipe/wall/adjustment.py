"""Heads and centre line, adjusted together so that what every ring saw lies on one pipe.

One observation is a sector of one ring in one frame. Rings of a frame lie at different ranges and frames overlap, so
the frames on both sides of a joint tie its two pipes together: some numbers a head, a piece and a ring, in one robust
least-squares problem whose heads are eliminated frame by frame.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import CAUCHY, SIGMA_OF_MAD
from annulus_pipe.wall.centreline import STRAIGHT, Centreline, Piece
from annulus_pipe.wall.profile import Profile

POINTS_LEAST = 3  # points of a ring's sector, for an observation
FRAME_LEAST = 200  # points in a frame, for the numbers of its head
SIGMA_LEAST_MM = 0.03  # of an observation
HEAD = 5  # numbers a head: rx, ry, tx, ty, roll
BIAS = 3  # numbers a ring: mean, to the camera's right, down
PIECE = 13  # numbers a piece: offset 2, turn 2, curvature 2, radius, taper, oval 2, trefoil 2, start
BIAS_SIGMA_MM = 0.05  # of a ring: how far its own colour and cone may put it beside the others
BIAS_COMMON_MM = 0.002  # of all rings
BIAS_STEP_MM = 1e-3
# Of a ring's scatter: how far the middle of its slit moves between straight and bent wall, each way: some hundredths of
# a pixel, which no residual shows. So large that twice the sigma holds in the bends of two ray tracers, one of them
# drawn blind (`bench scenes`, and its --blind 2611); half of it held in one only.
CHANGES_OF_SCATTER = 1.4
ROLL_SIGMA = 0.01  # radians; of a head whose roll a sensor gave ..
ROLL_HELD = 1e-5  # .. and of one that has none: rings cannot tell it, so it stays
UNIT_LEAST = 0.3  # of what points say they may be off: what a ring's points have in common does not scatter
APART = 0.4  # of the way between two starts: as far as one step may go ..
APART_LEAST_MM = 1.0  # .. and how near they may come
HEAD_STEPS = (1e-5, 1e-5, 1e-3, 1e-3, 1e-5)  # radians, mm: of the derivatives
PIECE_STEPS = (1e-3, 1e-3, 1e-5, 1e-5, 1e-8, 1e-8, 1e-3, 1e-6, 1e-3, 1e-3, 1e-3, 1e-3, 1e-2)
OFFSET, TURN, CURVATURE, RADIUS, TAPER = slice(0, 2), slice(2, 4), slice(4, 6), 6, 7
# A circle aside of its place in an oval pipe shows a threefold wave. Were the wall's own not free, rings of an oval
# pipe would move aside to make it, and all heads lean with them: a degree, in a 4-inch pipe of 4 % with .08 mm of it.
SHAPE, START = slice(8, 12), 12  # two waves round the clock and three; where the piece begins


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Observations (N,), those of one frame side by side: points in the camera's frame, mm; sigma;
    frame, ring and where each frame's begin. chainage (F,): of the heads."""

    points_mm: FloatArray  # (N, 3)
    sigma_mm: FloatArray
    frame: NDArray[np.intp]
    ring: NDArray[np.intp]
    first: NDArray[np.intp]  # (F,)
    chainage_mm: FloatArray  # (F,)
    heads: FloatArray  # (F, HEAD) as the frames found them: rx, ry, tx, ty, roll
    roll_known: NDArray[np.bool_]  # (F,)
    which: NDArray[np.intp]  # (F,) index of the profile
    rings: int
    radius_mm: float
    slide_mm: FloatArray  # (N, 3) how a point moves with its slit's place in the image, radially, in the camera frame
    ways: FloatArray  # (N, BIAS) 1 and its direction in the camera


@dataclass(frozen=True, slots=True, eq=False)
class AdjustmentState:
    """Where all is. pieces (P, PIECE), the radius of all but the first as its step against the one before; bias_mm
    (R, BIAS) of the rings; heads (F, HEAD)."""

    pieces: FloatArray
    bias_mm: FloatArray
    heads: FloatArray

    def radii_mm(self) -> FloatArray:
        """(P,) at the start of each piece."""
        grown = self.pieces[:-1, TAPER] * np.diff(self.pieces[:, START])
        return np.asarray(np.cumsum(self.pieces[:, RADIUS] + np.append(0.0, grown)))

    def centreline(self) -> Centreline:
        return Centreline(
            [
                Piece(
                    float(row[START]),
                    float(radius),
                    (float(row[0]), float(row[1])),
                    (float(row[2]), float(row[3])),
                    (float(row[4]), float(row[5])),
                    float(row[TAPER]),
                )
                for row, radius in zip(self.pieces, self.radii_mm(), strict=True)
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Where:
    """Observations in pipe coordinates: residual (N,) mm, chainage, unit direction (N, 2)."""

    residual_mm: FloatArray
    chainage_mm: FloatArray
    direction: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """A state with the robust sigma of its weighted residuals, and the covariance of its free numbers.

    `free`: flat indices into pieces (P, PIECE); covariance (n, n) in their order, scaled by what is left. When the line
    moves by a step (n,) of those, heads do by `follow` (F, HEAD, n) times it; `head_covariance` (F, HEAD, HEAD) is
    theirs on a line that is known."""

    state: AdjustmentState
    where: Where
    weight: FloatArray
    unit: float  # robust sigma of residual over sigma
    cost: float
    free: NDArray[np.intp]
    covariance: FloatArray
    follow: FloatArray
    head_covariance: FloatArray

    def sigma(self, piece: int, number: int) -> float:
        """Standard deviation of one number of a piece; 0 where it was held."""
        at = np.flatnonzero(self.free == piece * PIECE + number)
        return float(np.sqrt(self.covariance[at[0], at[0]])) if len(at) else 0.0


def sightings(profiles: Sequence[Profile], cones: Sequence[Cone], sectors: int) -> Sightings | None:
    """The observations of all frames with a pose, so many to a full ring; None where there is none."""
    usable = [i for i, p in enumerate(profiles) if p.pose is not None and len(p.points_mm) >= FRAME_LEAST]
    if not usable:
        return None
    usable.sort(key=lambda i: profiles[i].z_mm)
    parts = [_of_frame(profiles[i], sectors) for i in usable]
    points, sigma, ring = (np.concatenate([part[j] for part in parts]) for j in range(3))
    counts = np.array([len(part[1]) for part in parts])
    poses = [pose for i in usable if (pose := profiles[i].pose) is not None]
    radii = [np.hypot(*profiles[i].points_mm[::37, :2].T) for i in usable]
    return Sightings(
        points,
        sigma,
        np.repeat(np.arange(len(parts)), counts),
        ring.astype(np.intp),
        np.concatenate([[0], np.cumsum(counts)[:-1]]),
        np.array([profiles[i].z_mm for i in usable]),
        np.array([[p.rx, p.ry, p.tx, p.ty, p.roll or 0.0] for p in poses]),
        np.array([p.roll is not None for p in poses]),
        np.array(usable),
        int(ring.max()) + 1,
        float(np.median(np.concatenate(radii))),
        _slides(points, ring.astype(np.intp), cones),
        np.column_stack([np.ones(len(points)), points[:, :2] / np.hypot(points[:, 0], points[:, 1])[:, None]]),
    )


def _slides(points: FloatArray, ring: NDArray[np.intp], cones: Sequence[Cone]) -> FloatArray:
    """(N, 3) how far points move along their cones when their place in the image is off by a constant, scaled so that
    of each ring half move outwards by more than 1."""
    vertex = np.array([cone.vertex_mm for cone in cones])[ring]
    along = points - vertex
    along /= np.linalg.norm(along, axis=1)[:, None]
    away = np.linalg.norm(points, axis=1)
    parallax = np.linalg.norm(np.cross(along, points / away[:, None]), axis=1)
    slide = along * (away / np.maximum(parallax, 1e-3))[:, None]
    outwards = (slide[:, :2] * points[:, :2]).sum(axis=1) / np.hypot(points[:, 0], points[:, 1])
    usual = np.array([np.median(outwards[ring == k]) if (ring == k).any() else 1.0 for k in range(len(cones))])
    return np.asarray(slide / usual[ring, None])


def _of_frame(profile: Profile, sectors: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (N, 3) in the camera frame, their sigma and ring: of each sector the point of median radius.

    A point, not a mean: in a bend a ring's radius goes up and down round the clock, and the middle of that is none of
    the wall's (a bend's radius was off by up to 1.5 %).
    """
    assert profile.pose is not None
    size, keys = len(profile.ring), (int(profile.ring.max()) + 1) * sectors
    room = np.empty(keys, np.int64), np.empty(size, np.int64), np.empty(size, np.int64), np.empty((2, size))
    chosen = np.empty(size, np.int64)
    points, ring = np.ascontiguousarray(profile.points_mm, np.float32), np.ascontiguousarray(profile.ring)
    chosen = chosen[: _middle_points(points, ring, sectors, POINTS_LEAST, *room, chosen)]
    stated = np.nan_to_num(profile.sigma_mm[chosen].astype(np.float64), nan=SIGMA_LEAST_MM)
    camera = profile.pose.to_camera(profile.points_mm[chosen].astype(np.float64), profile.z_mm)
    return camera, np.maximum(stated, SIGMA_LEAST_MM), profile.ring[chosen].astype(np.float64)


_middle_points = door(
    "middle_points",
    "f4[n,3] points",
    "u1[n] ring",
    "i8 sectors",
    "i8 needed",
    "i8[k]! ends",
    "i8[n]! sector",
    "i8[n]! laid",
    "f8[2,n]! radii",
    "i8[n]! chosen",
    returns="i8",
)
_SEEN = "f8[n,3] points", "f8[n,3] slide", "f8[n,3] ways", "i8[n] ring", "i8[n] frame"
_STATE = "f8[r,3] bias", "f8[f,5] heads", "f8[f] chainage", "f8[p,13] pieces", "f8 straight"
_ROOM = "f8[f,16]! stands", "f8[p,16]! line", "f8[p]! radii"
_residuals = door("wall_residuals", *_SEEN, *_STATE, *_ROOM, "f8[n]! residuals", "f8[n]! where", "f8[n,2]! direction")
_by_heads = door(
    "wall_by_heads", *_SEEN, *_STATE, *_ROOM, "f8[n] residuals", "f8[5] steps", "f8[f,5]! tried", "f8[n,5]! out"
)
_by_pieces = door(
    "wall_by_pieces",
    *_SEEN,
    *_STATE,
    *_ROOM,
    "f8[n] residuals",
    "i8[c] columns",
    "f8[c] steps",
    "f8[p,13]! tried",
    "i8[n]! reached",
    "f8[n,c]! out",
)


def _at(seen: Sightings, state: AdjustmentState) -> tuple[Any, ...]:
    """What the loops take of both, and room for them to work in."""
    heads, pieces = len(seen.chainage_mm), len(state.pieces)
    return (
        *(seen.points_mm, seen.slide_mm, seen.ways, seen.ring, seen.frame),
        *(state.bias_mm, state.heads, seen.chainage_mm, state.pieces, STRAIGHT),
        *(np.empty((heads, 16)), np.empty((pieces, 16)), np.empty(pieces)),
    )


def locate(seen: Sightings, state: AdjustmentState) -> Where:
    """Every observation in pipe coordinates, and how far it is off the wall."""
    size = len(seen.frame)
    where = Where(np.empty(size), np.empty(size), np.empty((size, 2)))
    _residuals(*_at(seen, state), where.residual_mm, where.chainage_mm, where.direction)
    return where


def adjust(
    seen: Sightings,
    start: AdjustmentState,
    free: NDArray[np.bool_],
    *,
    scales_mm: Sequence[float] = (),
    rounds: int = 8,
) -> Adjusted:
    """Gauss-Newton with Cauchy's weights, whose scale goes down in steps (`scales_mm`) to what is left.

    free : (P, PIECE) which numbers of the pieces may change. The first piece's offset and turn never may: its frame is
    space. Rings' biases are free with a small prior, so that the colour of a ring is not taken for a taper or a bend.
    """
    state, where = start, locate(seen, start)
    columns = np.flatnonzero(free.ravel())
    scales = [*scales_mm, *[0.0] * rounds]
    cost = math.inf
    for i, scale in enumerate(scales):
        weight, unit = _weights(where.residual_mm, seen.sigma_mm, scale)
        step = _step(seen, state, where, weight, unit, columns)
        flat = state.pieces.ravel().copy()
        flat[columns] += step.pieces
        pieces = flat.reshape(state.pieces.shape)
        was = state.pieces[:, START]
        apart = APART * np.diff(was)  # a start leaps over no other
        most = np.append(was[1:-1] + apart[1:], np.inf)
        pieces[1:, START] = np.clip(pieces[1:, START], was[1:] - apart, most[: len(apart)])
        for k in range(1, len(pieces)):
            pieces[k, START] = max(pieces[k, START], pieces[k - 1, START] + APART_LEAST_MM)
        state = replace(
            state, pieces=pieces, bias_mm=state.bias_mm + step.bias.reshape(-1, BIAS), heads=state.heads + step.heads
        )
        where = locate(seen, state)
        if scale == 0.0:
            before, cost = cost, cost_of(where.residual_mm, seen.sigma_mm)
            if i > len(scales_mm) and abs(before - cost) < 1e-3 * cost:
                break
    weight, unit = _weights(where.residual_mm, seen.sigma_mm, 0.0)
    alike = _alike(seen, where.residual_mm * np.sqrt(weight) / unit)
    return Adjusted(
        state,
        where,
        weight,
        unit,
        cost_of(where.residual_mm, seen.sigma_mm),
        columns,
        alike * step.covariance,
        step.follow,
        alike * step.head_covariance,
    )


def unmodelled(seen: Sightings, found: Adjusted) -> FloatArray:
    """(n, n) covariance of the free numbers from what each ring is off in bends otherwise than in straights, and no
    residual shows: a part of its points' scatter, each way by itself."""
    bent = np.array([piece.is_bent for piece in found.state.centreline().pieces])
    if not bent.any():
        return np.zeros_like(found.covariance)
    own = found.state.centreline().piece_of(found.where.chainage_mm)
    each = np.where(bent[own][:, None], _by_bias(seen, found.state, found.where), 0.0)
    step = _step(seen, found.state, found.where, found.weight, found.unit, found.free, each)
    scatter = np.zeros(seen.rings)
    for k in np.unique(seen.ring):
        scatter[k] = SIGMA_OF_MAD * float(np.median(np.abs(found.where.residual_mm[seen.ring == k])))
    moved = step.answers * (CHANGES_OF_SCATTER * np.repeat(scatter, BIAS))
    return np.asarray(moved @ moved.T)


def _alike(seen: Sightings, residual: FloatArray) -> float:
    """How many observations count as one: a ring of a frame is off as a whole, a quarter of it at a time."""
    quarter = np.floor(np.arctan2(seen.ways[:, 2], seen.ways[:, 1]) * (2 / np.pi)).astype(np.intp) + 2
    _, own = np.unique((seen.frame * seen.rings + seen.ring) * 5 + quarter, return_inverse=True)
    square = np.bincount(own, weights=residual) ** 2
    return max(float(square.sum() / np.sum(residual**2)), 1.0)


def _weights(residual: FloatArray, sigma: FloatArray, scale_mm: float) -> tuple[FloatArray, float]:
    """1/mm^2, and the unit: robust sigma of residual over sigma, never less than UNIT_LEAST."""
    unit = max(SIGMA_OF_MAD * float(np.median(np.abs(residual / sigma))), UNIT_LEAST)
    if scale_mm > 0:
        return np.asarray(1.0 / (1.0 + (residual / scale_mm) ** 2) / sigma**2), unit
    return np.asarray(1.0 / (1.0 + (residual / (CAUCHY * unit * sigma)) ** 2) / sigma**2), unit


def cost_of(residual: FloatArray, sigma: FloatArray) -> float:
    """Cauchy's, in units of chi-square."""
    return float((CAUCHY**2 * np.log1p((residual / (CAUCHY * sigma)) ** 2)).sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """Steps of heads (F, HEAD), free numbers of the pieces (n,), biases (R * BIAS,); the rest as in `Adjusted`, as if
    points were independent. `answers` (n, m): how the free numbers answer to each residual asked about."""

    heads: FloatArray
    pieces: FloatArray
    bias: FloatArray
    covariance: FloatArray
    follow: FloatArray
    head_covariance: FloatArray
    answers: FloatArray


def _step(
    seen: Sightings,
    state: AdjustmentState,
    where: Where,
    weight: FloatArray,
    unit: float,
    columns: NDArray[np.intp],
    asked: FloatArray | None = None,
) -> _Step:
    """One step of Gauss-Newton. asked : (N, m) residuals, mm, to which the answers are wanted."""
    heads_do = by_head(seen, state, where)
    by_line = np.concatenate([by_pieces(seen, state, where, columns), _by_bias(seen, state, where)], axis=1)
    f, n = len(seen.first), by_line.shape[1]
    weighted = by_line * weight[:, None]
    normal = by_line.T @ weighted
    right = -weighted.T @ where.residual_mm
    u = np.add.reduceat((heads_do * weight[:, None])[:, :, None] * heads_do[:, None, :], seen.first)
    w = np.stack(
        [heads_do[a:b].T @ weighted[a:b] for a, b in zip(seen.first, [*seen.first[1:], len(weight)], strict=True)]
    )
    gh = -np.add.reduceat(heads_do * (weight * where.residual_mm)[:, None], seen.first)
    roll = np.where(seen.roll_known, ROLL_SIGMA, ROLL_HELD)
    prior = np.zeros((f, HEAD))
    prior[:, 4] = (unit / roll) ** 2
    prior[:, :4] = 1e-6 * np.einsum("fii->fi", u)[:, :4] + 1e-9
    gh[:, 4] -= prior[:, 4] * (state.heads[:, 4] - seen.heads[:, 4])
    u = u + prior[:, :, None] * np.eye(HEAD)
    solved = np.linalg.solve(u, np.concatenate([w, gh[:, :, None]], axis=2))
    across, follow = w.reshape(-1, n).T, solved.reshape(-1, n + 1)  # of all heads' numbers, one after the other
    reduced = normal - across @ follow[:, :n]
    held = np.concatenate([_priors(state)[columns], np.full(BIAS * seen.rings, BIAS_SIGMA_MM)])
    value = np.concatenate([np.zeros(len(columns)), state.bias_mm.ravel()])
    # what all rings have in common is the pipe's radius, not a bias
    common = np.concatenate([np.zeros(len(columns)), np.tile([1.0 / seen.rings, 0.0, 0.0], seen.rings)])
    both = (unit / BIAS_COMMON_MM) ** 2 * np.outer(common, common) + np.diag((unit / held) ** 2)
    reduced += both
    right = right - across @ follow[:, n] - both @ value
    inverse = np.asarray(np.linalg.inv(reduced), np.float64)
    step = inverse @ right
    heads = solved[:, :, n] - solved[:, :, :n] @ step
    k = len(columns)
    answers = np.zeros((k, 0))
    if asked is not None:
        pull = np.stack(
            [
                heads_do[a:b].T @ (weight[a:b, None] * asked[a:b])
                for a, b in zip(seen.first, [*seen.first[1:], len(weight)], strict=True)
            ]
        )
        answers = -(inverse @ (weighted.T @ asked - follow[:, :n].T @ pull.reshape(len(follow), -1)))[:k]
    with_line = inverse[:, :k] @ np.linalg.inv(inverse[:k, :k])  # biases, too, follow the line
    return _Step(
        heads,
        step[:k],
        step[k:],
        unit**2 * inverse[:k, :k],
        -solved[:, :, :n] @ with_line,
        unit**2 * np.linalg.inv(u),
        answers,
    )


def _priors(state: AdjustmentState) -> FloatArray:
    """(P * PIECE,) how far a number of a piece moves in one step, standard deviation: what nobody saw stays near."""
    radius = float(state.pieces[0, RADIUS])
    of_radius = 0.1 * radius
    one = [of_radius, of_radius, 0.2, 0.2, 1 / radius, 1 / radius, of_radius, 0.1, *[of_radius] * 5]
    return np.tile(np.array(one), len(state.pieces))


def by_head(seen: Sightings, state: AdjustmentState, where: Where) -> FloatArray:
    """(N, HEAD) what each number of its head does to each residual."""
    out = np.empty((len(seen.frame), HEAD))
    _by_heads(*_at(seen, state), where.residual_mm, np.array(HEAD_STEPS), np.empty_like(state.heads), out)
    return out


def by_pieces(seen: Sightings, state: AdjustmentState, where: Where, columns: NDArray[np.intp]) -> FloatArray:
    """(N, n) what each free number does."""
    out = np.empty((len(seen.frame), len(columns)))
    steps = np.array(PIECE_STEPS)[columns % PIECE]
    room = np.empty_like(state.pieces), np.empty(len(seen.frame), np.int64)
    _by_pieces(*_at(seen, state), where.residual_mm, columns, steps, *room, out)
    return out


def _by_bias(seen: Sightings, state: AdjustmentState, where: Where) -> FloatArray:
    """(N, R * BIAS) what each number of each ring's bias does."""
    more = replace(state, bias_mm=state.bias_mm + np.array([BIAS_STEP_MM, 0.0, 0.0]))
    change = (locate(seen, more).residual_mm - where.residual_mm) / BIAS_STEP_MM
    own = (seen.ring[:, None] == np.arange(seen.rings))[:, :, None]
    return np.asarray(np.where(own, (change[:, None] * seen.ways)[:, None, :], 0.0).reshape(len(seen.ring), -1))
