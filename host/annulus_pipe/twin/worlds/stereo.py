"""The short, rigid head of chapter 5: a projector between two fisheye cameras at right angles around it. Nothing holds
them together in sight, no glass and no rod, so all directions are lit and seen.
"""

import math

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera, Matrix, Vector
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import rotation_x, rotation_y, rotation_z
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.twin.worlds.sensor_head import CameraOptics, Led, Projector
from annulus_pipe.twin.worlds.world import World

# Vertex (mm), full angle (deg), axis x, y of the seven cones in the first camera's frame (Alzuhiri 2022, Table 5.2).
_RINGS = (
    (-16.7285, -0.1566, -1.7120, 56.458, 0.0265, 0.0021),
    (-16.8924, -0.1934, -1.9813, 63.551, 0.0307, 0.0026),
    (-17.3053, -0.2878, -1.3781, 70.996, 0.0359, 0.0044),
    (-16.7792, -0.0816, -2.9095, 77.069, 0.0342, 0.0021),
    (-17.3869, -0.1896, -2.0114, 84.677, 0.0406, 0.0040),
    (-17.5744, -0.1553, -1.7845, 92.011, 0.0437, 0.0039),
    (-17.5291, -0.0003, -2.1345, 99.069, 0.0447, 0.0024),
)
_SECOND_MM = (-16.2253, -15.2014, 1.4238)  # where the second camera is (Table 5.4) ..
_SECOND_DEG = (0.0752, 0.8771, 88.1706)  # .. and how it is turned about x, y, z
_SLIT_HALF_DEG = 0.64  # about twelve pixels on the wall
_HALF_FIELD_DEG = 85.0


def _second_camera() -> HeadCamera:
    about_x, about_y, about_z = (math.radians(a) for a in _SECOND_DEG)
    turn = (rotation_z(about_z) @ rotation_y(about_y) @ rotation_x(about_x)).T
    moved = -turn @ np.array(_SECOND_MM)
    camera = Camera("fisheye", 1664, 1232, 561.5, 561.5, 834.8, 613.1, (-0.010, 0.0024, -0.0006, 0.0))
    rows: Matrix = tuple(tuple(float(v) for v in row) for row in turn)  # type: ignore[assignment]
    place: Vector = tuple(float(v) for v in moved)  # type: ignore[assignment]
    return HeadCamera(1, camera, rows, place)


def stereo_projector() -> Projector:
    """Seven slits, R R G B G R B B."""
    cones = tuple(
        Cone(math.radians(theta / 2), (ax, ay, math.sqrt(1 - ax * ax - ay * ay)), (vx, vy, vz))
        for vx, vy, vz, theta, ax, ay in _RINGS
    )
    return Projector(cones, (_SLIT_HALF_DEG,) * len(cones), "RRGBGRBB", margin_deg=(4.5, 4.5))


def stereo_world(seed: int = 9, radius_mm: float = 76.2, travel_mm: float = 200.0) -> World:
    """In a 6-inch pipe, or another: pockets and bumps on the seams, where both cameras see a ring equally well, and
    where one of them does. Their places and sizes go with the pipe's radius.
    """
    k = radius_mm / 76.2
    features = (
        WorldFeature("pocket", z_mm=k * 170.0, length_mm=k * 28.0, depth_mm=k * 4.0, clock_deg=135.0, arc_deg=20.0),
        WorldFeature("bump", z_mm=k * 205.0, length_mm=k * 28.0, depth_mm=k * 4.0, clock_deg=315.0),
        WorldFeature("pocket", z_mm=k * 235.0, length_mm=k * 24.0, depth_mm=k * 2.5, clock_deg=270.0, arc_deg=14.0),
        WorldFeature("bump", z_mm=k * 250.0, length_mm=k * 24.0, depth_mm=k * 3.0, clock_deg=0.0),
    )
    first = Camera("fisheye", 1664, 1232, 556.0, 556.0, 829.4, 618.2, (-0.012, 0.0031, -0.0008, 0.0))
    second = _second_camera()
    middle = (_SECOND_MM[0] / 2, _SECOND_MM[1] / 2)
    return World(
        first,
        stereo_projector(),
        radius_mm,
        features,
        led=Led(peak=150.0 * k, aside_mm=middle),
        wobble_deg=1.0,
        wobble_mm=0.02 * radius_mm,
        optics=CameraOptics(half_field_deg=_HALF_FIELD_DEG),
        travel_mm=travel_mm,
        seed=seed,
        others=(second,),
        centre_mm=middle,
    )
