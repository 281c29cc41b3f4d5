"""The wall as triangles: coarse where it is even, fine about whatever stands on it.

Blocks of the (clock, chainage) plane are cut along the lines where a thing begins, ends or has its ramp, so that an
edge is an edge in the mesh. A chord lies inside its arc: vertices are put out by what makes the mean of both agree.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tools.bench.blind.pipe import Thing
from tools.bench.blind.surface import RINGED, Array, Surface, away_deg

BLOCK_DEG, BLOCK_OF_RADIUS = 6.0, 0.1
COARSE_DEG, COARSE_PARTS = 1.5, 2  # of a block without a thing; 0.007 mm from the arc at 76 mm
FINE_DEG, FINE_PARTS = 0.75, 4  # of one with a thing, whose own lines are cut beside
EDGE_MM = 1e-3  # the wall on both sides of a jump


def mesh(surface: Surface, first: float, last: float) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (N, 3) in space and triangles (M, 3) of the wall between two chainages."""
    radius = surface.pipe.radius_mm
    jumps = _jumps(surface, first, last)
    rows = max(1, math.ceil((last - first) / (BLOCK_OF_RADIUS * radius)))
    z_edges = np.linspace(first, last, rows + 1)
    vertices: list[Array] = []
    triangles: list[NDArray[np.int64]] = []
    count = 0
    for z0, z1 in pairwise(z_edges):
        near = [one for one in surface.pipe.things if _meets(one, z0, z1)]
        ringed = any(one.kind in RINGED for one in near)
        z = _lines(z0, z1, FINE_PARTS if near else COARSE_PARTS, [*jumps, *_stations(near)])
        for start in np.arange(0.0, 360.0, BLOCK_DEG):
            mine = [one for one in near if _covers(one, start)]
            fine = bool(mine)
            marks = [clock for one in mine for clock in _clocks(one, radius)]
            step = COARSE_DEG if not fine or (ringed and len(mine) == 1) else FINE_DEG
            clock = _lines(start, start + BLOCK_DEG, round(BLOCK_DEG / step), marks)
            own = z if fine else _lines(z0, z1, COARSE_PARTS, jumps)
            points, faces = _patch(surface, clock, own, math.radians(step))
            vertices.append(points)
            triangles.append(faces + count)
            count += len(points)
    return np.concatenate(vertices), np.concatenate(triangles)


def _patch(surface: Surface, clock: Array, z: Array, step: float) -> tuple[Array, NDArray[np.int64]]:
    grid_clock, grid_z = np.meshgrid(clock, z, indexing="ij")
    r = surface.radius(grid_clock, grid_z, bottoms=False) * (1.0 + step * step / 12.0)
    points = surface.to_space(grid_clock, grid_z, r).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(len(clock) - 1), np.arange(len(z) - 1), indexing="ij")
    a = (i * len(z) + j).ravel()
    b, c, d = a + 1, a + len(z), a + len(z) + 1
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])


def _lines(low: float, high: float, parts: int, marks: Sequence[float]) -> Array:
    inside = [one for one in marks if low < one < high]
    return np.unique(np.round(np.concatenate([np.linspace(low, high, parts + 1), inside]), 9))


def _jumps(surface: Surface, first: float, last: float) -> list[float]:
    """Both sides of wherever the wall steps: where pieces meet, and at a gap's ends."""
    places = [*surface.starts[1:]]
    places += [end for one in surface.pipe.things if one.kind == "gap" for end in one.span_mm]
    return [one + side for one in places for side in (-EDGE_MM, EDGE_MM) if first < one < last]


def _stations(things: Sequence[Thing]) -> list[float]:
    """Where a thing's form has an edge, or must be cut finely along the pipe."""
    marks = []
    for one in things:
        first, last = one.span_mm
        if one.kind in ("pocket", "groove"):
            marks += [first, first + one.ramp_mm, last - one.ramp_mm, last]
        elif one.kind == "joint":
            marks += list(np.linspace(first, last, 41))
        elif one.kind in ("bump", "dent"):
            marks += list(np.linspace(first, last, 25))
    return marks


def _clocks(thing: Thing, radius: float) -> list[float]:
    """The same round the clock."""
    half, ramp = thing.arc_deg / 2, math.degrees(thing.ramp_mm / radius)
    if thing.kind != "pocket":
        return []
    return [(thing.clock_deg + side) % 360.0 for side in (-half, -half + ramp, half - ramp, half)]


def _meets(thing: Thing, z0: float, z1: float) -> bool:
    first, last = thing.span_mm
    on_wall = thing.kind in ("pocket", "groove", "bump", "dent", "joint")
    return on_wall and first < z1 and z0 < last


def _covers(thing: Thing, start_deg: float) -> bool:
    middle = start_deg + BLOCK_DEG / 2
    off = abs(float(away_deg(np.array(middle), thing.clock_deg)))
    return thing.kind in RINGED or off <= thing.arc_deg / 2 + BLOCK_DEG / 2
