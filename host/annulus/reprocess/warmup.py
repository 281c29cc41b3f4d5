"""The frame that methods are warmed up with."""

from typing import cast

import cv2
import numpy as np

from annulus.geometry.calibration import Calibration, HeadCamera
from annulus.geometry.cone import intersect_cylinder
from annulus.numeric.arrays import Image

SLIT_HALF = 0.0035  # radians, about the real slide's


def warmup_frame(calibration: Calibration, of: HeadCamera | None = None) -> Image:
    """Roughly what a camera of the head (the first if none is named) sees in a clean pipe, the first in its middle:
    (H, W, 3) BGR. Good for warming up only."""
    of = of or calibration.cameras[0]
    camera, step = of.camera, 4
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step]
    starts, rays = camera.lines(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    turn = np.array(of.rotation)
    starts, rays = (starts - of.translation_mm) @ turn, rays @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        axis = np.array([0.0, 0.0, 1.0])
        wall = intersect_cylinder(rays, np.zeros(3), axis, calibration.pipe_radius_mm, starts)
        near = np.zeros(len(rays), bool)
        stripe, dark = np.zeros(len(rays), np.intp), ~(rays[:, 2] > 0) & camera.central
        for cone in calibration.rings:
            beam = wall - np.array(cone.vertex_mm)
            angle = np.arccos(np.clip(beam @ np.array(cone.axis) / np.linalg.norm(beam, axis=1), -1.0, 1.0))
            stripe += angle > cone.half_angle
            near |= np.abs(angle - cone.half_angle) < SLIT_HALF
    if calibration.kind == "line":
        lit = np.where((near & ~dark)[:, None], np.array((8, 8, 180), np.uint8), np.uint8(4))
        picture = lit.reshape(*u.shape, 3)
        return cast(Image, cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR))
    dark |= near
    paint = np.array([{"R": (8, 8, 180), "G": (8, 180, 8), "B": (180, 8, 8)}[c] for c in calibration.colours], np.uint8)
    picture = np.where(dark[:, None], np.uint8(4), paint[stripe]).reshape(*u.shape, 3)
    return cast(Image, cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR))
