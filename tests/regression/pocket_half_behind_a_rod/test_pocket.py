"""A pocket of 3.0 mm half behind a rod read as 0.6 mm and conformed: what is deepest of it may lie where nobody saw.
Fails without the places of `unjudged` that go on."""

import numpy as np
from over_limit import scanned
from synthetic_pipe import CALIBRATION, pocket, round_pipe

from annulus_pipe.untrusted import parse_toml
from annulus_pipe.wall.conformity import Criteria, Decision, judge
from annulus_pipe.wall.survey import survey

LIMITS = Criteria.from_dict(parse_toml(b"[[loss]]\nseverity = 3\ndepth_mm = 2.0\n"))


def test_a_shallow_place_beside_a_rods_shadow_is_not_accepted() -> None:
    wall = pocket(pocket(round_pipe, 227, 3.5, 170, 195, 2.2), 236, 9, 170, 195, 0.8)  # the deeper part is hidden
    pipe = survey(scanned(wall), CALIBRATION)
    assert [round(one.depth_mm, 1) for one in pipe.defects] == [0.8]
    found = judge(pipe, LIMITS)
    assert found.decision is Decision.UNDECIDED
    place = next(one for one in found.not_established if not one.usual)
    assert place.kinds == ("loss",) and place.z_from_mm < 182 < place.z_to_mm
    assert abs(np.mod(place.clock_deg - 231 + 180, 360) - 180) < 10


def test_rods_alone_leave_nothing_open() -> None:
    found = judge(survey(scanned(round_pipe), CALIBRATION), LIMITS)
    assert found.decision is Decision.SEEN, "and says which strips it does not speak of"
    strips = [one for one in found.not_established if "rod" in one.reason]
    assert len(strips) == 3 and all(one.usual for one in found.not_established)
