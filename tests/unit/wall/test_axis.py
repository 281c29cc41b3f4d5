"""The pipe's axis from frames of a head that wobbles through joints, bends and tapers; and none where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from chained_pipe import bead, frames, pit
from synthetic_pipe import CALIBRATION, bump, oval, pocket, round_pipe, scan

from annulus_pipe.wall.axis import Begins, find_axis
from annulus_pipe.wall.bends import find_bends
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import survey

R = 76.2
STATIONS = [4.0 * i for i in range(25) if i % 5 != 4]


def test_a_straight_pipe_is_one_piece_and_comes_back_to_the_bit() -> None:
    damaged = pocket(bump(oval(round_pipe, 30.0, 0.01), 200.0, 150.0, 15.0, 3.0), 40.0, 25.0, 140.0, 175.0, 3.0)
    for profiles in (scan(round_pipe), scan(damaged), frames(Centreline([Piece(0.0, R)]), STATIONS)):
        axis = find_axis(profiles, CALIBRATION.rings)
        assert axis.begins == (Begins.STRAIGHT,)
        assert axis.adjusted is None
        assert all(a is b for a, b in zip(axis.profiles, profiles, strict=True))


def lines(profiles: list[Profile]) -> list[Profile]:
    """What was cast are rays: slits of no width, and said to be."""
    return [replace(one, slit_rad=np.full(5, 1e-5, np.float32)) for one in profiles]


HILO_AND_KINK = ((1.2, -0.9), (0.0105, -0.014), 0.0)
STEP = ((-0.6, 0.3), (0.0, 0.0), -0.75)


@pytest.mark.deep(gate="tests/unit/wall/test_axis.py::test_a_narrower_pipe_is_no_gap")
@pytest.mark.parametrize(("offset", "turn", "step"), [HILO_AND_KINK, STEP])
def test_a_joint_is_measured(offset: tuple[float, float], turn: tuple[float, float], step: float) -> None:
    line = Centreline([Piece(0.0, R), Piece(170.0, R + step, offset, turn)])
    profiles = lines(frames(line, STATIONS, bead(170.0, 3.0, 4.0, pit(120.0, 200.0, 2.5)), step_mm=1.5))
    pipe = survey(profiles, CALIBRATION)
    (joint,) = pipe.features
    assert joint.kind is FeatureKind.JOINT
    assert joint.z_mm == pytest.approx(170.0, abs=2.5)
    assert joint.measured("height_mm") == pytest.approx(3.0, abs=0.4)
    assert joint.measured("width_mm") == pytest.approx(8.0, abs=2.0)
    assert joint.measured("hilo_mm") == pytest.approx(np.hypot(*offset), abs=0.1)
    assert joint.measured("angle_deg") == pytest.approx(np.degrees(np.hypot(*turn)), abs=0.08)
    assert joint.measured("step_mm") == pytest.approx(2 * step, abs=0.06)
    (loss,) = pipe.defects  # behind the joint, and nothing else
    assert loss.depth_mm == pytest.approx(2.5, abs=0.15)
    assert loss.clock_deg == pytest.approx(120.0, abs=4.0)


@pytest.mark.deep(gate="tests/unit/wall/test_axis.py::test_a_narrower_pipe_is_no_gap")
def test_slits_that_a_beads_shadow_cuts_in_half_do_not_widen_it() -> None:
    """Behind it they seem to stand as high as it does, and say how little they know."""
    line = Centreline([Piece(0.0, R), Piece(170.0, R, *HILO_AND_KINK[:2])])
    rng = np.random.default_rng(2)
    profiles = []
    for one in lines(frames(line, STATIONS, bead(170.0, 3.0, 4.0), step_mm=1.5)):
        behind = (one.points_mm[:, 2] > 176.0) & (one.points_mm[:, 2] < 182.0) & (rng.random(len(one.ring)) < 0.7)
        points = one.points_mm.copy()
        points[behind, :2] *= 1 - 2.6 / R
        sigma = np.where(behind, 1.0, one.sigma_mm).astype(np.float32)
        profiles.append(replace(one, points_mm=points, sigma_mm=sigma))
    (joint,) = survey(profiles, CALIBRATION).features
    assert joint.measured("width_mm") == pytest.approx(8.0, abs=2.3)


def test_a_narrower_pipe_is_no_gap() -> None:
    pipe = survey(frames(Centreline([Piece(0.0, R), Piece(160.0, R - 3.0)]), STATIONS), CALIBRATION)
    (joint,) = pipe.features
    assert joint.kind is FeatureKind.JOINT
    assert joint.measured("step_mm") == pytest.approx(-6.0, abs=0.03)
    assert not pipe.defects


@pytest.mark.deep(gate="tests/unit/wall/test_axis.py::test_a_narrower_pipe_is_no_gap")
def test_a_wider_pipe_is_no_gap() -> None:
    """What its lip hides, 14 mm even of the widest ring's light, is no room between two ends."""
    pipe = survey(frames(Centreline([Piece(0.0, R), Piece(160.0, R + 8.0)]), STATIONS), CALIBRATION)
    (joint,) = pipe.features
    assert joint.kind is FeatureKind.REDUCER  # a tenth of the radius is another size of pipe
    before, after = (joint.measured(name) for name in ("radius_before_mm", "radius_after_mm"))
    assert after - before == pytest.approx(8.0, abs=0.03)
    assert not pipe.defects


@pytest.mark.deep(gate="tests/unit/wall/test_axis.py::test_a_narrower_pipe_is_no_gap")
def test_a_bend_is_measured_in_space() -> None:
    radius = 3.0 * 2 * R
    arc = radius * np.pi / 2
    line = Centreline([Piece(0.0, R), Piece(150.0, R, curvature=(0.0, 1 / radius)), Piece(150.0 + arc, R)])
    profiles = frames(line, np.arange(-30.0, 930.0, 24.0), pit(0.0, 510.0, 3.0), roll=True)
    pipe = survey(profiles, CALIBRATION)
    (bend,) = pipe.features
    assert bend.kind is FeatureKind.BEND
    assert bend.measured("start_mm") == pytest.approx(150.0, abs=1.5)
    assert bend.measured("radius_mm") == pytest.approx(radius, rel=0.006)
    assert bend.measured("angle_deg") == pytest.approx(90.0, abs=0.3)
    assert bend.measured("plane_deg") == pytest.approx(90.0, abs=0.5)
    assert bend.remark == "3.0 D, 90 degrees, to 6 o'clock"
    end = line.to_space(np.array([[0.0, 0.0, 900.0]]))
    assert np.linalg.norm(pipe.centreline.to_space(np.array([[0.0, 0.0, 900.0]])) - end) < 3.0
    (loss,) = pipe.defects
    assert loss.z_mm == pytest.approx(510.0, abs=6.0)


@pytest.mark.deep(gate="tests/unit/wall/test_axis.py::test_a_narrower_pipe_is_no_gap")
def test_a_taper_is_measured() -> None:
    line = Centreline([Piece(0.0, R), Piece(120.0, R, taper=-0.02), Piece(220.0, R - 2.0)])
    pipe = survey(frames(line, STATIONS), CALIBRATION)
    (taper,) = pipe.features
    assert taper.kind is FeatureKind.TAPER
    assert taper.z_range_mm == pytest.approx((120.0, 220.0), abs=4.0)
    assert taper.measured("radius_after_mm") == pytest.approx(R - 2.0, abs=0.06)
    assert not pipe.defects


@pytest.mark.deep(gate="tests/unit/wall/test_axis.py::test_a_narrower_pipe_is_no_gap")
@pytest.mark.parametrize("seed", [1])
def test_what_is_said_of_a_bend_holds(seed: int) -> None:
    line = Centreline([Piece(0.0, R), Piece(140.0, R, curvature=(-1 / 700.0, 0.0))])
    axis = find_axis(frames(line, [7.0 * i for i in range(25)], roll=True, seed=seed), CALIBRATION.rings)
    (bend,) = find_bends(axis, (60.0, 320.0))
    true = {"start_mm": 140.0, "radius_mm": 700.0, "angle_deg": np.degrees(180.0 / 700.0)}
    for one in bend.measures:
        if one.name in true:
            assert abs(one.value - true[one.name]) <= 1.5 * one.k2
            assert one.k2 < {"start_mm": 1.5, "radius_mm": 14.0, "angle_deg": 0.3}[one.name]
