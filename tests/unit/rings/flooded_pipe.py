"""Profiles of a round pipe with water or silt in it, as triangulated without knowing of it.

Light is followed forwards: out of the projector, through the surface, to what lies there; and back up to the camera by
where the surface lets it through. Nothing here inverts anything, unlike the code under test.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from synthetic_pipe import CALIBRATION, NOISE_MM, RADIUS_MM, turn

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.cone import Cone, intersect_cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import WALL_TOLERANCE
from annulus_pipe.wall.pose import fit_pose
from annulus_pipe.wall.profile import Profile

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (x, z) mm, pipe frame turned upright -> y of the surface
Shape = Callable[[np.ndarray], np.ndarray]  # clock degrees -> radius of the wall, mm


def still(height_mm: float) -> Surface:
    return lambda x, z: np.full(np.broadcast(x, z).shape, height_mm)


def scan(
    surface: Surface,
    *,
    index: float | None = None,
    frames: int = 20,
    every_mm: float = 4.0,
    roll_deg: float = 0.0,
    told_roll: bool = False,
    rods_deg: Sequence[float] = (107.0, 227.0, 347.0),
    noise: float = 1.0,
    bias_mm: float = 0.02,
    wall: Shape | None = None,
    calibration: Calibration = CALIBRATION,
    directions: int = 360,
    seed: int = 3,
    unseen: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> list[Profile]:
    """Frames of a wandering head, posed by `fit_pose` as real ones are.

    index : refractive index of what is clear; None where it is opaque. roll_deg : how far the head is turned, which a
    sensor told or not. bias_mm : of each ring in each frame. unseen : (x, z) of points on the surface nobody sees.
    """
    rng = np.random.default_rng(seed)
    out = []
    for i in range(frames):
        z0 = every_mm * i
        a, b = rng.normal(0, 0.015, 2)
        true = Pose(float(a), float(b), *(float(v) for v in rng.normal(0, 1.0, 2)), math.radians(roll_deg))
        clock = (np.arange(directions) + 0.5) * 360.0 / directions
        clock = clock[np.all([np.abs(turn(clock, rod)) > 4.0 for rod in rods_deg], axis=0)] if rods_deg else clock
        points, ring = [], []
        for k, cone in enumerate(calibration.rings):
            seen = _apparent(cone, true, clock, surface, index, wall, z0, unseen)
            push = rng.normal(0, noise * NOISE_MM[k], len(seen)) + rng.normal(0, bias_mm)
            upright = true.to_pipe(seen)
            far = np.hypot(*upright[:, :2].T)
            upright = (upright * np.where([1, 1, 0], (1 + push / far)[:, None], 1.0))[
                far > (1 - WALL_TOLERANCE) * RADIUS_MM
            ]
            points.append(true.to_camera(upright))
            ring.append(np.full(len(upright), k))
        stacked, number = np.concatenate(points), np.concatenate(ring)
        sigma = np.hypot(np.array(NOISE_MM[: len(calibration.rings)])[number] * noise, bias_mm)
        fit = fit_pose(stacked, calibration.pipe_radius_mm, sigma, None, len(calibration.rings) == 1)
        blank = np.zeros((len(stacked), 3), np.uint8)
        if fit is None:
            nothing = np.zeros(0, np.uint8)
            out.append(
                Profile(i, z0, None, np.zeros((0, 3), np.float32), blank[:0], nothing, nothing.astype(np.uint16))
            )
            continue
        found = fit.pose
        pose = Pose(found.rx, found.ry, found.tx, found.ty, math.radians(roll_deg) if told_roll else None)
        out.append(
            Profile(
                i,
                z0,
                pose,
                pose.to_pipe(stacked, z0).astype(np.float32),
                blank,
                number.astype(np.uint8),
                np.zeros(len(stacked), np.uint16),
                fit.robust_sigma_mm,
                sigma_mm=sigma.astype(np.float32),
                lean_sigma_deg=fit.lean_sigma_deg,
            )
        )
    return out


def _apparent(
    cone: Cone,
    pose: Pose,
    clock: np.ndarray,
    surface: Surface,
    index: float | None,
    wall: Shape | None,
    z0: float,
    unseen: Callable[[np.ndarray, np.ndarray], np.ndarray] | None,
) -> np.ndarray:
    """(N, 3) camera frame: where camera rays to what one ring lights meet that ring's cone."""
    axis = np.asarray(cone.axis)
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    t = np.radians(clock)[:, None]
    ways = math.cos(cone.half_angle) * axis + math.sin(cone.half_angle) * (
        np.sin(t) * across - np.cos(t) * np.cross(axis, across)
    )
    ways = ways @ pose.rotation
    lamp = np.broadcast_to(pose.to_pipe(np.array(cone.vertex_mm)[None]), ways.shape)
    dry = _ahead(lamp, ways, wall)
    top = _ahead(lamp, ways, None, surface, z0)
    above = ~(_nearer(lamp, top, dry))
    lit = np.where(above[:, None], dry, top)
    eye = pose.to_pipe(np.zeros((1, 3)))[0]
    target = lit.copy()
    if index is not None and not above.all():
        wet = ~above
        below = ways[wet].copy()
        below[:, [0, 2]] /= index
        below[:, 1] = np.sqrt(1 - below[:, 0] ** 2 - below[:, 2] ** 2)
        bottom = _ahead(top[wet], below, wall)
        target[wet] = _window(eye, bottom, surface(bottom[:, 0], bottom[:, 2] + z0), index)
    kept = np.isfinite(target).all(axis=1)
    if unseen is not None:
        kept &= above | ~unseen(lit[:, 0], lit[:, 2] + z0)
    rays = (target - eye)[kept] @ pose.rotation.T
    seen, _ = intersect_cone(rays / np.linalg.norm(rays, axis=1)[:, None], cone)
    return seen[np.isfinite(seen).all(axis=1)]


def _ahead(
    start: np.ndarray, ways: np.ndarray, wall: Shape | None, surface: Surface | None = None, z0: float = 0.0
) -> np.ndarray:
    """Where rays leave the wall, or go through the surface: bisected between inside and outside."""
    low, high = np.zeros(len(ways)), np.full(len(ways), 1500.0)
    for _ in range(45):
        s = 0.5 * (low + high)
        x, y, z = (start + s[:, None] * ways).T
        if surface is not None:
            inside = y < surface(x, z + z0)
        else:
            inside = np.hypot(x, y) < (RADIUS_MM if wall is None else wall(np.degrees(np.arctan2(x, -y))))
        low, high = np.where(inside, s, low), np.where(inside, high, s)
    return np.where((high < 1500.0)[:, None], start + low[:, None] * ways, np.inf)


def _nearer(start: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(one - start, axis=1) < np.linalg.norm(other - start, axis=1)


def _window(eye: np.ndarray, bottom: np.ndarray, height: np.ndarray, index: float) -> np.ndarray:
    """Where light from the bottom leaves a flat surface on its way to the eye: Fermat's shortest time."""
    across = bottom - eye
    far = np.hypot(across[:, 0], across[:, 2])
    up, down = height - eye[1], bottom[:, 1] - height
    low, high = np.zeros(len(bottom)), np.ones(len(bottom))
    for _ in range(45):
        part = 0.5 * (low + high)
        slope = part * far / np.hypot(part * far, up) - index * (1 - part) * far / np.hypot((1 - part) * far, down)
        low, high = np.where(slope < 0, part, low), np.where(slope < 0, high, part)
    out = eye + across * low[:, None]
    out[:, 1] = height
    return out
