"""Heads of bright rings and planes in the twin: one colour, dark between."""

import math

import cv2
import numpy as np

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.twin.worlds.pipes import demo_rods, pinhole_camera
from annulus_pipe.twin.worlds.sensor_head import Projector

RED = (1.0, 0.06, 0.03)
AXIS = (math.sin(math.radians(0.6)), 0.0, math.cos(math.radians(0.6)))


def head(
    *cones: tuple[float, float], features: tuple[WorldFeature, ...] = (), rods: bool = True, seed: int = 3
) -> World:
    """cones : full angle in degrees and the vertex' place along the camera's axis, mm, from the innermost outwards."""
    rings = tuple(Cone(math.radians(full / 2), AXIS, (0.8, -0.5, z)) for full, z in cones)
    lit = Projector(rings, (0.25,) * len(rings), "R" * (len(rings) + 1), line=RED)
    rod = demo_rods() if rods else ()
    world = World(pinhole_camera(), lit, features=features, rods=rod, travel_mm=100.0, texture=False, seed=seed)
    return world.scaled(832)


ONE_RING = ((60.0, -56.0),)
TWO_RINGS = ((52.0, -56.0), (66.0, -54.0))
PLANE = ((180.0, 75.0),)


def picture(world: World, z_mm: float, seed: int = 1) -> np.ndarray:
    """(H, W, 3) BGR as the camera gives it."""
    return np.asarray(to_bgr(Renderer(world).render(world.pose(z_mm), z_mm, 1.0, seed=seed), "bayer_rggb8"))


def with_reflection(image: np.ndarray, part: float, times: float) -> np.ndarray:
    """The image, and itself `times` as large and `part` as bright in its lower right quarter."""
    height, width = image.shape[:2]
    larger = cv2.warpAffine(
        image, np.float32([[times, 0, (1 - times) * width / 2], [0, times, (1 - times) * height / 2]]), (width, height)
    )
    add = (part * larger).astype(np.float32)
    add[: height // 2], add[:, : width // 2] = 0, 0
    return np.clip(image + add, 0, 255).astype(np.uint8)
