"""Walls: where a ray meets one that is not a plain cylinder, and what stands between it and a light.

In closed form where the wall is a plain cylinder, by secant where it swells gently, by marching and bisection where it
has edges. Tiles of the wall map say which, and bound what a ray may meet on its way.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.late import ndimage
from annulus_pipe.twin.stretch import (
    COLUMN,
    CX,
    CY,
    CZ,
    F32,
    LIT,
    NX,
    NY,
    NZ,
    OPEN,
    PAINT,
    PLAIN,
    U8,
    WX,
    WY,
    WZ,
    PixelRun,
    Real,
    S,
    X,
    Y,
    Z,
    atan2,
    jit,
)
from annulus_pipe.twin.worlds.world import CLOCKS, STEP_Z_MM, World

PER_Z = np.float32(1.0 / STEP_Z_MM)
_TILE_ROWS, _TILE_COLUMNS = 6, 8  # cells of the wall map to a tile: 2.4 mm by 2 degrees
_PLAIN_MM = 0.002  # a tile deviating less than this is a cylinder
_STEEP = 0.25  # slope above which a wall can hide itself from a grazing ray
_WALL_PITCH = CLOCKS + 4  # of the padded wall map: one column before twelve o'clock, three after
_MARCH_MM = 0.8  # along the pipe; no feature is shorter, and bisection follows
GENTLE, STEEP, PAINTED = 1, 2, 4  # bits of a tile's kind; a steep one has both


Ray = tuple[Real, Real, Real]  # x, y, z in the pipe frame


class Relief(NamedTuple):
    """The shape of a wall, as a march along one ray needs it."""

    radius: np.float32  # mm
    z0: np.float32  # station of the first row of the map, mm
    deviation: F32  # the world's radius map, padded and flat
    tile_low: F32  # bounds of the deviation within a tile, mm
    tile_high: F32


class WorldWall(NamedTuple):
    """A world's wall."""

    relief: Relief
    near_low: F32  # bounds of what a ray to the tile may meet on its way, mm
    near_high: F32
    kind: U8


@jit
def wall_at(deviation: F32, column: Real, row: Real) -> Real:
    """Bilinear deviation (mm) at a fractional map place, column -1..CLOCKS + 1; its first and last row are clean."""
    return _wall_and_slopes(deviation, column, row)[0]


@jit
def _wall_and_slopes(deviation: F32, column: Real, row: Real) -> Real:
    """Deviation (mm), its change per column, its change per row. Unsigned indices: no wrap-around to check for."""
    top = np.float32(deviation.shape[0] // _WALL_PITCH) - np.float32(1.01)
    row = min(max(row, np.float32(0.0)), top)
    column += np.float32(1.0)
    i, j = np.int32(row), np.int32(column)
    fj, fi = column - np.float32(j), row - np.float32(i)
    k = np.uint64(np.uint32(i * np.int32(_WALL_PITCH) + j))
    a, b = deviation[k], deviation[k + np.uint64(1)]
    c, d = deviation[k + np.uint64(_WALL_PITCH)], deviation[k + np.uint64(_WALL_PITCH + 1)]
    left, right = a + fi * (c - a), b + fi * (d - b)
    return left + fj * (right - left), right - left, (c - a) + fj * ((d - b) - (c - a))


@jit
def _cylinder(cx: Real, cy: Real, wx: Real, wy: Real, radius: Real) -> Real:
    """Range along a ray from inside to the cylinder r = radius about the z axis; 1e6 if it never gets there."""
    a = wx * wx + wy * wy + np.float32(1e-12)
    b = cx * wx + cy * wy
    c = cx * cx + cy * cy - radius * radius
    return min((np.sqrt(max(b * b - a * c, np.float32(0.0))) - b) / a, np.float32(1e6))


@jit
def _column(x: Real, y: Real) -> Real:
    """Fractional map column of a pipe-frame place: clock angle = atan2(x, -y), in [0, CLOCKS)."""
    f = atan2(x, -y) * np.float32(CLOCKS / (2 * np.pi))
    return f + np.float32(CLOCKS) if f < 0 else f


@jit
def _excess(relief: Relief, s: Real, c: F32, way: Ray, column: Real) -> Real:
    """r - wall at range s of a ray in the pipe frame; the clock angle hardly changes over a wall's roughness."""
    wx, wy, wz = way
    x, y, z = c[0] + s * wx, c[1] + s * wy, c[2] + s * wz
    return np.sqrt(x * x + y * y) - relief.radius - wall_at(relief.deviation, column, (z - relief.z0) * PER_Z)


@jit
def _meet_gentle(part: PixelRun, station: F32, relief: Relief) -> None:
    """Meet a wall without edges instead of the plain cylinder, for a whole stretch: mends range, place and normal.

    The fixed point r = R + wall(where r is met), by secant, at every fourth pixel; such a wall is straight enough
    between them (0.01 mm).
    """
    scratch, n, z0, radius, deviation = part.scratch, part.n, relief.z0, relief.radius, relief.deviation
    one, half, quarter = np.float32(1.0), np.float32(0.5), np.float32(0.25)
    sx, sy, sz = station[0], station[1], station[2]
    c0 = sx * sx + sy * sy
    was, was_c, was_z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range((n + 6) // 4):
        u = min(4 * k, n - 1)
        wx, wy, wz, column = scratch[WX + u], scratch[WY + u], scratch[WZ + u], scratch[COLUMN + u]
        d0 = wall_at(deviation, column, (scratch[Z + u] - z0) * PER_Z)
        s = _cylinder(sx, sy, wx, wy, radius + d0)
        d1 = wall_at(deviation, column, (sz + s * wz - z0) * PER_Z)
        gain = (d1 - d0) / (d0 if abs(d0) > np.float32(1e-3) else np.float32(1e-3))
        lift = one / (one - min(max(gain, -half), half))
        d2 = d0 + (d1 - d0) * lift
        s = _cylinder(sx, sy, wx, wy, radius + d2)
        d3, slope_c, slope_z = _wall_and_slopes(deviation, column, (sz + s * wz - z0) * PER_Z)
        d3 = d2 + (d3 - d2) * lift
        if k > 0:
            for i in range(4):
                t = quarter * np.float32(i)
                at = 4 * k - 4 + i
                scratch[LIT + at] = was + t * (d3 - was)
                scratch[NX + at] = was_c + t * (slope_c - was_c)
                scratch[NZ + at] = was_z + t * (slope_z - was_z)
        was, was_c, was_z = d3, slope_c, slope_z
    for u in range(n):
        wx, wy, wz = scratch[WX + u], scratch[WY + u], scratch[WZ + u]
        r = radius + scratch[LIT + u]
        a = wx * wx + wy * wy + np.float32(1e-7)
        b = sx * wx + sy * wy
        s = (np.sqrt(max(b * b - a * (c0 - r * r), np.float32(0.0))) - b) / a
        x, y = sx + s * wx, sy + s * wy
        inverse = one / r
        slope_z = scratch[NZ + u] * PER_Z
        slope_c = scratch[NX + u] * np.float32(CLOCKS / (2 * np.pi)) * inverse
        ex, ey = x * inverse, y * inverse  # outwards; the clock angle grows along (-ey, ex)
        scale = one / np.sqrt(one + slope_c * slope_c + slope_z * slope_z)
        scratch[S + u], scratch[X + u], scratch[Y + u], scratch[Z + u] = s, x, y, sz + s * wz
        scratch[NX + u], scratch[NY + u] = (ex + slope_c * ey) * scale, (ey - slope_c * ex) * scale
        scratch[NZ + u] = -slope_z * scale


@jit
def _meet_steep(relief: Relief, c: F32, way: Ray, low: Real, high: Real, column: Real) -> Real:
    """Range at which a ray first goes through a wall that stays within low..high (mm) thereabouts.

    The clock angle is that of the plain cylinder; over low..high it drifts by less than a map column.
    """
    radius, z0, tile_low, tile_high = relief.radius, relief.z0, relief.tile_low, relief.tile_high
    wx, wy, wz = way
    s0 = _cylinder(c[0], c[1], wx, wy, radius + low - np.float32(0.01))
    s1 = _cylinder(c[0], c[1], wx, wy, radius + high + np.float32(0.01))
    # the tiles it really passes on its way know tighter bounds: often a flat floor, and no march at all
    first = int((c[2] + min(s0 * wz, s1 * wz) - z0) * PER_Z) // _TILE_ROWS
    last = int((c[2] + max(s0 * wz, s1 * wz) - z0) * PER_Z) // _TILE_ROWS
    at = min(int(column) // _TILE_COLUMNS, tile_low.shape[1] - 1)
    if first >= 0 and last < tile_low.shape[0]:
        low, high = tile_low[first, at], tile_high[first, at]
        for i in range(first + 1, last + 1):
            low, high = min(low, tile_low[i, at]), max(high, tile_high[i, at])
        if high - low < np.float32(1e-3):
            return _cylinder(c[0], c[1], wx, wy, radius + low)
        s0 = _cylinder(c[0], c[1], wx, wy, radius + low - np.float32(0.01))
        s1 = _cylinder(c[0], c[1], wx, wy, radius + high + np.float32(0.01))
    a, fa = s0, _excess(relief, s0, c, way, column)
    if fa >= 0:
        return s0
    steps = min(int(abs((s1 - s0) * wz) * np.float32(1.0 / _MARCH_MM)) + 2, 200)
    ds = (s1 - s0) / np.float32(steps)
    b, fb = s1, np.float32(-1.0)
    for i in range(1, steps + 1):
        b = s0 + np.float32(i) * ds
        fb = _excess(relief, b, c, way, column)
        if fb >= 0:
            break
        a, fa = b, fb
    if fb <= 0:
        return b
    side = 0
    for _ in range(8):  # regula falsi, Illinois
        m = (a * fb - b * fa) / (fb - fa)
        fm = _excess(relief, m, c, way, column)
        if abs(fm) < np.float32(1e-3):
            return m
        if fm < 0:
            a, fa = m, fm
            if side == -1:
                fb *= np.float32(0.5)
            side = -1
        else:
            b, fb = m, fm
            if side == 1:
                fa *= np.float32(0.5)
            side = 1
    return (a * fb - b * fa) / (fb - fa)


@jit
def _shadowed(relief: Relief, place: Ray, light: F32, low: Real, column: Real) -> bool:
    """Whether the wall stands between a wall point and a light inside the pipe (both pipe frame)."""
    radius, z0, tile_low, deviation = relief.radius, relief.z0, relief.tile_low, relief.deviation
    x, y, z = place
    dx, dy, dz = light[0] - x, light[1] - y, light[2] - z
    r0 = np.sqrt(x * x + y * y)
    drop = (dx * x + dy * y) / r0  # how fast r falls on the way
    clear = min(
        (low - (r0 - radius)) / min(drop, np.float32(-1.0)), np.float32(0.5)
    )  # from here on nothing can hide it
    if clear <= 0:
        return False
    at = min(int(column) // _TILE_COLUMNS, tile_low.shape[1] - 1)
    last = min(max(int((z - z0) * PER_Z) // _TILE_ROWS, 0), tile_low.shape[0] - 1)
    first = min(max(int((z + clear * dz - z0) * PER_Z) // _TILE_ROWS, 0), last)
    lowest = tile_low[last, at]
    for i in range(first, last):
        lowest = min(lowest, tile_low[i, at])
    if lowest > r0 - radius - np.float32(0.03):
        return False  # nothing on the way stands higher than this point
    turn = (x * dy - y * dx) / (r0 * r0) * np.float32(CLOCKS / (2 * np.pi))  # columns per unit of t
    step = np.float32(_MARCH_MM) / (abs(dz) + np.float32(1e-3))
    t = np.float32(0.6) * step  # off the surface, so that it does not shadow itself
    while t < clear:
        qx, qy, qz = x + t * dx, y + t * dy, z + t * dz
        r = np.sqrt(qx * qx + qy * qy) - radius
        at_column = min(max(column + t * turn, np.float32(-1.0)), np.float32(CLOCKS + 1))
        if r > wall_at(deviation, at_column, (qz - z0) * PER_Z) + np.float32(0.03):
            return True
        t += step
    return False


@jit
def _meet_rough(
    part: PixelRun, rough: int, station: F32, starts: F32 | None, wall: WorldWall, light: F32, ask_shadow: bool
) -> None:
    """Meet a wall with edges, where a pixel's kind has a bit of `rough`: mends range, place, normal and shadow."""
    scratch, kinds, relief = part.scratch, part.marks, wall.relief
    z0, deviation = relief.z0, relief.deviation
    start = station.copy()  # of the ray in hand
    for k in range(part.n):
        if not kinds[k] & rough:
            continue
        if starts is not None:
            start[0], start[1], start[2] = scratch[CX + k], scratch[CY + k], scratch[CZ + k]
        row = (start[2] + scratch[WZ + k] * scratch[PLAIN + k] - z0) * PER_Z
        ti, tj = int(row) // _TILE_ROWS, min(int(scratch[COLUMN + k]) // _TILE_COLUMNS, wall.kind.shape[1] - 1)
        near_low, near_high = wall.near_low[ti, tj], wall.near_high[ti, tj]
        wx, wy, wz, column = scratch[WX + k], scratch[WY + k], scratch[WZ + k], scratch[COLUMN + k]
        s = _meet_steep(relief, start, (wx, wy, wz), near_low, near_high, column)
        x, y, z = start[0] + s * wx, start[1] + s * wy, start[2] + s * wz
        r = np.sqrt(x * x + y * y)
        row = (z - z0) * PER_Z
        half = np.float32(0.4)  # of a map cell, both ways
        slope_c = wall_at(deviation, column + half, row) - wall_at(deviation, column - half, row)
        slope_z = (wall_at(deviation, column, row + half) - wall_at(deviation, column, row - half)) * (
            PER_Z / (half + half)
        )
        slope_c *= np.float32(CLOCKS / (2 * np.pi)) / (r * (half + half))
        ex, ey = x / r, y / r
        scale = np.float32(1.0) / np.sqrt(np.float32(1.0) + slope_c * slope_c + slope_z * slope_z)
        scratch[S + k], scratch[X + k], scratch[Y + k], scratch[Z + k] = s, x, y, z
        scratch[NX + k], scratch[NY + k] = (ex + slope_c * ey) * scale, (ey - slope_c * ex) * scale
        scratch[NZ + k] = -slope_z * scale
        low = near_low - np.float32(0.02)
        if ask_shadow and _shadowed(relief, (x, y, z), light, low, column):
            scratch[OPEN + k] = np.float32(0.0)


@jit
def meet_wall(part: PixelRun, station: F32, starts: F32 | None, wall: WorldWall, light: F32, ask_shadow: bool) -> None:
    """Mend what `meet_cylinder` found where the wall is not plain; ask_shadow: whether `light` gets there."""
    scratch, n, kinds, tile_kind = part.scratch, part.n, part.marks, wall.kind
    tiles_z, tiles_c = tile_kind.shape
    z0 = wall.relief.z0
    one, zero = np.float32(1.0), np.float32(0.0)
    for u in range(n):
        scratch[COLUMN + u] = _column(scratch[X + u], scratch[Y + u])
    gentle, steep = 0, 0
    for u in range(n):
        row = (scratch[Z + u] - z0) * PER_Z
        ti, tj = int(row) // _TILE_ROWS, min(int(scratch[COLUMN + u]) // _TILE_COLUMNS, tiles_c - 1)
        kind = int(tile_kind[ti, tj]) if row >= 0 and ti < tiles_z else 0
        kinds[u] = kind
        scratch[PAINT + u] = one if kind & PAINTED else zero
        gentle += 1 if kind & 3 == GENTLE else 0
        steep += kind & STEEP
    rough = STEEP  # kinds met one pixel at a time; of rays that start apart, every wall that is not plain
    if starts is not None:
        rough = STEEP | GENTLE
        steep += gentle
    elif gentle:
        _meet_gentle(part, station, wall.relief)
    if steep:
        _meet_rough(part, rough, station, starts, wall, light, ask_shadow)


def padded(world: World) -> F32:
    """The world's radius map as `wall_at` reads it: flat, with columns to spare on both sides."""
    return np.pad(world.radius_map, ((0, 0), (1, _WALL_PITCH - CLOCKS - 1)), mode="wrap").ravel()


def wall_of(world: World) -> WorldWall:
    low, high, near_low, near_high, kind = _tiles(world)
    relief = Relief(np.float32(world.radius_mm), np.float32(world.z_range_mm[0]), padded(world), low, high)
    return WorldWall(relief, near_low, near_high, kind)


def _behind(tiles: NDArray[Any], reach: int, combine: Callable[..., NDArray[Any]]) -> NDArray[Any]:
    """Each tile combined with the `reach` tiles before it along the pipe."""
    out = tiles.copy()
    for k in range(1, reach + 1):
        out[k:] = combine(out[k:], tiles[:-k])
    return out


def _tiles(world: World) -> tuple[F32, F32, F32, F32, U8]:
    """Per tile of wall: bounds of the deviation in it, bounds of what a ray to it may meet on its way, how it is met.

    A ray that grazes at angle a passes height h of relief over h / tan(a) of pipe, so bounds reach that far.
    """
    deviation, paint = world.radius_map, world.albedo_map
    rows = deviation.shape[0] // _TILE_ROWS * _TILE_ROWS
    shape = (rows // _TILE_ROWS, _TILE_ROWS, CLOCKS // _TILE_COLUMNS, _TILE_COLUMNS)
    tiles = deviation[:rows].reshape(shape)
    low, high = tiles.min(axis=(1, 3)), tiles.max(axis=(1, 3))
    slope = np.maximum(
        np.abs(np.diff(deviation, axis=0, append=deviation[-1:]))[:rows] / STEP_Z_MM,
        np.abs(np.diff(deviation, axis=1, append=deviation[:, :1]))[:rows] / (world.radius_mm * 2 * np.pi / CLOCKS),
    )
    steep = slope.reshape(shape).max(axis=(1, 3)) > _STEEP
    grazing = math.tan(max(world.projector.innermost, math.radians(8.0)))
    relief = max(float(np.abs(deviation).max(initial=0.0)), 0.0)
    reach = math.ceil(relief / grazing / (STEP_Z_MM * _TILE_ROWS)) + 2
    mode = ("nearest", "wrap")
    near_low = _behind(ndimage.minimum_filter(low, size=3, mode=mode), reach, np.minimum)
    near_high = ndimage.maximum_filter(high, size=(5, 3), mode=mode)
    # what is carved out of the wall is met through its own opening; what stands out of it hides the wall behind it
    carved = ndimage.maximum_filter(high, size=3, mode=mode) > _PLAIN_MM
    steep_near = ndimage.maximum_filter(steep, size=(2 * reach + 1, 3), mode=mode) & carved
    steep_near |= ndimage.maximum_filter(steep, size=3, mode=mode)
    stands = ndimage.maximum_filter(steep & (low < -_PLAIN_MM), size=3, mode=mode)
    steep_near |= _behind(stands, reach, np.maximum)
    kind = np.where(
        steep_near, STEEP | GENTLE, np.where((near_high > _PLAIN_MM) | (near_low < -_PLAIN_MM), GENTLE, 0)
    ).astype(np.uint8)
    bare = (np.array(world.albedo) * 255.0 + 0.5).astype(np.uint8)
    marked = (paint[:rows] != bare).any(axis=2).reshape(shape).any(axis=(1, 3))
    kind |= np.where(ndimage.maximum_filter(marked, size=3, mode=mode), PAINTED, 0).astype(np.uint8)
    bounds = [np.ascontiguousarray(bound, dtype=np.float32) for bound in (low, high, near_low, near_high)]
    return bounds[0], bounds[1], bounds[2], bounds[3], kind
