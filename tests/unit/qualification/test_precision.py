"""ASTM E691's own study, glucose in serum: data as NIST publishes them, statistics by NIST's definitions."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from annulus_pipe.qualification.precision import components, precision

STUDY: dict[str, Any] = json.loads((Path(__file__).parents[2] / "data/e691_glucose.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("material", "ABCDE")
def test_the_glucose_study_comes_out(material: str) -> None:
    made, known = precision(np.array(STUDY["materials"][material])), STUDY["statistics"][material]
    for name, value in (
        ("mean", made.mean),
        ("s_cell_averages", made.s_means),
        ("s_r", made.s_r),
        ("s_R", made.s_R),
        ("cell_averages", made.cell_mean),
        ("cell_deviations", made.cell_sd),
    ):
        assert np.abs(np.subtract(known[name], value)).max() <= 0.6e-4, name
    for name, value in (("r", made.r), ("R", made.R), ("h", made.h), ("k", made.k)):
        assert np.abs(np.subtract(known[name], value)).max() <= 0.6e-2, name
    assert round(made.h_critical, 2) == STUDY["critical_h"] and round(made.k_critical, 2) == STUDY["critical_k"]


def test_what_e691_flags_is_flagged() -> None:
    """Laboratory 4's reading of C, and laboratory 2's of E, stand beyond the critical k, as the standard discusses."""
    flagged = {
        (material, i + 1)
        for material, values in STUDY["materials"].items()
        for made in [precision(np.array(values))]
        for i, k in enumerate(made.k)
        if k > made.k_critical
    }
    assert flagged == {("C", 4), ("E", 2)}


@pytest.mark.parametrize("values", [np.zeros((1, 5)), np.zeros((5, 1)), np.full((2, 2), np.nan)])
def test_too_little_is_refused(values: Any) -> None:
    with pytest.raises(ValueError, match=r"expected 2 of both|a result is missing"):
        precision(values)


def test_operators_who_differ_by_less_than_their_repeats_do_not_differ() -> None:
    """E691: a reproducibility below the repeatability is set to it; of one piece, and of all together."""
    errors = np.array([[[-1.0, 1.0], [-1.0, 1.0]], [[-2.0, 2.0], [-2.0, 2.0]], [[3.0, -3.0], [3.0, -3.0]]])
    of_all = components(errors)
    assert of_all.reproducibility().value == of_all.repeatability().value > 0
    assert of_all.reproducibility().low <= of_all.reproducibility().value <= of_all.reproducibility().high
    assert all(one.s_R == one.s_r for one in map(precision, errors))
