"""A loss of 3 mm that too little was known of to list it stood in a counter only, and its pipe conformed. Fails where
what is not sure is not told of as undecided."""

from dataclasses import replace

import numpy as np
from over_limit import scanned
from synthetic_pipe import CALIBRATION, pocket, round_pipe

from annulus_pipe.untrusted import parse_toml
from annulus_pipe.wall.conformity import Criteria, Decision, judge
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.survey import survey

LIMITS = Criteria.from_dict(parse_toml(b"[[loss]]\nseverity = 3\ndepth_mm = 2.0\n"))


def test_a_place_that_was_not_confirmed_leaves_the_verdict_open() -> None:
    profiles = scanned(pocket(round_pipe, 200, 3, 172, 180, 2.4))
    unsure = [replace(one, sigma_mm=np.full_like(one.sigma_mm, 0.9)) for one in profiles]
    pipe = survey(unsure, CALIBRATION)
    assert pipe.defects == () and [one.kind for one in pipe.detection.undecided] == [Kind.LOSS]
    assert abs(pipe.detection.undecided[0].z_mm - 176) < 6
    assert judge(pipe, LIMITS).decision is Decision.UNDECIDED


def test_a_hole_that_its_own_rim_throws_is_none_that_every_scan_has() -> None:
    """Of a pocket too short for its depth the map shows a hole only."""
    pipe = survey(scanned(pocket(round_pipe, 200, 3, 174, 180, 2.4)), CALIBRATION)
    assert pipe.defects == ()
    assert judge(pipe, LIMITS).decision is Decision.UNDECIDED
