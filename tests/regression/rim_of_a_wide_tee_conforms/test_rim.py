"""A tee of 38 mm bore and more, whose rim stood 4 mm in, was a branch, and a limit of 3 mm of protrusion conformed:
a rim cut square stands out before and behind so wide a bore, and not at its sides. Fails without `may_stand`."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, NOISE_MM, opening, round_pipe, scan

from annulus_pipe.wall.conformity import Criteria, Decision, judge
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.survey import Survey, survey

LIMITS = Criteria.from_dict({"tee": [{"severity": 1, "protrusion_mm": 3.0}]})


def surveyed(bore_mm: float, stands_mm: float) -> Survey:
    rim = bore_mm + 16.0 if stands_mm else 0.0
    radius = opening(round_pipe, 285.0, 170.0, bore_mm, rim, stands_mm)
    sigma = np.array(NOISE_MM, np.float32)
    profiles = scan(radius, z_mm=[2.4 * i for i in range(70) if i % 5 != 4], directions=360, steep=True)
    return survey([replace(one, sigma_mm=sigma[one.ring]) for one in profiles], CALIBRATION)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("bore_mm", [38.0, 45.0, 60.0])
def test_what_stands_in_and_was_not_measured_does_not_conform(bore_mm: float) -> None:
    pipe = surveyed(bore_mm, 4.0)
    (one,) = pipe.features
    assert one.kind is FeatureKind.BRANCH and np.isnan(one.measured("protrusion_mm"))
    assert judge(pipe, LIMITS).decision is Decision.UNDECIDED


def test_a_branch_without_a_rim_has_no_protrusion() -> None:
    pipe = surveyed(45.0, 0.0)
    assert [[one.name for one in feature.measures] for feature in pipe.features] == [["inner_d_mm"]]
    assert judge(pipe, LIMITS).decision.value.startswith("conforms")
