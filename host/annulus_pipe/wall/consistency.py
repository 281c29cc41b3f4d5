"""Points that the other frames of a scan contradict.

A shadow's edge inside a stripe can look like a slit all along an arc, and its points then agree with one another. Other
frames see the same wall through other rings, where the shadow falls elsewhere: they outvote it.
"""

from collections.abc import Sequence

import numpy as np

from annulus_pipe.numeric.native import door
from annulus_pipe.wall.cylinder import points_of, round_axis
from annulus_pipe.wall.profile import Profile

# CELL_OF_RADIUS and AGREE_OF_RADIUS are guarded both ways by test_consistency.py; what all of it costs a scan shows in
# the benchmark topics uncertainty and diameter.
COLUMNS = 180  # cells round the pipe; a point is judged by its own cell and the eight around it
CELL_OF_RADIUS = 0.026  # of the radius: a cell's length along the pipe, 2 mm in a 6-inch pipe
ROWS_MAX = 40_000  # cells along the pipe; bounds memory on very long scans
AGREE_OF_RADIUS = 0.01  # of the radius: two points this near in radius see the same wall ..
AGREE_LEAST = 0.1  # .. and where less than this part of the other frames' points do, by weight, though ..
OTHERS_NEEDED = 3  # .. there are so many, the point is contradicted: a step's edge has both sides about it
SURE = 0.1  # of that radius difference: a point known better than this votes no louder
SECTORS = 12  # round the pipe: a ring's part in one of them ..
MOST = 0.5  # .. is wrong as a whole where more than this part of its points is

_votes = door(
    "wall_votes",
    "i8[n] cell",
    "f8[n] frame",
    "f8[n] radius",
    "f8[n] weight",
    "f8 slack",
    "f8 needed",
    "f8 part",
    "i8 rows",
    "i8[c]! first",
    "i8[n]! order",
    "f8[3,n]! sorted",
    "b1[n]! good",
)


def without_inconsistent(profiles: Sequence[Profile]) -> tuple[Profile, ...]:
    """The same profiles less the points that the points of other frames around them contradict.

    A vote weighs 1 / sigma. Who is contradicted along most of an arc is not believed on the rest of it, where fewer
    looked: a stain that a slit crosses draws it aside all the way. How many went is added to each profile's
    `rejected["contradicted"]`. Where few frames look, nothing is dropped.
    """
    if not any(len(profile.points_mm) for profile in profiles):
        return tuple(profiles)
    radius, turn, z = round_axis(points_of(profiles))
    usual = float(np.median(radius))
    low, high = np.percentile(z, [0.05, 99.95])  # a stray point far away must not stretch the grid
    length = max(CELL_OF_RADIUS * usual, float(high - low) / ROWS_MAX)
    rows = int((high - low) / length) + 1
    row = np.clip((z - low) / length, 0, rows - 1).astype(np.int64)
    column = (turn * (COLUMNS / (2 * np.pi))).astype(np.int64) % COLUMNS
    frame = np.repeat(np.arange(len(profiles)), [len(profile.points_mm) for profile in profiles])
    cell = row * COLUMNS + column
    sigma = np.concatenate([profile.sigma_mm for profile in profiles]).astype(np.float64)
    weight = np.nan_to_num(1.0 / np.maximum(sigma, SURE * AGREE_OF_RADIUS * usual), nan=1.0)
    size = len(radius)
    good, first = np.empty(size, np.bool_), np.empty(rows * COLUMNS + 1, np.int64)
    room = (first, np.empty(size, np.int64), np.empty((3, size)))
    against = (AGREE_OF_RADIUS * usual, OTHERS_NEEDED, AGREE_LEAST)
    _votes(cell, frame.astype(np.float64), radius, weight, *against, rows, *room, good)
    ring = np.concatenate([profile.ring for profile in profiles]).astype(np.int64)
    arc = ((frame * (int(ring.max()) + 1) + ring) * SECTORS) + column * SECTORS // COLUMNS
    good &= (np.bincount(arc, weights=~good) <= MOST * np.bincount(arc))[arc]
    out, at = [], 0
    for profile in profiles:
        kept = good[at : at + len(profile.points_mm)]
        at += len(kept)
        out.append(profile if kept.all() else profile.without(~kept, "contradicted"))
    return tuple(out)
