"""What the camera sees of a world: one Bayer frame, lit row by row by as much of each lamp as the gates gave it.

Every pixel's ray is met with the wall: in closed form where the wall is a plain cylinder, by bracketing where it swells
gently, by marching and bisection where it has edges. Light comes from two points (projector, LED), so shadows of rods
and of the wall itself are rays too. Lens blur is not a filter over the image: a slit's edge is a step in projected
angle, smoothed by what the blur subtends in that angle at that pixel.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from annulus.geometry.pose import Pose
from annulus.twin.world import CLOCKS, STEP_Z_MM, World

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Real = Any  # float32 inside compiled code
Kernel = TypeVar("Kernel", bound=Callable[..., object])

_TILE_ROWS, _TILE_COLUMNS = 6, 8  # cells of the wall map to a tile: 2.4 mm by 2 degrees
_PLAIN_MM = 0.002  # a tile deviating less than this is a cylinder
_STEEP = 0.25  # slope above which a wall can hide itself from a grazing ray
_BINS = 2048  # of the table from cos(projected angle) to the nearest slit
_NOISE = 1 << 20
_PER_Z = np.float32(1.0 / STEP_Z_MM)
_WALL_PITCH = CLOCKS + 4  # of the padded wall map: one column before twelve o'clock, three after
_MARCH_MM = 0.8  # along the pipe; no feature is shorter, and bisection follows
# A row is drawn in stretches of at most _STRETCH pixels, their intermediate values in one flat array at these offsets.
# One base and constant distances are what lets LLVM prove that the loops over it may run as vectors.
_PITCH = 512 + 8  # eight to spare, for loops that write in fours
_STRETCH = 512
_WX, _WY, _WZ, _S, _X, _Y, _Z, _NX, _NY, _NZ, _OPEN, _COLUMN, _PAINT, _LIT, _LEVEL, _PLAIN, _CX, _CY, _CZ = range(
    0, 19 * _PITCH, _PITCH
)
_SCRATCH = 19 * _PITCH


def _compiled(function: Kernel) -> Kernel:
    return cast(Kernel, numba.njit(nogil=True, fastmath=True, cache=True, error_model="numpy")(function))


@_compiled
def _atan2(y: Real, x: Real) -> Real:
    """atan2 within 2e-6 rad, float32."""
    ax, ay = abs(x), abs(y)
    big, small = max(ax, ay), min(ax, ay)
    q = small / (big + np.float32(1e-20))
    s = q * q
    r = np.float32(0.0078254829)
    r = r * s + np.float32(-0.0368986292)
    r = r * s + np.float32(0.0837415565)
    r = r * s + np.float32(-0.1348040561)
    r = r * s + np.float32(0.1987987216)
    r = r * s + np.float32(-0.3332637452)
    r = r * s * q + q
    if ay > ax:
        r = np.float32(1.5707963) - r
    if x < 0:
        r = np.float32(3.1415927) - r
    return -r if y < 0 else r


@_compiled
def _step_up(x: Real) -> Real:
    """Standard normal distribution function within 3e-4 (Abramowitz & Stegun 7.1.27); branch-free."""
    t = min(abs(x) * np.float32(0.70710678), np.float32(6.0))  # p ** 4 must not overflow
    p = np.float32(1.0) + t * (
        np.float32(0.278393) + t * (np.float32(0.230389) + t * (np.float32(0.000972) + t * np.float32(0.078108)))
    )
    p = p * p
    tail = np.float32(0.5) / (p * p)
    return tail if x < 0 else np.float32(1.0) - tail


@_compiled
def _wall(deviation: F32, column: Real, row: Real) -> Real:
    """Bilinear deviation (mm) at a fractional map place, column -1..CLOCKS + 1; its first and last row are clean."""
    return _wall_and_slopes(deviation, column, row)[0]


@_compiled
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


@_compiled
def _cylinder(cx: Real, cy: Real, wx: Real, wy: Real, radius: Real) -> Real:
    """Range along a ray from inside to the cylinder r = radius about the z axis; 1e6 if it never gets there."""
    a = wx * wx + wy * wy + np.float32(1e-12)
    b = cx * wx + cy * wy
    c = cx * cx + cy * cy - radius * radius
    return min((np.sqrt(max(b * b - a * c, np.float32(0.0))) - b) / a, np.float32(1e6))


@_compiled
def _column(x: Real, y: Real) -> Real:
    """Fractional map column of a pipe-frame place: clock angle = atan2(x, -y), in [0, CLOCKS)."""
    f = _atan2(x, -y) * np.float32(CLOCKS / (2 * np.pi))
    return f + np.float32(CLOCKS) if f < 0 else f


@_compiled
def _excess(
    deviation: F32, s: Real, c: F32, wx: Real, wy: Real, wz: Real, column: Real, z0: Real, radius: Real
) -> Real:
    """r - wall at range s of a ray in the pipe frame; the clock angle hardly changes over a wall's roughness."""
    x, y, z = c[0] + s * wx, c[1] + s * wy, c[2] + s * wz
    return np.sqrt(x * x + y * y) - radius - _wall(deviation, column, (z - z0) * _PER_Z)


@_compiled
def _meet_gentle(n: int, scratch: F32, station: F32, z0: Real, radius: Real, deviation: F32) -> None:
    """Meet a wall without edges instead of the plain cylinder, for a whole stretch: mends range, place and normal.

    The fixed point r = R + wall(where r is met), by secant, at every fourth pixel; such a wall is straight enough
    between them (0.01 mm).
    """
    one, half, quarter = np.float32(1.0), np.float32(0.5), np.float32(0.25)
    sx, sy, sz = station[0], station[1], station[2]
    c0 = sx * sx + sy * sy
    was, was_c, was_z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range((n + 6) // 4):
        u = min(4 * k, n - 1)
        wx, wy, wz, column = scratch[_WX + u], scratch[_WY + u], scratch[_WZ + u], scratch[_COLUMN + u]
        d0 = _wall(deviation, column, (scratch[_Z + u] - z0) * _PER_Z)
        s = _cylinder(sx, sy, wx, wy, radius + d0)
        d1 = _wall(deviation, column, (sz + s * wz - z0) * _PER_Z)
        gain = (d1 - d0) / (d0 if abs(d0) > np.float32(1e-3) else np.float32(1e-3))
        lift = one / (one - min(max(gain, -half), half))
        d2 = d0 + (d1 - d0) * lift
        s = _cylinder(sx, sy, wx, wy, radius + d2)
        d3, slope_c, slope_z = _wall_and_slopes(deviation, column, (sz + s * wz - z0) * _PER_Z)
        d3 = d2 + (d3 - d2) * lift
        if k > 0:
            for i in range(4):
                t = quarter * np.float32(i)
                at = 4 * k - 4 + i
                scratch[_LIT + at] = was + t * (d3 - was)
                scratch[_NX + at] = was_c + t * (slope_c - was_c)
                scratch[_NZ + at] = was_z + t * (slope_z - was_z)
        was, was_c, was_z = d3, slope_c, slope_z
    for u in range(n):
        wx, wy, wz = scratch[_WX + u], scratch[_WY + u], scratch[_WZ + u]
        r = radius + scratch[_LIT + u]
        a = wx * wx + wy * wy + np.float32(1e-7)
        b = sx * wx + sy * wy
        s = (np.sqrt(max(b * b - a * (c0 - r * r), np.float32(0.0))) - b) / a
        x, y = sx + s * wx, sy + s * wy
        inverse = one / r
        slope_z = scratch[_NZ + u] * _PER_Z
        slope_c = scratch[_NX + u] * np.float32(CLOCKS / (2 * np.pi)) * inverse
        ex, ey = x * inverse, y * inverse  # outwards; the clock angle grows along (-ey, ex)
        scale = one / np.sqrt(one + slope_c * slope_c + slope_z * slope_z)
        scratch[_S + u], scratch[_X + u], scratch[_Y + u], scratch[_Z + u] = s, x, y, sz + s * wz
        scratch[_NX + u], scratch[_NY + u] = (ex + slope_c * ey) * scale, (ey - slope_c * ex) * scale
        scratch[_NZ + u] = -slope_z * scale


@_compiled
def _meet_steep(
    deviation: F32, tile_low: F32, tile_high: F32, c: F32, wx: Real, wy: Real, wz: Real, z0: Real, radius: Real,
    low: Real, high: Real, column: Real,
) -> Real:  # fmt: skip
    """Range at which a ray first goes through a wall that stays within low..high (mm) thereabouts.

    The clock angle is that of the plain cylinder; over low..high it drifts by less than a map column.
    """
    s0 = _cylinder(c[0], c[1], wx, wy, radius + low - np.float32(0.01))
    s1 = _cylinder(c[0], c[1], wx, wy, radius + high + np.float32(0.01))
    # the tiles it really passes on its way know tighter bounds: often a flat floor, and no march at all
    first = int((c[2] + min(s0 * wz, s1 * wz) - z0) * _PER_Z) // _TILE_ROWS
    last = int((c[2] + max(s0 * wz, s1 * wz) - z0) * _PER_Z) // _TILE_ROWS
    at = min(int(column) // _TILE_COLUMNS, tile_low.shape[1] - 1)
    if first >= 0 and last < tile_low.shape[0]:
        low, high = tile_low[first, at], tile_high[first, at]
        for i in range(first + 1, last + 1):
            low, high = min(low, tile_low[i, at]), max(high, tile_high[i, at])
        if high - low < np.float32(1e-3):
            return _cylinder(c[0], c[1], wx, wy, radius + low)
        s0 = _cylinder(c[0], c[1], wx, wy, radius + low - np.float32(0.01))
        s1 = _cylinder(c[0], c[1], wx, wy, radius + high + np.float32(0.01))
    a, fa = s0, _excess(deviation, s0, c, wx, wy, wz, column, z0, radius)
    if fa >= 0:
        return s0
    steps = min(int(abs((s1 - s0) * wz) * np.float32(1.0 / _MARCH_MM)) + 2, 200)
    ds = (s1 - s0) / np.float32(steps)
    b, fb = s1, np.float32(-1.0)
    for i in range(1, steps + 1):
        b = s0 + np.float32(i) * ds
        fb = _excess(deviation, b, c, wx, wy, wz, column, z0, radius)
        if fb >= 0:
            break
        a, fa = b, fb
    if fb <= 0:
        return b
    side = 0
    for _ in range(8):  # regula falsi, Illinois
        m = (a * fb - b * fa) / (fb - fa)
        fm = _excess(deviation, m, c, wx, wy, wz, column, z0, radius)
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


@_compiled
def _shadowed(
    deviation: F32, tile_low: F32, x: Real, y: Real, z: Real, light: F32, z0: Real, radius: Real, low: Real,
    column: Real,
) -> bool:  # fmt: skip
    """Whether the wall stands between a wall point and a light inside the pipe (both pipe frame)."""
    dx, dy, dz = light[0] - x, light[1] - y, light[2] - z
    r0 = np.sqrt(x * x + y * y)
    drop = (dx * x + dy * y) / r0  # how fast r falls on the way
    clear = min(
        (low - (r0 - radius)) / min(drop, np.float32(-1.0)), np.float32(0.5)
    )  # from here on nothing can hide it
    if clear <= 0:
        return False
    at = min(int(column) // _TILE_COLUMNS, tile_low.shape[1] - 1)
    last = min(max(int((z - z0) * _PER_Z) // _TILE_ROWS, 0), tile_low.shape[0] - 1)
    first = min(max(int((z + clear * dz - z0) * _PER_Z) // _TILE_ROWS, 0), last)
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
        place = min(max(column + t * turn, np.float32(-1.0)), np.float32(CLOCKS + 1))
        if r > _wall(deviation, place, (qz - z0) * _PER_Z) + np.float32(0.03):
            return True
        t += step
    return False


@_compiled
def _rough(
    k: int, ask_shadow: bool, scratch: F32, station: F32, light: F32, z0: Real, radius: Real,
    deviation: F32, tile_low: F32, tile_high: F32, near_low: Real, near_high: Real,
) -> None:  # fmt: skip
    """Meet a wall with edges: mends range, place, normal and shadow of pixel k of a stretch."""
    wx, wy, wz, column = scratch[_WX + k], scratch[_WY + k], scratch[_WZ + k], scratch[_COLUMN + k]
    s = _meet_steep(deviation, tile_low, tile_high, station, wx, wy, wz, z0, radius, near_low, near_high, column)
    x, y, z = station[0] + s * wx, station[1] + s * wy, station[2] + s * wz
    r = np.sqrt(x * x + y * y)
    row = (z - z0) * _PER_Z
    half = np.float32(0.4)  # of a map cell, both ways
    slope_c = _wall(deviation, column + half, row) - _wall(deviation, column - half, row)
    slope_z = (_wall(deviation, column, row + half) - _wall(deviation, column, row - half)) * (_PER_Z / (half + half))
    slope_c *= np.float32(CLOCKS / (2 * np.pi)) / (r * (half + half))
    ex, ey = x / r, y / r
    scale = np.float32(1.0) / np.sqrt(np.float32(1.0) + slope_c * slope_c + slope_z * slope_z)
    scratch[_S + k], scratch[_X + k], scratch[_Y + k], scratch[_Z + k] = s, x, y, z
    scratch[_NX + k], scratch[_NY + k] = (ex + slope_c * ey) * scale, (ey - slope_c * ex) * scale
    scratch[_NZ + k] = -slope_z * scale
    low = near_low - np.float32(0.02)
    if ask_shadow and _shadowed(deviation, tile_low, x, y, z, light, z0, radius, low, column):
        scratch[_OPEN + k] = np.float32(0.0)


@_compiled
def _reflect(albedo: U8, column: Real, row: Real, channel: int, base: F32) -> Real:
    """Bilinear albedo 0..1 of one channel at a fractional map place."""
    rows, columns = albedo.shape[1], albedo.shape[2]
    i, j = int(row), int(column)
    if row < 0 or i >= rows - 1:
        return base[channel]
    fj, fi = column - np.float32(j), row - np.float32(i)
    if j >= columns:
        j -= columns
    k = j + 1 if j + 1 < columns else 0
    p, q = np.float32(albedo[channel, i, j]), np.float32(albedo[channel, i, k])
    r, s = np.float32(albedo[channel, i + 1, j]), np.float32(albedo[channel, i + 1, k])
    a, b = p + fj * (q - p), r + fj * (s - r)
    return (a + fi * (b - a)) * np.float32(1.0 / 255.0)


@_compiled
def _draw(
    out: U8, first: int, last: int, rays: F32, starts: F32 | None, rotation: F32, station: F32, projector_gain: F32,
    led_gain: F32, lit: F32, radius: Real, z0: Real, deviation: F32, tile_low: F32, tile_high: F32, near_low: F32,
    near_high: F32, tile_kind: U8, albedo: U8, base: F32, nearest: NDArray[np.int8], cos0: Real, cos_step: Real,
    centre: F32, slits: F32, colours: F32, leak: Real, power: Real, rods: F32, led: F32, led_power: F32, blur: Real,
    focal: Real, sensor: F32, balance: F32, noise: F32, seed: int,
) -> None:  # fmt: skip
    """Rows first..last of one frame, a row at a time in short loops that the compiler turns into vector code.

    rays, starts: see `_ray_table`. rotation, station: pose, camera in the pipe. lit: the circle (u, v, inner, outer
    px) that holds all projected light. centre: vertex, axis of the mean cone; finds the nearest slit through `nearest`.
    slits[i]: vertex, axis, cos, sin of the half-angle, half-width (rad); the first and the last "slit" are the
    pattern's rims; both in the pipe frame. colours[i], [i + 1]: stripes inside and outside of it. tile_kind: 0 plain,
    1 gentle, 3 steep, +4 marked with paint; tile_low, tile_high: wall within a tile, near_*: on a ray's way to it.
    """
    width = out.shape[1]
    scratch = np.zeros(_SCRATCH, np.float32)
    slit_of = np.zeros(_STRETCH, np.int32)
    kinds = np.zeros(_STRETCH, np.int32)
    level = np.zeros(width, np.float32)
    light = centre[:3]
    start = station.copy()  # of the ray in hand
    lamp = station.copy()  # LED in the pipe frame
    for k in range(3):
        for m in range(3):
            lamp[k] += rotation[m, k] * led[m]
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    sx, sy, sz = station[0], station[1], station[2]
    one, zero = np.float32(1.0), np.float32(0.0)
    black, read2, shot = sensor[0], sensor[1] * sensor[1], sensor[2]
    tiles_z, tiles_c = tile_kind.shape
    state = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(1)
    for v in range(first, last):
        gp, gl = projector_gain[v], led_gain[v]
        level[:] = zero
        # which stretches of the row can hold light: all, or left and right of the pattern's hole
        a0, a1, b0, b1 = 0, 0, 0, 0
        if gl > 0:
            a1 = width
        elif gp > 0:
            dv = np.float32(v) - lit[1]
            chord = lit[3] * lit[3] - dv * dv
            if chord > 0:
                half = np.sqrt(chord)
                a0 = min(max(int(lit[0] - half), 0), width)
                a1 = max(min(int(lit[0] + half) + 2, width), a0)
                hole = lit[2] * lit[2] - dv * dv
                if hole > 0:
                    b1 = a1
                    b0 = max(min(int(lit[0] + np.sqrt(hole)), b1), a0)
                    a1 = max(min(int(lit[0] - np.sqrt(hole)) + 1, b0), a0)
        chunks_a = (a1 - a0 + _STRETCH - 1) // _STRETCH
        chunks = chunks_a + (b1 - b0 + _STRETCH - 1) // _STRETCH
        for chunk in range(chunks):
            if chunk < chunks_a:
                u0 = a0 + chunk * _STRETCH
                n = min(_STRETCH, a1 - u0)
            else:
                u0 = b0 + (chunk - chunks_a) * _STRETCH
                n = min(_STRETCH, b1 - u0)
            ray_x, ray_y, spread = rays[0, v, u0 : u0 + n], rays[1, v, u0 : u0 + n], rays[2, v, u0 : u0 + n]
            odd = u0 & 1
            for u in range(n):
                dx, dy = ray_x[u], ray_y[u]
                dz = np.sqrt(max(one - dx * dx - dy * dy, zero))
                cx, cy, cz = sx, sy, sz
                if starts is not None:  # decided when compiled
                    ox, oy, oz = starts[0, v, u0 + u], starts[1, v, u0 + u], starts[2, v, u0 + u]
                    dz *= starts[3, v, u0 + u]
                    cx += r00 * ox + r10 * oy + r20 * oz
                    cy += r01 * ox + r11 * oy + r21 * oz
                    cz += r02 * ox + r12 * oy + r22 * oz
                    scratch[_CX + u], scratch[_CY + u], scratch[_CZ + u] = cx, cy, cz
                wx = r00 * dx + r10 * dy + r20 * dz
                wy = r01 * dx + r11 * dy + r21 * dz
                wz = r02 * dx + r12 * dy + r22 * dz
                a = wx * wx + wy * wy + np.float32(1e-7)
                b = cx * wx + cy * wy
                c = cx * cx + cy * cy - radius * radius
                s = (np.sqrt(max(b * b - a * c, zero)) - b) / a
                x, y = cx + s * wx, cy + s * wy
                scratch[_WX + u], scratch[_WY + u], scratch[_WZ + u] = wx, wy, wz
                scratch[_S + u], scratch[_X + u], scratch[_Y + u], scratch[_Z + u] = s, x, y, cz + s * wz
                scratch[_NX + u], scratch[_NY + u], scratch[_NZ + u] = x / radius, y / radius, zero
                scratch[_OPEN + u], scratch[_LEVEL + u], scratch[_PLAIN + u] = one, zero, s
            for u in range(n):
                scratch[_COLUMN + u] = _column(scratch[_X + u], scratch[_Y + u])
            gentle, steep = 0, 0
            for u in range(n):
                row = (scratch[_Z + u] - z0) * _PER_Z
                ti, tj = int(row) // _TILE_ROWS, min(int(scratch[_COLUMN + u]) // _TILE_COLUMNS, tiles_c - 1)
                kind = int(tile_kind[ti, tj]) if row >= 0 and ti < tiles_z else 0
                kinds[u] = kind
                scratch[_PAINT + u] = one if kind & 4 else zero
                gentle += 1 if kind & 3 == 1 else 0
                steep += kind & 2
            rough = 2  # kinds met one pixel at a time; of rays that start apart, every wall that is not plain
            if starts is not None:
                rough = 3
                steep += gentle
            elif gentle:
                _meet_gentle(n, scratch, station, z0, radius, deviation)
            if steep:
                for u in range(n):
                    if kinds[u] & rough:
                        if starts is not None:
                            start[0], start[1], start[2] = scratch[_CX + u], scratch[_CY + u], scratch[_CZ + u]
                        wz = (start[2] + scratch[_WZ + u] * scratch[_PLAIN + u] - z0) * _PER_Z
                        ti, tj = int(wz) // _TILE_ROWS, min(int(scratch[_COLUMN + u]) // _TILE_COLUMNS, tiles_c - 1)
                        _rough(
                            u, gp > 0, scratch, start, light, z0, radius, deviation, tile_low, tile_high,
                            near_low[ti, tj], near_high[ti, tj],
                        )  # fmt: skip
            if gp > 0:
                vx, vy, vz, ax, ay, az = centre[0], centre[1], centre[2], centre[3], centre[4], centre[5]
                for u in range(n):
                    px, py, pz = scratch[_X + u] - vx, scratch[_Y + u] - vy, scratch[_Z + u] - vz
                    d2 = px * px + py * py + pz * pz
                    inverse = one / np.sqrt(d2)
                    facing = px * scratch[_NX + u] + py * scratch[_NY + u] + pz * scratch[_NZ + u]
                    scratch[_LIT + u] = (
                        gp * power * max(facing, zero) * inverse * inverse * inverse * scratch[_OPEN + u]
                    )
                    at = (px * ax + py * ay + pz * az) * inverse
                    slit_of[u] = np.int32(max(min((at - cos0) * cos_step, np.float32(_BINS - 1)), zero))
                for i in range(rods.shape[0]):
                    rx, ry, thick, back, front = rods[i, 0], rods[i, 1], rods[i, 2], rods[i, 3], rods[i, 4]
                    shaded = 0
                    for u in range(n):
                        x, y, z = scratch[_X + u] - vx, scratch[_Y + u] - vy, scratch[_Z + u] - vz
                        px, py = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z
                        across = rx * py - ry * px
                        near = across * across < np.float32(4.0) * thick * thick * (px * px + py * py)
                        shaded += 1 if near and rx * px + ry * py > zero else 0
                    if shaded == 0:
                        continue
                    for u in range(n):
                        x, y, z = scratch[_X + u] - vx, scratch[_Y + u] - vy, scratch[_Z + u] - vz
                        px, py = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z
                        pz = r20 * x + r21 * y + r22 * z
                        flat2 = px * px + py * py
                        t = (rx * px + ry * py) / flat2  # where on its way the light passes nearest to the rod
                        wide2 = rx * rx + ry * ry - t * t * flat2
                        z = t * pz
                        past = max(max(z - front, back - z), zero)
                        past2 = past * past * flat2 / (flat2 + pz * pz)
                        distance = np.sqrt(max(wide2 + past2, zero))
                        far = scratch[_S + u] * max(t, np.float32(0.05))
                        through = _step_up((distance - thick) * focal / (blur * far))
                        scratch[_LIT + u] *= through if t > 0 else one
                u = 0
                while u < n:  # runs of pixels that share their nearest slit
                    i = nearest[slit_of[u]]
                    end = u + 1
                    while end < n and nearest[slit_of[end]] == i:
                        end += 1
                    vx, vy, vz, ax, ay, az = (
                        slits[i, 0], slits[i, 1], slits[i, 2], slits[i, 3], slits[i, 4], slits[i, 5]
                    )  # fmt: skip
                    cosine0, sine0, wide = slits[i, 6], slits[i, 7], slits[i, 8]
                    even, other = (v & 1) + odd, (v & 1) + 1 - odd
                    even_in, odd_in = colours[i, even], colours[i, other]
                    even_out, odd_out = colours[i + 1, even], colours[i + 1, other]
                    for k in range(u, end):
                        px, py, pz = scratch[_X + k] - vx, scratch[_Y + k] - vy, scratch[_Z + k] - vz
                        cosine = (px * ax + py * ay + pz * az) / np.sqrt(px * px + py * py + pz * pz)
                        sine2 = max(one - cosine * cosine, zero)
                        off = np.sqrt(sine2) * cosine0 - cosine * sine0  # sin(theta_P - theta), small
                        sharp = one / (blur * sine2 * spread[k] + np.float32(1e-9))
                        inside = one - _step_up((off + wide) * sharp)
                        outside = _step_up((off - wide) * sharp)
                        colour_in = odd_in if k & 1 else even_in
                        colour_out = odd_out if k & 1 else even_out
                        share = inside * colour_in + outside * colour_out
                        share += leak * (one - inside - outside) * (colour_in + colour_out)
                        scratch[_LEVEL + k] = scratch[_LIT + k] * share
                    u = end
            if gl > 0:
                for u in range(n):
                    lx, ly, lz = scratch[_X + u] - lamp[0], scratch[_Y + u] - lamp[1], scratch[_Z + u] - lamp[2]
                    d2 = lx * lx + ly * ly + lz * lz
                    facing = lx * scratch[_NX + u] + ly * scratch[_NY + u] + lz * scratch[_NZ + u]
                    lit_power = led_power[(v & 1) + 1] if (u & 1) != odd else led_power[v & 1]
                    scratch[_LEVEL + u] += gl * lit_power * max(facing, zero) / (d2 * np.sqrt(d2))
            for u in range(n):
                channel = (v & 1) + ((u & 1) ^ odd)
                if scratch[_PAINT + u] > 0 and scratch[_LEVEL + u] > 0:
                    row = (scratch[_Z + u] - z0) * _PER_Z
                    scratch[_LEVEL + u] *= _reflect(albedo, scratch[_COLUMN + u], row, channel, base)
                else:
                    scratch[_LEVEL + u] *= base[channel]
                if spread[u] <= 0:  # the lens sees nothing here
                    scratch[_LEVEL + u] = zero
            for u in range(n):
                level[u0 + u] = scratch[_LEVEL + u]
        state = state * np.uint64(6364136223846793005) + np.uint64(2 * v + 1442695040888963407)
        at = int((state >> np.uint64(33)) % np.uint64(noise.shape[0] - width))
        gain_even, gain_odd = balance[v & 1], balance[(v & 1) + 1]
        for u in range(width):
            gain = gain_odd if u & 1 else gain_even
            value = gain * (level[u] + np.sqrt(read2 + shot * level[u]) * noise[at + u]) + black + np.float32(0.5)
            out[v, u] = np.uint8(min(max(value, zero), np.float32(255.0)))


class Renderer:
    """Draws frames of one world. Holds tables, no state between frames; safe to call from several threads."""

    def __init__(self, world: World) -> None:
        self.world = world
        camera, projector, optics = world.camera, world.projector, world.optics
        self.height, self.width = camera.height, camera.width
        self._rays, self._starts = _ray_table(world)
        # px a radian, for the softness of rods' shadows
        self._focal = np.float32(camera.fx)
        if camera.mirror is not None:
            self._focal *= np.float32(camera.mirror.radius_mm / (2 * np.linalg.norm(camera.mirror.centre_mm)))
        self._deviation = np.pad(world.radius_map, ((0, 0), (1, _WALL_PITCH - CLOCKS - 1)), mode="wrap").ravel()
        self._extremes = np.stack([world.radius_map.min(axis=1), world.radius_map.max(axis=1)], axis=1)
        self._albedo = np.ascontiguousarray(world.albedo_map.transpose(2, 0, 1))
        self._base = np.array(world.albedo, np.float32)
        self._tiles = _tiles(world)
        cones = projector.cones
        vertex = np.mean([c.vertex_mm for c in cones], axis=0)
        axis = np.mean([c.axis for c in cones], axis=0)
        axis /= np.linalg.norm(axis)
        self._centre = np.concatenate([vertex, axis])
        rims = (
            cones[0].half_angle - math.radians(projector.margin_deg[0]),
            cones[-1].half_angle + math.radians(projector.margin_deg[1]),
        )
        self._rims = rims
        angles = [rims[0], *(c.half_angle for c in cones), rims[1]]
        halves = [0.0, *(math.radians(h) for h in projector.slit_half_deg), 0.0]
        ends = [cones[0], *cones, cones[-1]]
        self._slits = np.array(
            [[*c.vertex_mm, *c.axis, math.cos(a), math.sin(a), h] for c, a, h in zip(ends, angles, halves, strict=True)]
        )
        response = np.array(projector.response)
        stripes = np.array([response["RGB".index(c)] for c in projector.colours])
        self._colours = np.concatenate([np.zeros((1, 3)), stripes, np.zeros((1, 3))]).astype(np.float32)
        # nearest slit by projected angle, uniform in its cosine so that no pixel needs an arc cosine
        cos0, cos1 = math.cos(rims[1] + 0.02), math.cos(max(rims[0] - 0.02, 0.0))
        middle = np.arccos(cos0 + (np.arange(_BINS) + 0.5) * (cos1 - cos0) / _BINS)
        bounds = (np.array(angles[1:]) + np.array(angles[:-1])) / 2
        self._nearest = np.searchsorted(bounds, middle).astype(np.int8)
        self._cos0, self._cos_step = np.float32(cos0), np.float32(_BINS / (cos1 - cos0))
        last = cones[-1].half_angle
        self._power = np.float32(projector.peak / max(world.albedo) / (math.sin(last) ** 3 / world.radius_mm**2))
        near = math.atan2(world.radius_mm, 45.0 + world.led.behind_mm)
        led = world.led.peak / max(world.albedo) / (math.sin(near) ** 3 / world.radius_mm**2)
        self._led_power = (led * np.array(world.led.colour)).astype(np.float32)
        self._led = np.array([0.0, 0.0, -world.led.behind_mm], np.float32)
        self._rods = np.array(
            [
                [r.x_mm - vertex[0], r.y_mm - vertex[1], r.radius_mm, r.z0_mm - vertex[2], r.z1_mm - vertex[2]]
                for r in world.rods
            ],
            np.float32,
        ).reshape(-1, 5)  # from the projector
        self._blur = np.float32(math.sqrt(optics.blur_px**2 + 1.0 / 12.0))  # the pixel itself is a box
        self._sensor = np.array([optics.black, optics.read, optics.shot], np.float32)
        self._balance = np.array(optics.balance, np.float32)
        noise = np.random.default_rng([world.seed, 0x4015E]).standard_normal(_NOISE)
        self._noise = noise.astype(np.float32)

    def render(
        self,
        pose: Pose,
        z_mm: float,
        projector: F32 | float = 0.0,
        led: F32 | float = 0.0,
        *,
        seed: int = 0,
        rows: tuple[int, int] | None = None,
        out: U8 | None = None,
    ) -> U8:
        """One raw frame, (H, W) uint8, RGGB mosaic.

        pose, z_mm : where the head was when the light flashed. projector, led : light each row collected, in units of
        the lamp's nominal on-time, (H,) or one number. seed : of this frame's noise. rows : draw only these, into
        `out` (which a caller with two threads shares between them).
        """
        frame = np.empty((self.height, self.width), np.uint8) if out is None else out
        # Copies: a broadcast view is read-only, which numba would compile a second kernel for.
        gains = [np.array(np.broadcast_to(g, (self.height,)), np.float32) for g in (projector, led)]
        first, last = rows or (0, self.height)
        centre, slits = (self._in_pipe(table, pose, z_mm) for table in (self._centre[None], self._slits))
        station = pose.to_pipe(np.zeros((1, 3)), z_mm)[0].astype(np.float32)
        _draw(
            frame, first, last, self._rays, self._starts, pose.rotation.astype(np.float32), station, gains[0], gains[1],
            self._lit_circle(pose, z_mm), np.float32(self.world.radius_mm), np.float32(self.world.z_range_mm[0]),
            self._deviation, *self._tiles, self._albedo, self._base, self._nearest, self._cos0,
            self._cos_step, centre[0], slits, self._colours, np.float32(self.world.projector.leak),
            self._power, self._rods, self._led, self._led_power, self._blur,
            self._focal, self._sensor, self._balance, self._noise, seed & 0x7FFFFFFF,
        )  # fmt: skip
        return frame

    @staticmethod
    def _in_pipe(table: NDArray[np.float64], pose: Pose, z_mm: float) -> F32:
        """Rows of vertex, axis and more, from the camera frame to the pipe's."""
        place, way = pose.to_pipe(table[:, :3], z_mm), table[:, 3:6] @ pose.rotation
        return np.hstack([place, way, table[:, 6:]]).astype(np.float32)

    def _lit_circle(self, pose: Pose, z_mm: float) -> F32:
        """(u, v, inner, outer): pixels outside the ring inner..outer get no projector light."""
        world = self.world
        if not world.camera.central:  # not worth a search: only the demo's frames must be quick
            return np.array([0.0, 0.0, 0.0, 1e6], np.float32)
        around = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        vertex, axis = self._centre[:3], self._centre[3:]
        side = np.cross(axis, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        up = np.cross(axis, side)
        ring = np.cos(around)[:, None] * side + np.sin(around)[:, None] * up
        v = pose.to_pipe(vertex[None])[0]
        bounds = []
        for angle, extreme in ((self._rims[0] - 0.01, np.max), (self._rims[1] + 0.01, np.min)):
            rays = (math.cos(angle) * axis + math.sin(angle) * ring) @ pose.rotation
            # how deep or shallow the wall gets about where this rim meets it
            rim_mm = z_mm + v[2] + world.radius_mm / math.tan(angle)
            first, last = (round((rim_mm + d - world.z_range_mm[0]) / STEP_Z_MM) for d in (-30.0, 30.0))
            near = self._extremes[max(first, 0) : max(last, 0)]
            radius = world.radius_mm + float(extreme(near)) if near.size else world.radius_mm
            a = rays[:, 0] ** 2 + rays[:, 1] ** 2
            b = v[0] * rays[:, 0] + v[1] * rays[:, 1]
            s = (np.sqrt(b * b - a * (v[0] ** 2 + v[1] ** 2 - radius**2)) - b) / a
            bounds.append(world.camera.project(pose.to_camera(v + s[:, None] * rays)))
        centre = bounds[1].mean(axis=0)
        inner = np.linalg.norm(bounds[0] - centre, axis=1).min() - 6.0
        outer = np.linalg.norm(bounds[1] - centre, axis=1).max() + 6.0
        return np.array([*centre, max(inner, 0.0), outer], np.float32)


def _ray_table(world: World) -> tuple[F32, F32 | None]:
    """Where every pixel looks: the table all cameras have, and what one without a single centre has besides.

    (3, H, W): x, y of every pixel's unit ray, and how its cot(theta) on the wall changes with a pixel: a ring on the
    wall of a clean pipe, half-angle t, is blurred by sin^2 t times that (zero where the lens sees nothing).
    (4, H, W): x, y, z (mm) where the ray starts, and the sign of its z.
    """
    camera = world.camera
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    shape = (camera.height, camera.width, 3)
    start, rays = (part.reshape(shape) for part in camera.lines(grid.reshape(-1, 2)))
    across = np.hypot(rays[..., 0], rays[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        if camera.mirror is None:
            theta = np.arctan2(across, rays[..., 2])
            spread = _slope(theta) / np.sin(theta) ** 2
            seen = (rays[..., 2] > 0) & (theta > 1e-3)
        else:
            reach = world.radius_mm - np.hypot(start[..., 0], start[..., 1])
            spread = _slope(start[..., 2] + reach * rays[..., 2] / across) / world.radius_mm
            eye = camera.mirror.eye_mm
            to_eye = eye - start  # the housing of the camera, a disc about its pinhole
            past = np.cross(to_eye, rays)
            facing = (rays * eye).sum(axis=-1) > 0
            seen = ~(facing & (np.linalg.norm(past, axis=-1) < world.housing_mm)) & (across > 1e-3)
    seen &= np.isfinite(spread)
    table = np.where(seen, np.stack([rays[..., 0], rays[..., 1], spread]), 0.0).astype(np.float32)
    if camera.central:
        return table, None
    sign = np.where(rays[..., 2] < 0, -1.0, 1.0)[..., None]
    return table, np.nan_to_num(np.concatenate([start, sign], axis=-1)).transpose(2, 0, 1).astype(np.float32).copy()


def _slope(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(*np.gradient(values)) if min(values.shape) > 1 else np.zeros_like(values)


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
    cones = world.projector.cones
    grazing = math.tan(max(cones[0].half_angle - math.radians(world.projector.margin_deg[0]), math.radians(8.0)))
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
    kind = np.where(steep_near, 3, np.where((near_high > _PLAIN_MM) | (near_low < -_PLAIN_MM), 1, 0)).astype(np.uint8)
    bare = (np.array(world.albedo) * 255.0 + 0.5).astype(np.uint8)
    marked = (paint[:rows] != bare).any(axis=2).reshape(shape).any(axis=(1, 3))
    kind |= np.where(ndimage.maximum_filter(marked, size=3, mode=mode), 4, 0).astype(np.uint8)
    bounds = [np.ascontiguousarray(bound, dtype=np.float32) for bound in (low, high, near_low, near_high)]
    return bounds[0], bounds[1], bounds[2], bounds[3], kind
