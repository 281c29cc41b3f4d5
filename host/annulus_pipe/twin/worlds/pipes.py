"""The simulated main sensor, five rings behind a wide lens, and the pipes it is pulled through."""

import math
from dataclasses import replace

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.translucency import Translucency
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.twin.worlds.sensor_head import Projector, Response, Rod
from annulus_pipe.twin.worlds.world import World

# Full cone angles, axes and vertices of the source's simulated sensor (Alzuhiri 2022, Table 4.1): refraction in the
# glass gives every ring its own vertex.
_RINGS = (
    (37.893, -0.016, 0.015, 1.106, -1.211, -56.503),
    (42.382, -0.016, 0.014, 1.283, -0.940, -56.490),
    (47.473, -0.017, 0.014, 1.436, -1.065, -55.994),
    (52.829, -0.013, 0.011, 0.785, 0.339, -54.579),
    (57.745, -0.015, 0.011, 0.986, 0.103, -54.244),
)
_SLIT_HALF_DEG = (0.244, 0.217, 0.187, 0.158, 0.132)  # about nine pixels wide on a 6-inch wall, each


def demo_projector() -> Projector:
    """Five slits, R R G B G R, cones as in the source's Table 4.1."""
    cones = tuple(
        Cone(math.radians(theta / 2), (ax, ay, math.sqrt(1 - ax * ax - ay * ay)), (vx, vy, vz))
        for theta, ax, ay, vx, vy, vz in _RINGS
    )
    return Projector(cones, _SLIT_HALF_DEG)


def demo_rods() -> tuple[Rod, ...]:
    """Three bars on a circle of 22 mm."""
    angles = (math.radians(17 + 120 * i) for i in range(3))
    return tuple(Rod(22.0 * math.cos(a), 22.0 * math.sin(a)) for a in angles)


def pinhole_camera() -> Camera:
    """IMX219 at 1664x1232 behind a wide lens without distortion, the source's simulated camera."""
    return Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)


def fisheye_camera() -> Camera:
    """The same sensor behind a 160-degree lens (Kannala-Brandt)."""
    return Camera("fisheye", 1664, 1232, 545.0, 545.0, 835.0, 612.0, (-0.012, 0.004, -0.0015, 0.0002))


def clean_world(seed: int = 1, camera: Camera | None = None, travel_mm: float = 120.0) -> World:
    """A round, unmarked pipe."""
    return World(
        camera or pinhole_camera(), demo_projector(), rods=demo_rods(), texture=False, travel_mm=travel_mm, seed=seed
    )


# What red, green and blue pixels see of the stripes through cheap filters: the green one lets much blue by.
CONTAMINATED = ((1.0, 0.12, 0.05), (0.10, 1.0, 0.22), (0.04, 0.15, 0.80))


def painted(world: World, albedo: tuple[float, float, float], response: Response | None = None) -> World:
    """The same world in a pipe of another colour (`WHITE`, `YELLOW`, `ORANGE`), seen through other filters if given.

    The projector is as strong as before and the exposure such that the pipe's brightest channel is.
    """
    projector = world.projector
    if response is not None and isinstance(projector, Projector):
        projector = replace(projector, response=response)
    return replace(world, albedo=albedo, projector=projector)


# Of red light's way in polyethylene: pigment and additives scatter and take blue sooner.
_OF_RED = (1.0, 0.8, 0.58)


def translucent(world: World, red_mm: float = 0.56, surface_share: float = 0.25) -> World:
    """The same world with a wall that light enters. red_mm : red light's mean free path; with 0.56 the middle of red
    light moves 0.26 mm along the pipe, of blue 0.15."""
    red, green, blue = (red_mm * part for part in _OF_RED)
    return replace(world, translucency=Translucency((red, green, blue), surface_share))


def demo_world(seed: int = 7, travel_mm: float = 330.0) -> World:
    """The demo: a 6-inch white PVC pipe with two pockets, a bump and a short oval stretch.

    All of them lie where every ring passes when the head travels 330 mm or more, whatever the frame rate.
    """
    features = (
        WorldFeature("pocket", z_mm=180.0, length_mm=32.0, depth_mm=4.0, clock_deg=100.0, arc_deg=26.0),
        WorldFeature("bump", z_mm=214.0, length_mm=26.0, depth_mm=4.0, clock_deg=215.0, arc_deg=20.0),
        WorldFeature("pocket", z_mm=246.0, length_mm=12.0, depth_mm=2.0, clock_deg=330.0, arc_deg=80.0),
        WorldFeature("oval", z_mm=332.0, length_mm=84.0, depth_mm=1.5, clock_deg=20.0),
    )
    return World(
        pinhole_camera(), demo_projector(), features=features, rods=demo_rods(), travel_mm=travel_mm, seed=seed
    )
