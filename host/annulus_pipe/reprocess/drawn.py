"""The frame that a machine's pace is measured with."""

import cv2
import numpy as np

from annulus_pipe.geometry.calibration import Calibration, HeadCamera
from annulus_pipe.geometry.cone import intersect_cylinder
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, Image

SLIT_HALF = 0.0035  # radians, about the real slide's
DRAWN_HALF_PX = 1.5  # a line that is thinner is drawn so wide: half of the least that `find_lines` sees all round
STEP_PX = 4  # angles are asked for that often, and are smooth between; a line need not be as wide


def drawn_frame(calibration: Calibration, of: HeadCamera | None = None) -> Image:
    """Roughly what a camera of the head (the first if none is named) sees in a clean pipe, the first in its middle:
    (H, W, 3) BGR. Good for seconds, not for millimetres. A ring that is nowhere in the picture is
    not in it; nothing is raised."""
    of = of or calibration.cameras[0]
    camera = of.camera
    v, u = np.mgrid[0 : camera.height + STEP_PX : STEP_PX, 0 : camera.width + STEP_PX : STEP_PX]
    starts, rays = camera.lines(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    turn = np.array(of.rotation)
    starts, rays = (starts - of.translation_mm) @ turn, rays @ turn
    stripe = np.zeros((camera.height, camera.width), np.intp)
    near = np.zeros(stripe.shape, bool)
    with np.errstate(all="ignore"):  # rays that meet no wall, or meet it where the light starts
        wall = intersect_cylinder(rays, np.zeros(3), np.array([0.0, 0.0, 1.0]), calibration.pipe_radius_mm, starts)
        dark = _pixels((~(rays[:, 2] > 0) & camera.central).reshape(u.shape), stripe.shape) > 0.5
        for cone in calibration.rings:
            beam = wall - np.array(cone.vertex_mm)
            angle = np.arccos(np.clip(beam @ np.array(cone.axis) / np.linalg.norm(beam, axis=1), -1.0, 1.0))
            off = (angle - cone.half_angle).reshape(u.shape)
            rad_per_px = np.hypot(*np.gradient(off)) / STEP_PX
            off, half = (_pixels(one, stripe.shape) for one in (off, np.maximum(SLIT_HALF, DRAWN_HALF_PX * rad_per_px)))
            stripe += off > 0
            near |= np.abs(off) < half
    if calibration.kind == "line":
        return np.where((near & ~dark)[..., None], np.array((8, 8, 180), np.uint8), np.uint8(4))
    paint = np.array([{"R": (8, 8, 180), "G": (8, 180, 8), "B": (180, 8, 8)}[c] for c in calibration.colours], np.uint8)
    return np.where((near | dark)[..., None], np.uint8(4), paint[stripe])


def _pixels(coarse: FloatArray | BoolArray, size: tuple[int, ...]) -> Float32Array:
    """(H, W) between values that stand STEP_PX apart, from the first pixel's centre on."""
    v, u = (np.arange(n, dtype=np.float32) / STEP_PX for n in size)
    return np.asarray(cv2.remap(coarse.astype(np.float32), *np.meshgrid(u, v), cv2.INTER_LINEAR))
