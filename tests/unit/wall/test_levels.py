"""Promises of levels: water and deposit are told apart by refraction, measured, taken out, and never made of a wall.

`flooded_pipe` follows light forwards through the surface and back; nothing of it inverts what the code under test
inverts.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import synthetic_pipe
from flooded_pipe import scan, still
from synthetic_pipe import CALIBRATION, RADIUS_MM, RadiusMap, bump, oval, round_pipe, turn

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.wall.features import Feature, FeatureKind
from annulus_pipe.wall.levels import covered, without_levels
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.refraction import WATER
from annulus_pipe.wall.stations import not_enough_seen
from annulus_pipe.wall.survey import survey

LIMITS = {FeatureKind.WATER: 0.1, FeatureKind.DEPOSIT: 0.05}  # mm; asked are 1 and 0.3


def only(profiles: Sequence[Profile], calibration: Calibration = CALIBRATION) -> Feature:
    _, (level,) = without_levels(profiles, calibration)
    return level.feature


def off(feature: Feature, level_mm: float) -> float:
    return abs(feature.measured("level_mm") - level_mm)


@pytest.mark.deep(gate="tests/unit/wall/test_levels.py::test_half_a_pipe_is_not_measured")
@pytest.mark.parametrize(("index", "kind"), [(WATER, FeatureKind.WATER), (None, FeatureKind.DEPOSIT)])
@pytest.mark.parametrize("level_mm", [73.0, 66.0, 45.0, 30.0])
def test_a_level_is_found_told_and_measured(level_mm: float, index: float | None, kind: FeatureKind) -> None:
    """From 2 to 30 % of the pipe's height; no ring is believed deep below 0.65 of the radius."""
    profiles = scan(still(level_mm), index=index)
    assert all(profile.pose is not None for profile in profiles)
    found = only(profiles)
    assert found.kind is kind and found.remark == "flat"
    (level,) = (one for one in found.measures if one.name == "level_mm")
    assert abs(level.value - level_mm) < min(LIMITS[kind], level.k2) and level.k2 < 0.2
    assert found.measured("depth_mm") == pytest.approx(RADIUS_MM - level_mm, abs=0.1)
    assert found.measured("height_percent") == pytest.approx(50 * (1 - level_mm / RADIUS_MM), abs=0.1)
    assert abs(turn(np.array(found.clock_deg), 180.0)) < 0.2
    assert found.arc_deg == pytest.approx(2 * math.degrees(math.acos(level_mm / RADIUS_MM)), abs=0.5)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("index", [WATER, None])
def test_what_lies_below_is_no_wall(index: float | None) -> None:
    """No bump, no loss, no ovality, no point; and each point that went is counted."""
    profiles = scan(still(66.0), index=index)
    pipe = survey(profiles, CALIBRATION)
    assert pipe.defects == () and pipe.findings == () and len(pipe.features) == 1
    points = np.concatenate([profile.points_mm for profile in pipe.profiles])
    assert points[:, 1].max() < 66.0
    assert np.abs(np.hypot(points[:, 0], points[:, 1]) - RADIUS_MM).max() < 1.0
    seen = sum(len(profile.points_mm) for profile in profiles)
    assert seen - len(points) == pipe.rejected["below level"] + pipe.rejected.get("contradicted", 0)
    true = 2 * math.degrees(math.acos(66.0 / RADIUS_MM)) / 360.0 * seen
    assert pipe.rejected["below level"] == pytest.approx(true, rel=0.1), "and little of the wall with them"
    assert pipe.diameter_mean_mm == pytest.approx(2 * RADIUS_MM, abs=0.05)
    assert pipe.shape_ovality_max_percent < 0.1


def test_poses_are_fitted_without_what_lies_below() -> None:
    """A level at a fifth of the height pulls on them: 0.4 mm of level before they were fitted again."""
    above, (level,) = without_levels(scan(still(45.0)), CALIBRATION)
    x, y, _ = np.concatenate([profile.points_mm for profile in above]).astype(float).T
    assert abs(np.median(np.hypot(x, y)) - RADIUS_MM) < 0.02
    assert off(level.feature, 45.0) < 0.03


@pytest.mark.deep(gate="tests/unit/wall/test_levels.py::test_half_a_pipe_is_not_measured")
@pytest.mark.parametrize("index", [WATER, None])
def test_a_head_that_is_turned_finds_the_middle(index: float | None) -> None:
    for roll, told, clock in ((20.0, False, 160.0), (-15.0, False, 195.0), (-15.0, True, 180.0)):
        found = only(scan(still(66.0), index=index, roll_deg=roll, told_roll=told))
        assert abs(turn(np.array(found.clock_deg), clock)) < 0.5
        assert off(found, 66.0) < 0.1


@pytest.mark.deep(gate="tests/unit/wall/test_levels.py::test_a_bottom_nobody_saw_is_no_level")
def test_a_slope_is_followed_and_an_uneven_bottom_said() -> None:
    sloped = only(scan(lambda x, z: 66.0 + 0.01 * z + 0.0 * x, index=WATER))
    assert sloped.kind is FeatureKind.WATER and sloped.remark == "flat"
    assert off(sloped, 66.0 + 0.01 * 160.0) < 0.6, "somewhere in the middle"
    uneven = only(scan(lambda x, z: 66.0 + 2.0 * np.sin(x / 9 + 1) * np.cos(z / 23)))
    assert uneven.kind is FeatureKind.DEPOSIT and uneven.remark.startswith("uneven by")
    assert off(uneven, 66.0) < 0.3


@pytest.mark.deep(gate="tests/unit/wall/test_levels.py::test_half_a_pipe_is_not_measured")
def test_a_level_of_a_part_of_the_pipe_ends_where_it_ends() -> None:
    def heap(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        return 68.0 + 0.25 * np.maximum(110.0 - z, 0.0) + 0.2 * np.maximum(z - 200.0, 0.0) + 0.0 * x

    profiles = scan(heap)
    found = only(profiles)
    first, last = found.z_range_mm
    assert 60 < first < 95 and 215 < last < 245, "its corners lie on the wall at 77 and 241 mm"
    assert not survey(profiles, CALIBRATION).defects


def fewer(**changes: Any) -> Calibration:
    return dataclasses.replace(CALIBRATION, **changes)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("index", [WATER, None])
@pytest.mark.parametrize(
    ("calibration", "how"),
    [
        (fewer(rings=CALIBRATION.rings[2:3], colours="RG"), {}),
        (CALIBRATION, {"frames": 5, "every_mm": 40.0}),
        (CALIBRATION, {"noise": 4.0, "bias_mm": 0.15}),
    ],
    ids=["one ring", "rings see different places", "noisy"],
)
def test_where_nobody_can_tell_both_are_within_k2(calibration: Calibration, how: Any, index: float | None) -> None:
    found = only(scan(still(71.0), index=index, calibration=calibration, **how), calibration)
    (level,) = (one for one in found.measures if one.name == "level_mm")
    assert abs(level.value - 71.0) < level.k2
    told = "not told" not in found.remark
    assert found.kind is (FeatureKind.WATER if told and index else FeatureKind.DEPOSIT)


@pytest.mark.deep(gate="tests/unit/wall/test_levels.py::test_half_a_pipe_is_not_measured")
def test_a_level_in_an_oval_pipe_leaves_the_ovality() -> None:
    pipe = survey(scan(still(66.0), wall=lambda c: RADIUS_MM * (1 + 0.03 * np.cos(2 * np.radians(c)))), CALIBRATION)
    (found,) = pipe.features
    assert off(found, 66.0) < 0.1
    (defect,) = pipe.defects
    assert defect.kind == "ovality" and abs(defect.depth_mm - 0.06 * RADIUS_MM) < defect.depth_k2_mm


@pytest.mark.deep(gate="tests/unit/wall/test_levels.py::test_half_a_pipe_is_not_measured")
def test_rods_before_the_level_do_not_hide_it() -> None:
    for rod in (180.0, 150.0):
        assert off(only(scan(still(66.0), index=WATER, rods_deg=(rod, rod + 120, rod + 240))), 66.0) < 0.1


def test_a_bottom_nobody_saw_is_no_level() -> None:
    _, levels = without_levels(scan(still(66.0), index=WATER, unseen=lambda x, z: np.abs(x) < 99), CALIBRATION)
    assert levels == ()


def test_half_a_pipe_is_not_measured() -> None:
    """Beyond a third of the height poses do not find the pipe: nothing is said of a level, and nothing wrong."""
    for index in (WATER, None):
        _, levels = without_levels(scan(still(0.0), index=index), CALIBRATION)
        assert levels == ()


def dent(half_deg: float, depth: float) -> RadiusMap:
    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        away = np.minimum(np.abs(turn(clock, 180.0)) / half_deg, 1.0)
        return round_pipe(clock, z) - depth * np.cos(np.pi / 2 * away) ** 2

    return radius


def rim(outer_mm: float, low_mm: float) -> RadiusMap:
    """Of a tee that stands into the pipe, cut flat."""

    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        a = np.radians(turn(clock, 180.0))
        flat = low_mm / np.maximum(np.cos(a), 0.2)
        there = (np.abs(a) < 1) & (np.hypot(flat * np.sin(a), z - 150.0) < outer_mm / 2)
        return np.where(there, np.minimum(round_pipe(clock, z), flat), round_pipe(clock, z))

    return radius


def stepped(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
    return round_pipe(clock, z) - (z > 150.0) * (3.0 + 5.0 * np.cos(np.radians(clock - 180.0)))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    "wall",
    [
        round_pipe,
        stepped,
        bump(round_pipe, 180, 150, 40, 6),
        rim(40, 72),
        rim(60, 72),
        rim(50, 68),
        *(dent(half, depth) for half in (15, 25, 40) for depth in (2, 4)),
        dent(60, 6),
        *(oval(round_pipe, clock, 0.08) for clock in (0.0, 45.0, 90.0)),
    ],
)
def test_a_wall_is_no_level(wall: RadiusMap) -> None:
    profiles = synthetic_pipe.scan(wall)
    above, levels = without_levels(profiles, CALIBRATION)
    assert levels == () and all(a is b for a, b in zip(above, profiles, strict=True))


@pytest.mark.deep(gate="tests/unit/wall/test_levels.py::test_a_bottom_nobody_saw_is_no_level")
def test_an_arc_below_a_level_is_said_to_be_that() -> None:
    pipe = survey(scan(still(45.0), noise=3.0), CALIBRATION)
    (found,) = pipe.features
    unsure = dataclasses.replace(pipe.wall, shape_covariance=np.full((len(pipe.wall.z_mm), 5, 5), np.inf))
    (finding,) = not_enough_seen(unsure, [found])
    assert "about clock 6:00 lie below deposit" in finding.text
    assert "were not seen" in not_enough_seen(unsure)[0].text


def test_nothing_below_is_nothing_covered() -> None:
    assert not covered((), np.array([180.0]), np.array([[0.0], [1.0]])).any()
    assert without_levels([], CALIBRATION) == ((), ())
