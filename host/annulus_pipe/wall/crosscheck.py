"""What points may be off, as the frames of a scan show it among themselves.

A frame sees its own noise, and guesses from how its rings disagree how far their edges are drawn; a taper, a step or a
pose that is off looks the same to it. Frames overlap: where two of them look at one spot of the wall, through one ring
or two, they differ by the errors of both and by nothing of the pipe's. What all rings and frames have in common is
seen by nobody here: that share stays as it was.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage, optimize
from annulus_pipe.numeric.native import door
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.consistency import AGREE_OF_RADIUS, CELL_OF_RADIUS, COLUMNS
from annulus_pipe.wall.cylinder import points_of, round_axis, round_clock
from annulus_pipe.wall.grid import Wall, cell_medians
from annulus_pipe.wall.profile import Profile

# All by test_crosscheck.py and the benchmark `scenes` (93 to 97 % of true radii inside k = 2).
GAPS_MOST = 4  # rows of spots a point, to be numbered by looking each up
PAIRS_LEAST = 40  # of two rings; fewer say nothing
TOGETHER = 10  # spots beside one another err as one, round the clock: so many pairs tell what a single one would
ALIKE = 0.5  # of the usual scale, as a square: standard deviation of the scale of one ring's noise
# Blind bench, even seeds: k = 2 held for 70 % of points where the wall changes so near them, and for 95 % elsewhere.
EDGE_OF_RADIUS = 0.04  # of the radius, along and round: two pixels of the smallest pictures, which a slit is drawn over
EDGE_PART = 0.5  # of what the wall changes by within that: evenly from side to side would be 0.58, some are on theirs
EDGE_NOISE = 5.0  # times a cell's noise: what cells of an even wall differ by at most, among so many
OFTEN = 95.45  # per cent of differences that are less ..
NORMAL = 2.0  # .. than so many sigma, where errors are normal

# A spot's observations are compared with the next one and the one after: bounds what a long scan costs.
_spot_pairs = door(
    "spot_pairs",
    "i8[n] cell",
    "i8[n] frame",
    "i8[n] ring",
    "b1[c] calm",
    "i8[c]! ends",
    "i4[n]! order",
    "i4[n]! one",
    "i4[2,2,n]! pairs",
    "i8[1]! size",
    returns="i8",
)


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Points a and b (P,) of one spot in two frames, ring of a <= ring of b, and how far a is outside b, mm."""

    a: NDArray[np.intp]
    b: NDArray[np.intp]
    apart_mm: FloatArray

    def of_rings(self, ring: NDArray[np.intp], rings: int) -> Iterator[tuple[int, int, BoolArray]]:
        """Which pairs are of rings i < k, where there are enough. One ring sees a spot twice only from one place: what
        draws its edge there draws it both times, and the two agree though both are off."""
        kind = ring[self.a] * rings + ring[self.b]
        for i, k in combinations(range(rings), 2):
            these = kind == i * rings + k
            if np.count_nonzero(these) >= PAIRS_LEAST:
                yield i, k, these


def with_revised_sigma(profiles: Sequence[Profile], centreline: Centreline) -> tuple[Profile, ...]:
    """The same profiles in pipe coordinates, each point's sigma such that the frames' disagreements are what it says.

    Of every ring over the scan: how far it lies off the others is a bias, known but not taken out; how far frames
    scatter scales what its points said of their own noise and pose: upwards only as long as the poses are the frames'
    own, for neighbours err a little alike; of a pipe of pieces they are not. Where frames do not overlap, sigma stays.
    """
    used = [profile for profile in profiles if _states_sigma_by_ring(profile)]
    if not used:
        return tuple(profiles)
    rings = max(len(p.ring_sigma_mm) for p in used)
    ring = np.concatenate([p.ring for p in used]).astype(np.intp)
    own, fixed = (np.concatenate(parts) for parts in zip(*map(_parts, used), strict=True))
    usual = np.array([np.sqrt(np.median(own[ring == k])) if (ring == k).any() else np.nan for k in range(rings)])
    pairs = _pairs(used, ring, centreline)
    bias, common = _biases(pairs, ring, usual)
    noise = _noises(pairs, ring, own, usual, bias)
    # a part of what no frame can show varies all the same, and is in the differences already
    shown = np.array([np.median(fixed[ring == k]) if (ring == k).any() else 0.0 for k in range(rings)])
    noise = np.sqrt(np.maximum(noise**2 - shown, noise**2 / 4))
    if len(centreline.pieces) == 1:
        noise = np.maximum(noise, usual)
    known = np.isfinite(noise)
    out, at = [], 0
    for profile in profiles:
        if not _states_sigma_by_ring(profile):
            out.append(profile)
            continue
        mine = slice(at, at + len(profile.ring))
        at = mine.stop
        k = ring[mine]
        square = own[mine] * (noise / usual)[k] ** 2 + fixed[mine] + common**2
        sigma = np.where(known[k], _half_of_95(bias[k], np.sqrt(square)), profile.sigma_mm)
        out.append(replace(profile, sigma_mm=sigma.astype(np.float32)))
    return tuple(out)


def with_edges(profiles: Sequence[Profile], wall: Wall) -> tuple[Profile, ...]:
    """The same profiles, the points beside a step of the wall less sure of their radius: a picture cannot tell on which
    side of it they are. Of a point alone: a floor's depth is that of all its points, and knows where they lie."""
    rows = max(1, round(EDGE_OF_RADIUS * wall.mean_radius_mm / wall.z_step_mm))
    columns = max(1, round(np.degrees(EDGE_OF_RADIUS) / wall.clock_step_deg))
    about = np.pad(wall.residual_mm(), ((0, 0), (columns, columns)), mode="wrap")
    seen, size = np.isfinite(about), (2 * rows + 1, 2 * columns + 1)
    high = ndimage.maximum_filter(np.where(seen, about, -np.inf), size, mode="nearest")
    low = ndimage.minimum_filter(np.where(seen, about, np.inf), size, mode="nearest")
    change = np.where(high > low, high - low, 0.0)[:, columns:-columns] - EDGE_NOISE * wall.cell_noise_mm
    edge = np.asarray(EDGE_PART * np.maximum(np.nan_to_num(change), 0.0))
    out = []
    for one in profiles:
        _, clock, z = round_clock(one.points_mm)
        row = np.clip(np.rint((z - wall.z_mm[0]) / wall.z_step_mm), 0, len(wall.z_mm) - 1).astype(np.intp)
        column = np.floor(clock / wall.clock_step_deg).astype(np.intp) % len(wall.clock_deg)
        out.append(replace(one, sigma_mm=np.hypot(one.sigma_mm, edge[row, column]).astype(np.float32)))
    return tuple(out)


def _states_sigma_by_ring(profile: Profile) -> bool:
    return len(profile.ring) > 0 and len(profile.ring_sigma_mm) > int(profile.ring.max())


def _parts(profile: Profile) -> tuple[FloatArray, FloatArray]:
    """Per point, mm^2: what it said of noise and pose; what no frame can show."""
    drawn, hidden = profile.ring_sigma_mm.astype(np.float64)[profile.ring].T
    variance = profile.sigma_mm.astype(np.float64) ** 2
    return np.maximum(variance - drawn**2 - hidden**2, 1e-6 * variance), hidden**2


def _pairs(profiles: Sequence[Profile], ring: NDArray[np.intp], centreline: Centreline) -> _Pairs:
    """One point of each ring and frame a spot, against those of the next frames; spots at a step are left out."""
    radius, turn, z = round_axis(points_of(profiles))
    usual = float(np.median(radius))
    if not centreline.is_even:
        radius = radius - centreline.radius_at(z)
    row = _compact(np.floor(z / (CELL_OF_RADIUS * usual)).astype(np.int64))
    cell = row * COLUMNS + (turn * (COLUMNS / (2 * np.pi))).astype(np.int64) % COLUMNS
    frame = np.repeat(np.arange(len(profiles)), [len(p.ring) for p in profiles])
    calm = _calm(cell, radius, int(row.max()) + 1, AGREE_OF_RADIUS * usual)
    room = np.empty(len(calm), np.int64), np.empty(len(cell), np.int32), np.empty(len(cell), np.int32)
    pairs, more = np.empty((2, 2, len(cell)), np.int32), np.empty(1, np.int64)
    first = _spot_pairs(cell, frame, ring, calm, *room, pairs, more)
    a, b = np.concatenate([pairs[0, :, :first], pairs[1, :, : more[0]]], axis=1).astype(np.intp)
    a, b = np.where(ring[a] > ring[b], b, a), np.where(ring[a] > ring[b], a, b)
    return _Pairs(a, b, radius[a] - radius[b])


def _compact(values: IntArray) -> IntArray:
    """The same numbered from 0 in their order, without gaps."""
    low, high = int(values.min()), int(values.max())
    if high - low > GAPS_MOST * len(values):  # a stray point far away
        return np.unique(values, return_inverse=True)[1]
    there = np.zeros(high - low + 1, np.int64)
    there[values - low] = 1
    return np.asarray((np.cumsum(there) - 1)[values - low])


def _calm(cell: NDArray[np.int64], radius: FloatArray, rows: int, slack: float) -> BoolArray:
    """(cells,) whether the wall is even to `slack` over a spot and those around it: points of a flank differ."""
    wall, _ = cell_medians(cell, radius, (rows, COLUMNS))
    wall = np.pad(wall, ((0, 0), (1, 1)), mode="wrap")
    unseen = ~np.isfinite(wall)
    low = ndimage.minimum_filter(np.where(unseen, np.inf, wall), 3, mode="nearest")[:, 1:-1]
    high = ndimage.maximum_filter(np.where(unseen, -np.inf, wall), 3, mode="nearest")[:, 1:-1]
    return np.asarray((high - low < slack).ravel())


def _biases(pairs: _Pairs, ring: NDArray[np.intp], usual: FloatArray) -> tuple[FloatArray, float]:
    """(K,) how far outside the wall each ring lies, all of them weighed by their noise being right on average; and how
    far that average may be off, were biases as large, beside noise, as they are found to be."""
    weight = np.nan_to_num(1.0 / usual**2)
    rows, right = [weight / weight.sum()], [0.0]
    for i, k, these in pairs.of_rings(ring, len(usual)):
        if i != k:
            rows.append(np.zeros(len(usual)))
            rows[-1][[i, k]] = 1.0, -1.0
            right.append(float(np.median(pairs.apart_mm[these])))
    bias = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    seen = weight > 0
    return bias, math.sqrt(float(np.mean((bias[seen] / usual[seen]) ** 2)) / float(weight.sum()))


def _noises(pairs: _Pairs, ring: NDArray[np.intp], own: FloatArray, usual: FloatArray, bias: FloatArray) -> FloatArray:
    """(K,) sigma of each ring, mm; NaN where nothing tells. Two rings' differences scatter by both: solved for each.

    Not the median of the differences but one that few exceed says what interval most errors lie in: they have tails.
    And differences in what their two points expected: where some frames and flanks are worse than most, and say so,
    nothing is to be scaled.
    """
    rings = len(usual)
    rows, right, seen = [], [], np.zeros(rings, bool)
    for i, k, these in pairs.of_rings(ring, rings):
        expected = np.sqrt(own[pairs.a[these]] + own[pairs.b[these]])
        apart = np.abs(pairs.apart_mm[these] - bias[i] + bias[k]) / expected
        both = (float(np.percentile(apart, OFTEN)) / NORMAL) ** 2
        trust = math.sqrt(len(apart)) / max(both, 1e-12)
        row = np.zeros(rings)
        row[[i, k]] = usual[[i, k]] ** 2 / (usual[i] ** 2 + usual[k] ** 2)
        rows.append(trust * row)
        right.append(trust * both)
        seen[[i, k]] = True
    if not rows:
        return np.full(rings, np.nan)
    table = np.array(rows)
    all_alike = float(table.sum(axis=1) @ right) / float(np.square(table.sum(axis=1)).sum())
    prior = np.eye(rings) * math.sqrt(TOGETHER) / (ALIKE * all_alike)
    square = optimize.nnls(np.vstack([table, prior]), np.append(right, prior.sum(axis=1) * all_alike))[0]
    return np.where(seen, usual * np.sqrt(square), np.nan)


def _half_of_95(bias: FloatArray, noise: FloatArray) -> FloatArray:
    """Half of what an error of a known bias and of normal noise stays within 95 times of 100: what k = 2 promises.

    The root of squares as long as the bias is small; beyond, it reaches one tail only. The two touch at noise / sqrt 3.
    """
    bias = np.abs(bias)
    one_tail = 0.5 * (bias + math.sqrt(3) * noise)
    return np.where(bias < noise / math.sqrt(3), np.hypot(bias, noise), one_tail)
