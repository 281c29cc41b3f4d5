"""A pipe of several pieces: rays against closed forms of cylinder, torus, cone, step, bore and water."""

import json
import math
from dataclasses import asdict

import numpy as np
import pytest

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.twin.course import InSpace, Tube, entry, leaves, passed, tube_of
from annulus_pipe.twin.worlds import WORLDS, World
from annulus_pipe.twin.worlds.course import Course, WorldJoint, WorldOpening, WorldPiece, across
from annulus_pipe.twin.worlds.fittings import FITTINGS
from annulus_pipe.vocabulary import AnnulusError

R = 76.2
AXIS = (0.0, 0.0, 0.0)


def tube(*pieces: WorldPiece, **others: object) -> Tube:
    world = WORLDS["butt"](1)
    course = Course(pieces, **others)  # type: ignore[arg-type]
    return tube_of(World(world.camera, world.projector, R, course=course, travel_mm=60.0, texture=False))


def hit(pipe: Tube, start: tuple[float, float, float], clock_deg: float, lean_deg: float) -> np.ndarray:
    lean = math.radians(lean_deg)
    way = math.sin(lean) * across(clock_deg) + np.array([0.0, 0.0, math.cos(lean)])
    return start + leaves(pipe, np.asarray(start), way, 500.0) * way


@pytest.mark.parametrize("lean_deg", [14.0, 25.0, 60.0])
def test_a_straight_piece_is_a_cylinder(lean_deg: float) -> None:
    place = hit(tube(WorldPiece(900.0, R)), AXIS, 70.0, lean_deg)
    assert place[2] == pytest.approx(R / math.tan(math.radians(lean_deg)), abs=0.01)


def test_a_taper_is_a_cone() -> None:
    place = hit(tube(WorldPiece(200.0, R, 72.2)), AXIS, 200.0, 30.0)
    assert np.hypot(*place[:2]) == pytest.approx(R - 0.02 * place[2], abs=0.003)


@pytest.mark.parametrize(("clock_deg", "lean_deg"), [(90.0, 40.0), (270.0, 25.0), (20.0, 25.0), (200.0, 32.0)])
def test_a_bend_is_a_torus(clock_deg: float, lean_deg: float) -> None:
    bend = 457.2
    pipe = tube(WorldPiece(50.0, R), WorldPiece(bend * math.pi / 2, R, bend_radius_mm=bend), WorldPiece(900.0, R))
    x, y, z = hit(pipe, AXIS, clock_deg, lean_deg)
    assert z > 60.0
    assert math.hypot(bend - math.hypot(bend - x, z - 50.0), y) == pytest.approx(R, abs=0.003)


def test_behind_a_bend_the_pipe_goes_on_where_the_axis_ends() -> None:
    bend, angle = 300.0, math.radians(60.0)
    course = Course((WorldPiece(100.0, R), WorldPiece(bend * angle, R, bend_radius_mm=bend), WorldPiece(400.0, R)))
    origin, axes, piece = course.frame(100.0 + bend * angle + 80.0)
    end = np.array([bend * (1 - math.cos(angle)), 0.0, 100.0 + bend * math.sin(angle)])
    way = np.array([math.sin(angle), 0.0, math.cos(angle)])
    np.testing.assert_allclose(origin, end + 80.0 * way, atol=1e-9)
    np.testing.assert_allclose(axes[:, 2], way, atol=1e-12)
    assert piece == 2 and np.linalg.det(axes) == pytest.approx(1.0)


def test_hilo_and_step_set_the_second_cylinder_aside() -> None:
    pipe = tube(WorldPiece(100.0, R), WorldPiece(900.0, R + 1.0, joint=WorldJoint(hilo_mm=1.5, hilo_clock_deg=90.0)))
    for clock in (90.0, 180.0, 270.0):
        x, y, z = hit(pipe, AXIS, clock, 25.0)
        assert z > 110.0 and math.hypot(x - 1.5, y) == pytest.approx(R + 1.0, abs=0.003)


def test_a_face_that_stands_in_the_pipe_is_met_on_its_plane() -> None:
    pipe = tube(WorldPiece(100.0, R), WorldPiece(900.0, R - 6.0))
    lean = math.degrees(math.atan2(R - 3.0, 100.0))
    assert hit(pipe, AXIS, 30.0, lean)[2] == pytest.approx(100.0, abs=0.01)


def test_a_bead_has_its_height_and_its_notch() -> None:
    bead = WorldJoint(height_mm=4.0, width_mm=10.0, notch_mm=1.5)
    pipe = tube(WorldPiece(120.0, R), WorldPiece(900.0, R, joint=bead))
    for z, height in ((117.5, 4.0), (122.5, 4.0), (120.0, 2.5), (110.0, 0.0)):
        place = hit(pipe, (0.0, 0.0, z), 130.0, 90.0)
        assert np.hypot(*place[:2]) == pytest.approx(R - height, abs=0.01)


def test_through_an_opening_a_ray_meets_the_bore() -> None:
    pipe = tube(WorldPiece(900.0, R), openings=(WorldOpening(150.0, 90.0, 30.0),))
    x, y, z = hit(pipe, (0.0, 0.0, 130.0), 90.0, 70.0)
    assert x > R and math.hypot(y, z - 150.0) == pytest.approx(15.0, abs=0.01)


def test_light_enters_water_by_snells_law() -> None:
    x = entry(60.0, 9.0, 100.0)
    above, below = math.sin(math.atan2(x, 60.0)), math.sin(math.atan2(100.0 - x, 9.0))
    assert above == pytest.approx(1.333 * below, rel=1e-6)
    assert passed(1.0) == pytest.approx(1 - (0.333 / 2.333) ** 2, rel=1e-9)
    assert passed(0.02) < 0.2


def test_a_head_in_a_straight_piece_stands_as_its_pose_says() -> None:
    pose, points = Pose(0.01, -0.02, 1.0, 2.0), np.array([[1.0, 2.0, 3.0], [-20.0, 5.0, 60.0]])
    head = InSpace(pose, Course((WorldPiece(900.0, R),))).at(40.0)
    np.testing.assert_allclose(head.to_pipe(points, 40.0), pose.to_pipe(points, 40.0), atol=1e-9)
    np.testing.assert_allclose(head.rotation, pose.rotation, atol=1e-12)


@pytest.mark.parametrize("name", FITTINGS)
def test_a_fitting_is_plain_data_and_its_seed(name: str) -> None:
    world = WORLDS[name](3)
    assert world.course == WORLDS[name](3).course != WORLDS[name](4).course
    assert World.from_dict(json.loads(json.dumps(world.to_dict()))) == world
    assert world.truth()["named"] and world.truth()["course"] == asdict(world.course)  # type: ignore[arg-type]


def test_a_course_that_cannot_be_is_refused() -> None:
    with pytest.raises(AnnulusError, match="above zero"):
        Course((WorldPiece(0.0, R),))
    with pytest.raises(AnnulusError, match="further from its centre"):
        Course((WorldPiece(10.0, R, bend_radius_mm=70.0),))
    with pytest.raises(AnnulusError, match="one straight piece"):
        Course((WorldPiece(10.0, R), WorldPiece(10.0, R)), level_mm=60.0)
