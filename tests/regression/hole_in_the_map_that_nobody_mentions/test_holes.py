"""A pocket behind a joint left a hole of just its shape in the map, and a report without limits was silent on it;
strips of rods stood in thirty lines, and hid the rest. Fails without `find_holes`, and where only a verdict names its
places."""

import numpy as np
import pytest
from over_limit import RODS_DEG, scanned
from synthetic_pipe import CALIBRATION, RadiusMap, pocket, round_pipe

from annulus_pipe.report import ScanAccount
from annulus_pipe.report.page import _verdict
from annulus_pipe.report.summary import summarize
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.unjudged import Unjudged

HERE = "tests/regression/hole_in_the_map_that_nobody_mentions/test_holes.py"


def holes(pipe: Survey) -> list[Unjudged]:
    return [one for one in pipe.unjudged if one.is_hole and not one.usual]


def bead(inner: RadiusMap, at_mm: float) -> RadiusMap:
    return lambda c, z: inner(c, z) - 1.5 * np.sqrt(np.maximum(1.0 - ((z - at_mm) / 5.0) ** 2, 0.0))


def without(profiles: list[Profile], clock: tuple[float, float], z_mm: tuple[float, float]) -> list[Profile]:
    out = []
    for one in profiles:
        x, y, z = one.points_mm.T
        away = np.abs((np.degrees(np.arctan2(x, -y)) - clock[0] + 180.0) % 360.0 - 180.0)
        out.append(one.without((away < clock[1]) & (z > z_mm[0]) & (z < z_mm[1]), "swallowed"))
    return out


def test_rods_are_a_line_each_and_open_nothing() -> None:
    pipe = survey(scanned(round_pipe), CALIBRATION)
    assert holes(pipe) == []
    rods = [one for one in pipe.unjudged if one.is_hole and "rod" in one.reason]
    assert len(rods) == 3 and all(one.z_to_mm - one.z_from_mm > 180 for one in rods)
    assert np.allclose(sorted(one.clock_deg for one in rods), RODS_DEG, atol=2)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("clock", "z_mm", "reason"), [((45.0, 25.0), (0.0, 500.0), "over-exposed"), ((45.0, 6.0), (170.0, 184.0), "light")]
)
def test_a_hole_is_told_of_with_why(clock: tuple[float, float], z_mm: tuple[float, float], reason: str) -> None:
    pipe = survey(without(scanned(round_pipe), clock, z_mm), CALIBRATION)
    (hole,) = holes(pipe)
    assert reason in hole.reason and abs(hole.clock_deg - clock[0]) < 2 and abs(hole.arc_deg - 2 * clock[1]) < 4
    assert abs(hole.z_from_mm - max(z_mm[0], pipe.scanned_mm[0])) < 3
    assert abs(hole.z_to_mm - min(z_mm[1], pipe.scanned_mm[1])) < 3
    reported = summarize(pipe, ScanAccount("x", {}, {}, {}, ()), 0.0)["not_seen"]
    assert [one["reason"] for one in reported if not one["usual"]] == [hole.reason]
    assert "1 place of the wall was not seen" in _verdict(pipe)


@pytest.mark.deep(gate=f"{HERE}::test_a_hole_is_told_of_with_why")
def test_frames_that_were_lost_leave_a_hole() -> None:
    frames = scanned(round_pipe, stations=np.arange(0.0, 170.0, 2.4))
    pipe = survey([one for one in frames if not 24 < one.z_mm < 134], CALIBRATION)
    assert any("no ring" in one.reason for one in holes(pipe)), [one.words for one in pipe.unjudged]


@pytest.mark.deep(gate=f"{HERE}::test_a_hole_is_told_of_with_why")
@pytest.mark.parametrize("half_deg", [5, 8, 12])
def test_a_pocket_behind_a_joint_is_listed_or_told_of(half_deg: float) -> None:
    pipe = survey(scanned(bead(pocket(round_pipe, 60, half_deg, 183, 191, 3.0), 176.0)), CALIBRATION)
    places = [(one.z_range_mm, one.clock_deg) for one in (*pipe.defects, *pipe.detection.undecided)]
    places += [((one.z_from_mm, one.z_to_mm), one.clock_deg) for one in holes(pipe)]
    assert any(z[0] < 191 and z[1] > 183 and abs(clock - 60) < 8 for z, clock in places)
