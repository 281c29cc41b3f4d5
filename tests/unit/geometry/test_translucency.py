"""Where light leaves a wall that it entered: mean and spread of what is drawn, and how far an edge of it moves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone, intersect_cone, intersect_cylinder
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.geometry.translucency import (
    SHIFT_MAX_MM,
    Translucency,
    along,
    edge_shift_mm,
    incidence_rad,
    leaving,
    mean_shift_mm,
    slit_shift_mm,
    spread_mm,
    wall_from_dict,
    wall_to_dict,
)

R = 76.2
CAMERA = Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)
RING = Cone(math.radians(37.893 / 2), (0.0, 0.0, 1.0), (0.0, 0.0, -56.0))
lengths = st.tuples(*[st.floats(0.01, 2.0)] * 3)
walls = st.builds(Translucency, lengths, st.floats(0.0, 1.0), st.floats(0.0, 2.0))
angles = st.floats(0.1, 1.5)


@settings(max_examples=60, deadline=None)
@given(walls, angles)
def test_what_is_drawn_has_the_kernels_mean_and_spread(wall: Translucency, incidence: float) -> None:
    where, share, sigma = np.moveaxis(leaving(wall, incidence), 2, 0)
    mean = (where * share).sum(axis=1)
    square = ((where**2 + sigma**2) * share).sum(axis=1) - mean**2
    assert share.sum(axis=1) == pytest.approx(1.0)
    assert mean == pytest.approx(mean_shift_mm(wall, incidence), abs=1e-12)
    assert square == pytest.approx(spread_mm(wall, incidence) ** 2, abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(walls, angles, st.floats(0.02, 1.0))
def test_an_edge_moves_no_farther_than_the_middle_and_by_all_of_it_where_blur_is_wide(
    wall: Translucency, incidence: float, blur: float
) -> None:
    mean = mean_shift_mm(wall, incidence)
    edge = edge_shift_mm(wall, incidence, blur)
    step = along(wall, incidence).max() / 1000
    assert (edge >= -step).all() and (edge <= mean + step).all()
    wide = 20.0 * along(wall, incidence).max() + 20.0 * wall.wander * max(wall.mean_free_mm)
    assert edge_shift_mm(wall, incidence, wide) == pytest.approx(mean, rel=0.02, abs=step)


@settings(max_examples=20, deadline=None)
@given(lengths, st.floats(0.05, 0.9), angles)
def test_an_edge_stands_still_where_nothing_blurs_it_and_the_surface_returns_some(
    free: tuple[float, float, float], share: float, incidence: float
) -> None:
    assert np.abs(edge_shift_mm(Translucency(free, share), incidence, 1e-4)).max() < 1e-3


def test_a_reference_by_counting_light() -> None:
    """A million ways drawn one by one: Snell, an exponential, wandering."""
    rng, wall, incidence = np.random.default_rng(4), Translucency((0.5, 0.4, 0.3), 0.25), incidence_rad(RING.half_angle)
    inside = rng.random(400_000) >= wall.surface_share
    bent = math.asin(math.sin(incidence) / 1.5)
    for c, free in enumerate(wall.mean_free_mm):
        way = rng.exponential(free, inside.size) * math.sin(bent) + rng.normal(0.0, 0.5 * free, inside.size)
        out = np.where(inside, way, 0.0)
        assert out.mean() == pytest.approx(mean_shift_mm(wall, incidence)[c], abs=0.002)
        assert out.std() == pytest.approx(spread_mm(wall, incidence)[c], abs=0.002)
        density, edges = np.histogram(out + rng.normal(0.0, 0.4, out.size), np.linspace(-0.6, 0.9, 31), density=True)
        middle = 0.5 * (edges[1:] + edges[:-1])
        bend, slope, _ = np.polyfit(middle[8:20], density[8:20], 2)
        assert -slope / (2 * bend) == pytest.approx(edge_shift_mm(wall, incidence, 0.4)[c], abs=0.02)


def test_red_goes_farther_than_blue_and_wide_rings_less_far() -> None:
    wall = Translucency((0.56, 0.45, 0.32), 0.25)
    narrow, wide = (mean_shift_mm(wall, incidence_rad(math.radians(half))) for half in (19.0, 29.0))
    assert (np.diff(narrow) < 0).all() and (narrow > wide).all() and 0.14 < narrow[2] < narrow[0] < 0.28
    assert slit_shift_mm((0.3, 0.2, 0.1), "RRGB") == pytest.approx([0.3, 0.25, 0.15])


@pytest.mark.parametrize("wrong", [((-0.1, 0.0, 0.0), 0.2), ((0.1, 0.1, 0.1), 1.2), ((math.nan, 0.1, 0.1), 0.2)])
def test_what_is_no_wall_is_refused(wrong: tuple[tuple[float, float, float], float]) -> None:
    with pytest.raises(ValueError, match=r"a share is 0\.\.1, lengths are 0 or more"):
        Translucency(*wrong)


@pytest.mark.parametrize(
    ("section", "named"),
    [
        (None, r"wall.* must be an object"),
        ([], r"wall.* must be an object"),
        ({"sigma_mm": {"R": 0.1, "G": 0.1, "B": 0.1}}, "must be an object with .translucency_mm"),
        ({"translucency_mm": 0.2}, r"wall\.translucency_mm.* must be three numbers, mm, named R, G and B"),
        ({"translucency_mm": {"R": 0.1, "G": 0.1}}, "must be three numbers, mm"),
        ({"translucency_mm": {"R": 0.1, "G": 0.1, "B": 0.1, "X": 1}}, "must be three numbers, mm"),
        ({"translucency_mm": {"R": -0.1, "G": 0.1, "B": 0.1}}, r"translucency_mm\.R.* expected a number in 0\.\.2"),
        ({"translucency_mm": {"R": 0.1, "G": 2.1, "B": 0.1}}, r"translucency_mm\.G.* expected a number in 0\.\.2"),
        ({"translucency_mm": {"R": 0.1, "G": 0.1, "B": math.nan}}, r"translucency_mm\.B"),
        ({"translucency_mm": {"R": 0.1, "G": True, "B": 0.1}}, r"translucency_mm\.G"),
        ({"translucency_mm": {"R": 0.1, "G": 0.1, "B": 0.1}, "sigma_mm": {"R": "x"}}, r"wall\.sigma_mm"),
    ],
)
def test_a_section_that_is_no_walls_is_named(section: object, named: str) -> None:
    whole = Calibration(CAMERA, "RG", (RING,), R).to_dict()
    with pytest.raises(ValueError, match=named) as refused:
        Calibration.from_dict({**whole, "wall": section})
    assert "\n" not in str(refused.value)
    with pytest.raises(ValueError, match="by colour, line has none"):
        Calibration.from_dict(
            {**Calibration(CAMERA, "", (RING,), R, pattern={"kind": "line"}).to_dict(), "wall": section}
        )


@given(st.tuples(*[st.floats(0.0, SHIFT_MAX_MM)] * 3), st.none() | st.tuples(*[st.floats(0.0, SHIFT_MAX_MM)] * 3))
def test_a_wall_is_read_back(shift: tuple[float, float, float], sigma: tuple[float, float, float] | None) -> None:
    assert wall_from_dict(wall_to_dict(shift, sigma)) == (shift, sigma)


def test_a_calibration_of_an_opaque_wall_has_no_section() -> None:
    opaque = Calibration(CAMERA, "RG", (RING,), R)
    assert "wall" not in opaque.to_dict() and opaque.in_wall() is opaque


@pytest.mark.parametrize(("lean", "most", "mean"), [(0.0, 1e-9, 1e-9), (1.0, 0.025, 0.0002), (8.0, 0.18, 0.005)])
def test_a_leaning_pipe(lean: float, most: float, mean: float) -> None:
    """How far a moved vertex is off, radius in mm, where light leaves a wall 0.3 mm farther along."""
    known = Calibration(CAMERA, "RR", (RING,), R, translucency_mm=(0.3, 0.0, 0.0))
    pose = Pose(math.radians(lean), 0.0, 0.0, 0.0)
    turn = np.linspace(0, 2 * math.pi, 360, endpoint=False)
    out, forward = math.sin(RING.half_angle), np.full(360, math.cos(RING.half_angle))
    light = np.stack([out * np.cos(turn), out * np.sin(turn), forward], axis=1)
    axis = pose.rotation[:, 2]
    left = intersect_cylinder(light, pose.translation, axis, R, np.array(RING.vertex_mm)) + 0.3 * axis
    rays = left / np.linalg.norm(left, axis=1, keepdims=True)
    points, _ = intersect_cone(rays, known.in_wall().rings[0])
    off = np.hypot(*pose.to_pipe(points)[:, :2].T) - R
    assert np.abs(off).max() < most and abs(off.mean()) < mean
