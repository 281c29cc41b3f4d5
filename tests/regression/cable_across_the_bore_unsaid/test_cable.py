"""A cable across the bore stood in every picture, and nothing was said of it: the light it took was a hole in the map,
or none, for another frame had seen the wall. Fails without `find_objects`."""

from collections.abc import Callable

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, VERTEX_Z_MM, round_pipe, scan, turn

from annulus_pipe.wall.lost import OBJECT
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, survey

Inside = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
WAY = np.linspace(0.3, 0.985, 40)[:, None]  # of the way from the head to the wall


def cable(z_mm: float, aside: float, clock_deg: float) -> Inside:
    """From wall to wall, 8 mm thick, `aside` of the radius off the middle towards a clock position."""
    t = np.radians(clock_deg)

    def inside(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.hypot(x * np.sin(t) - y * np.cos(t) - aside * RADIUS_MM, z - z_mm) < 4.0

    return inside


def before(inside: Inside | None, profiles: list[Profile]) -> list[Profile]:
    """The same, less the points whose light something stops on its way from the projector or to the camera."""
    out = []
    for one in profiles:
        stopped = np.zeros(len(one.points_mm), bool)
        for start in (0.0, VERTEX_Z_MM):
            x, y, z = one.points_mm.T
            if inside is not None:
                stopped |= inside(WAY * x, WAY * y, one.z_mm + start + WAY * (z - one.z_mm - start)).any(axis=0)
        out.append(one.without(stopped, "hidden"))
    return out


def surveyed(inside: Inside | None, profiles: list[Profile] | None = None) -> Survey:
    return survey(before(inside, scan(round_pipe, directions=360) if profiles is None else profiles), CALIBRATION)


def objects(pipe: Survey) -> list[str]:
    return [one.text for one in pipe.findings if one.kind == OBJECT]


@pytest.mark.parametrize(
    ("z_mm", "aside", "clock_deg"),
    [(200.0, 0.5, 200.0)]
    + [
        pytest.param(z, aside, clock, marks=pytest.mark.deep(but=1))
        for z, aside, clock in ((180.0, 0.3, 300.0), (190.0, 0.6, 20.0))
    ],
)
def test_a_cable_is_an_object_where_it_stands(z_mm: float, aside: float, clock_deg: float) -> None:
    pipe = surveyed(cable(z_mm, aside, clock_deg))
    assert objects(pipe)
    for one in pipe.standing:
        assert one.z_from_mm < z_mm < one.z_to_mm
        assert abs(turn(np.array(one.clock_deg), clock_deg + (180.0 if aside < 0 else 0.0))) < 75.0
        where = [place for place in pipe.unjudged if place == one.place]
        assert where and where[0].may_reach("bump", 2.0), "the wall behind it was judged"


def test_what_is_on_the_wall_is_no_object() -> None:
    profiles = []
    for one in scan(round_pipe, directions=360):
        x, y, z = one.points_mm.T
        clock = np.degrees(np.arctan2(x, -y))
        stain = (np.abs(turn(clock, 200.0)) < 15.0) & (np.abs(z - 200.0) < 15.0)  # wherever it is looked at from
        dim = (one.ring == 0) & (np.abs(turn(clock, 60.0)) < 30.0)  # one ring, all along
        profiles.append(one.without(stain | dim, "hidden"))
    assert not objects(surveyed(None, profiles))
