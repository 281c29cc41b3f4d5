"""How far sound wall lies apart along the pipe: so wide a gap between two pipes may lie there.

A gap goes all round, and in every sector no ring that lands in it lands on wall. So it is no wider than the way from
the last sound wall before it to the first one after it. Where that way is as long as rings lie apart on any wall, a gap
would have to lie between two rings; where something in it is no sound wall, or where nothing came back over a longer
way, it may be a gap.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.wall.grid import BRIDGE_OF_RADIUS, Wall
from annulus_pipe.wall.indications import Limits
from annulus_pipe.wall.joints import Joint, taken
from annulus_pipe.wall.looks import LookPoints

# Held by test_gaps_never_flattered.py, set with its even draws.
ROW_MM = 1.0  # a gap has a row of its own between its ends
GAP_SECTORS = 12  # each with its own ends: two pipes at an angle have theirs askew
ROW_POINTS = 3  # of a row of a sector, that say something: fewer are strays
MOST_OF = 0.5  # part of a row's points that agree, and part of the sectors: rods and bands hide fewer


@dataclass(frozen=True, slots=True)
class Apart:
    """A stretch without sound wall all round, mm: no gap in it is wider than `most_mm`, infinite at an end of the scan.
    hidden_mm : how much of that a joint's step outwards keeps from every ring's light. is_plain : nothing there but
    that rings lie so far apart."""

    from_mm: float
    to_mm: float
    most_mm: float
    hidden_mm: float
    is_plain: bool


def sound_wall_apart(
    wall: Wall, points: LookPoints | None, joints: Sequence[Joint] = (), shadow_ratio: float = 0.0
) -> tuple[Apart, ...]:
    """Every stretch that is no plain wall in order of distance, and then one over all of the scan for what is.

    points : of the rings; None where every pixel measures, and the map's cells are points. joints : those that say
    themselves how wide their gap is are left out. shadow_ratio : of the narrowest ring, see `taken`.
    """
    limits = Limits()
    limit = max(limits.seed_noise * float(np.median(wall.noise_mm)), limits.seed_of_radius * wall.mean_radius_mm)
    z, clock, departure = _cells(wall) if points is None else (points.z_mm, points.clock_deg, points.departure_mm)
    first, last = wall.extent[:2]
    rows = int(np.ceil((last - first) / ROW_MM))
    inside = (z >= first) & (z < last)
    row = np.minimum(((z[inside] - first) / ROW_MM).astype(np.intp), rows - 1)
    key = (clock[inside] * GAP_SECTORS / 360.0).astype(np.intp) % GAP_SECTORS * rows + row
    own = np.minimum(((np.arange(rows) + 0.5) * ROW_MM / wall.z_step_mm).astype(np.intp), len(wall.z_mm) - 1)
    measured = np.asarray(taken(wall, [one for one in joints if one.measures_gap], shadow_ratio).any(axis=1))[own]
    way, broken, known = _ways(key, z[inside] - first, np.abs(departure[inside]) < limit, measured)
    if not known.any():
        return ()
    way, broken = np.median(way[known], axis=0), broken[known].mean(axis=0) >= MOST_OF
    ends = np.isinf(way)  # a scan ends where it ends; what is no wall there may be half of a gap
    longest = BRIDGE_OF_RADIUS * wall.mean_radius_mm
    odd = np.where(ends, broken, (way > longest) | (broken & (way > limits.size_of_radius * wall.mean_radius_mm)))
    out = []
    label, n = ndimage.label(odd)
    for i in range(1, n + 1):
        mine = np.flatnonzero(label == i)
        begins, stops = first + float(mine[0]) * ROW_MM, first + float(mine[-1] + 1) * ROW_MM
        hidden = max((one.hidden_mm for one in joints if one.from_mm < stops and one.to_mm > begins), default=0.0)
        out.append(Apart(begins, stops, float(way[mine].max()), hidden, is_plain=False))
    if (plain := ~odd & ~ends).any():
        out.append(Apart(first, last, float(way[plain].max()), 0.0, is_plain=True))
    return tuple(out)


def _ways(
    key: IntArray, z_mm: FloatArray, sound: BoolArray, measured: BoolArray
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """(S, R) of each row of each sector from sound wall before it to sound wall after it, mm, 0 where it is sound
    itself or measured; whether something that is no sound wall lies between; (S,) whether the sector saw sound wall.

    key : (N,) sector * R + row of each point. z_mm : from the first row on.
    """
    shape = GAP_SECTORS, len(measured)
    size = GAP_SECTORS * len(measured)
    count, good = np.bincount(key, minlength=size), np.bincount(key[sound], minlength=size)
    shown = (good >= ROW_POINTS) & (good > MOST_OF * count)
    broken = (count - good >= ROW_POINTS) & ~shown
    low, high = np.full(size, np.inf), np.full(size, -np.inf)
    np.minimum.at(low, key[sound], z_mm[sound])
    np.maximum.at(high, key[sound], z_mm[sound])
    at = np.arange(len(measured))
    is_sound = shown.reshape(shape) | measured
    low = np.where(measured, np.minimum(low.reshape(shape), at * ROW_MM), low.reshape(shape))
    high = np.where(measured, np.maximum(high.reshape(shape), (at + 1) * ROW_MM), high.reshape(shape))
    before = np.maximum.accumulate(np.where(is_sound, at, -1), axis=1)
    after = np.minimum.accumulate(np.where(is_sound, at, len(measured))[:, ::-1], axis=1)[:, ::-1]
    a, b = before.clip(0), after.clip(max=len(measured) - 1)
    way = np.take_along_axis(low, b, axis=1) - np.take_along_axis(high, a, axis=1)
    way[(before < 0) | (after > b)] = np.inf
    odd = np.cumsum(broken.reshape(shape), axis=1)
    between = np.take_along_axis(odd, b, axis=1) > np.where(before < 0, 0, np.take_along_axis(odd, a, axis=1))
    return np.where(is_sound, 0.0, way), ~is_sound & between, np.asarray(shown.reshape(shape).any(axis=1))


def _cells(wall: Wall) -> tuple[FloatArray, FloatArray, FloatArray]:
    row, column = np.nonzero(wall.seen & (wall.count > 0))
    return wall.z_mm[row], wall.clock_deg[column], wall.residual_mm()[row, column].astype(np.float64)
