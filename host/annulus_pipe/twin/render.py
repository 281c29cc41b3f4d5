"""What the camera sees of a world: one Bayer frame, lit row by row by as much of each lamp as the gates gave it.

`rays` says where pixels look, `walls` what they meet, `lights` what arrives there; here paint and sensor are added.
Light comes from two points (projector, LED), so shadows of rods and of the wall itself are rays too.
"""

import math
from typing import NamedTuple

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.twin.course import InSpace, Tube, meet_tube, tube_of
from annulus_pipe.twin.lights.led import LedRing, LedTable, shine
from annulus_pipe.twin.lights.projector import Beam, SlideProjector, fall, shade
from annulus_pipe.twin.lights.slide import slides_of, through
from annulus_pipe.twin.rays import PipeCamera, eye_at, meet_cylinder, ray_table
from annulus_pipe.twin.stretch import COLUMN, CX, F32, LEVEL, PAINT, PIXELS, PLAIN, SCRATCH, U8, PixelRun, Real, Z, jit
from annulus_pipe.twin.walls import PER_Z, WorldWall, meet_wall, wall_of
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import World

_NOISE = 1 << 20
_APART = 0x2545F491  # seeds of two cameras' noise in one frame


class Paint(NamedTuple):
    """What the wall reflects."""

    albedo: U8  # (3, rows, CLOCKS), 255 = all
    base: F32  # (3,) of a bare wall, 1 = all


class Pixel(NamedTuple):
    """What the sensor makes of light, in 8-bit grey levels."""

    levels: F32  # black level, read noise, variance per level
    balance: F32  # (3,) red, green, blue
    noise: F32  # a table of standard normal numbers
    seed: int  # of this frame's


@jit
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


@jit
def _lit_part(v: int, width: int, beam: Beam, led: LedTable) -> Real:
    """Which pixels of a row can hold light: all, or left and right of the pattern's hole; two ranges."""
    a0, a1, b0, b1 = 0, 0, 0, 0
    lit = beam.lit
    if led.gain[v] > 0:
        a1 = width
    elif beam.gain[v] > 0:
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
    return a0, a1, b0, b1


@jit
def _paint(part: PixelRun, wall: WorldWall, paint: Paint) -> None:
    """Light that arrives to light that comes back."""
    scratch, spread, albedo, base, z0 = part.scratch, part.spread, paint.albedo, paint.base, wall.relief.z0
    zero = np.float32(0.0)
    for u in range(part.n):
        channel = (part.v & 1) + ((u & 1) ^ part.odd)
        if scratch[PAINT + u] > 0 and scratch[LEVEL + u] > 0:
            row = (scratch[Z + u] - z0) * PER_Z
            scratch[LEVEL + u] *= _reflect(albedo, scratch[COLUMN + u], row, channel, base)
        else:
            scratch[LEVEL + u] *= base[channel]
        if spread[u] <= 0:  # the lens sees nothing here
            scratch[LEVEL + u] = zero


@jit
def _draw(
    out: U8,
    rows: tuple[int, int],
    eye: PipeCamera,
    starts: F32 | None,
    wall: WorldWall,
    paint: Paint,
    beam: Beam,
    slide: NamedTuple,
    led: LedTable,
    pixel: Pixel,
) -> None:
    """Rows first..last of one frame, a row at a time in short loops that the compiler turns into vector code."""
    width = out.shape[1]
    scratch = np.zeros(SCRATCH, np.float32)
    marks = np.zeros(PIXELS, np.int32)
    level = np.zeros(width, np.float32)
    zero = np.float32(0.0)
    state = np.uint64(pixel.seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(1)
    for v in range(rows[0], rows[1]):
        gp, gl = beam.gain[v], led.gain[v]
        level[:] = zero
        a0, a1, b0, b1 = _lit_part(v, width, beam, led)
        chunks_a = (a1 - a0 + PIXELS - 1) // PIXELS
        chunks = chunks_a + (b1 - b0 + PIXELS - 1) // PIXELS
        for chunk in range(chunks):
            if chunk < chunks_a:
                u0 = a0 + chunk * PIXELS
                n = min(PIXELS, a1 - u0)
            else:
                u0 = b0 + (chunk - chunks_a) * PIXELS
                n = min(PIXELS, b1 - u0)
            part = PixelRun(scratch, marks, eye.rays[2, v, u0 : u0 + n], n, v, u0 & 1)
            meet_cylinder(part, u0, eye, starts, wall.relief.radius)
            meet_wall(part, eye.station, starts, wall, beam.centre, gp > 0)
            if gp > 0:
                fall(part, beam)
                shade(part, beam)
                through(slide, part, beam)
            if gl > 0:
                shine(part, led)
            _paint(part, wall, paint)
            for u in range(n):
                level[u0 + u] = scratch[LEVEL + u]
        state = _expose(out, v, level, pixel, state)


@jit
def _draw_course(
    out: U8,
    rows: tuple[int, int],
    eye: PipeCamera,
    pixel_rad: F32,
    tube: Tube,
    paint: Paint,
    beam: Beam,
    slide: NamedTuple,
    led: LedTable,
    pixel: Pixel,
    lit: F32,
    hint: int,
) -> None:
    """The same in a pipe of several pieces; a row with water in it twice, for what the surface mirrors. lit : see
    `meet_tube`. hint : the piece that the head is in."""
    width = out.shape[1]
    scratch = np.zeros(SCRATCH, np.float32)
    marks = np.zeros(PIXELS, np.int32)
    level = np.zeros(width, np.float32)
    sharp = np.zeros(PIXELS, np.float32)
    zero = np.float32(0.0)
    state = np.uint64(pixel.seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(1)
    for v in range(rows[0], rows[1]):
        gp, gl = beam.gain[v], led.gain[v]
        level[:] = zero
        for u0 in range(0, width if gp > 0 or gl > 0 else 0, PIXELS):
            n = min(PIXELS, width - u0)
            seen = PixelRun(scratch, marks, eye.rays[2, v, u0 : u0 + n], n, v, u0 & 1)
            part = PixelRun(scratch, marks, sharp[:n], n, v, u0 & 1)
            for mirrored in range(2):
                wet = meet_tube(seen, u0, eye, pixel_rad, sharp, tube, beam.centre, lit, mirrored == 1, hint)
                scratch[LEVEL : LEVEL + n] = zero
                if gp > 0:
                    fall(part, beam)
                    shade(part, beam)
                    through(slide, part, beam)
                if gl > 0:
                    shine(part, led)
                for k in range(n):
                    if sharp[k] > 0:
                        channel = (v & 1) + ((k & 1) ^ part.odd)
                        row = scratch[PLAIN + k] * PER_Z
                        white = _reflect(paint.albedo, scratch[COLUMN + k], row, channel, paint.base)
                        level[u0 + k] += scratch[LEVEL + k] * white * scratch[PAINT + k] * scratch[CX + k]
                if not wet:
                    break
        state = _expose(out, v, level, pixel, state)


@jit
def _expose(out: U8, v: int, level: F32, pixel: Pixel, state: Real) -> Real:
    """A row of light to grey levels; the state of the noise's dice after it."""
    width, noise, balance, zero = out.shape[1], pixel.noise, pixel.balance, np.float32(0.0)
    black, read2, shot = pixel.levels[0], pixel.levels[1] * pixel.levels[1], pixel.levels[2]
    state = state * np.uint64(6364136223846793005) + np.uint64(2 * v + 1442695040888963407)
    at = int((state >> np.uint64(33)) % np.uint64(noise.shape[0] - width))
    gain_even, gain_odd = balance[v & 1], balance[(v & 1) + 1]
    for u in range(width):
        gain = gain_odd if u & 1 else gain_even
        value = gain * (level[u] + np.sqrt(read2 + shot * level[u]) * noise[at + u]) + black + np.float32(0.5)
        out[v, u] = np.uint8(min(max(value, zero), np.float32(255.0)))
    return state


class Renderer:
    """Draws what one camera of a world sees. Holds tables, no state between frames; safe to call from several
    threads.
    """

    def __init__(self, world: World, camera: int = 0) -> None:
        """camera : which of the world's, from 0."""
        self.world, self._number = world, camera
        self._first, self._seen = world.cameras[0], world.cameras[camera]
        self.height, self.width = self._seen.camera.height, self._seen.camera.width
        self._wall = wall_of(world) if world.course is None else None
        self._tube = None if world.course is None else tube_of(world)
        albedo = np.ascontiguousarray(world.albedo_map.transpose(2, 0, 1))
        self._paint = Paint(albedo, np.array(world.albedo, np.float32))
        self._slides = slides_of(world)
        tables = [
            ray_table(world, self._seen, slide.coordinate if world.others or slide.by_coordinate else None)
            for slide in self._slides
        ]
        self._rays, self._starts = [rays for rays, _ in tables], tables[0][1]
        self._projectors = [
            SlideProjector(world, self._seen, slide.axis, slide.rims, slide.brightest) for slide in self._slides
        ]
        self._led = LedRing(world)
        self._pixel_rad = None if world.course is None else _pixel_rad(self._rays[0])
        optics = world.optics
        noise = np.random.default_rng([world.seed, 0x4015E]).standard_normal(_NOISE)
        self._pixel = Pixel(
            np.array([optics.black, optics.read, optics.shot], np.float32),
            np.array(optics.balance, np.float32),
            noise.astype(np.float32),
            0,
        )

    def render(
        self,
        pose: Pose,
        z_mm: float,
        projector: F32 | float = 0.0,
        led: F32 | float = 0.0,
        *,
        slot: int | None = None,
        seed: int = 0,
        rows: tuple[int, int] | None = None,
        out: U8 | None = None,
    ) -> U8:
        """One raw frame, (H, W) uint8, RGGB mosaic.

        pose, z_mm : where the head, its first camera, was when the light flashed. projector, led : light each row
        collected, in units of the lamp's nominal on-time, (H,) or one number. slot : of the lamp cycle, which tells
        several slides apart. seed : of this frame's noise. rows : draw
        only these, into `out` (which a caller with two threads shares between them).
        """
        frame = np.empty((self.height, self.width), np.uint8) if out is None else out
        # Copies: a broadcast view is read-only, which numba would compile a second kernel for.
        gains = [np.array(np.broadcast_to(g, (self.height,)), np.float32) for g in (projector, led)]
        if self._tube is not None:
            return self._render_course(pose, z_mm, gains, frame, rows or (0, self.height), seed)
        assert self._wall is not None
        light = self.world.projector
        lit = 0 if isinstance(light, Projector) else light.lit(slot)
        eye = eye_at(self._rays[lit], self._seen, pose, z_mm)
        first = eye if self._number == 0 else eye_at(self._rays[lit], self._first, pose, z_mm)
        noise = (seed + self._number * _APART) & 0x7FFFFFFF
        _draw(
            frame,
            rows or (0, self.height),
            eye,
            self._starts,
            self._wall,
            self._paint,
            self._projectors[lit].beam(pose, z_mm, gains[0]),
            self._slides[lit].table(pose, z_mm),
            self._led.table(first, gains[1]),
            self._pixel._replace(seed=noise),
        )
        return frame

    def _render_course(
        self, pose: Pose, z_mm: float, gains: list[F32], frame: U8, rows: tuple[int, int], seed: int
    ) -> U8:
        """In a pipe of several pieces; z_mm : chainage."""
        course = self.world.course
        assert course is not None and self._tube is not None and self._pixel_rad is not None
        head = InSpace(pose, course).at(z_mm)
        eye = eye_at(self._rays[0], self._seen, head, z_mm)
        # of a frame of the LED alone no light of the projector is asked for
        lit = np.array([math.cos(rim) for rim in self._slides[0].rims] if gains[0].any() else [-1.0, 1.0], np.float32)
        _draw_course(
            frame,
            rows,
            eye,
            self._pixel_rad,
            self._tube,
            self._paint,
            self._projectors[0].beam(head, z_mm, gains[0]),
            self._slides[0].table(head, z_mm),
            self._led.table(eye, gains[1]),
            self._pixel._replace(seed=seed & 0x7FFFFFFF),
            lit,
            course.frame(z_mm)[2],
        )
        return frame


def _pixel_rad(rays: F32) -> F32:
    """(H, W) angle between the rays of neighbouring pixels; the mean of both ways, as a blur sees it."""
    way = rays.astype(np.float64)
    way[2] = np.sqrt(np.maximum(1.0 - way[0] ** 2 - way[1] ** 2, 0.0))
    down, right = (np.linalg.norm(np.gradient(way, axis=axis), axis=0) for axis in (1, 2))
    return np.ascontiguousarray(np.sqrt(down * right), dtype=np.float32)
