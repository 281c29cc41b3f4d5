"""How far off reported sizes are, against published factors and simulated tools whose errors are known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.numeric.late import stats
from annulus_pipe.qualification.sizing import (
    Basis,
    SizedPair,
    Sizing,
    normal_factor,
    order_needed,
    order_statistic,
    size_errors,
)


@pytest.mark.parametrize(
    ("certainty", "factors"),
    [  # Meeker, Hahn and Escobar, Statistical Intervals (2nd ed.), Tables J.5a and J.5b, 95 % confidence, as printed
        (0.80, {2: 24.722, 5: 3.375, 10: 2.234, 14: 1.985, 20: 1.809, 30: 1.672}),
        (0.90, {2: 31.092, 5: 4.291, 10: 2.856, 14: 2.542, 17: 2.410}),
    ],
)
def test_published_two_sided_factors_come_out_to_their_digits(certainty: float, factors: dict[int, float]) -> None:
    assert {n: round(normal_factor(n, certainty), 3) for n in factors} == factors


def test_factors_of_iso_16269_6_come_out_to_their_digits() -> None:
    """Annex F, Table F.1 (90 % of the population, 90 % confidence), which rounds up."""
    printed = {2: 15.5124, 8: 2.7542, 16: 2.2537, 35: 1.9906, 100: 1.8232}
    assert {n: math.ceil(1e4 * normal_factor(n, 0.90, 0.90)) / 1e4 for n in printed} == printed


def test_published_order_statistics_come_out() -> None:
    """Meeker, Hahn and Escobar, Table J.11 (95 % confidence): which of n, counted from the largest."""
    printed = {(0.90, 50): 2, (0.90, 100): 5, (0.90, 200): 13, (0.95, 60): 1, (0.95, 100): 2, (0.95, 200): 5}
    assert {(p, n): n - (order_statistic(n, p) or 0) + 1 for p, n in printed} == printed


def test_fourteen_errors_bound_eighty_percent_and_twenty_nine_ninety_without_any_assumption() -> None:
    assert (order_needed(0.80), order_needed(0.90)) == (14, 29)
    assert [order_statistic(n, 0.90) for n in (28, 29)] == [None, 29]


def study(chance: np.random.Generator, n: int, bias: float, sd: float, true_sd: float) -> Sizing:
    true = chance.uniform(0.5, 4.0, n)
    reported = true + chance.normal(bias, sd, n)
    found = true + chance.normal(0.0, true_sd, n)
    return size_errors([SizedPair(r, t, 2 * true_sd) for r, t in zip(reported, found, strict=True)])


def kept(studies: int, n: int, bias: float, sd: float, true_sd: float) -> list[float]:
    """In which part of the studies a tolerance really holds its certainty of the tool's own errors."""
    chance = np.random.default_rng(n)
    held = np.zeros(2)
    for _ in range(studies):
        for i, one in enumerate(study(chance, n, bias, sd, true_sd).tolerances):
            inside = stats.norm.cdf((one.tolerance_mm - bias) / sd) - stats.norm.cdf((-one.tolerance_mm - bias) / sd)
            held[i] += inside >= one.certainty
    return list(held / studies)


@pytest.mark.parametrize(
    ("studies", "n", "bias", "true_sd"),
    [
        (200, 30, 0.03, 0.0),
        *(
            pytest.param(2000, n, bias, true_sd, marks=pytest.mark.deep)
            for n in (5, 8, 14, 29, 60)
            for bias, true_sd in ((0.0, 0.0), (0.1, 0.0), (0.0, 0.05))
        ),
    ],
)
def test_a_tolerance_holds_in_as_many_studies_as_it_states(studies: int, n: int, bias: float, true_sd: float) -> None:
    """Of 95 % confidence, less three standard deviations of what so many studies show."""
    short = 3 * math.sqrt(0.95 * 0.05 / studies)
    assert min(kept(studies, n, bias, 0.1, true_sd)) >= 0.95 - short


def test_what_the_truths_may_be_off_is_taken_off_the_spread_alone() -> None:
    sizing = study(np.random.default_rng(3), 4000, 0.02, 0.06, 0.08)
    assert sizing.sd_mm == pytest.approx(0.10, abs=0.004)
    assert sizing.sd_own_mm == pytest.approx(0.06, abs=0.005)


def test_truths_that_explain_every_error_leave_the_tool_none() -> None:
    sizing = study(np.random.default_rng(3), 40, 0.0, 0.001, 0.08)
    better = size_errors([SizedPair(1.0 + 0.01 * (i % 2), 1.0, 0.5) for i in range(6)])
    assert sizing.sd_own_mm < 0.05 and better.sd_own_mm == 0.0
    assert "no larger than what the true sizes may be off themselves" in " ".join(better.statement())


def test_a_lower_limit_is_no_error() -> None:
    pairs = [SizedPair(1.0 + 0.01 * i, 1.0) for i in range(6)]
    sizing = size_errors([*pairs, SizedPair(0.2, 3.0, at_least=True)])
    assert (sizing.n, sizing.left_out) == (6, 1) and sizing.mean_mm == pytest.approx(0.025)
    assert "left out, reported as lower limits: 1" in sizing.statement()


@pytest.mark.parametrize(
    ("n", "bases"), [(4, (Basis.NONE,) * 2), (13, (Basis.NORMAL,) * 2), (14, (Basis.DISTRIBUTION_FREE, Basis.NORMAL))]
)
def test_a_tolerance_says_what_it_rests_on(n: int, bases: tuple[Basis, ...]) -> None:
    sizing = size_errors([SizedPair(1.0 + 0.01 * i, 1.0) for i in range(n)])
    assert tuple(one.basis for one in sizing.tolerances) == bases
    if n == 4:
        assert "cannot be told, 4 of 5 errors needed" in sizing.statement()[-2] + sizing.statement()[-3]


def test_no_size_says_nothing() -> None:
    sizing = size_errors([])
    assert math.isnan(sizing.mean_mm) and all("cannot be told, 0 of 5" in line for line in sizing.statement())


MM = st.floats(-50.0, 50.0)
PAIRS = st.lists(st.builds(SizedPair, MM, MM, st.none() | st.floats(0.0, 5.0), st.booleans()), max_size=40)


@settings(max_examples=40, deadline=None)
@given(PAIRS)
def test_a_sizing_comes_back_from_its_file(pairs: list[SizedPair]) -> None:
    sizing = size_errors(pairs)
    again = Sizing.from_dict(sizing.to_dict())
    assert again.to_dict() == sizing.to_dict() and again.statement() == sizing.statement()
    assert sizing.n + sizing.left_out == len(pairs)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e9])
def test_a_size_that_is_no_number_is_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="expected numbers"):
        size_errors([SizedPair(wrong, 1.0)])


def test_a_file_that_somebody_changed_is_refused_in_one_line() -> None:
    good = size_errors([SizedPair(1.0, 1.0)]).to_dict()
    for change, why in (
        ({"n": "1"}, "n is '1'"),
        ({"tolerances": 3}, "tolerances must be"),
        ({"sd_mm": []}, "sd_mm is"),
    ):
        with pytest.raises(ValueError, match=why):
            Sizing.from_dict(good | change)
