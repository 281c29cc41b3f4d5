"""What host/native/wall_adjustment.c computes, sighting by sighting, on the centre line as Python lays it."""

import math

import numpy as np

from annulus_pipe.geometry.pose import rotations
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wall.adjustment import SHAPE, START, TAPER, AdjustmentState, Sightings, Where
from annulus_pipe.wall.centreline import STRAIGHT, Centreline


def point_to_pipe(point: FloatArray, piece: int, line: Centreline) -> tuple[float, float, float]:
    """x, y, chainage of a point in space, sought from a piece on."""
    while True:
        x, y, z = (float(v) for v in line.frames[piece].T @ (point - line.origins[piece]))
        bend = np.array(line.pieces[piece].curvature)
        k = float(np.hypot(*bend))
        if k > STRAIGHT:
            bx, by = bend / k
            towards = bx * x + by * y
            arm = 1.0 / k - towards
            change = 1.0 / k - math.hypot(arm, z) - towards  # back about the bend's centre, to the piece's beginning
            x, y, z = x + change * bx, y + change * by, math.atan2(z, arm) / k
        z += line.starts[piece]
        if piece + 1 == len(line.pieces) or not z > line.starts[piece + 1]:
            return x, y, z
        piece += 1


def locate(seen: Sightings, state: AdjustmentState) -> Where:
    """Eq. 1 of every sighting, from camera to space to pipe."""
    line, radii = state.centreline(), state.radii_mm()
    origins, frames = line.frames_at(seen.chainage_mm)
    turned = rotations(state.heads[:, 0], state.heads[:, 1], state.heads[:, 4])
    since = line.piece_of(seen.chainage_mm)
    size = len(seen.frame)
    out = Where(np.empty(size), np.empty(size), np.empty((size, 2)))
    for n, (frame, ring) in enumerate(zip(seen.frame, seen.ring, strict=True)):
        off = seen.points_mm[n] - (state.bias_mm[ring] @ seen.ways[n]) * seen.slide_mm[n]
        off[:2] -= state.heads[frame, 2:4]
        space = origins[frame] + frames[frame] @ turned[frame].T @ off
        x, y, z = point_to_pipe(space, int(since[frame]), line)
        own = int(np.searchsorted(line.starts[1:], z, side="right")) if math.isfinite(z) else 0
        radius = math.hypot(x, y)
        x, y = x / max(radius, 1e-9), y / max(radius, 1e-9)
        row = state.pieces[own]
        t = math.atan2(y, x)
        waves = [math.cos(2 * t), math.sin(2 * t), math.cos(3 * t), math.sin(3 * t)]
        out.residual_mm[n] = radius - (radii[own] + row[TAPER] * (z - row[START]) + row[SHAPE] @ waves)  # Eq. 1
        out.chainage_mm[n], out.direction[n] = z, (x, y)
    return out
