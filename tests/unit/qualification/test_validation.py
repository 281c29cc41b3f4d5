"""What is made of so many measurements within a tolerance out of so many, against published intervals."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.extras import need
from annulus_pipe.numeric.late import stats
from annulus_pipe.qualification.validation import ClaimJudgement, Outcome, Proportion, judge_claim, needed, proportion

ERROR = 0.025  # each way, of an interval of 95 % confidence
COUNTS = st.integers(0, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
PARTS = st.floats(0.05, 0.99)


@pytest.mark.parametrize(
    ("hits", "n", "confidence", "lower", "upper"),
    [  # the example table of codingace.net/statistics/clopper_pearson_interval.html, as printed
        (3, 20, 0.95, 0.0321, 0.3789),
        (12, 30, 0.90, 0.2495, 0.5661),
        (42, 100, 0.95, 0.3220, 0.5229),
        (85, 120, 0.99, 0.5904, 0.8092),
    ],
)
def test_published_intervals_come_out_to_their_digits(
    hits: int, n: int, confidence: float, lower: float, upper: float
) -> None:
    found = proportion(hits, n, confidence)
    assert (round(found.lower, 4), round(found.upper, 4)) == (lower, upper)


@pytest.mark.parametrize(("hits", "n"), [(0, 7), (7, 7), (11, 14), (180, 231)])
def test_two_other_libraries_give_the_same_interval(hits: int, n: int) -> None:
    found = proportion(hits, n)
    theirs = need("statsmodels.stats.proportion").proportion_confint(hits, n, alpha=0.05, method="beta")
    scipys = stats.binomtest(hits, n).proportion_ci(0.95, method="exact")
    for low, high in (theirs, scipys):
        assert (found.lower, found.upper) == pytest.approx((low if hits else 0.0, high if hits < n else 1.0), abs=1e-9)


def test_eighty_percent_is_accepted_from_seventeen_measurements_on_and_ninety_from_thirty_six() -> None:
    """0.80^17 and 0.90^36 are the first powers below 2.5 %."""
    assert (needed(0, 0, 0.80), needed(0, 0, 0.90)) == (17, 36)
    assert judge_claim(17, 17).outcome is Outcome.ACCEPTED
    assert judge_claim(16, 16).outcome is Outcome.OPEN


def test_a_level_says_what_so_many_measurements_could_decide() -> None:
    assert [judge_claim(n, n).level for n in (0, 2, 3, 16, 17)] == [1, 1, 2, 2, 3]


@pytest.mark.parametrize("n", [5, 12, 40])
def test_the_one_sided_outcome_is_the_exact_binomial_test(n: int) -> None:
    for hits in range(n + 1):
        p_value = stats.binomtest(hits, n, 0.8, alternative="less").pvalue
        assert (judge_claim(hits, n).one_sided is Outcome.REJECTED) == (p_value < 0.05)


def wrong_rates(n: int, certainty: float, true: float) -> tuple[float, float]:
    """How often a tool with `true` of its measurements within is accepted, and rejected; exact, all counts summed."""
    judged = [(judge_claim(hits, n, certainty).outcome, stats.binom.pmf(hits, n, true)) for hits in range(n + 1)]
    return tuple(sum(p for outcome, p in judged if outcome is which) for which in (Outcome.ACCEPTED, Outcome.REJECTED))


@pytest.mark.parametrize(
    ("n", "certainty"),
    [(30, 0.8), *(pytest.param(n, c, marks=pytest.mark.deep) for n in (17, 60, 150, 400) for c in (0.8, 0.9))],
)
def test_a_false_claim_is_accepted_and_a_true_one_rejected_no_oftener_than_stated(n: int, certainty: float) -> None:
    for true in (certainty - 0.2, certainty - 0.02, certainty - 1e-9):
        assert wrong_rates(n, certainty, true)[0] <= ERROR
    for true in (certainty, certainty + 0.02, certainty + 0.09):
        assert wrong_rates(n, certainty, true)[1] <= ERROR


def test_nothing_measured_proves_and_disputes_nothing() -> None:
    judged = judge_claim(0, 0)
    assert judged.outcome is judged.one_sided is Outcome.OPEN and judged.level == 1
    assert math.isnan(judged.proportion.value) and "was not tried" in judged.statement()


@settings(max_examples=60, deadline=None)
@given(COUNTS, PARTS)
def test_so_many_more_accept_a_claim_and_one_fewer_does_not(counts: tuple[int, int], certainty: float) -> None:
    hits, n = counts
    more = needed(hits, n, certainty)
    assert judge_claim(hits + more, n + more, certainty).outcome is Outcome.ACCEPTED
    if more:
        assert judge_claim(hits + more - 1, n + more - 1, certainty).outcome is not Outcome.ACCEPTED


@settings(max_examples=60, deadline=None)
@given(COUNTS, PARTS, st.floats(0.6, 0.99))
def test_a_judgement_comes_back_from_its_file(counts: tuple[int, int], certainty: float, confidence: float) -> None:
    judged = judge_claim(*counts, certainty, confidence)
    again = ClaimJudgement.from_dict(judged.to_dict())
    assert again.to_dict() == judged.to_dict() and again.statement() == judged.statement()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"n": -1}, "n is -1, expected a whole number in 0"),
        ({"hits": 9}, "hits is 9, expected a whole number in 0..5"),
        ({"lower": "0.1"}, "lower is '0.1', expected a number in 0..1"),
    ],
)
def test_a_file_that_somebody_changed_is_refused_in_one_line(change: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Proportion.from_dict(proportion(3, 5).to_dict() | change)


def test_counts_and_parts_that_are_none_are_refused() -> None:
    for wrong in (lambda: proportion(6, 5), lambda: judge_claim(3, 5, 1.0), lambda: proportion(3, 5, 0.5, sides=1)):
        with pytest.raises(ValueError, match="expected"):
            wrong()
