"""Two pipes 8 mm apart and 3 mm aside of one another conformed to a hi-lo of 1.5 mm: what is called a gap was held
against the limits of gaps only. Fails with the limits of joints asked of joints only."""

from dataclasses import dataclass

import pytest

from annulus_pipe.untrusted import parse_toml
from annulus_pipe.wall.conformity import Criteria, Decision, _of_feature
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure

LIMITS = "[[gap]]\nseverity = 3\ngap_mm = 10.0\n[[joint]]\nseverity = 3\nhilo_mm = 1.5\nbead_height_mm = 2.0\n"


@dataclass(frozen=True)
class Case:
    hilo_mm: float
    decision: Decision


@pytest.mark.parametrize(
    "case", [Case(3.0, Decision.FAILS), Case(1.45, Decision.UNDECIDED), Case(1.0, Decision.CONFORMS)]
)
def test_a_coupling_is_held_against_the_limits_of_joints(case: Case) -> None:
    measures = FeatureMeasure("gap_mm", 8.0, 1.0), FeatureMeasure("hilo_mm", case.hilo_mm, 0.1)
    coupling = Feature(FeatureKind.GAP, 180.0, 8.0, measures=measures, remark="coupling")
    found = {
        (one.kind, one.quantity): one
        for one in _of_feature(0, coupling, Criteria.from_dict(parse_toml(LIMITS.encode())))
    }
    assert found.keys() == {("gap", "gap_mm"), ("joint", "hilo_mm")}, "it has no bead"
    assert found["gap", "gap_mm"].decision is Decision.CONFORMS
    assert found["joint", "hilo_mm"].decision is case.decision
