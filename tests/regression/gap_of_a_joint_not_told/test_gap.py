"""Gaps of 7 to 9 mm conformed to a limit of 6: no joint of which the gap was told, so no limit was asked. Fails without
the places where no sound wall goes all round (`apart`)."""

import numpy as np
import pytest
from over_limit import scanned
from synthetic_pipe import CALIBRATION, round_pipe

from annulus_pipe.untrusted import parse_toml
from annulus_pipe.wall.conformity import Criteria, Decision, Verdict, judge
from annulus_pipe.wall.survey import survey

EVERY_SECOND = np.array([2.4 * i for i in range(50) if i % 5 != 4])[::2]
GAP = "[[gap]]\nseverity = 3\ngap_mm = 6.0\n"


def verdict(gap_mm: float, limits: str = GAP, stations: np.ndarray | None = None, step_mm: float = 0.0) -> Verdict:
    def wall(c: np.ndarray, z: np.ndarray) -> np.ndarray:
        return round_pipe(c, z) + 6.0 * (np.abs(z - 181.0) < gap_mm / 2) + step_mm * (z > 181.0)

    return judge(survey(scanned(wall, stations=stations), CALIBRATION), Criteria.from_dict(parse_toml(limits.encode())))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("gap_mm", [8.0, 7.0, 9.0])
def test_a_gap_between_pipes_in_line_is_not_accepted(gap_mm: float) -> None:
    found = verdict(gap_mm)
    assert found.decision is Decision.UNDECIDED
    assert any("gap" in one.kinds and one.z_from_mm < 181.0 < one.z_to_mm for one in found.not_established)


def test_nor_is_one_at_a_step_of_radius_whatever_its_depth_is_called() -> None:
    """The joint was found, its kind was not told."""
    limits = GAP + "[[loss]]\nseverity = 3\ndepth_mm = 4.0\n"
    assert verdict(8.0, limits, EVERY_SECOND, step_mm=1.0).decision is Decision.UNDECIDED


def test_a_pipe_without_one_conforms() -> None:
    assert verdict(0.0).decision is Decision.CONFORMS
