"""Heads that project a static sinusoid in a pipe (Alzuhiri 2022, §6.8.2): camera and slide in series, pairs of cameras
about the pipe with a slide each, and cameras about the pipe under one slide that a mirror sends back.
"""

import math
from dataclasses import replace

import numpy as np

from annulus_pipe.geometry.calibration import STILL, HeadCamera, Matrix, matrix_of, vector_of
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.twin.worlds.sensor_head import CameraOptics, Led, Rod
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.wings.fringe.light import Fringe, Fringes
from annulus_pipe.wings.fringe.measure import FringeProjector

_PERIOD_MM = 8.0  # on the wall
_WIRES = (Rod(16.0, 9.0, 0.4), Rod(-16.0, -9.0, 0.4))  # that feed the projector of Model A, along its glass
_MODULES = 4  # of Model B, and cameras of Model C
_SIDE = Camera("fisheye", 640, 480, 280.0, 280.0, 319.5, 239.5, (-0.01, 0.003, -0.0006, 0.0))
_BASELINE_MM = 40.0  # of a pair, along the pipe
_MIRRORED_MM = 95.0  # ahead of the cameras, where the mirror shows the light of Model C
_PROJECTS_FROM_MM = 20.0  # ahead of the cameras, and ..
_BALL_MM = 15.0  # .. the radius of the ball that it looks at
_NARROW_MM = 66.0  # period of its slide's rings: the ball makes 8 mm of it on the wall
_QUIET = CameraOptics(blur_px=0.9, read=0.8, shot=0.01)


def series_world(seed: int = 3, radius_mm: float = 101.6, travel_mm: float = 60.0) -> World:
    """Model A: a fisheye, and behind it a slide of rings whose phase is linear along an 8-inch pipe."""
    slide = FringeProjector(
        "rings", (0.4, -0.3, -60.0), _turned(0.15, -0.1), _PERIOD_MM, 0.4, nominal_radius_mm=radius_mm
    )
    light = Fringes((Fringe(slide, (22.0, 38.0)),), reach_mm=radius_mm / math.sin(math.radians(38.0)) ** 1.5)
    camera = Camera("fisheye", 1104, 1104, 545.0, 545.0, 552.0, 549.0, (-0.012, 0.004, -0.0015, 0.0002))
    return World(
        camera,
        light,
        radius_mm,
        _features(1.5 * radius_mm, radius_mm),
        rods=_WIRES,
        optics=_QUIET,
        led=Led(peak=120.0),
        wobble_deg=0.5,
        wobble_mm=0.8,
        travel_mm=travel_mm,
        seed=seed,
    )


def modules_world(seed: int = 4, radius_mm: float = 76.2, travel_mm: float = 84.0) -> World:
    """Model B: four pairs of cameras look at a 6-inch wall across the pipe, each pair about a slide of stripes of its
    own. The lamp cycle lights one slide after the other, so that neighbours never mix."""
    out_mm = 0.29 * radius_mm
    cameras: list[HeadCamera] = []
    slides = []
    for k in range(_MODULES):
        along, round_, outwards = _axes(2 * math.pi * k / _MODULES)
        middle = out_mm * outwards
        for end in (-0.5, 0.5):
            cameras.append(_camera(len(cameras), middle + end * _BASELINE_MM * along, round_, along, outwards))
        slide = FringeProjector(
            "stripes",
            vector_of(middle),
            matrix_of(np.stack([along, -round_, outwards])),
            _PERIOD_MM / (radius_mm - out_mm),
            0.3 * k,
        )
        slides.append(Fringe(slide, (42.0, 61.0), (2 * k, 2 * k + 1), (k,)))
    return _around(cameras, Fringes(tuple(slides), radius_mm - out_mm), radius_mm, travel_mm, seed)


def mirror_fringe_world(seed: int = 5, radius_mm: float = 76.2, travel_mm: float = 40.0) -> World:
    """Model C: four cameras look at the wall across the pipe; one slide of rings, whose light a mirror ahead sends back
    at it, lights all they see. The mirror is taken as flat: the light comes from one point behind it."""
    cameras: list[HeadCamera] = []
    for k in range(_MODULES):
        along, round_, outwards = _axes(2 * math.pi * (k + 0.5) / _MODULES)
        cameras.append(_camera(k, 0.2 * radius_mm * outwards, round_, along, outwards))
    back: Matrix = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    slide = FringeProjector("rings", (0.5, 0.3, _MIRRORED_MM), back, _PERIOD_MM, 0.2, nominal_radius_mm=radius_mm)
    light = Fringes((Fringe(slide, (29.0, 56.0)),), radius_mm / math.sin(math.radians(50.0)) ** 1.5, peak=150.0)
    return _around(cameras, light, radius_mm, travel_mm, seed)


def ball_fringe_world(seed: int = 6, radius_mm: float = 76.2, travel_mm: float = 40.0) -> World:
    """Model C as the source draws it (Figure 6.15 b): a narrow projector among the cameras looks ahead, and a ball
    sends its light back at the wall. Its rays have no one centre."""
    flat = mirror_fringe_world(seed, radius_mm, travel_mm)
    assert isinstance(flat.projector, Fringes)
    ball = (0.2, -0.3, _MIRRORED_MM + _BALL_MM - _PROJECTS_FROM_MM, _BALL_MM)
    slide = FringeProjector(
        "rings", (0.4, 0.3, _PROJECTS_FROM_MM), STILL, _NARROW_MM, 0.2, nominal_radius_mm=radius_mm, mirror_mm=ball
    )
    light = Fringes((Fringe(slide, (1.6, 6.5)),), flat.projector.reach_mm, peak=flat.projector.peak)
    return replace(flat, projector=light)


def _around(cameras: list[HeadCamera], light: Fringes, radius_mm: float, travel_mm: float, seed: int) -> World:
    first, *others = cameras
    return World(
        first.camera,
        light,
        radius_mm,
        _features(0.5 * travel_mm, radius_mm),
        optics=_QUIET,
        led=Led(behind_mm=0.0, peak=100.0),
        wobble_deg=0.4,
        wobble_mm=0.5,
        travel_mm=travel_mm,
        seed=seed,
        others=tuple(others),
        mounted=(first.rotation, first.translation_mm),
    )


def _features(middle_mm: float, radius_mm: float) -> tuple[WorldFeature, ...]:
    """A pocket, a bump, and scratches along and round the pipe."""
    along_deg = math.degrees(2.0 / radius_mm)
    return (
        WorldFeature("pocket", z_mm=middle_mm - 6.0, length_mm=14.0, depth_mm=1.5, clock_deg=80.0, arc_deg=14.0),
        WorldFeature("bump", z_mm=middle_mm + 4.0, length_mm=22.0, depth_mm=1.5, clock_deg=215.0),
        WorldFeature("pocket", z_mm=middle_mm, length_mm=22.0, depth_mm=0.6, clock_deg=310.0, arc_deg=along_deg),
        WorldFeature("pocket", z_mm=middle_mm + 8.0, length_mm=4.0, depth_mm=0.6, clock_deg=150.0, arc_deg=24.0),
    )


def _axes(angle: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Along the pipe, round it and outwards, at an angle from x towards y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([0.0, 0.0, 1.0]), np.array([-s, c, 0.0]), np.array([c, s, 0.0])


def _camera(number: int, place: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> HeadCamera:
    turn = matrix_of(np.stack([x, y, z]))
    return HeadCamera(number, _SIDE, turn, vector_of(-np.array(turn) @ place))


def _turned(x_deg: float, y_deg: float) -> Matrix:
    """A slide that looks along the pipe but for a small tilt."""
    if x_deg == y_deg == 0:
        return STILL
    a, b = math.radians(x_deg), math.radians(y_deg)
    z = np.array([math.sin(b), -math.sin(a), math.sqrt(1 - math.sin(a) ** 2 - math.sin(b) ** 2)])
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return matrix_of(np.stack([x, np.cross(z, x), z]))
