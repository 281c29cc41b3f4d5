"""A loss of 3 mm all round, from one place to the scan's end, was listed as a joint with a step of 6 mm and conformed
to a loss of 2 mm: where a wider stretch's other end was not seen nothing tells it from another pipe."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, NOISE_MM, round_pipe, scan

from annulus_pipe.wall.conformity import Criteria, Decision, judge
from annulus_pipe.wall.survey import survey


@pytest.mark.parametrize("behind", [True, pytest.param(False, marks=pytest.mark.deep(but=1))])
def test_a_wider_stretch_without_an_end_is_open(behind: bool) -> None:
    def wall(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        return round_pipe(clock, z) + 3.0 * ((z > 190.0) == behind)

    noise = np.array(NOISE_MM, np.float32)
    seen = [replace(one, sigma_mm=noise[one.ring]) for one in scan(wall, z_mm=[4.0 * i for i in range(40)])]
    pipe = survey(seen, CALIBRATION)

    def decided(limit_mm: float) -> Decision:
        return judge(
            pipe, Criteria.from_dict({"accept_severity": 0, "loss": [{"severity": 1, "depth_mm": limit_mm}]})
        ).decision

    assert decided(2.0) in (Decision.FAILS, Decision.UNDECIDED)
    assert decided(4.0) is Decision.SEEN or not behind
