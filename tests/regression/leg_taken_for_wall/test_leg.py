"""A crawler's leg and rubble in a laser ring were wall: bumps of 17 mm, Dmax - Dmin 23 mm where it is 7.3."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.survey import Survey, survey

RADIUS_MM, RING_PX, SWING_MM = 150.0, 100.0, 7.3  # Dmax - Dmin of the oval
PLANE_MM = 250.0 * RADIUS_MM / RING_PX
PLANE = Cone(math.pi / 2, (0.0, 0.0, 1.0), (0.0, 0.0, PLANE_MM))
HEAD = Calibration(
    Camera("pinhole", 352, 288, 250.0, 250.0, 176.0, 144.0), "", (PLANE,), RADIUS_MM, pattern={"kind": "line"}
)
FRAMES = 10

Leg = tuple[float, float, float]  # clock and width, degrees; how far inwards, part of the radius
Stone = tuple[float, float]  # clock, degrees; radius in mm: a disc that lies on the wall


def off(clock: np.ndarray, at: float) -> np.ndarray:
    return (clock - at + 180) % 360 - 180


def picture(i: int, legs: Sequence[Leg], stones: Sequence[Stone], dent: tuple[float, float]) -> np.ndarray:
    """The plane's light on what it meets first from the middle, in an oval pipe; a dent of so many mm at a clock."""
    v, u = np.mgrid[0:288, 0:352]
    x, y = (u - 176 - math.sin(i)) * PLANE_MM / 250, (v - 144 - math.cos(1.3 * i)) * PLANE_MM / 250
    clock, radius = np.degrees(np.arctan2(x, -y)), np.hypot(x, y)
    met = RADIUS_MM + SWING_MM / 4 * np.cos(2 * np.radians(clock))
    met += dent[1] * np.exp(-0.5 * (np.radians(off(clock, dent[0])) * RADIUS_MM / 10) ** 2)
    for at, wide, inwards in legs:
        met = np.where(np.abs(off(clock, at)) < wide / 2, RADIUS_MM * (1 - inwards), met)
    for at, size in stones:
        turn, far = np.radians(off(clock, at)), RADIUS_MM - 0.5 * size
        under = size**2 - (far * np.sin(turn)) ** 2
        hit = far * np.cos(turn) - np.sqrt(np.maximum(under, 0))
        met = np.where((under > 0) & (np.cos(turn) > 0), np.minimum(met, hit), met)
    light = 200 * np.exp(-0.5 * ((radius - met) * 250 / PLANE_MM / 1.1) ** 2)
    image = np.stack([0.35 * light, 0.15 * light, light], axis=2)
    return np.clip(image + np.random.default_rng(i).normal(4, 2, image.shape), 0, 255).astype(np.uint8)


def measured(legs: Sequence[Leg] = (), rubble: Sequence[int] = (), dent: tuple[float, float] = (95.0, 0.0)) -> Survey:
    rec, draw = Reconstructor(HEAD), np.random.default_rng(3)
    profiles = []
    for i in range(FRAMES):
        stones = [(draw.uniform(150, 210), draw.uniform(6, 22)) for _ in range(7)] if i in rubble else []
        profiles.append(rec.profile(picture(i, legs, stones, dent), frame=i, z_mm=10.0 * i))
    return survey(profiles, HEAD)


def swing(pipe: Survey) -> np.ndarray:
    return np.asarray(pipe.stations.diameter_max_mm - pipe.stations.diameter_min_mm)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("wide", "inwards"), [(18, 0.12), (10, 0.06), (25, 0.06), (10, 0.25), (25, 0.2)])
def test_a_leg_at_four_and_eight_is_no_wall(wide: float, inwards: float) -> None:
    pipe = measured([(120.0, wide, inwards), (240.0, wide, inwards)])
    assert np.all(np.abs(swing(pipe) - SWING_MM) < pipe.stations.diameter_k2_mm)
    assert {defect.kind for defect in pipe.defects} <= {Kind.OVALITY}
    if inwards <= 0.2:  # farther inwards no ring is named at all
        assert pipe.rejected["object"] > FRAMES * 2 * wide
        assert [(one.kind, len(one.frames)) for one in pipe.findings if one.kind == "object"] == [("object", FRAMES)]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("deep_mm", [-6.0, 6.0, -9.0])
def test_a_dent_or_a_pocket_beside_a_leg_is_kept(deep_mm: float) -> None:
    (found,) = (d for d in measured([(120.0, 18, 0.12)], dent=(97.0, deep_mm)).defects if d.kind is not Kind.OVALITY)
    assert found.kind is (Kind.BUMP if deep_mm < 0 else Kind.LOSS)
    assert abs(found.depth_mm - abs(deep_mm)) < found.depth_k2_mm + 0.2 and abs(found.clock_deg - 97.0) < 3.0


def test_rubble_is_no_diameter_and_no_bump() -> None:
    pipe = measured(rubble=range(3, 7))
    # the long diameter may lie under stones: then a shorter one is the longest that was seen, never a longer one
    assert np.all(swing(pipe) < SWING_MM + pipe.stations.diameter_k2_mm) and np.all(swing(pipe) > 0.6 * SWING_MM)
    assert {defect.kind for defect in pipe.defects} <= {Kind.OVALITY}
    assert [one.frames for one in pipe.findings if one.kind == "object"] == [(3, 4, 5, 6)]


@pytest.mark.parametrize(("deep_mm", "dent"), [(-20.0, 30.0), (15.0, 200.0)])
def test_a_deep_dent_without_steps_is_wall(deep_mm: float, dent: float) -> None:
    one = Reconstructor(HEAD).profile(picture(0, (), (), (dent, deep_mm)), frame=0, z_mm=0.0)
    assert one.rejected["object"] == 0 and len(one.points_mm) > 700
