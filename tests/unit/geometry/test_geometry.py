"""Rays, cones, cylinders and cameras against closed-form truth."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone, cone_distance, intersect_cone, intersect_cylinder
from annulus_pipe.geometry.pose import Pose

CAMERAS = [
    Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5),
    Camera("pinhole", 1664, 1232, 900.0, 905.0, 829.0, 611.0, (-0.1, 0.02, 1e-3, -1e-3, 0.0)),
    Camera("fisheye", 1664, 1232, 500.0, 498.0, 831.5, 615.5, (0.01, -0.02, 0.003, 0.0)),
]

angles = st.floats(-0.25, 0.25)
shifts = st.floats(-15.0, 15.0)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{c.model}-{len(c.distortion)}")
def test_a_pixel_goes_out_as_a_ray_and_comes_back(camera: Camera) -> None:
    pixels = np.random.default_rng(1).uniform([0, 0], [camera.width - 1, camera.height - 1], (2000, 2))
    rays = camera.rays(pixels)
    assert np.allclose(np.linalg.norm(rays, axis=1), 1.0, rtol=0, atol=1e-14)
    assert np.abs(camera.project(37.0 * rays) - pixels).max() < 1e-11


def test_the_principal_point_looks_straight_down_the_pipe() -> None:
    for camera in CAMERAS:
        assert np.allclose(camera.rays(np.array([[camera.cx, camera.cy]])), [[0, 0, 1]], atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(rx=angles, ry=angles, tx=shifts, ty=shifts, z=st.floats(-1e3, 1e4))
def test_a_pose_is_undone_by_its_inverse(rx: float, ry: float, tx: float, ty: float, z: float) -> None:
    pose = Pose(rx, ry, tx, ty)
    points = np.random.default_rng(2).normal(0, 80, (50, 3))
    assert np.allclose(pose.to_camera(pose.to_pipe(points, z), z), points, rtol=0, atol=1e-11)
    assert math.isclose(np.linalg.det(pose.rotation), 1.0, rel_tol=1e-12)


@settings(max_examples=60, deadline=None)
@given(half=st.floats(0.15, 0.7), ax=st.floats(-0.05, 0.05), ay=st.floats(-0.05, 0.05), vz=st.floats(-90, -30))
def test_ray_cone_points_lie_on_the_ray_and_on_the_forward_cone(half: float, ax: float, ay: float, vz: float) -> None:
    cone = Cone(half, (ax, ay, math.sqrt(1 - ax * ax - ay * ay)), (1.1, -1.0, vz))
    phi = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    spread = half + 0.25  # the camera stands ahead of the projector, so it sees a ring wider than its cone
    rays = np.stack([np.sin(spread) * np.cos(phi), np.sin(spread) * np.sin(phi), np.full(90, np.cos(spread))], axis=1)
    points, delta = intersect_cone(rays, cone)
    assert np.isfinite(points).all() and (delta > 0).all()
    assert np.abs(cone_distance(points, cone)).max() < 1e-11
    assert np.allclose(np.cross(points, rays), 0, atol=1e-12)
    assert ((points - cone.vertex_mm) @ cone.axis > 0).all()


def test_ray_cone_matches_the_concentric_special_case() -> None:
    """Alzuhiri 2022, Eq. 3.1: z = d / (1 - r_p/r_c), rho = r_p z / f, z counted from the projector."""
    d, f, r_p, r_c = 56.0, 470.0, 200.0, 330.0
    z = d / (1 - r_p / r_c)
    points, _ = intersect_cone(
        np.array([[r_c, 0.0, f]]) / math.hypot(r_c, f), Cone(math.atan2(r_p, f), (0, 0, 1), (0, 0, -d))
    )
    assert np.allclose(points[0], [r_p * z / f, 0.0, z - d], rtol=0, atol=1e-11)


def test_a_ray_that_meets_only_the_backward_nappe_gives_nothing() -> None:
    points, _ = intersect_cone(np.array([[0.0, 0.0, 1.0], [0.9, 0.0, -0.43589]]), Cone(0.4, (0, 0, 1), (0, 0, 50)))
    assert np.isnan(points).all()


def test_ray_cylinder_points_stand_on_the_wall() -> None:
    pose = Pose(0.03, -0.05, 3.0, -2.0)
    rays = CAMERAS[0].rays(np.random.default_rng(3).uniform([0, 0], [1663, 1231], (500, 2)))
    points = intersect_cylinder(rays, pose.translation, pose.rotation[:, 2], 76.2)
    assert np.allclose(np.hypot(*pose.to_pipe(points)[:, :2].T), 76.2, rtol=0, atol=1e-12)
    assert (np.einsum("ij,ij->i", points, rays) > 0).all()


def good() -> dict[str, object]:
    return {
        "format": "annulus-calibration/1",
        "camera": {"model": "pinhole", "width": 1664, "height": 1232, "fx": 470, "fy": 470, "cx": 831.5, "cy": 615.5},
        "pattern": {"colours": "RGB"},
        "rings": [{"theta_full_deg": t, "axis": [0, 0, 1], "vertex_mm": [0, 0, -56]} for t in (40, 50)],
        "pipe": {"radius_mm": 76.2},
    }


def test_a_calibration_survives_its_own_dictionary() -> None:
    calibration = Calibration.from_dict(good())
    again = Calibration.from_dict(json.loads(json.dumps(calibration.to_dict())))
    assert again.camera == calibration.camera and again.colours == "RGB"
    assert [c.half_angle for c in again.rings] == pytest.approx([math.radians(20), math.radians(25)])


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        (("format",), "annulus-calibration/9", "format"),
        (("camera", "model"), "orthographic", "camera.model"),
        (("camera", "fx"), "470", "camera.fx"),
        (("camera", "fx"), math.nan, "camera.fx"),
        (("camera", "width"), 1664.5, "camera.width"),
        (("camera", "distortion"), [0.1], "camera.distortion"),
        (("pattern", "colours"), "RGX", "pattern.colours"),
        (("rings",), [], "rings"),
        (("rings", 0, "axis"), [0, 0, -1], r"rings\[0\].axis"),
        (("rings", 1, "theta_full_deg"), 20, "rings"),
        (("rings", 1, "vertex_mm"), [0, 0], r"rings\[1\].vertex_mm"),
        (("pipe", "radius_mm"), True, "pipe.radius_mm"),
        (("pipe",), None, "pipe"),
    ],
)
def test_a_wrong_key_is_named(path: tuple[str | int, ...], value: object, named: str) -> None:
    data = json.loads(json.dumps(good()))
    at = data
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(ValueError, match=named):
        Calibration.from_dict(data)
