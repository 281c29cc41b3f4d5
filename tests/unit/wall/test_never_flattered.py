"""A pipe with something over its limit never conforms, and a sound one that was seen well does.

Constants were set with draws 1 to 61 and 301 to 325 in view; the others are held out. "Conforms where seen" is said
with the places that were not.
"""

import numpy as np
import pytest
from over_limit import LIMITS, Drawn, draw, scanned
from synthetic_pipe import CALIBRATION, round_pipe

from annulus_pipe.untrusted import parse_toml
from annulus_pipe.wall.conformity import Criteria, Decision, Verdict, judge
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import survey


def verdict(drawn: Drawn, profiles: list[Profile]) -> tuple[Verdict, tuple[float, float]]:
    """And from where to where there is a wall, mm."""
    pipe = survey(profiles, CALIBRATION)
    told = judge(pipe, Criteria.from_dict(parse_toml(LIMITS[drawn.kind].encode())))
    return told, (float(pipe.wall.z_mm[0]), float(pipe.wall.z_mm[-1]))


def in_sight(drawn: Drawn, told: Verdict, scanned_mm: tuple[float, float]) -> float:
    """Part of what is over the limit that lies in no place of which the verdict says that it was not judged. Where
    frames were lost at an end of the scan there may be nothing left of it.
    """
    z, clock = np.arange(70.0, 300.0, 0.5)[:, None], np.arange(0.25, 360.0, 0.5)[None, :]
    over = np.asarray(drawn.over(clock, z)) & (z > max(82.0, scanned_mm[0])) & (z < min(282.0, scanned_mm[1]))
    left = over.copy()
    for one in told.not_established:
        away = np.abs((clock - one.clock_deg + 180.0) % 360.0 - 180.0)
        left &= ~((z >= one.z_from_mm - 3.0) & (z <= one.z_to_mm + 3.0) & (away <= one.arc_deg / 2 + 2.0))
    return float(left.sum() / max(over.sum(), 1))


@pytest.mark.deep(but=4)
@pytest.mark.parametrize("seed", range(1, 401, 2))
def test_what_is_over_its_limit_never_conforms(seed: int) -> None:
    drawn = draw(seed)
    told, scanned_mm = verdict(drawn, drawn.pipe())
    if told.decision in (Decision.CONFORMS, Decision.SEEN):
        assert in_sight(drawn, told, scanned_mm) < 0.1, str(drawn)


@pytest.mark.deep(but=2)
@pytest.mark.parametrize("seed", range(1, 81, 2))
def test_a_sound_pipe_is_not_called_bad(seed: int) -> None:
    drawn = draw(seed)
    told, _ = verdict(drawn, drawn.sound_pipe())
    assert told.decision is not Decision.FAILS, str(drawn)
    if drawn.way == "well" and not (drawn.kind == "joint" and drawn.place == "beside a joint"):
        assert told.decision in (Decision.CONFORMS, Decision.SEEN), str(drawn)


def test_what_no_ring_landed_in_is_no_sound_wall() -> None:
    """A pocket 3 mm deep and 9.5 mm long, whose floor lay between two rings 8.8 mm apart: the map went over it."""
    drawn = draw(293)
    told, _ = verdict(drawn, drawn.pipe())
    assert told.decision is Decision.UNDECIDED
    between = [one for one in told.not_established if one.z_from_mm <= 205.0 and one.z_to_mm >= 210.0 and not one.usual]
    assert between and all("between rings" in one.reason for one in between)


def test_at_an_end_of_a_scan_no_joint_is_judged() -> None:
    """Hi-lo 3 mm where the wall of the scan begins: there is no other pipe to hold it against."""
    pipe = survey(scanned(lambda c, z: round_pipe(c, z) + 3.0 * np.cos(np.radians(c)) * (z > 84.0)), CALIBRATION)
    told = judge(pipe, Criteria.from_dict(parse_toml(LIMITS["joint"].encode())))
    first, last = pipe.wall.extent[:2]
    assert told.decision is Decision.SEEN
    ends = [(one.z_from_mm, one.z_to_mm) for one in told.not_established if one.kinds == ("joint",)]
    assert ends[0][0] == first <= 84.0 < ends[0][1] and ends[-1][1] == last
