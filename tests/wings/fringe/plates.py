"""A plate of one height seen past a slide of stripes, drawn pixel by pixel through the lens's blur: no ray missed, no
code of the method used but the slide's phase."""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.wings.fringe.measure import FringeProjector

STILL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
SLIDE = FringeProjector("stripes", (20.0, 0.0, 0.0), STILL, 0.04, 0.6)
LENS = Camera("pinhole", 320, 120, 300.0, 300.0, 159.5, 59.5)
LEFT = HeadCamera(0, LENS)
RIGHT = HeadCamera(1, LENS, STILL, (-40.0, 0.0, 0.0))
DISTANCE_MM, OVER = 100.0, 3
SPECKS = gaussian_filter(np.random.default_rng(2).normal(0, 1, (128, 128)), 1.0, mode="wrap")  # one a mm


def drawn(
    moved_mm: FloatArray,
    height_mm: float = 0.0,
    *,
    noise: float = 0.0,
    texture: float = 0.0,
    specks: float = 0.0,
    blur_px: float = 0.0,
    head: HeadCamera = LEFT,
    seed: int = 1,
    slide: FringeProjector = SLIDE,
) -> Float32Array:
    """(N, H, W) grey levels, linear. moved_mm : (N,) along x. texture : share by which albedo varies, 6 mm a wave;
    specks : the same without a period."""
    camera, random = head.camera, np.random.default_rng(seed)
    fine = (np.arange(OVER) - (OVER - 1) / 2) / OVER
    u = (np.arange(camera.width)[:, None] + fine).ravel()
    v = (np.arange(camera.height)[:, None] + fine).ravel()
    depth = DISTANCE_MM - height_mm
    x = (u - camera.cx) / camera.fx * depth - head.translation_mm[0]
    y = (v - camera.cy) / camera.fy * depth
    X, Y = np.meshgrid(x, y)
    light = 1 + 0.8 * np.cos(slide.phase(np.stack([X, Y, np.full(X.shape, depth)], axis=-1)))
    images = []
    for moved in moved_mm:
        albedo = 1 + texture * np.sin((X + moved) * 1.05) * np.cos(Y * 0.9)
        if specks:
            places = np.stack([Y, X + moved]).reshape(2, -1)
            albedo += (
                specks / SPECKS.std() * map_coordinates(SPECKS, places, order=1, mode="grid-wrap").reshape(X.shape)
            )
        seen = 90 * albedo * light
        seen = gaussian_filter(seen, blur_px * OVER) if blur_px else seen
        image = seen.reshape(camera.height, OVER, camera.width, OVER).mean(axis=(1, 3))
        images.append(image + random.normal(0, noise, image.shape) if noise else image)
    return np.array(images, np.float32)
