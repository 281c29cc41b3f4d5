"""Scans of heads whose optics have drifted, drawn point by point: no pictures, so a head costs a tenth of a second."""

import math

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone, intersect_cylinder
from annulus_pipe.geometry.drift import Drift, drifted, seen_with
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wall.pose import fit_pose
from annulus_pipe.wall.profile import Profile

RADIUS = 76.2
ANGLES = (37.9, 42.4, 47.5, 52.8, 57.7)
DIRECTIONS = 180
PX_MM = 0.35  # of the radius a pixel moves it by, roughly


def head(colours: str = "RRGBGR", camera: Camera | None = None, tube_mm: float = 56.0) -> Calibration:
    axis = (-0.016, 0.015, math.sqrt(1 - 0.016**2 - 0.015**2))
    rings = tuple(Cone(math.radians(angle / 2), axis, (1.1, -1.0, -tube_mm)) for angle in ANGLES)
    return Calibration(camera or Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5), colours, rings, RADIUS)


def scan(
    calibration: Calibration,
    drift: Drift,
    radius_mm: float,
    rng: np.random.Generator,
    frames: int = 40,
    step_mm: float = 4.0,
    noise_mm: float = 0.02,
    edges_px: float = 0.01,
    end: Drift | None = None,
) -> list[Profile]:
    """As the head measures it that knows nothing of its drift. end : at the last frame, evenly from the first one's.
    edges_px : each ring's own offset, the same in all frames, standard deviation."""
    rings = len(calibration.rings)
    edges = edges_px * PX_MM * rng.normal(size=rings)
    out = []
    for number in range(frames):
        part = number / max(frames - 1, 1)
        now = drift if end is None else Drift.of((1 - part) * drift.values + part * end.values)
        true = drifted(calibration, now)
        turn, shift = np.radians(rng.normal(0.0, 0.8, 2)), rng.normal(0.0, 1.2, 2)
        pose = Pose(*turn.tolist(), *shift.tolist())
        points, ring = _lit(true, pose, radius_mm)
        away = points / np.hypot(points[:, 0], points[:, 1])[:, None]
        away[:, 2] = 0.0
        seen = seen_with(points, ring, true, calibration)
        seen += (noise_mm * rng.normal(size=len(seen)) + edges[ring])[:, None] * away
        sigma = np.full(len(seen), math.hypot(noise_mm, edges_px * PX_MM))
        fit = fit_pose(seen, calibration.pipe_radius_mm, sigma)
        assert fit is not None
        z = number * step_mm
        common = np.tile([edges_px * PX_MM, 0.0115 * PX_MM], (rings, 1)).astype(np.float32)
        out.append(
            Profile(
                number,
                z,
                fit.pose,
                fit.pose.to_pipe(seen, z).astype(np.float32),
                np.zeros((len(seen), 3), np.uint8),
                ring.astype(np.uint8),
                np.tile(np.arange(DIRECTIONS), rings).astype(np.uint16),
                fit.robust_sigma_mm,
                sigma_mm=sigma.astype(np.float32),
                lean_sigma_deg=fit.lean_sigma_deg,
                ring_sigma_mm=common,
            )
        )
    return out


def _lit(calibration: Calibration, pose: Pose, radius_mm: float) -> tuple[FloatArray, FloatArray]:
    """Points of all rings on the wall, camera frame, and each one's ring."""
    turn = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    points, ring = [], []
    for k, cone in enumerate(calibration.rings):
        axis = np.array(cone.axis)
        first = np.cross(axis, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        aside = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(axis, first)
        rays = math.cos(cone.half_angle) * axis + math.sin(cone.half_angle) * aside
        origin = np.array(cone.vertex_mm)
        points.append(intersect_cylinder(rays, pose.translation, pose.rotation[:, 2], radius_mm, origin))
        ring.append(np.full(DIRECTIONS, k))
    return np.concatenate(points), np.concatenate(ring)


def radius_of(profiles: list[Profile]) -> float:
    return float(np.median(np.concatenate([np.hypot(*one.points_mm[:, :2].T) for one in profiles])))
