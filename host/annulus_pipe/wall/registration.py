"""Frames aligned with each other on the wall they share.

A frame's own pose comes from its own rings, and where one of them lies in a groove or on an oval stretch it leans a
little. Frames overlap many times over, so the wall that most of them agree on shows who leans.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from annulus_pipe.geometry.pose import Pose, rotation_z
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.robust import TUKEY, biweight, robust_sigma
from annulus_pipe.wall.grid import NOISE_FLOOR_MM, Wall, build_wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.shape import harmonics

# POINTS_NEEDED, ANGLE_MAX and WORTH_MM are guarded by test_registration.py one way each. ROUNDS and SHIFT_OF_RADIUS:
# unguarded; what all of it gains shows in the benchmark topic diameter (clouds before and after).
ROUNDS = 2
POINTS_NEEDED = 200  # points in a frame, for the four numbers of its correction
ANGLE_MAX = 0.03  # radians; a frame that wants more is wrong in another way and is left alone ..
WORTH_MM = 0.04  # what a correction must do to most of a frame's points; less is noise of the fit
SHIFT_OF_RADIUS = 0.05  # of the radius; .. and so is one that wants a longer shift than this


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
        wall = build_wall(current, z_step_mm=z_step_mm)
        current = tuple(_aligned(profile, wall) for profile in current)
    return current


def _aligned(profile: Profile, wall: Wall) -> Profile:
    pose = profile.pose
    if pose is None or len(profile.points_mm) < POINTS_NEEDED:
        return profile
    points = profile.points_mm.astype(np.float64)
    x, y, z = points.T
    radius = np.hypot(x, y)
    clock = np.degrees(np.arctan2(x, -y))
    covered = (z >= wall.z_mm[0]) & (z <= wall.z_mm[-1])
    shape = np.stack([np.interp(z, wall.z_mm, column) for column in wall.shape_mm.T], axis=1)
    excess = radius - (shape * harmonics(clock)).sum(axis=1)
    if covered.sum() < POINTS_NEEDED:
        return profile
    direction = np.stack([x, y], axis=1) / radius[:, None]
    ahead = (z - profile.z_mm)[:, None] / wall.mean_radius_mm  # in radii: one scale for shifts and tilts
    design = np.concatenate([direction, direction * ahead], axis=1)[covered]
    found = _biweight(design, excess[covered])
    if found is None or np.percentile(np.abs(design @ found), 90) < WORTH_MM:
        return profile
    dx, dy = found[:2]
    gx, gy = found[2:] / wall.mean_radius_mm
    if max(abs(gx), abs(gy)) > ANGLE_MAX or np.hypot(dx, dy) > SHIFT_OF_RADIUS * wall.mean_radius_mm:
        return profile
    # from the pipe's right and down to the head's
    turn = rotation_z(-(pose.roll or 0.0))[:2, :2]
    (dx, dy), (gx, gy) = turn @ [dx, dy], turn @ [gx, gy]
    better = Pose(pose.rx - gy, pose.ry + gx, pose.tx + dx, pose.ty + dy, pose.roll)
    moved = better.to_pipe(pose.to_camera(points, profile.z_mm), profile.z_mm)
    return replace(profile, pose=better, points_mm=moved.astype(np.float32))


def _biweight(design: FloatArray, value: FloatArray) -> FloatArray | None:
    """Tukey's biweight regression; None when fewer than half of the points agree with what it finds."""
    fit: FloatArray = np.zeros(design.shape[1])
    for _ in range(8):
        residual = value - design @ fit
        scale = max(robust_sigma(residual), NOISE_FLOOR_MM)
        weight = biweight(residual / (TUKEY * scale))
        weighted = design * weight[:, None]
        normal = weighted.T @ design
        if np.linalg.cond(normal) > 1e6:
            return None
        fit = np.asarray(np.linalg.solve(normal, weighted.T @ value))
    return fit if (weight > 0).mean() >= 0.5 else None
