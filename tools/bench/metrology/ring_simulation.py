"""§4.3.2's simulation: rings of Table 4.1 on a pipe, poses of Table 4.2, a pinhole camera, pixels rounded.

What the source leaves open is settled so. Light leaves in 720 directions of each ring. The image's middle is at half
its size. "Projection angle" is the full angle theta_T, as in its tables: noise of 0.325 degrees on it makes the
source's own 4.15 px, on the half angle it would make 8. The noise belongs to the projector and is the same in every
frame, as in its section on artefacts, which smooths that same noise.
"""

from dataclasses import dataclass

import numpy as np

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.calibration.bundle import Solution
from annulus_pipe.rings.calibration.observations import Observations, observe

RADIUS_MM = 76.2
DIRECTIONS = 720
NOISE_DEG = 0.325  # of the full angle
CAMERA = Camera("pinhole", 1664, 1232, 470.0, 470.0, 832.0, 616.0)
TABLE_41 = (  # full angle deg, axis x y, vertex mm
    (37.893, -0.016, 0.015, 1.106, -1.211, -56.503),
    (42.382, -0.016, 0.014, 1.283, -0.940, -56.490),
    (47.473, -0.017, 0.014, 1.436, -1.065, -55.994),
    (52.829, -0.013, 0.011, 0.785, 0.339, -54.579),
    (57.745, -0.015, 0.011, 0.986, 0.103, -54.244),
)
TABLE_42 = (  # rx, ry deg, tx, ty mm
    (11.46, 11.46, 12.7, 12.7),
    (-11.46, -11.46, -12.7, -12.7),
    (11.46, -11.46, 12.7, -12.7),
    (-11.46, 11.46, -12.7, 12.7),
    (0.0, 13.75, 0.0, 15.24),
    (0.0, -13.75, 0.0, -15.24),
    (13.75, 0.0, 15.24, 0.0),
    (-13.75, 0.0, -15.24, 0.0),
)
RINGS = tuple(
    Cone(np.radians(t / 2), (ax, ay, float(np.sqrt(1 - ax * ax - ay * ay))), (x, y, z))
    for t, ax, ay, x, y, z in TABLE_41
)
POSES = tuple(Pose(np.radians(a), np.radians(b), x, y) for a, b, x, y in TABLE_42)


@dataclass(frozen=True)
class Errors:
    angle_deg: float  # the worst ring's full angle
    vertex_mm: float  # the worst component of all vertices


def poses_within(rng: np.random.Generator, count: int, lean_deg: float, shift_mm: float) -> tuple[Pose, ...]:
    """Poses drawn evenly."""
    leans = np.radians(rng.uniform(-lean_deg, lean_deg, (count, 2)))
    shifts = rng.uniform(-shift_mm, shift_mm, (count, 2))
    return tuple(Pose(*map(float, (*a, *b))) for a, b in zip(leans, shifts, strict=True))


def noise(rng: np.random.Generator, rings: int = len(RINGS)) -> FloatArray:
    """NP1: (K, 720) rad of the half-angle."""
    return rng.normal(0.0, np.radians(NOISE_DEG / 2), (rings, DIRECTIONS))


def artefacts(rng: np.random.Generator, rings: int = len(RINGS)) -> FloatArray:
    """NP2, Eq. 4.14 with N = 10, s_n = 3."""
    raw = noise(rng, rings)
    return 0.3 * sum((np.roll(raw, -i, axis=1) for i in range(10)), np.zeros_like(raw))


def simulate(
    poses: tuple[Pose, ...],
    pattern: FloatArray | None = None,
    *,
    rings: tuple[Cone, ...] = RINGS,
    camera: Camera = CAMERA,
    radius_mm: float = RADIUS_MM,
    phase: float = 0.0,
    fresh_noise: np.random.Generator | None = None,
    rounded: bool = True,
) -> Observations:
    """What the camera sees. pattern : (K, 720) rad added to the half-angles. phase : of the directions, in steps.
    fresh_noise : adds NP1 anew in every frame."""
    frame, ring, places = [], [], []
    turn = (np.arange(DIRECTIONS) + phase) * (2 * np.pi / DIRECTIONS)
    for j, pose in enumerate(poses):
        for k, cone in enumerate(rings):
            half = np.full(DIRECTIONS, cone.half_angle) + (0.0 if pattern is None else pattern[k])
            if fresh_noise is not None:
                half = half + noise(fresh_noise, 1)[0]
            axis = np.asarray(cone.axis)
            one = np.cross(np.cross(axis, [1.0, 0.0, 0.0]), axis)
            one /= np.linalg.norm(one)
            two = np.cross(axis, one)
            across = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * two
            way = (np.cos(half)[:, None] * axis + np.sin(half)[:, None] * across) @ pose.rotation
            start = pose.to_pipe(np.array([cone.vertex_mm]))[0]
            a, b = (way[:, :2] ** 2).sum(axis=1), way[:, :2] @ start[:2]
            s = (np.sqrt(b * b - a * (start[:2] @ start[:2] - radius_mm**2)) - b) / a
            pixels = camera.project(pose.to_camera(start + s[:, None] * way))
            pixels = np.rint(pixels) if rounded else pixels
            pixels = pixels[((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)]
            frame.append(np.full(len(pixels), j))
            ring.append(np.full(len(pixels), k))
            places.append(pixels)
    centre = np.array([camera.cx, camera.cy])
    return observe(camera, np.concatenate(frame), np.concatenate(ring), np.vstack(places), centre)


def errors(solution: Solution, rings: tuple[Cone, ...] = RINGS) -> Errors:
    angle = max(abs(np.degrees(2 * (a.half_angle - b.half_angle))) for a, b in zip(solution.rings, rings, strict=True))
    vertex = max(
        float(np.abs(np.subtract(a.vertex_mm, b.vertex_mm)).max()) for a, b in zip(solution.rings, rings, strict=True)
    )
    return Errors(float(angle), vertex)
