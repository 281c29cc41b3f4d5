"""Where a ray meets a pipe of pieces, and how light gets there, past beads and through water.

A place lies in one piece, has a chainage there and two coordinates across; it is in the pipe while the distance from
the axis is less than the radius at that chainage and clock angle, or in an opening's bore. Rays march by what is free
for certain, by 0.3 mm where relief is near, and are bisected. Float64, a pixel at a time: several times slower than
`walls`.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.twin.rays import PipeCamera
from annulus_pipe.twin.stretch import (
    COLUMN,
    CX,
    F32,
    NX,
    NY,
    NZ,
    OPEN,
    PAINT,
    PLAIN,
    WX,
    WY,
    WZ,
    PixelRun,
    Real,
    S,
    X,
    Y,
    Z,
    jit,
)
from annulus_pipe.twin.walls import PER_Z, padded, wall_at
from annulus_pipe.twin.worlds.course import Course, across
from annulus_pipe.twin.worlds.world import CLOCKS, World

WATER = 1.333  # refractive index
FAR_MM = 500.0  # what is further is not lit
_DRY_MM = 1e6
_TABLE_MM = 0.5  # of the table of what is free
_STEP_MM, _NEAR_MM, _LEAP_MM = 0.3, 2.0, 20.0  # shortest step; longest near relief, and where there is none
_NORMAL_MM = 0.15  # over which a wall's slope is taken
# Columns of the pieces' table.
_START, _LENGTH, _ORIGIN, _AXES, _BEND, _DX, _DY, _RADIUS, _SLOPE, _BRIGHT = 0, 1, 2, 5, 14, 15, 16, 17, 18, 19

Place = tuple[Real, Real, Real]


class Tube(NamedTuple):
    """A course as the kernels read it."""

    pieces: FloatArray  # (P, 20)
    beads: FloatArray  # (B, 4) chainage, height, width, notch
    bores: FloatArray  # (O, 8) a point of the pipe's axis, outwards, radius, depth
    level: float  # of water, as y in space; far below where there is none
    deviation: F32  # the world's radius map, padded and flat
    first_mm: float  # chainage of the tables' first row
    turn_rate: float  # sine of how far the axes of straight pieces stand to each other within a leap
    rough: NDArray[np.uint8]  # (T,) 1 where the map has anything
    near: FloatArray  # (T,) mm: nothing within `_NEAR_MM` is nearer to the axis
    leap: FloatArray  # (T,) the same within `_LEAP_MM`


class InSpace:
    """A pose of the head at a chainage, as the lights ask for it (see Pose): pipe frame is space."""

    def __init__(self, pose: Pose, course: Course) -> None:
        self._pose, self._course = pose, course
        self._at: tuple[float, FloatArray, FloatArray] | None = None

    def _frame(self, z_mm: float) -> tuple[FloatArray, FloatArray]:
        if self._at is None or self._at[0] != z_mm:
            self._at = (z_mm, *self._course.frame(z_mm)[:2])
        return self._at[1], self._at[2]

    def at(self, z_mm: float) -> "InSpace":
        self._frame(z_mm)
        return self

    @property
    def rotation(self) -> FloatArray:
        """(3, 3), space to head, where `at` put it."""
        assert self._at is not None
        return np.asarray(self._pose.rotation @ self._at[2].T)

    def to_pipe(self, points: FloatArray, z_mm: float) -> FloatArray:
        """(N, 3) mm in the head's frame -> space."""
        origin, axes = self._frame(z_mm)
        return np.asarray(origin + self._pose.to_pipe(points) @ axes.T)


@jit
def locate(pieces: FloatArray, place: Place, hint: int) -> Any:
    """(piece, chainage, x, y) of a place in space; x and y across the pipe, in axes carried along it without twist."""
    i, forward = hint, False
    while True:
        x, y, z = place[0] - pieces[i, 2], place[1] - pieces[i, 3], place[2] - pieces[i, 4]
        u = pieces[i, 5] * x + pieces[i, 6] * y + pieces[i, 7] * z
        v = pieces[i, 8] * x + pieces[i, 9] * y + pieces[i, 10] * z
        s = pieces[i, 11] * x + pieces[i, 12] * y + pieces[i, 13] * z
        bend = pieces[i, _BEND]
        if bend > 0.0:
            dx, dy = pieces[i, _DX], pieces[i, _DY]
            aside, beside = u * dx + v * dy, v * dx - u * dy
            inner = bend - math.sqrt((bend - aside) ** 2 + s * s)
            s = bend * math.atan2(s, bend - aside)
            u, v = inner * dx - beside * dy, inner * dy + beside * dx
        if s > pieces[i, _LENGTH] and i + 1 < pieces.shape[0]:
            i, forward = i + 1, True
        elif s < 0.0 and i > 0 and not forward:
            i -= 1
        else:
            return i, pieces[i, _START] + s, u, v


@jit
def bead(beads: FloatArray, s: Real) -> Real:
    """How far beads stand into the pipe at a chainage, mm."""
    most = 0.0
    for k in range(beads.shape[0]):
        quarter = beads[k, 2] / 4
        off = abs(s - beads[k, 0])
        if off < 2 * quarter:
            arm = (off - quarter) / quarter
            roll = beads[k, 1] * math.sqrt(max(1.0 - arm * arm, 0.0))
            if off < quarter:
                roll = max(roll, beads[k, 1] - beads[k, 3])
            most = max(most, roll)
    return most


@jit
def excess(tube: Tube, place: Place, hint: int) -> Any:
    """(mm, piece, chainage, x, y): how far a place is out of the pipe; below zero inside."""
    i, s, u, v = locate(tube.pieces, place, hint)
    pieces = tube.pieces
    wall = pieces[i, _RADIUS] + pieces[i, _SLOPE] * (s - pieces[i, _START]) - bead(tube.beads, s)
    row = int((s - tube.first_mm) / _TABLE_MM)
    if 0 <= row < tube.rough.shape[0] and tube.rough[row]:
        wall += wall_at(tube.deviation, np.float32(column_of(u, v)), np.float32(s) * PER_Z)
    out = math.sqrt(u * u + v * v) - wall
    for k in range(tube.bores.shape[0]):
        bores = tube.bores
        x, y, z = place[0] - bores[k, 0], place[1] - bores[k, 1], place[2] - bores[k, 2]
        t = x * bores[k, 3] + y * bores[k, 4] + z * bores[k, 5]
        if t > 0.0:
            side = math.sqrt(max(x * x + y * y + z * z - t * t, 0.0)) - bores[k, 6]
            out = min(out, max(side, t - bores[k, 7]))
    return out, i, s, u, v


@jit
def column_of(u: Real, v: Real) -> Real:
    """Fractional map column of a place across the pipe, in [0, CLOCKS)."""
    f = math.atan2(u, -v) * (CLOCKS / (2 * math.pi))
    return f + CLOCKS if f < 0 else f


@jit
def trace(tube: Tube, start: Place, way: Place, far: Real, hint: int) -> Any:
    """(mm, piece) along a unit ray from inside to where it leaves the pipe; `far` where it does not before."""
    at, i, rows, pieces = 0.0, hint, tube.near.shape[0], tube.pieces
    inside, outside, most, least = 0.0, -1.0, 0.0, 0.0  # last range in the pipe, first out of it, excess at both
    tries = 0
    while at < far:
        place = (start[0] + at * way[0], start[1] + at * way[1], start[2] + at * way[2])
        out, i, s, u, v = excess(tube, place, i)
        if out >= 0.0:
            outside, most = at, out
        else:
            inside, least = at, out
        if outside >= 0.0:
            if abs(out) < 1e-3 or tries == 12:
                return at, i
            tries += 1
            # the secant where the wall is smooth; where it steps, halves
            at = (inside * most - outside * least) / (most - least) if tries < 4 else (inside + outside) / 2
            continue
        row = min(max(int((s - tube.first_mm) / _TABLE_MM), 0), rows - 1)
        rho = math.sqrt(u * u + v * v)
        # how fast the ray can leave the axis: in a bend the axis turns while it goes, too
        along = pieces[i, 11] * way[0] + pieces[i, 12] * way[1] + pieces[i, 13] * way[2]
        rate = 1.0
        if pieces.shape[0] == 1 or pieces[i, _BEND] == 0.0:
            rate = min(math.sqrt(max(1.0 - along * along, 0.0)) + tube.turn_rate, 1.0)
        step = min((tube.leap[row] - rho) / rate, _LEAP_MM)
        if step < _STEP_MM:
            step = max(min((tube.near[row] - rho) / rate, _NEAR_MM), _STEP_MM)
        at += step
    return far, i


@jit
def normal_at(tube: Tube, place: Place, hint: int) -> Any:
    """Unit vector out of the pipe at a place of its wall."""
    x, y, z = place
    gx, gy, gz = 0.0, 0.0, 0.0
    for k in range(6):
        h = _NORMAL_MM if k < 3 else -_NORMAL_MM
        way = (h if k % 3 == 0 else 0.0, h if k % 3 == 1 else 0.0, h if k % 3 == 2 else 0.0)
        out = excess(tube, (x + way[0], y + way[1], z + way[2]), hint)[0]
        gx, gy, gz = gx + out * way[0], gy + out * way[1], gz + out * way[2]
    scale = 1.0 / math.sqrt(gx * gx + gy * gy + gz * gz + 1e-18)
    return gx * scale, gy * scale, gz * scale


@jit
def passed(cosine: Real) -> Real:
    """Part of unpolarised light that goes through a water surface at an angle whose cosine is given (Fresnel)."""
    inner = math.sqrt(1.0 - (1.0 - cosine * cosine) / (WATER * WATER))
    across_ = (cosine - WATER * inner) / (cosine + WATER * inner)
    along = (WATER * cosine - inner) / (WATER * cosine + inner)
    return 1.0 - (across_ * across_ + along * along) / 2


@jit
def entry(above: Real, below: Real, apart: Real) -> Real:
    """How far (mm) from above one point light enters the water on its way to another, by Snell's law."""
    low, high = 0.0, apart
    for _ in range(40):
        x = (low + high) / 2
        if x * math.hypot(apart - x, below) < WATER * (apart - x) * math.hypot(x, above):
            low = x
        else:
            high = x
    return (low + high) / 2


@jit
def meet_tube(
    part: PixelRun,
    u0: int,
    eye: PipeCamera,
    pixel_rad: F32,
    sharp: F32,
    tube: Tube,
    lamp: F32,
    lit: F32,
    mirrored: bool,
    hint: int,
) -> bool:
    """What each pixel sees, as `fall` and those after it ask. Whether water is in view.

    Of a place under water, X, Y, Z are where the projector's light would have come to had it gone on straight, the
    normal is shortened to the cosine it arrives with, OPEN is what the surface lets in, CX what it lets out. PLAIN is
    chainage, PAINT the piece's brightness. mirrored : what the surface shows instead of what lies under it. sharp :
    (n,) set to how much cot of the angle to the projector's axis changes in a pixel, see `rays.ray_table`.
    lit : (2,) cosines of that angle between which there is light.
    """
    scratch, v, rotation, station = part.scratch, part.v, eye.rotation, eye.station
    dark_within, dark_beyond = lit[0], lit[1]
    origin = (float(station[0]), float(station[1]), float(station[2]))
    wet = False
    for k in range(part.n):
        scratch[OPEN + k], scratch[PAINT + k], sharp[k] = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        scratch[X + k], scratch[Y + k], scratch[Z + k] = lamp[0], lamp[1], lamp[2] + np.float32(1e3)
        scratch[NX + k], scratch[NY + k], scratch[NZ + k] = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        scratch[S + k], scratch[COLUMN + k], scratch[PLAIN + k] = np.float32(1e3), np.float32(0.0), np.float32(0.0)
        if part.spread[k] <= 0.0:
            continue
        dx, dy = eye.rays[0, v, u0 + k], eye.rays[1, v, u0 + k]
        dz = math.sqrt(max(1.0 - dx * dx - dy * dy, 0.0))
        way = (
            rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz,
            rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz,
            rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz,
        )
        start, light, view, ahead, piece = origin, 1.0, 1.0, 0.0, hint
        s = 0.0
        for leg in range(2):
            s, piece = trace(tube, start, way, FAR_MM, piece)
            if leg == 1 or way[1] <= 1e-6 or origin[1] + s * way[1] <= tube.level:
                break
            wet = True
            ahead = (tube.level - origin[1]) / way[1]
            start = (origin[0] + ahead * way[0], tube.level, origin[2] + ahead * way[2])
            view = passed(way[1])
            if mirrored:
                way, view = (way[0], -way[1], way[2]), 1.0 - view
            else:
                down = math.sqrt(1.0 - (1.0 - way[1] * way[1]) / (WATER * WATER))
                way = (way[0] / WATER, down, way[2] / WATER)
        if mirrored and ahead == 0.0:
            continue
        if s >= FAR_MM:
            continue
        place = (start[0] + s * way[0], start[1] + s * way[1], start[2] + s * way[2])
        nx, ny, nz = normal_at(tube, place, piece)
        _, piece, chainage, across_x, across_y = excess(tube, place, piece)
        s += ahead
        px, py, pz = place[0] - lamp[0], place[1] - lamp[1], place[2] - lamp[2]
        if place[1] > tube.level:
            above, apart = tube.level - lamp[1], math.hypot(px, pz)
            x = entry(above, place[1] - tube.level, apart)
            whole = math.hypot(x, above) + math.hypot(apart - x, place[1] - tube.level)
            cosine = above / math.hypot(x, above)
            inner = math.sqrt(1.0 - (1.0 - cosine * cosine) / (WATER * WATER))
            level_part = math.sqrt(1.0 - inner * inner) / apart
            facing = px * level_part * nx + inner * ny + pz * level_part * nz
            light = passed(cosine)
            level_part = math.sqrt(1.0 - cosine * cosine) / apart
            px, py, pz = px * level_part * whole, cosine * whole, pz * level_part * whole
            slant = way[0] * nx + way[1] * ny + way[2] * nz
            gx, gy, gz = nx, ny, nz
            nx, ny, nz = px / whole * facing, py / whole * facing, pz / whole * facing
        else:
            whole = math.sqrt(px * px + py * py + pz * pz)
            facing = px * nx + py * ny + pz * nz
            cosine = (px * lamp[3] + py * lamp[4] + pz * lamp[5]) / whole
            back = (lamp[0], lamp[1], lamp[2])
            if (
                not (dark_within > cosine > dark_beyond)
                or facing <= 0.0
                or trace(tube, back, (px / whole, py / whole, pz / whole), whole - 0.1, piece)[0] < whole - 0.1
            ):
                light = 0.0
            slant = way[0] * nx + way[1] * ny + way[2] * nz
            gx, gy, gz = nx, ny, nz
        # how fast the angle to the projector's axis turns as the ray does, on the plane that the wall is here
        cosine = (px * lamp[3] + py * lamp[4] + pz * lamp[5]) / whole
        sine2 = max(1.0 - cosine * cosine, 1e-6)
        by = 1.0 / (whole * math.sqrt(sine2))
        tx, ty, tz = (
            by * (px / whole * cosine - lamp[3]),
            by * (py / whole * cosine - lamp[4]),
            by * (pz / whole * cosine - lamp[5]),
        )
        along = (tx * way[0] + ty * way[1] + tz * way[2]) / max(slant, 0.02)
        turn = s * math.sqrt((tx - along * gx) ** 2 + (ty - along * gy) ** 2 + (tz - along * gz) ** 2)
        sharp[k] = np.float32(turn * pixel_rad[v, u0 + k] / sine2 + 1e-9)
        scratch[WX + k], scratch[WY + k], scratch[WZ + k] = way[0], way[1], way[2]
        scratch[S + k] = s
        scratch[X + k], scratch[Y + k], scratch[Z + k] = lamp[0] + px, lamp[1] + py, lamp[2] + pz
        scratch[NX + k], scratch[NY + k], scratch[NZ + k] = nx, ny, nz
        scratch[OPEN + k] = light
        scratch[CX + k] = view
        scratch[PAINT + k] = tube.pieces[piece, _BRIGHT]
        scratch[COLUMN + k] = column_of(across_x, across_y)
        scratch[PLAIN + k] = chainage
    return wet


def tube_of(world: World) -> Tube:
    """Of a world that has a course."""
    course = world.course
    assert course is not None
    rows = []
    for piece, start, (origin, axes) in zip(course.pieces, course.starts_mm, course.placed, strict=True):
        end = piece.radius_mm if piece.end_radius_mm is None else piece.end_radius_mm
        toward = across(piece.toward_deg)
        rows.append(
            [
                start,
                piece.length_mm,
                *origin,
                *axes.T.ravel(),
                piece.bend_radius_mm,
                toward[0],
                toward[1],
                piece.radius_mm,
                (end - piece.radius_mm) / piece.length_mm,
                piece.brightness,
            ]
        )
    pieces = np.array(rows)
    joints = [(s, p.joint) for s, p in zip(course.starts_mm[1:], course.pieces[1:], strict=True) if p.joint]
    beads = np.array([[s, j.height_mm, j.width_mm, j.notch_mm] for s, j in joints if j.height_mm > 0]).reshape(-1, 4)
    bores = []
    for one in course.openings:
        origin, axes, _ = course.frame(one.z_mm)
        bores.append([*origin, *(axes @ across(one.clock_deg)), one.inner_d_mm / 2, one.deep_mm])
    low, high = world.z_range_mm
    stations = np.arange(low - 300.0, high + 300.0, _TABLE_MM)
    map_z = low + np.arange(len(world.radius_map)) * (high - low) / len(world.radius_map)
    lowest = np.interp(stations, map_z, world.radius_map.min(axis=1), 0.0, 0.0)
    highest = np.interp(stations, map_z, world.radius_map.max(axis=1), 0.0, 0.0)
    rough = ndimage.maximum_filter((np.abs(lowest) + np.abs(highest) > 0).astype(np.uint8), size=9)
    which = np.maximum(np.searchsorted(course.starts_mm, stations, side="right") - 1, 0)
    free = pieces[which, _RADIUS] + pieces[which, _SLOPE] * (stations - pieces[which, _START]) + lowest
    free -= np.array([bead(beads, s) for s in stations])
    for s, j in joints:  # across a joint the axis itself jumps, and a turn of it lifts one side
        radius = course.pieces[course.frame(s)[2]].radius_mm
        slack = j.hilo_mm + 2 * radius * math.sin(math.radians(j.angle_deg))
        free[np.abs(stations - s) < 4.0] -= slack + 0.1
    bends = [p for p in course.pieces if p.bend_radius_mm]
    stretch = max([1.0] + [p.bend_radius_mm / (p.bend_radius_mm - p.radius_mm) for p in bends])  # chainage a mm inside
    near, leap = (
        ndimage.minimum_filter(free, size=2 * math.ceil((reach * stretch + 1.0) / _TABLE_MM) + 1)
        for reach in (_NEAR_MM, _LEAP_MM)
    )
    # a ray that leaves a straight piece soon runs in the next: a bend turns by a leap over its radius
    turn = sum(math.sin(math.radians(j.angle_deg)) for _, j in joints)
    turn += max([0.0] + [_LEAP_MM / (p.bend_radius_mm - p.radius_mm) for p in bends])
    level = _DRY_MM if course.level_mm is None else course.level_mm
    return Tube(
        pieces,
        beads,
        np.array(bores).reshape(-1, 8),
        level,
        padded(world),
        float(stations[0]),
        turn,
        rough,
        np.ascontiguousarray(near),
        np.ascontiguousarray(leap),
    )
