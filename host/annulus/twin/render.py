"""What the camera sees of a world: one Bayer frame, lit row by row by as much of each lamp as the gates gave it.

Every pixel's ray is met with the wall: in closed form where the wall is a plain cylinder, by bracketing where it swells
gently, by marching and bisection where it has edges. Light comes from two points (projector, LED), so shadows of rods
and of the wall itself are rays too. Lens blur is not a filter over the image: a slit's edge is a step in projected
angle, smoothed by what the blur subtends in that angle at that pixel.
"""

import math
from collections.abc import Callable
from typing import TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from annulus.geometry.pose import Pose
from annulus.twin.world import CLOCKS, STEP_Z_MM, World

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Kernel = TypeVar("Kernel", bound=Callable[..., object])

_TILE_ROWS, _TILE_COLUMNS = 6, 8  # cells of the wall map to a tile: 2.4 mm by 2 degrees
_PLAIN_MM = 0.002  # a tile deviating less than this is a cylinder
_STEEP = 0.25  # slope above which a wall can hide itself from a grazing ray
_BINS = 2048  # of the table from cos(projected angle) to the nearest slit
_NOISE = 1 << 20


def _compiled(function: Kernel) -> Kernel:
    return cast(Kernel, numba.njit(nogil=True, fastmath=True, cache=True, error_model="numpy")(function))


@_compiled
def _atan2(y: float, x: float) -> float:
    """atan2 within 2e-6 rad, float32."""
    ax, ay = abs(x), abs(y)
    big, small = max(ax, ay), min(ax, ay)
    q = small / (big + np.float32(1e-20))
    s = q * q
    r = np.float32(0.0029745)
    r = r * s + np.float32(-0.0162866)
    r = r * s + np.float32(0.0432620)
    r = r * s + np.float32(-0.0755900)
    r = r * s + np.float32(0.1066689)
    r = r * s + np.float32(-0.1421006)
    r = r * s + np.float32(0.1999402)
    r = r * s + np.float32(-0.3333312)
    r = r * s * q + q
    if ay > ax:
        r = np.float32(1.5707963) - r
    if x < 0:
        r = np.float32(3.1415927) - r
    return -r if y < 0 else r


@_compiled
def _step_up(x: float) -> float:
    """Standard normal distribution function within 3e-4, zero and one past 3.5 sigma."""
    if x <= np.float32(-3.5):
        return np.float32(0.0)
    if x >= np.float32(3.5):
        return np.float32(1.0)
    t = x * (np.float32(0.7988) + np.float32(0.03566) * x * x)
    return np.float32(0.5) + np.float32(0.5) * np.float32(math.tanh(t))


@_compiled
def _wall(deviation: F32, column: float, row: float) -> float:
    """Bilinear deviation (mm) at fractional map place; clean outside in z, wraps in clock."""
    rows, columns = deviation.shape
    i = int(row)
    if row < np.float32(0.0) or i >= rows - 1:
        return np.float32(0.0)
    if column < 0:
        column += np.float32(columns)
    j = int(column)
    fj, fi = column - np.float32(j), row - np.float32(i)
    if j >= columns:
        j -= columns
    k = j + 1
    if k >= columns:
        k = 0
    a = deviation[i, j] + fj * (deviation[i, k] - deviation[i, j])
    b = deviation[i + 1, j] + fj * (deviation[i + 1, k] - deviation[i + 1, j])
    return a + fi * (b - a)


@_compiled
def _cylinder(cx: float, cy: float, wx: float, wy: float, radius: float) -> float:
    """Range along a ray from inside to the cylinder r = radius about the z axis; 1e6 for a ray that never gets there."""
    a = wx * wx + wy * wy + np.float32(1e-12)
    b = cx * wx + cy * wy
    c = cx * cx + cy * cy - radius * radius
    return min((np.sqrt(max(b * b - a * c, np.float32(0.0))) - b) / a, np.float32(1e6))


@_compiled
def _column(x: float, y: float) -> float:
    """Fractional map column of a pipe-frame place: clock angle = atan2(x, -y), in [0, CLOCKS)."""
    f = _atan2(x, -y) * np.float32(CLOCKS / (2 * np.pi))
    return f + np.float32(CLOCKS) if f < 0 else f


@_compiled
def _excess(
    deviation: F32, s: float, c: F32, wx: float, wy: float, wz: float, column: float, z0: float, radius: float
) -> float:
    """r - wall at range s of a ray in the pipe frame; the clock angle hardly changes over a wall's roughness."""
    x, y, z = c[0] + s * wx, c[1] + s * wy, c[2] + s * wz
    return np.sqrt(x * x + y * y) - radius - _wall(deviation, column, (z - z0) * np.float32(1.0 / STEP_Z_MM))


@_compiled
def _meet(
    deviation: F32, c: F32, wx: float, wy: float, wz: float, z0: float, radius: float,
    low: float, high: float, steep: bool,
) -> float:  # fmt: skip
    """Range at which a ray first goes through a wall whose deviation stays within low..high (mm) thereabouts.

    The clock angle is that of the plain cylinder; over low..high it drifts by less than a map column.
    """
    s0 = _cylinder(c[0], c[1], wx, wy, radius + low - np.float32(0.01))
    s1 = _cylinder(c[0], c[1], wx, wy, radius + high + np.float32(0.01))
    middle = np.float32(0.5) * (s0 + s1)
    column = _column(c[0] + middle * wx, c[1] + middle * wy)
    a, fa = s0, _excess(deviation, s0, c, wx, wy, wz, column, z0, radius)
    b, fb = s1, np.float32(0.0)
    if steep:
        steps = min(int(abs((s1 - s0) * wz) * np.float32(1.0 / STEP_Z_MM)) + 2, 200)
        ds = (s1 - s0) / np.float32(steps)
        for i in range(1, steps + 1):
            b = s0 + np.float32(i) * ds
            fb = _excess(deviation, b, c, wx, wy, wz, column, z0, radius)
            if fb >= 0:
                break
            a, fa = b, fb
    else:
        fb = _excess(deviation, b, c, wx, wy, wz, column, z0, radius)
    if fa >= 0 or fb <= 0:
        return a if fa >= 0 else b
    side = 0
    for _ in range(8):  # regula falsi, Illinois
        m = (a * fb - b * fa) / (fb - fa)
        fm = _excess(deviation, m, c, wx, wy, wz, column, z0, radius)
        if abs(fm) < np.float32(5e-4):
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
    deviation: F32, x: float, y: float, z: float, light: F32, z0: float, radius: float, low: float
) -> bool:
    """Whether the wall stands between a wall point and a light inside the pipe (both pipe frame)."""
    dx, dy, dz = light[0] - x, light[1] - y, light[2] - z
    step = np.float32(STEP_Z_MM) / (abs(dz) + np.float32(1e-3))
    column = _column(x, y)
    # half a step off the surface, so that it does not shadow itself
    for i in range(160):
        t = (np.float32(i) + np.float32(0.75)) * step
        if t >= np.float32(1.0):
            return False
        qx, qy, qz = x + t * dx, y + t * dy, z + t * dz
        r = np.sqrt(qx * qx + qy * qy) - radius
        if r < low:
            return False
        if i & 7 == 7:
            column = _column(qx, qy)
        if r > _wall(deviation, column, (qz - z0) * np.float32(1.0 / STEP_Z_MM)) + np.float32(0.03):
            return True
    return False


@_compiled
def _reflect(albedo: U8, column: float, row: float, channel: int, base: F32) -> float:
    """Bilinear albedo 0..1 of one channel at a fractional map place."""
    rows, columns = albedo.shape[0], albedo.shape[1]
    i, j = int(row), int(column)
    if row < 0 or i >= rows - 1:
        return base[channel]
    fj, fi = column - np.float32(j), row - np.float32(i)
    if j >= columns:
        j -= columns
    k = j + 1 if j + 1 < columns else 0
    p, q = np.float32(albedo[i, j, channel]), np.float32(albedo[i, k, channel])
    r, s = np.float32(albedo[i + 1, j, channel]), np.float32(albedo[i + 1, k, channel])
    a, b = p + fj * (q - p), r + fj * (s - r)
    return (a + fi * (b - a)) * np.float32(1.0 / 255.0)


@_compiled
def _slide(
    x: float, y: float, z: float, spread: float, channel: int, nearest: NDArray[np.int8], cos0: float, cos_step: float,
    centre: F32, slits: F32, colours: F32, leak: float, blur: float,
) -> float:  # fmt: skip
    """Share of a lit stripe's light that reaches a camera-frame point, as one channel sees it.

    centre: vertex and axis of the mean cone; finds the nearest slit. slits[i]: vertex, axis, cos, sin of the half-angle,
    half-width (rad); the first and last "slit" are the pattern's rims. colours[i], [i+1]: stripes inside and outside.
    spread: what dtheta_camera / dpixel / sin^2(theta_camera) is at this pixel, for the blur in projected angle.
    """
    vx, vy, vz = x - centre[0], y - centre[1], z - centre[2]
    cosine = (vx * centre[3] + vy * centre[4] + vz * centre[5]) / np.sqrt(vx * vx + vy * vy + vz * vz)
    at = int((cosine - cos0) * cos_step)
    if at < 0 or at >= nearest.shape[0]:
        return np.float32(0.0)
    i = nearest[at]
    vx, vy, vz = x - slits[i, 0], y - slits[i, 1], z - slits[i, 2]
    along = vx * slits[i, 3] + vy * slits[i, 4] + vz * slits[i, 5]
    cosine = along / np.sqrt(vx * vx + vy * vy + vz * vz)
    sine2 = np.float32(1.0) - cosine * cosine
    off = np.sqrt(sine2) * slits[i, 6] - cosine * slits[i, 7]  # sin(theta_P - theta), small
    sigma = blur * sine2 * spread
    inside = np.float32(1.0) - _step_up((off + slits[i, 8]) / sigma)
    outside = _step_up((off - slits[i, 8]) / sigma)
    a, b = colours[i, channel], colours[i + 1, channel]
    return inside * a + outside * b + leak * (np.float32(1.0) - inside - outside) * (a + b)


@_compiled
def _rods_pass(x: float, y: float, z: float, rods: F32, light: F32, blur_mm: float) -> float:
    """Share of projector light that the rods let through to a camera-frame point; rods lie along camera z."""
    out = np.float32(1.0)
    dx, dy, dz = x - light[0], y - light[1], z - light[2]
    flat2 = dx * dx + dy * dy
    for i in range(rods.shape[0]):
        rx, ry = rods[i, 0] - light[0], rods[i, 1] - light[1]
        t = (rx * dx + ry * dy) / flat2
        if t <= 0 or t >= 1:
            continue
        wide = abs(rx * dy - ry * dx) / np.sqrt(flat2)
        if wide > rods[i, 2] * np.float32(3.0):
            continue
        over = light[2] + t * dz - rods[i, 4]
        under = rods[i, 3] - (light[2] + t * dz)
        past = max(max(over, under), np.float32(0.0)) * np.sqrt(flat2 / (flat2 + dz * dz))
        distance = np.sqrt(wide * wide + past * past)
        out *= _step_up((distance - rods[i, 2]) / (blur_mm * t))
    return out


@_compiled
def _draw(
    out: U8, first: int, last: int, rays: F32, rotation: F32, station: F32, projector_gain: F32, led_gain: F32,
    lit: F32, radius: float, z0: float, deviation: F32, tile_low: F32, tile_high: F32, tile_kind: U8, albedo: U8,
    base: F32, nearest: NDArray[np.int8], cos0: float, cos_step: float, centre: F32, slits: F32, colours: F32,
    leak: float, power: float, rods: F32, led: F32, led_power: F32, blur: float, focal: float, sensor: F32,
    noise: F32, seed: int,
) -> None:  # fmt: skip
    """Rows first..last of one frame. station: camera in the pipe; lit: the circle (u, v, inner, outer px) that holds
    all projected light; tile_kind: 0 plain, 1 gentle, 2 steep, +4 marked with paint."""
    height, width = out.shape
    row_light = np.zeros(width, np.float32)
    light = np.empty(3, np.float32)  # projector in the pipe frame
    lamp = np.empty(3, np.float32)  # LED in the pipe frame
    for k in range(3):
        light[k] = station[k]
        lamp[k] = station[k]
        for m in range(3):
            light[k] += rotation[m, k] * centre[m]
            lamp[k] += rotation[m, k] * led[m]
    black, read2, shot = sensor[0], sensor[1] * sensor[1], sensor[2]
    tiles_z, tiles_c = tile_kind.shape
    state = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(1)
    for v in range(first, last):
        gp, gl = projector_gain[v], led_gain[v]
        row_light[:] = np.float32(0.0)
        u0, u1, h0, h1 = 0, width, 0, 0
        if gp <= 0 and gl <= 0:
            u1 = 0
        elif gl <= 0:
            dv = np.float32(v) - lit[1]
            chord = lit[3] * lit[3] - dv * dv
            if chord <= 0:
                u1 = 0
            else:
                half = np.sqrt(chord)
                u0, u1 = max(0, int(lit[0] - half)), min(width, int(lit[0] + half) + 2)
                hole = lit[2] * lit[2] - dv * dv
                if hole > 0:
                    h0, h1 = int(lit[0] - np.sqrt(hole)) + 1, int(lit[0] + np.sqrt(hole))
        for u in range(u0, u1):
            if h0 <= u < h1:
                continue
            dx, dy, spread = rays[v, u, 0], rays[v, u, 1], rays[v, u, 2]
            if spread <= 0:
                continue  # the lens sees nothing here
            dz = np.sqrt(max(np.float32(1.0) - dx * dx - dy * dy, np.float32(0.0)))
            wx = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
            wy = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
            wz = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
            s = _cylinder(station[0], station[1], wx, wy, radius)
            if s > np.float32(3000.0):
                continue
            x, y, z = station[0] + s * wx, station[1] + s * wy, station[2] + s * wz
            column = _column(x, y)
            row = (z - z0) * np.float32(1.0 / STEP_Z_MM)
            kind = 0
            ti, tj = int(row) // _TILE_ROWS, int(column) // _TILE_COLUMNS
            inside = row >= 0 and ti < tiles_z
            if inside:
                tj = min(tj, tiles_c - 1)
                kind = tile_kind[ti, tj]
            nx, ny, nz = x / radius, y / radius, np.float32(0.0)
            hidden = False
            if kind & 3:
                s = _meet(
                    deviation, station, wx, wy, wz, z0, radius, tile_low[ti, tj], tile_high[ti, tj], (kind & 2) != 0
                )
                x, y, z = station[0] + s * wx, station[1] + s * wy, station[2] + s * wz
                column = _column(x, y)
                row = (z - z0) * np.float32(1.0 / STEP_Z_MM)
                r = np.sqrt(x * x + y * y)
                here = _wall(deviation, column - np.float32(0.4), row), _wall(deviation, column + np.float32(0.4), row)
                slope_c = (here[1] - here[0]) * np.float32(CLOCKS / (2 * np.pi * 0.8)) / r
                here = _wall(deviation, column, row - np.float32(0.4)), _wall(deviation, column, row + np.float32(0.4))
                slope_z = (here[1] - here[0]) * np.float32(1.0 / (0.8 * STEP_Z_MM))
                ex, ey = x / r, y / r  # outwards; the clock angle grows along (-ey, ex)
                nx, ny, nz = ex + slope_c * ey, ey - slope_c * ex, -slope_z
                scale = np.float32(1.0) / np.sqrt(nx * nx + ny * ny + nz * nz)
                nx, ny, nz = nx * scale, ny * scale, nz * scale
                if gp > 0 and (kind & 2) != 0:
                    hidden = _shadowed(deviation, x, y, z, light, z0, radius, tile_low[ti, tj] - np.float32(0.02))
            channel = (v & 1) + (u & 1)
            total = np.float32(0.0)
            if gp > 0 and not hidden:
                px, py, pz = s * dx, s * dy, s * dz
                share = _slide(
                    px, py, pz, spread, channel, nearest, cos0, cos_step, centre, slits, colours, leak, blur
                )
                if share > 0:
                    lx, ly, lz = x - light[0], y - light[1], z - light[2]
                    facing = lx * nx + ly * ny + lz * nz
                    if facing > 0:
                        d2 = lx * lx + ly * ly + lz * lz
                        through = _rods_pass(px, py, pz, rods, centre, blur * s / focal)
                        total += gp * power * share * through * facing / (d2 * np.sqrt(d2))
            if gl > 0:
                lx, ly, lz = x - lamp[0], y - lamp[1], z - lamp[2]
                facing = lx * nx + ly * ny + lz * nz
                if facing > 0:
                    d2 = lx * lx + ly * ly + lz * lz
                    total += gl * led_power[channel] * facing / (d2 * np.sqrt(d2))
            if inside and kind & 4:
                total *= _reflect(albedo, column, row, channel, base)
            else:
                total *= base[channel]
            row_light[u] = total
        state = state * np.uint64(6364136223846793005) + np.uint64(2 * v + 1442695040888963407)
        at = int((state >> np.uint64(33)) % np.uint64(noise.shape[0] - width))
        for u in range(width):
            value = row_light[u] + black + np.sqrt(read2 + shot * row_light[u]) * noise[at + u] + np.float32(0.5)
            out[v, u] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))


class Renderer:
    """Draws frames of one world. Holds tables, no state between frames; safe to call from several threads."""

    def __init__(self, world: World) -> None:
        self.world = world
        camera, projector, optics = world.camera, world.projector, world.optics
        self.height, self.width = camera.height, camera.width
        self._rays = _ray_table(world)
        self._deviation = np.ascontiguousarray(world.radius_map)
        self._albedo = np.ascontiguousarray(world.albedo_map)
        self._base = np.array(world.albedo, np.float32)
        self._low, self._high, self._kind = _tiles(world)
        cones = projector.cones
        vertex = np.mean([c.vertex_mm for c in cones], axis=0)
        axis = np.mean([c.axis for c in cones], axis=0)
        axis /= np.linalg.norm(axis)
        self._centre = np.concatenate([vertex, axis]).astype(np.float32)
        rims = (
            cones[0].half_angle - math.radians(projector.margin_deg[0]),
            cones[-1].half_angle + math.radians(projector.margin_deg[1]),
        )
        self._rims = rims
        angles = [rims[0], *(c.half_angle for c in cones), rims[1]]
        halves = [0.0, *(math.radians(h) for h in projector.slit_half_deg), 0.0]
        ends = [cones[0], *cones, cones[-1]]
        self._slits = np.array(
            [
                [*c.vertex_mm, *c.axis, math.cos(a), math.sin(a), h]
                for c, a, h in zip(ends, angles, halves, strict=True)
            ],
            np.float32,
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
            [[r.x_mm, r.y_mm, r.radius_mm, r.z0_mm, r.z1_mm] for r in world.rods], np.float32
        ).reshape(-1, 5)
        self._blur = np.float32(math.sqrt(optics.blur_px**2 + 1.0 / 12.0))  # the pixel itself is a box
        self._sensor = np.array([optics.black, optics.read, optics.shot], np.float32)
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
        gains = [
            np.ascontiguousarray(np.broadcast_to(np.asarray(g, np.float32), (self.height,))) for g in (projector, led)
        ]
        first, last = rows or (0, self.height)
        station = pose.to_pipe(np.zeros((1, 3)), z_mm)[0].astype(np.float32)
        _draw(
            frame, first, last, self._rays, pose.rotation.astype(np.float32), station, gains[0], gains[1],
            self._lit_circle(pose), np.float32(self.world.radius_mm), np.float32(self.world.z_range_mm[0]),
            self._deviation, self._low, self._high, self._kind, self._albedo, self._base, self._nearest, self._cos0,
            self._cos_step, self._centre, self._slits, self._colours, np.float32(self.world.projector.leak),
            self._power, self._rods, self._led, self._led_power, self._blur,
            np.float32(self.world.camera.fx), self._sensor, self._noise, seed & 0x7FFFFFFF,
        )  # fmt: skip
        return frame

    def _lit_circle(self, pose: Pose) -> F32:
        """(u, v, inner, outer): pixels outside the ring inner..outer get no projector light."""
        world = self.world
        around = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        vertex, axis = self._centre[:3].astype(float), self._centre[3:].astype(float)
        side = np.cross(axis, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        up = np.cross(axis, side)
        ring = np.cos(around)[:, None] * side + np.sin(around)[:, None] * up
        deepest = world.radius_mm + float(self._deviation.max(initial=0.0))
        shallowest = world.radius_mm + float(self._deviation.min(initial=0.0))
        v = pose.to_pipe(vertex[None])[0]
        bounds = []
        for angle, radius in ((self._rims[0] - 0.01, deepest), (self._rims[1] + 0.01, shallowest)):
            rays = (math.cos(angle) * axis + math.sin(angle) * ring) @ pose.rotation
            a = rays[:, 0] ** 2 + rays[:, 1] ** 2
            b = v[0] * rays[:, 0] + v[1] * rays[:, 1]
            s = (np.sqrt(b * b - a * (v[0] ** 2 + v[1] ** 2 - radius**2)) - b) / a
            bounds.append(world.camera.project(pose.to_camera(v + s[:, None] * rays)))
        centre = bounds[1].mean(axis=0)
        inner = np.linalg.norm(bounds[0] - centre, axis=1).min() - 6.0
        outer = np.linalg.norm(bounds[1] - centre, axis=1).max() + 6.0
        return np.array([*centre, max(inner, 0.0), outer], np.float32)


def _ray_table(world: World) -> F32:
    """(H, W, 3): x, y of every pixel's unit ray, and dtheta/dpixel / sin^2 theta (zero where the lens sees nothing)."""
    camera = world.camera
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    rays = camera.rays(grid.reshape(-1, 2)).reshape(camera.height, camera.width, 3)
    theta = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    gradient = np.hypot(*np.gradient(theta)) if min(theta.shape) > 1 else np.zeros_like(theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = gradient / np.sin(theta) ** 2
    seen = np.isfinite(spread) & (rays[..., 2] > 0) & (theta > 1e-3)
    return np.where(seen[..., None], np.stack([rays[..., 0], rays[..., 1], spread], -1), 0.0).astype(np.float32)


def _tiles(world: World) -> tuple[F32, F32, U8]:
    """Per tile of wall: bounds of the deviation that a ray to it may meet on its way, and how it must be met.

    A ray that grazes at angle a passes height h of roughness over h / tan(a) of pipe, so bounds are spread that far.
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
    size = (2 * reach + 1, 3)
    mode = ("nearest", "wrap")
    low = ndimage.minimum_filter(low, size=size, mode=mode)
    high = ndimage.maximum_filter(high, size=size, mode=mode)
    steep = ndimage.maximum_filter(steep, size=size, mode=mode)
    kind = np.where(steep, 2, np.where((high > _PLAIN_MM) | (low < -_PLAIN_MM), 1, 0)).astype(np.uint8)
    marked = (paint[:rows] != np.round(np.array(world.albedo) * 255.0)).any(axis=2).reshape(shape).any(axis=(1, 3))
    kind |= np.where(ndimage.maximum_filter(marked, size=3, mode=mode), 4, 0).astype(np.uint8)
    return low.astype(np.float32), high.astype(np.float32), kind
