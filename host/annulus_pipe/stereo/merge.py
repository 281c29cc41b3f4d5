"""Where each ring met the wall, from what several cameras saw of it.

A ring's light leaves the projector along generators of its cone. On each of them the wall is one unknown, the distance
from the vertex. A camera that sees the ring says where its image is; how many pixels that moves with a mm of the wall
is the camera's sensitivity there, and the farther of two roots (§5.2) is the one near which it is taken. So the wall is
where the weighted squares of what is left, in pixels, are least: where one camera's ray is tangent to the cone
(delta = 0) its sensitivity is zero and it says nothing, by itself; no threshold decides (Alzuhiri 2022 has one, Delta).

Assumed: the cameras see the same wall. When they do not (an edge between them, a slit misread), they contradict each
other beyond what their sigmas allow, and neither is believed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.jit import around, jit
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.stereo.lens import on_line
from annulus_pipe.stereo.view import Expected, View

# By topic stereo of the metrology table: errors against truth, share inside k = 2, at the tangents as elsewhere.
JUMP_PX = 3.0  # between two neighbouring lines: more is an edge of the wall, and nothing is read between them
SLOPE_LINES = 3  # to each side, over which the course of what was seen is read
CLOSE_MM, ROUNDS = 0.2, 6  # a step so small ends it: what it bends by is its square over the distance
NEARER, FARTHER = 0.5, 2.0  # of the distance to a clean pipe: no wall is looked for beyond
CONTRADICTS, LEAST_PX = 6.0, 0.04  # sigma apart, of at least so much: two cameras do not see the same wall
ACROSS = 0.25  # of what is not known: where an edge of the wall leaves so much open of a slit's middle, none is known
SHARE = 0.03  # of the weight: a camera with less is none that a point was made from
BOTH, LEAST, UNIT_LEAST, UNIT_MOST = 0.1, 200, 0.5, 3.0  # share of each, points, for what sigmas are worth; its bounds
NOISY = 0.12  # of what is not known: a direction that says less is known together with its neighbours, ..
BESIDE_DEG, SLOPE_MM_DEG = 2.5, 0.2  # .. so far to each side, as a wall that goes out or in by so much a degree, ..
ALIKE = 3.0  # .. so many saying as much as one (pixels lie in rows), or less, by what they leave of that wall
KNOWN, UNSEEN, CONTRADICTED, BLUNT, EDGE = 0, 1, 2, 3, 4


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What one camera saw of the rings. On its lines (K, J): samples, NaN for nowhere; their standard deviation, px; of
    that what a slit across an edge of the wall may be off, in all cameras alike.
    bias_px: what neighbours may be off together."""

    place: FloatArray
    sigma_px: FloatArray
    edge_px: FloatArray
    bias_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """By ring and generator (K, P): distance from the vertex, mm, NaN where not known; its standard deviation; which
    camera saw it, its place in the list or, of several, their number; the heaviest, and the line it saw it on;
    KNOWN, UNSEEN, CONTRADICTED, BLUNT (seen, but from where it says too little of the wall) or EDGE (across one)."""

    distance_mm: FloatArray
    sigma_mm: FloatArray
    camera: NDArray[np.int64]
    heaviest: NDArray[np.int64]
    line: NDArray[np.int64]
    state: NDArray[np.int64]
    apart: FloatArray  # squares of how far the cameras lie apart, in sigmas, where each has a share; NaN elsewhere

    @property
    def unit(self) -> float:
        """What sigmas are to be multiplied by: how far the cameras really lie apart says one half of the variance, by
        the median; the other they may have in common. 1 where too few points tell."""
        known = self.apart[np.isfinite(self.apart)]
        if len(known) < LEAST:
            return 1.0
        unit = float(np.clip(SIGMA_OF_MAD * np.sqrt(np.median(known)), UNIT_LEAST, UNIT_MOST))
        return math.sqrt((1.0 + unit**2) / 2.0)


def merge(
    views: Sequence[View],
    expected: Sequence[Expected],
    sights: Sequence[Sight],
    vertices: FloatArray,
    ways: FloatArray,
    start_mm: FloatArray,
    sigma_most_mm: FloatArray,
    usable: BoolArray | None = None,
) -> Merged:
    """The wall's distance along each generator.

    Parameters
    ----------
    vertices (K, 3), ways (K, P, 3), start_mm (K, P) : generators, and how far a clean pipe is along them.
    sigma_most_mm : (K,) of each ring: a distance known no better is not known.
    usable : (C, K, P) where each camera is asked, and all count alike; None, everywhere, by what each says.
    """
    shape = start_mm.shape
    course = np.stack([e.course for e in expected])
    generators = _Generators(vertices, ways, start_mm, sigma_most_mm)
    stacked = _Sights(
        lenses=np.stack([view.lens for view in views]),
        expected=np.stack([e.by_generator for e in expected]),
        course=course,
        stray=np.stack([s.place for s in sights]) - course,
        sigma_px=np.stack([s.sigma_px for s in sights]),
        edge_px=np.stack([s.edge_px for s in sights]),
        bias_px=np.array([s.bias_px for s in sights]),
        usable=np.ones((1, 1, 1), np.bool_) if usable is None else usable,
    )
    solved = _Solved(
        distance=np.full(shape, np.nan),
        sigma=np.full(shape, np.nan),
        camera=np.zeros(shape, np.int64),
        heaviest=np.zeros(shape, np.int64),
        line=np.zeros(shape, np.int64),
        state=np.zeros(shape, np.int64),
        apart=np.full(shape, np.nan),
    )
    _solve(generators, stacked, usable is not None, solved)
    return Merged(*solved)


class _Generators(NamedTuple):
    """The generators of K rings, P each, as `_solve` takes them."""

    vertices: FloatArray  # (K, 3) mm
    ways: FloatArray  # (K, P, 3) unit
    start: FloatArray  # (K, P) mm, how far a clean pipe is along them
    limit: FloatArray  # (K,) mm: a distance known no better is not known


class _Sights(NamedTuple):
    """What C cameras saw of them on their lines (J), and where a clean pipe would show them."""

    lenses: FloatArray  # of each camera, as `on_line` takes it
    expected: FloatArray  # (C, 4, K, P) line and sample of a clean pipe, and what they change by in a mm
    course: FloatArray  # (C, K, J) sample of a clean pipe on each line
    stray: FloatArray  # (C, K, J) sample seen less that, NaN for nowhere
    sigma_px: FloatArray  # (C, K, J)
    edge_px: FloatArray  # (C, K, J) of that what a slit across an edge of the wall may be off
    bias_px: FloatArray  # (C,) what neighbours may be off together
    usable: BoolArray  # (C, K, P) where each camera is asked, if gated; else of any shape


class _Solved(NamedTuple):
    """What is written, (K, P) each: the fields of `Merged`, in its order."""

    distance: FloatArray
    sigma: FloatArray
    camera: IntArray
    heaviest: IntArray
    line: IntArray
    state: IntArray
    apart: FloatArray


@jit
def _solve(generators, sights, gated, solved):  # type: ignore[no-untyped-def]
    """The wall along every generator: `_Generators` and `_Sights` in, `_Solved` out. gated : see `merge`'s `usable`."""
    vertices, ways = generators.vertices, generators.ways
    start, limit = generators.start, generators.limit
    lenses, expected, course, stray = sights.lenses, sights.expected, sights.course, sights.stray
    sigma_px, edge_px, bias_px, usable = sights.sigma_px, sights.edge_px, sights.bias_px, sights.usable
    distance, sigma, camera, heaviest = solved.distance, solved.sigma, solved.camera, solved.heaviest
    line, state, apart = solved.line, solved.state, solved.apart
    cameras = len(lenses)
    rings, steps = start.shape
    left, gain, off, at = np.empty(cameras), np.empty(cameras), np.empty(cameras), np.empty(cameras)
    clean = np.empty((steps, cameras, 4))  # of one ring: what each direction says of how far a clean wall is off
    for k in range(rings):
        most = limit[k]
        clean[:] = 0.0
        for p in range(steps):
            state[k, p] = UNSEEN
            s = start[k, p]
            if s != s:
                continue
            total = 0.0
            for turn in range(ROUNDS):
                pull, total = 0.0, 0.0
                for c in range(cameras):
                    left[c] = gain[c] = off[c] = np.nan
                    if gated and not usable[c, k, p]:
                        continue
                    if turn == 0:
                        at[c], place = expected[c, 0, k, p], expected[c, 1, k, p]
                    else:
                        at[c], place = on_line(
                            lenses[c],
                            vertices[k, 0] + s * ways[k, p, 0],
                            vertices[k, 1] + s * ways[k, p, 1],
                            vertices[k, 2] + s * ways[k, p, 2],
                        )
                    by_line, by_place = expected[c, 2, k, p], expected[c, 3, k, p]
                    value, slope, spread = _look(stray[c, k], sigma_px[c, k], course[c, k], at[c])
                    if value != value:
                        continue
                    own = by_place - slope * by_line
                    left[c], gain[c], off[c] = value - place, own, spread
                    weight = (own / spread) ** 2 if not gated else own * own * 1e-6
                    if gated:  # the source's: each camera's own answer, and their mean
                        pull += (value - place) / own
                        total += 1.0
                    else:
                        pull += weight * (value - place) / own if own != 0.0 else 0.0
                        total += weight
                    if turn == 0:
                        clean[p, c, 0] = weight
                        clean[p, c, 1] = own * left[c] / spread**2
                        clean[p, c, 2] = (left[c] / spread) ** 2
                        clean[p, c, 3] = own / spread**2
                if not (total * (NOISY * most) ** 2 >= 1.0 or gated):
                    break
                step = min(max(pull / total, (NEARER - 1.0) * start[k, p]), (FARTHER - 1.0) * start[k, p])
                s = min(max(s + step, NEARER * start[k, p]), FARTHER * start[k, p])
                if abs(step) < CLOSE_MM:
                    for c in range(cameras):
                        left[c] -= gain[c] * step
                    break
            if not total > 0.0:
                continue
            square, wrong, weights, best, seen, used = 0.0, 0.0, 0.0, -1.0, 0, 0
            own, shared = 0.0, 0.0
            for c in range(cameras):
                if left[c] == left[c]:
                    weight = (gain[c] / off[c]) ** 2
                    edge = min(edge_px[c, k, around(int(at[c] + 0.5), edge_px.shape[2])], off[c])
                    own += weight * (1.0 - (edge / off[c]) ** 2)
                    shared += abs(gain[c]) * edge / (off[c] * off[c])
                    square += (left[c] / off[c]) ** 2
                    wrong += (left[c] / max(off[c], LEAST_PX)) ** 2
                    weights += weight
                    seen += 1
                    if weight > best:
                        best, heaviest[k, p] = weight, c
            if seen == 0 or not weights > 0.0:
                continue
            line[k, p] = int(at[heaviest[k, p]] + 0.5)
            if shared > ACROSS * most * weights and not gated:
                state[k, p] = EDGE
                clean[p] = 0.0  # it would put its neighbours off, too
                continue
            if not weights * (NOISY * most) ** 2 >= 1.0 and not gated:
                state[k, p] = BLUNT
                continue
            if seen > 1 and wrong > CONTRADICTS * CONTRADICTS * (seen - 1) and not gated:
                state[k, p] = CONTRADICTED
                continue
            for c in range(cameras):
                if left[c] == left[c] and (gain[c] / off[c]) ** 2 > SHARE * weights:
                    used += 1
            state[k, p] = KNOWN
            distance[k, p], sigma[k, p] = s, math.sqrt(own + shared * shared) / weights
            camera[k, p] = heaviest[k, p] if used == 1 else cameras
            if seen == 2 and best < (1.0 - BOTH) * weights:
                apart[k, p] = square
        if gated:
            continue
        for p in range(steps):
            if state[k, p] == EDGE or state[k, p] == BLUNT:
                _among_neighbours(clean, bias_px, p, start[k, p], most, distance[k], sigma[k], camera[k], state[k])


@jit
def _among_neighbours(clean, bias_px, p, start, most, distance, sigma, camera, state):  # type: ignore[no-untyped-def]
    """A direction that says too little by itself: as far from a clean wall as its neighbours are together."""
    steps, cameras = clean.shape[:2]
    beside = max(int(BESIDE_DEG * steps / 360.0 + 0.5), 1)
    total, by_turn, by_square = 0.0, 0.0, (steps / (360.0 * SLOPE_MM_DEG)) ** 2
    pull, pull_turn, square, count, best, first = 0.0, 0.0, 0.0, 0, 0.0, 0
    shift = np.zeros((cameras, 2))  # pull and pull_turn if all of a camera's places are off by a pixel
    for c in range(cameras):
        own = 0.0
        for d in range(-beside, beside + 1):
            weight, towards, left, by_px = clean[around(p + d, steps), c]
            if left > 0.0:
                own, by_turn, by_square = own + weight, by_turn + weight * d, by_square + weight * d * d
                pull, pull_turn, square = pull + towards, pull_turn + towards * d, square + left
                shift[c, 0], shift[c, 1] = shift[c, 0] + by_px, shift[c, 1] + by_px * d
                count += 1
        total += own
        if own > best:
            best, first = own, c
    if count <= beside or not total > 0.0:
        return
    lean = by_turn / by_square
    known = total - by_turn * lean
    beyond = (pull - pull_turn * lean) / known
    slope = (pull_turn - by_turn * beyond) / by_square
    unlike = (square - pull * beyond - pull_turn * slope) / count
    variance = ALIKE * max(unlike, 1.0) / known
    for c in range(cameras):
        variance += (bias_px[c] * (shift[c, 0] - shift[c, 1] * lean) / known) ** 2
    if not variance <= most * most:
        return
    state[p], sigma[p], distance[p] = KNOWN, math.sqrt(variance), start + beyond
    camera[p] = first if total - best < SHARE * total else cameras


@jit
def _look(stray, sigma_px, course, line):  # type: ignore[no-untyped-def]
    """Where a ring was seen on a line between lines (sample), how that changes from line to line, and its sigma, px;
    NaN where it was not seen."""
    if line != line:
        return np.nan, np.nan, np.nan
    lines = len(stray)
    at = int(line)
    a, b = around(at, lines), around(at + 1, lines)
    return _between(a, b, line - at, stray[a], sigma_px[a], stray[b], sigma_px[b], stray, course)


@jit
def _between(a, b, part, here, here_px, there, there_px, stray, course):  # type: ignore[no-untyped-def]
    lines = len(stray)
    if here == here and there == there:
        if abs(there - here) > JUMP_PX:
            return np.nan, np.nan, np.nan
        value, off = here + part * (there - here), here_px + part * (there_px - here_px)
    elif here == here and part <= 0.5:
        value, off = here, here_px
    elif there == there and part > 0.5:
        value, off = there, there_px
    else:
        return np.nan, np.nan, np.nan
    slope = course[b] - course[a]
    change = stray[around(b + SLOPE_LINES, lines)] - stray[around(a - SLOPE_LINES, lines)]
    change /= 2 * SLOPE_LINES + 1
    value += course[a] + part * slope
    if change == change and abs(change) < JUMP_PX / 2:
        slope += change
    return value, slope, off
