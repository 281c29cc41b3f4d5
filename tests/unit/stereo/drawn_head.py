"""A head with two cameras beside its projector, and what they see in a pipe: drawn ray by ray, apart from the twin."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration, HeadCamera
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone, intersect_cylinder
from annulus_pipe.geometry.pose import Pose, rotation_y, rotation_z

RADIUS_MM = 76.2
THETA_FULL_DEG = (56.458, 63.551, 70.996, 77.069, 84.677, 92.011, 99.069)
SLIT_HALF, MARGIN = math.radians(0.75), math.radians(4.5)
COLOURS = "RRGBGRBB"
# no two in a row or column: an edge along the pixels is as smooth as any
ROOKS = [((2 * i + 1) / 10 - 0.5, (2 * (3 * i % 5) + 1) / 10 - 0.5) for i in range(5)]


def head(scale: float = 0.5) -> Calibration:
    """Near the source's tables 5.2 to 5.4, at a part of the full size."""
    width, height = round(1664 * scale), round(1232 * scale)

    def lens(f: float, cx: float, cy: float) -> Camera:
        return Camera("fisheye", width, height, f * scale, f * scale, cx * scale, cy * scale, (-0.012, 0.003, 0.0, 0.0))

    turn = rotation_z(math.radians(-88.2)) @ rotation_y(math.radians(0.9))
    centre = np.array([-16.2, -15.2, 1.4])
    ax, ay = 0.0363, 0.0028
    axis = (ax, ay, math.sqrt(1 - ax * ax - ay * ay))
    cones = tuple(Cone(math.radians(t / 2), axis, (-17.15, -0.16, -1.99)) for t in THETA_FULL_DEG)
    rows = tuple(tuple(float(v) for v in row) for row in turn)
    moved = tuple(float(v) for v in -turn @ centre)
    other = HeadCamera(1, lens(561.5, 834.8, 613.1), rows, moved)  # type: ignore[arg-type]
    return Calibration(lens(556.0, 829.4, 618.2), COLOURS, cones, RADIUS_MM, others=(other,))


def draw(calibration: Calibration, of: HeadCamera, pose: Pose, noise: float = 1.5, seed: int = 0) -> NDArray[np.uint8]:
    """(H, W, 3) BGR of a clean pipe."""
    camera, turn = of.camera, np.array(of.rotation)
    centre = -turn.T @ np.array(of.translation_mm)
    cones = calibration.rings
    thetas = np.array([cone.half_angle for cone in cones])
    axis, vertex = np.array(cones[0].axis), np.array(cones[0].vertex_mm)
    names = np.array(["BGR".index(c) for c in calibration.colours])
    total = np.zeros((camera.height * camera.width, 3), np.float32)
    y, x = (part.ravel().astype(float) for part in np.mgrid[0 : camera.height, 0 : camera.width])
    for dx, dy in ROOKS:
        rays = camera.rays(np.stack([x + dx, y + dy], axis=1)) @ turn
        with np.errstate(invalid="ignore"):
            wall = intersect_cylinder(rays, pose.translation, pose.rotation[:, 2], RADIUS_MM, centre)
            beam = wall - vertex
            theta = np.arctan2(np.linalg.norm(np.cross(beam, axis), axis=1), beam @ axis)
        lit = (theta > thetas[0] - MARGIN) & (theta < thetas[-1] + MARGIN)
        lit &= (np.abs(theta[:, None] - thetas) > SLIT_HALF).all(axis=1)
        at = np.flatnonzero(lit)
        total[at, names[np.searchsorted(thetas, theta[at])]] += 180.0 / len(ROOKS)
    image = cv2.GaussianBlur(total.reshape(camera.height, camera.width, 3), (0, 0), 1.1)
    grain = np.random.default_rng(seed).normal(0.0, noise, image.shape) if noise else 0.0
    return np.clip(image + 3.0 + grain, 0, 255).astype(np.uint8)
