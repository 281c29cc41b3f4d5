"""The small sensor that sees a 2 to 4 inch pipe in a ball, and the pipes it is pulled through."""

import math

import numpy as np

from annulus_pipe.geometry.camera import Camera, Mirror
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.twin.worlds.sensor_head import Led, Projector, Rod
from annulus_pipe.twin.worlds.world import World

# The small sensor of §3.6 (Fig. 3.13: projector, mirror, camera in a row): seven slits of the nine that three colours
# in pairs allow, 25 mm behind the ball, whose shadow the innermost ring clears.
_SMALL_COLOURS = "RRGBBRBG"
_SMALL_RIMS_DEG = (31.0, 50.0)  # half-angles of the innermost and outermost slit
_SMALL_SLIT_PX = 7.5


def mirror_camera() -> Camera:
    """A narrow lens 45 mm from a ball 20 mm across, which fills nine tenths of the image's height."""
    ball = Mirror((0.25, -0.15, 45.0), 10.0)
    return Camera("mirror", 1664, 1232, 2450.0, 2450.0, 829.0, 618.0, (-0.04, 0.01, 0.0, 0.0), ball)


def mirror_projector() -> Projector:
    """Slits that stand at even distances, and are equally wide, in the mirror's image of a 3-inch pipe."""
    camera, wall_mm, behind_mm = mirror_camera(), 38.1, 25.0
    half = np.radians(np.linspace(_SMALL_RIMS_DEG[0] - 3, _SMALL_RIMS_DEG[1] + 3, 600))
    wall = np.stack([np.full_like(half, wall_mm), 0 * half, wall_mm / np.tan(half) - behind_mm], axis=1)
    away = np.abs(camera.project(wall)[:, 0] - camera.project(np.array([[0.0, 0.0, 30.0]]))[0, 0])
    first, last = np.interp(np.radians(_SMALL_RIMS_DEG), half, away)
    slits = np.linspace(first, last, len(_SMALL_COLOURS) - 1)
    angles = np.interp(slits, away, half)
    halves = np.interp(slits + _SMALL_SLIT_PX / 2, away, half) - angles
    cones = tuple(  # glass moves each ring's vertex by its own amount, less the wider it is
        Cone(
            float(t),
            (-0.008, 0.006, math.sqrt(1 - 1e-4)),
            (0.35 - 0.1 * i, -0.3 + 0.08 * i, -behind_mm - 0.6 + 0.2 * i),
        )
        for i, t in enumerate(angles)
    )
    return Projector(cones, tuple(float(h) for h in np.degrees(halves)), _SMALL_COLOURS, peak=180.0)


def mirror_world(seed: int = 5, radius_mm: float = 38.1, travel_mm: float = 160.0) -> World:
    """The small sensor in a 3-inch pipe (or another, of 2 to 4 inches) with a pocket, a bump and a groove."""
    features = (
        WorldFeature("pocket", z_mm=80.0, length_mm=16.0, depth_mm=2.0, clock_deg=100.0, arc_deg=40.0),
        WorldFeature("bump", z_mm=112.0, length_mm=12.0, depth_mm=2.0, clock_deg=215.0, arc_deg=18.0),
        WorldFeature("groove", z_mm=144.0, length_mm=8.0, depth_mm=1.0),
    )
    return World(
        mirror_camera(),
        mirror_projector(),
        radius_mm,
        features,
        (Rod(-9.0, -12.0, 0.6, -25.0, 45.0),),
        7.0,
        Led(behind_mm=25.0, peak=40.0),
        wobble_deg=1.0,
        wobble_mm=0.02 * radius_mm,
        travel_mm=travel_mm,
        seed=seed,
    )
