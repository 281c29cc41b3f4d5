"""Frames aligned with each other on the wall they share.

A frame's own pose comes from its own rings, and where one of them lies in a groove or on an oval stretch it leans a
little. Frames overlap many times over, so the wall that most of them agree on shows who leans.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from annulus_pipe.geometry.pose import Pose, rotation_z
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY
from annulus_pipe.wall.grid import NOISE_FLOOR_MM, pipe_shape
from annulus_pipe.wall.profile import Profile

# POINTS_NEEDED, ANGLE_MAX and WORTH_MM are guarded by test_registration.py one way each. ROUNDS and SHIFT_OF_RADIUS:
# unguarded; what all of it gains shows in the benchmark topic diameter (clouds before and after).
ROUNDS = 2
POINTS_NEEDED = 200  # points in a frame, for the four numbers of its correction
ANGLE_MAX = 0.03  # radians; a frame that wants more is wrong in another way and is left alone ..
WORTH_MM = 0.04  # what a correction must do to most of a frame's points; less is noise of the fit
SHIFT_OF_RADIUS = 0.05  # of the radius; .. and so is one that wants a longer shift than this
CONDITION_MOST = 1e6  # of the normal equations: a frame that sees a short arc only does not tell shift from tilt
LANES = 8  # points that a loop may work on beyond the last

_frame_correction = door(
    "frame_correction",
    "f4[n,3] points",
    "f8 z_mm",
    "f8[z] stations",
    "f8[z,5] shape",
    "f8 radius_mm",
    "f8 needed",
    "f8 floor_mm",
    "f8 tukey",
    "f8 of_mad",
    "f8 condition_most",
    "f8[13,m]! room",
    "f8[4]! found",
    "f8[1]! moves",
    returns="i8",
)


def register(
    profiles: Sequence[Profile], rounds: int = ROUNDS, *, z_step_mm: float | None = None
) -> tuple[Profile, ...]:
    """The same profiles, every frame's pose corrected so that its points fit the shape of the pipe all frames share.

    Each round fits the pipe's shape (mean circle, centre, ovality along the pipe) to all points, then every frame's
    two shifts and two tilts to that shape with redescending weights, so that defects do not count. Points move rigidly
    with their frame. Profiles without a pose, or with too few points, come back unchanged. Raises AnnulusError when
    there is no point at all. z_step_mm : of the wall's rows, as `build_wall` has it.
    """
    current = tuple(profiles)
    for _ in range(rounds):
        stations, shape = pipe_shape(current, z_step_mm)
        radius = float(np.median(shape[:, 0]))
        before, current = current, tuple(_aligned(profile, stations, shape, radius) for profile in current)
        if all(a is b for a, b in zip(before, current, strict=True)):  # another round would find the same again
            break
    return current


def _aligned(profile: Profile, stations_mm: FloatArray, shape_mm: FloatArray, radius: float) -> Profile:
    """shape_mm (Z, 5) : the pipe's, at stations (Z,). radius : mm, its median."""
    pose = profile.pose
    if pose is None or len(profile.points_mm) < POINTS_NEEDED:
        return profile
    found, moves = np.empty(4), np.empty(1)
    points = np.ascontiguousarray(profile.points_mm, np.float32)
    room = np.empty((13, len(points) + LANES))
    known = (radius, POINTS_NEEDED, NOISE_FLOOR_MM, TUKEY, SIGMA_OF_MAD, CONDITION_MOST)
    agrees = _frame_correction(points, profile.z_mm, stations_mm, shape_mm, *known, room, found, moves)
    if not agrees or moves[0] < WORTH_MM:
        return profile
    dx, dy = found[:2]
    gx, gy = found[2:] / radius
    if max(abs(gx), abs(gy)) > ANGLE_MAX or np.hypot(dx, dy) > SHIFT_OF_RADIUS * radius:
        return profile
    # from the pipe's right and down to the head's
    turn = rotation_z(-(pose.roll or 0.0))[:2, :2]
    (dx, dy), (gx, gy) = turn @ [dx, dy], turn @ [gx, gy]
    better = Pose(pose.rx - gy, pose.ry + gx, pose.tx + dx, pose.ty + dy, pose.roll)
    moved = better.to_pipe(pose.to_camera(points.astype(np.float64), profile.z_mm), profile.z_mm)
    return replace(profile, pose=better, points_mm=moved.astype(np.float32))
