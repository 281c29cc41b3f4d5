"""A pipe of pieces: where a ray meets it, and how light gets there, past beads and through water.

The loops are host/native/twin_tube.c and twin_course.c, float64, a pixel at a time: several times slower than a wall of
one piece.
"""

import math
from typing import NamedTuple

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import Float32Array, FloatArray, Image
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.native import door
from annulus_pipe.twin.walls import padded
from annulus_pipe.twin.worlds.course import Course, across
from annulus_pipe.twin.worlds.world import CLOCKS, STEP_Z_MM, World

_DRY_MM = 1e6
_TABLE_MM = 0.5  # of the table of what is free
_NEAR_MM, _LEAP_MM = 2.0, 20.0  # longest step of a ray near relief, and where there is none
# Columns of the pieces' table.
_START, _RADIUS, _SLOPE = 0, 17, 18

TUBE = (
    "f8[8] course",
    "f8[q,20] pieces",
    "f8[b,4] beads",
    "f8[o,8] bores",
    "f4[r,p] deviation",
    "u1[y] rough",
    "f8[y] near",
    "f8[y] leap",
)
_beads = door("twin_beads", "f8[b,4] beads", "f8[n] stations", "f8[n]! out")
_leaves = door("twin_leaves", *TUBE, "f8[3] start", "f8[3] way", "f8 far", returns="f8")
entry = door("twin_entry", "f8 above", "f8 below", "f8 apart", returns="f8")
passed = door("twin_passed", "f8 cosine", returns="f8")


class Tube(NamedTuple):
    """A course as the loops read it, in the order of TUBE."""

    numbers: FloatArray  # (8,) as listed in `tube_of`
    pieces: FloatArray  # (q, 20) the same
    beads: FloatArray  # (b, 4) chainage, height, width, notch
    bores: FloatArray  # (o, 8) a point of the pipe's axis, outwards, radius, depth
    deviation: Float32Array  # the world's radius map, padded
    rough: Image  # (y,) 1 where the map has anything
    near: FloatArray  # (y,) mm: nothing within `_NEAR_MM` is nearer to the axis
    leap: FloatArray  # (y,) the same within `_LEAP_MM`


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
    standing = np.empty_like(stations)
    _beads(beads, stations, standing)
    free -= standing
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
    numbers = [
        _DRY_MM if course.level_mm is None else course.level_mm,  # of water, as y in space
        stations[0],
        1 / _TABLE_MM,
        turn,  # sine of how far the axes of straight pieces stand to each other within a leap
        _NEAR_MM,
        _LEAP_MM,
        1 / STEP_Z_MM,
        CLOCKS,
    ]
    return Tube(
        np.array(numbers),
        pieces,
        beads,
        np.array(bores).reshape(-1, 8),
        padded(world),
        rough,
        np.ascontiguousarray(near),
        np.ascontiguousarray(leap),
    )


def leaves(tube: Tube, start: FloatArray, way: FloatArray, far_mm: float) -> float:
    """Range (mm) along a unit ray from inside of the first piece to where it leaves the pipe; far_mm where it does not
    before."""
    return float(_leaves(*tube, start, way, far_mm))
