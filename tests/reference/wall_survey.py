"""What host/native/wall_stations.c, wall_looks.c, wall_axis.c and the last of wall_grid.c answer, value by value."""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray


def station_medians(field: FloatArray, rows: int, beside: int) -> FloatArray:
    """(S, A) medians over so many rows and columns beside, round the clock; NaN where the column itself has nothing."""
    out = np.full((-(-len(field) // rows), field.shape[1]), np.nan)
    for station, line in enumerate(out):
        part = field[station * rows : (station + 1) * rows]
        for column in range(len(line)):
            about = part[:, [(column + step) % len(line) for step in range(-beside, beside + 1)]]
            if np.isfinite(part[:, column]).any():
                line[column] = np.median(about[np.isfinite(about)].astype(float))
    return out


def closed_line(radius: FloatArray, shape: FloatArray, unseen_most: float, gap_most: float, even: int) -> tuple:
    """Length and area of the closed line through radii, what was not seen crossed in the shape's course; NaN where too
    much was not, in all or on end."""
    n, known = len(radius), np.flatnonzero(np.isfinite(radius))
    if not len(known) or n - len(known) > unseen_most or (np.diff(known, append=known[0] + n) - 1).max() > gap_most:
        return np.nan, np.nan
    line = shape + np.interp(np.arange(n), known, (radius - shape)[known], period=n)
    line = np.mean([np.roll(line, even // 2 - k) for k in range(even)], axis=0)
    turn = 2 * np.pi / n
    ahead, arc = np.roll(line, -1), (turn / 2) / np.sin(turn / 2)
    length = arc * np.sqrt(line**2 + ahead**2 - 2 * line * ahead * np.cos(turn)).sum()
    return float(length), float(0.5 * turn * (line**2).sum())


def shape_departures(points: FloatArray, stations: FloatArray, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radius of each point, and how far it lies outside the shape at its station."""
    x, y, z = points.astype(float).T
    s = [np.interp(z, stations, column) for column in shape.T]
    t = np.arctan2(x, -y)
    at = s[0] + s[1] * np.cos(t) + s[2] * np.sin(t) + s[3] * np.cos(2 * t) + s[4] * np.sin(2 * t)
    return np.hypot(x, y), np.hypot(x, y) - at


def round_axis(points: FloatArray, clock: bool) -> FloatArray:
    """(3, N) radius, angle from x towards y in radians or of the clock in degrees, z."""
    x, y, z = points.astype(float).T
    return np.stack([np.hypot(x, y), np.degrees(np.arctan2(x, -y)) % 360.0 if clock else np.arctan2(y, x), z])


def spot_pairs(cell: IntArray, frame: IntArray, ring: IntArray, calm: BoolArray) -> list[tuple[int, int]]:
    """Of each ring of each frame its middle point on a calm spot; held against the next there, then those against the
    one after, where that is another frame's."""
    order = np.lexsort((ring, frame, cell))
    key = np.stack([cell, frame, ring])[:, order]
    start = np.flatnonzero(np.append(True, (np.diff(key) != 0).any(axis=0))) if len(order) else np.zeros(0, int)
    one = order[(start + np.append(start[1:], len(order))[: len(start)]) // 2]
    one = one[calm[cell[one]]]
    steps = [(one[i], one[i + step]) for step in (1, 2) for i in range(len(one) - step)]
    return [(int(a), int(b)) for a, b in steps if cell[a] == cell[b] and frame[a] != frame[b]]


def cell_observations(cell: IntArray, number: IntArray, square: FloatArray, cells: int) -> tuple:
    """Of each cell how many numbers it has, equals once, and the sum of what they square to."""
    of = [sorted(set(number[cell == c].tolist())) for c in range(cells)]
    return [float(len(one)) for one in of], [sum(square[n % len(square)] for n in one) for one in of]


def ring_ends(
    look: IntArray, angle: FloatArray, column: IntArray, inside: BoolArray, open_ended: BoolArray, order: IntArray
) -> list[tuple[int, int, float]]:
    """Of every look with three columns inside: its first and last of them where sound wall follows with a point of its
    own: look, column, and the angle of the last such point and half a direction towards the opening."""
    out = []
    for i in np.flatnonzero(np.count_nonzero(inside, axis=1) >= 3):
        run, mine = np.flatnonzero(inside[i]), np.flatnonzero(look == i)
        for last, way in ((run[0], -1), (run[-1], 1)):
            beyond = last + way
            if not 0 <= beyond < inside.shape[1] or open_ended[i, beyond]:
                continue
            ends = angle[mine[column[mine] == order[beyond]]]
            if len(ends):
                step = np.median(np.diff(np.sort(angle[mine]))) if len(mine) > 1 else np.nan
                out.append((int(i), int(last), float(way * (way * ends).min() - way * step / 2)))
    return out


def middle_points(points: FloatArray, ring: IntArray, sectors: int, needed: int) -> list[int]:
    """Of each sector of each ring with so many points the one of median radius."""
    x, y, _ = points.astype(float).T
    radius, turn = np.hypot(x, y), np.arctan2(y, x) / (2 * np.pi)
    key = ring.astype(int) * sectors + np.floor(turn * sectors).astype(int) % sectors
    order = np.lexsort((radius, key))
    _, start, count = np.unique(key[order], return_index=True, return_counts=True)
    return [int(one) for one in order[(start + count // 2)[count >= needed]]]


def begin_normals(
    frame: IntArray,
    z: FloatArray,
    direction: FloatArray,
    weight: FloatArray,
    residual: FloatArray,
    lean: FloatArray,
    held_by: FloatArray,
    at: float,
) -> tuple[FloatArray, FloatArray]:
    """Normal equations and right side of what begins at a place (Eq. 1), the five numbers of each head that has points
    on both sides of it eliminated."""
    normal, right = np.zeros((8, 8)), np.zeros(8)
    for one in np.unique(frame):
        own = frame == one
        if not (z[own].max() > at > z[own].min()):
            continue
        d, (u, v) = np.maximum(z[own] - at, 0.0), direction[own].T
        on, bent = (d > 0).astype(float), d * d / 2
        change = -np.stack([u * on, v * on, u * d, v * d, u * bent, v * bent, on, d], axis=1)
        w, head, left = weight[own, None], lean[own], residual[own]
        both, heads = change.T @ (w * head), head.T @ (w * head) + np.diag(held_by)
        normal += change.T @ (w * change) - both @ np.linalg.solve(heads, both.T)
        right += change.T @ (w[:, 0] * left) - both @ np.linalg.solve(heads, head.T @ (w[:, 0] * left))
    return normal, right
