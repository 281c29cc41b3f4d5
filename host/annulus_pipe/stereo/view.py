"""One camera of a head with several: its slits, named, and where it would see a point of the wall.

All that `rings` knows of finding slits holds for a camera beside the projector, too, but for one thing: where a ray is
tangent to its cone, the slit's place says nothing of the wall, and the wall nothing of the slit. So a slit is named by
how far it lies from where its ring should be in the image, against how far a wall could move it there.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration, HeadCamera
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose, pose_of
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import jit, middle
from annulus_pipe.numeric.mosaic import Picture
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.decode import NONE, UNKNOWN, classify, decode, readings
from annulus_pipe.rings.outliers import reject_outliers
from annulus_pipe.rings.pedestal import without_pedestal
from annulus_pipe.rings.polar import PolarGrid, polar_grid, unroll
from annulus_pipe.rings.slits import Slits, find_slits
from annulus_pipe.rings.triangulate import RingOptics, ring_optics
from annulus_pipe.stereo.lens import lens_numbers, on_line

STEP_PX = 1.5  # along a line, between a point and its neighbours on one wall, as in `rings` ..
STEP = 0.01  # .. plus what this part of the radius moves it by
FARTHER = 0.02  # of the distance: step of the finite differences along a generator
WIDE = 1.3  # of the usual width: a slit in a shadow's edge must not shift itself
EVERY = 12  # of so many generators places are worked out on one ..
NODES = 40  # .. but on so many of a cone at least
SOME = 8  # lines, of which one says how far a ring's image moves


@dataclass(frozen=True, slots=True, eq=False)
class ObservedSlits:
    """The slits (N,) of one frame, the colours beside them, and (N, K) which rings they could be by those."""

    slits: Slits
    inside: NDArray[np.uint8]
    outside: NDArray[np.uint8]
    could_be: NDArray[np.bool_]
    widest: float  # px: what is wider is no wider than this


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where a camera would see each ring on a clean pipe. By generator (K, P): line, sample along it, and how both move
    with a mm along the generator; by line (K, J): sample, and how it moves with the pipe's radius (px a radius) and the
    half-angle of the cone (px a radian)."""

    by_generator: FloatArray  # (4, K, P)
    course: FloatArray
    by_radius: FloatArray
    by_angle: FloatArray

    @property
    def line(self) -> FloatArray:
        return np.asarray(self.by_generator[0])

    @property
    def place(self) -> FloatArray:
        return np.asarray(self.by_generator[1])

    @property
    def line_by_mm(self) -> FloatArray:
        return np.asarray(self.by_generator[2])

    @property
    def place_by_mm(self) -> FloatArray:
        return np.asarray(self.by_generator[3])


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera where it stands: X_own = rotation X_head + translation_mm."""

    camera: Camera
    rotation: FloatArray  # (3, 3)
    translation_mm: FloatArray  # (3,)
    grid: PolarGrid
    optics: RingOptics
    colours: str
    lens: FloatArray  # all of the above for compiled loops, see `lens`

    def expect(self, cones: FloatArray, ways: FloatArray, start_mm: FloatArray, pose: Pose) -> Expected:
        """What a clean pipe would show. cones (K, 7), see `RingOptics`, ways (K, P, 3), start_mm (K, P): generators to
        where they meet it."""
        rings, lines = len(cones), len(self.grid.cosine)
        by_generator, by_line = np.empty((4, *start_mm.shape)), np.full((3, rings, lines), np.nan)
        _expect(self.lens, cones, ways, start_mm, pose.rotation, pose.translation, by_generator, by_line)
        return Expected(by_generator, *by_line)

    def see(self, image: Picture, colour: ColourProfile | None) -> tuple[ObservedSlits, dict[str, int]]:
        """The slits of one frame, and how many were left out, by reason."""
        slits = find_slits(unroll(without_pedestal(image, self.grid.spacing_px), self.grid), self.grid)
        both = classify(
            np.vstack([slits.inside, slits.outside]), self.colours, None if colour is None else colour.seen()
        )
        inside, outside = both[: len(slits.position)], both[len(slits.position) :]
        unknown = int(np.count_nonzero((inside == UNKNOWN) | (outside == UNKNOWN)))
        rejected = {"crowded": slits.crowded, "shallow": slits.shallow, "colour": unknown}
        widest = WIDE * middle(slits.width.copy(), len(slits.width)) if len(slits.width) else 0.0
        return ObservedSlits(slits, inside, outside, readings(inside, outside, self.colours), widest), rejected

    def name(self, seen: ObservedSlits, expected: Expected, tolerance: float) -> tuple[NDArray[np.int64], FloatArray]:
        """Ring of each slit, or NONE; and (N, K) px from where each ring should be. tolerance : of the wall, of the
        radius."""
        slits = seen.slits
        off, deviation = np.empty(seen.could_be.shape), np.empty(seen.could_be.shape)
        _off(
            slits.direction,
            slits.position,
            seen.could_be,
            expected.course,
            expected.by_radius,
            self.grid.spacing_px,
            off,
            deviation,
        )
        ring = decode(slits.direction, seen.inside, seen.outside, deviation, self.colours, tolerance)
        return ring, off

    def without_outliers(
        self, ring: NDArray[np.int64], seen: ObservedSlits, off: FloatArray, expected: Expected
    ) -> tuple[dict[str, int], FloatArray]:
        """Sets `ring` to NONE where a slit is not to be believed; see `rings.outliers`."""
        step = STEP_PX + STEP * nan_median(np.abs(expected.by_radius[:, ::SOME]).T)
        width = np.array(seen.slits.width)
        _as_usual(ring, seen.slits.direction, expected.by_angle, width)
        return reject_outliers(ring, replace(seen.slits, width=width), off, step, len(self.grid.cosine))

    def table(self, ring: NDArray[np.int64], seen: ObservedSlits) -> tuple[FloatArray, NDArray[np.int64]]:
        """(K, J) the samples at which each ring was seen, NaN for none; and which slit that is, -1 for none."""
        shape = self.optics.bend.shape
        place, which = np.full(shape, np.nan), np.full(shape, -1)
        slits = seen.slits
        _table(
            ring,
            slits.direction,
            slits.position,
            slits.width,
            seen.widest,
            self.optics.bend,
            self.optics.offset_px,
            place,
            which,
        )
        return place, which


def view_of(calibration: Calibration, of: HeadCamera, nominal: Pose, directions: int) -> View:
    """A view of one of the head's cameras; `nominal` : the pipe in the head's frame."""
    rotation, translation = np.array(of.rotation), np.array(of.translation_mm)
    rings = tuple(
        Cone(c.half_angle, _three(rotation @ c.axis), _three(rotation @ np.array(c.vertex_mm) + translation))
        for c in calibration.rings
    )
    own = replace(calibration, camera=of.camera, rings=rings, others=(), covariance=None)
    pose = pose_of(rotation @ nominal.rotation[:, 2], rotation @ nominal.translation + translation)
    grid = polar_grid(own, directions, pose)
    lens = lens_numbers(of.camera, rotation, translation, grid)
    return View(of.camera, rotation, translation, grid, ring_optics(own, grid, pose), calibration.colours, lens)


@jit
def _off(direction, position, could_be, course, by_radius, spacing, off, deviation):  # type: ignore[no-untyped-def]
    """(N, K) px of each slit beyond where each ring should be; and against how far a wall of a radius more or less, or
    the nearer neighbour's place, is from there, NaN where it cannot be that ring."""
    rings = len(course)
    for n in range(len(direction)):
        j = direction[n]
        for k in range(rings):
            off[n, k] = position[n] - course[k, j]
            if not could_be[n, k]:
                deviation[n, k] = np.nan
                continue
            gap = np.inf
            if k > 0 and course[k - 1, j] == course[k - 1, j]:
                gap = abs(course[k, j] - course[k - 1, j])
            if k + 1 < rings and course[k + 1, j] == course[k + 1, j]:
                gap = min(gap, abs(course[k + 1, j] - course[k, j]))
            gap = gap if gap < np.inf else spacing
            deviation[n, k] = off[n, k] / math.sqrt(by_radius[k, j] ** 2 + gap * gap)


@jit
def _as_usual(ring, direction, by_angle, width):  # type: ignore[no-untyped-def]
    """Turns widths (N,) into what they would be where a ring's slit were equally wide all round."""
    mean = np.zeros(len(by_angle))
    for k in range(len(by_angle)):
        count = 0
        for j in range(by_angle.shape[1]):
            if by_angle[k, j] == by_angle[k, j]:
                mean[k] += by_angle[k, j]
                count += 1
        mean[k] /= max(count, 1)
    for n in range(len(ring)):
        k = ring[n]
        if k != NONE and by_angle[k, direction[n]] > 0.0:
            width[n] *= mean[k] / by_angle[k, direction[n]]


@jit
def _table(ring, direction, position, width, widest, bend, offset, place, which):  # type: ignore[no-untyped-def]
    """Writes (K, J) slits and their places, moved to the middle of the angles, less what colours draw them."""
    for n in range(len(ring)):
        k, j = ring[n], direction[n]
        if k != NONE:
            wide = min(width[n], widest)
            which[k, j] = n
            place[k, j] = position[n] + bend[k, j] * wide * wide / 8.0 - offset[k, j]


@jit
def _expect(lens, cones, ways, start, rotation, shift, by_generator, by_line):  # type: ignore[no-untyped-def]
    """See `Expected`: line, place and their changes with a mm, (4, K, P); course, change with a radius and with a
    radian of the half-angle (3, K, J).

    They change slowly round a cone and are worked out on some generators; cubics lead to those between (6 degrees
    apart, within 2e-3 px), but for where the cone meets no wall."""
    rings, steps = start.shape
    lines = by_line.shape[2]
    every = EVERY
    while every > 1 and (steps % every or steps < every * NODES):
        every //= 2
    nodes = steps // every
    node, own = np.empty((nodes + 3, 6)), np.empty(6)  # the last, all, and the first two once more
    by_radius, turn = np.empty(steps), np.empty((steps, 2))
    cubic = np.empty((every, 4))
    for q in range(every):
        t = q / every
        cubic[q, 0], cubic[q, 1] = -t * (t - 1) * (t - 2) / 6, (t * t - 1) * (t - 2) / 2
        cubic[q, 2], cubic[q, 3] = -t * (t + 1) * (t - 2) / 2, t * (t * t - 1) / 6
    for k in range(rings):
        for m in range(nodes):
            _one(lens, cones[k], ways[k, m * every], start[k, m * every], rotation, shift, lines, node[m + 1])
        node[0], node[nodes + 1], node[nodes + 2] = node[nodes], node[1], node[2]
        for m in range(1, nodes + 3):  # lines begin anew after the last: between nodes they must not
            node[m, 0] -= lines * math.floor((node[m, 0] - node[m - 1, 0]) / lines + 0.5)
        m, q = -1, every - 1
        for p in range(steps):
            q += 1
            if q == every:
                m, q = m + 1, 0
            near = start[k, p]
            a, b, c, d = cubic[q, 0], cubic[q, 1], cubic[q, 2], cubic[q, 3]
            for i in range(6):
                own[i] = a * node[m, i] + b * node[m + 1, i] + c * node[m + 2, i] + d * node[m + 3, i]
            if own[3] != own[3] or near != near:
                _one(lens, cones[k], ways[k, p], near, rotation, shift, lines, own)
            own[0] -= lines * math.floor(own[0] / lines)
            for i in range(4):
                by_generator[i, k, p] = own[i]
            turn[p, 0], turn[p, 1] = own[4], own[5]
            # how fast the step leads away from the axis
            wx, wy, wz = ways[k, p, 0], ways[k, p, 1], ways[k, p, 2]
            x, y = cones[k, 0] + near * wx - shift[0], cones[k, 1] + near * wy - shift[1]
            u, v = _across(rotation, x, y, cones[k, 2] + near * wz - shift[2])
            wu, wv = _across(rotation, wx, wy, wz)
            by_radius[p] = (u * wu + v * wv) / (u * u + v * v)  # radii a mm
        for p in range(steps):
            q = (p + 1) % steps
            a, b = by_generator[0, k, p], by_generator[0, k, q]
            if not (a == a and b == b):
                continue
            span = b - a
            span -= lines * math.floor(span / lines + 0.5)
            if span == 0.0:
                continue
            before, after = by_generator[1, k, p], by_generator[1, k, q]
            slope = (after - before) / span
            low, high = (a, a + span) if span > 0 else (a + span, a)
            for j in range(math.ceil(low), math.floor(high) + 1):
                part = (j - a) / span
                by_line[0, k, j % lines] = before + part * (after - before)
                own_a = (by_generator[3, k, p] - slope * by_generator[2, k, p]) / by_radius[p]
                own_b = (by_generator[3, k, q] - slope * by_generator[2, k, q]) / by_radius[q]
                by_line[1, k, j % lines] = own_a + part * (own_b - own_a)
                own_a, own_b = turn[p, 1] - slope * turn[p, 0], turn[q, 1] - slope * turn[q, 0]
                by_line[2, k, j % lines] = own_a + part * (own_b - own_a)


@jit
def _across(rotation, x, y, z):  # type: ignore[no-untyped-def]
    """A vector of the head's frame along the pipe's x and y."""
    return (
        x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0],
        x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1],
    )


@jit
def _one(lens, cone, way, near, rotation, shift, lines, out):  # type: ignore[no-untyped-def]
    """Of a generator that meets the wall `near` mm from the vertex: line and sample, how both change with a mm, and how
    with a radian of the half-angle where the wall stays."""
    x, y, z = cone[0] + near * way[0], cone[1] + near * way[1], cone[2] + near * way[2]
    step = FARTHER * near
    out[0], out[1] = on_line(lens, x, y, z)
    _moved(lens, x + step * way[0], y + step * way[1], z + step * way[2], lines, step, out, 2)
    cosine, sine = math.cos(cone[6]), math.sin(cone[6])
    a, b, c = cosine * way[0] - cone[3], cosine * way[1] - cone[4], cosine * way[2] - cone[5]  # how the way turns
    u, v = _across(rotation, x - shift[0], y - shift[1], z - shift[2])
    wu, wv = _across(rotation, way[0], way[1], way[2])
    tu, tv = _across(rotation, a, b, c)
    back = (u * tu + v * tv) / (u * wu + v * wv)
    step /= sine
    x, y, z = x + step * (a - back * way[0]), y + step * (b - back * way[1]), z + step * (c - back * way[2])
    _moved(lens, x, y, z, lines, FARTHER, out, 4)


@jit
def _moved(lens, x, y, z, lines, by, out, at):  # type: ignore[no-untyped-def]
    """Writes how line and sample change from out[:2] to those of a point, which is `by` away."""
    line, place = on_line(lens, x, y, z)
    moved = line - out[0]
    moved -= lines * math.floor(moved / lines + 0.5)
    out[at], out[at + 1] = moved / by, (place - out[1]) / by


def _three(v: FloatArray) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
