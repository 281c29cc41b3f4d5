"""A pipe squashed over its limit conformed: where it was worst its shape could not be fitted, and such rows were left
out of the maximum. Fails without the ovality places of `unjudged`."""

import numpy as np
import pytest
from over_limit import scanned
from synthetic_pipe import CALIBRATION, RadiusMap, round_pipe

from annulus_pipe.untrusted import parse_toml
from annulus_pipe.wall.conformity import Criteria, Decision, judge
from annulus_pipe.wall.survey import survey

LIMITS = Criteria.from_dict(parse_toml(b"[[ovality]]\nseverity = 3\npercent = 6.0\n"))


def squashed(inner: RadiusMap) -> RadiusMap:
    """Flattened: two waves and a fourth, which five numbers cannot follow."""

    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        much = 6.0 * np.clip(1.5 - np.abs(z - 182.0) / 50.0, 0.0, 1.0)
        t = np.radians(clock)
        return inner(clock, z) + much * np.cos(2 * t) - 0.3 * much * np.cos(4 * t)

    return radius


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("hidden_deg", [60.0, 0.0, 20.0, 40.0, 90.0])
def test_a_dent_that_cannot_be_fitted_leaves_the_verdict_open(hidden_deg: float) -> None:
    found = judge(survey(scanned(squashed(round_pipe), hidden=(147.0, hidden_deg / 2)), CALIBRATION), LIMITS)
    assert found.decision in (Decision.UNDECIDED, Decision.FAILS)
    if found.decision is Decision.UNDECIDED:
        assert any("ovality" in one.kinds and not one.usual for one in found.not_established)


def test_a_round_pipe_conforms() -> None:
    found = judge(survey(scanned(round_pipe), CALIBRATION), LIMITS)
    assert found.decision is Decision.CONFORMS and found.not_established == ()
