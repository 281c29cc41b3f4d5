"""What digs say of a survey: outcomes of every kind, judgements of simulated tools, where to dig next."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.numeric.late import stats
from annulus_pipe.qualification import unity_file
from annulus_pipe.qualification.digs import Dig, DugKind
from annulus_pipe.qualification.matching import SurveyPlace
from annulus_pipe.qualification.trials import Pull, UnseenPlace
from annulus_pipe.qualification.unity import Dug, SurveyResults, ToolClaim, Unity, study
from annulus_pipe.qualification.validation import Outcome
from annulus_pipe.vocabulary import AnnulusError

CLAIM = ToolClaim(0.8, (("", 0.3),), "as claimed")
OWN = ToolClaim(0.95, (), "as the survey states")
NAN = math.nan


def place(i: int, depth: float, k2: float = 0.2, kind: str = "loss", **more: bool) -> SurveyPlace:
    return SurveyPlace(
        f"{'?' if more.get('undecided') else 'D'}{i}", kind, 500.0 * i, 90.0, 20.0, 30.0, depth, k2, **more
    )


def survey(places: Sequence[SurveyPlace], holes: Sequence[UnseenPlace] = (), wall_mm: float = NAN) -> SurveyResults:
    last = max((one.z_mm for one in places), default=2500.0) + 500.0
    return SurveyResults(Pull("results", "", 0.0, last, 50.0, 0.2, holes=tuple(holes)), tuple(places), wall_mm)


def dig(i: float, depth: float, u: float = 0.1, kind: DugKind = DugKind.LOSS, line: int = 2) -> Dig:
    return Dig(line, "", kind, 500.0 * i, 90.0, depth, u, 20.0, 20.0)


def held(places: Sequence[SurveyPlace], digs: Sequence[Dig], claim: ToolClaim = CLAIM) -> Unity:
    return study(survey(places), digs, "digs.csv", claim, 100.0)


def outcomes(unity: Unity) -> list[Dug]:
    return [row.outcome for row in unity.rows]


def test_every_dug_place_has_one_outcome() -> None:
    places = [place(1, 1.0), place(2, 1.0), place(3, 1.0, undecided=True), place(7, 1.0)]
    digs = [
        dig(1, 1.1),
        dig(2, NAN, NAN, DugKind.SOUND),
        dig(3, 0.9),
        dig(4, 1.2),
        dig(5, NAN, NAN, DugKind.SOUND),
        dig(6, 0.9),
        dig(6.5, 0.1),
    ]
    found = study(survey(places, [UnseenPlace(2900.0, 3100.0, 80.0, 40.0)]), digs, "digs.csv", CLAIM, 0.0)
    assert outcomes(found) == [
        Dug.FOUND,
        Dug.FALSE_CALL,
        Dug.UNDECIDED,
        Dug.MISSED,
        Dug.SOUND,
        Dug.NOT_SEEN,
        Dug.SHALLOW,
    ]
    assert (found.count(Dug.FOUND), found.count(Dug.MISSED)) == (1, 1)
    assert (found.confirmed.hits, found.confirmed.n) == (1, 2)
    assert [one.place.name for one in found.next_digs] == ["D7"]


def test_a_dig_beyond_the_scan_says_nothing_of_it() -> None:
    found = held([place(1, 1.0)], [dig(1, 1.0), dig(2.15, 2.0)])
    assert outcomes(found) == [Dug.FOUND, Dug.NOT_SEEN]


def test_both_may_be_off_together() -> None:
    """API 1163: 0.3 mm of the tool at 80 %, 0.1 mm of the dig at k = 2, which is 0.064 mm at 80 %."""
    together = math.hypot(0.3, 0.05 * stats.norm.ppf(0.9))
    found = held([place(1, 1.0), place(2, 1.0)], [dig(1, 1.0 + together - 1e-6), dig(2, 1.0 + together + 1e-6)])
    assert [row.within for row in found.rows] == [True, False]
    assert found.rows[0].tolerance_mm == pytest.approx(together)


def test_a_survey_is_held_to_its_own_k2_where_nothing_else_is_claimed() -> None:
    found = held([place(1, 1.0, 0.05), place(2, 1.0, 0.5), place(3, 1.0, NAN)], [dig(i, 1.3) for i in (1, 2, 3)], OWN)
    assert [row.within for row in found.rows] == [False, True, None]
    assert found.judgement.n == 2 and "1 reported depth without a tolerance" in found.remarks[0]


def test_each_kind_may_have_a_tolerance_of_its_own() -> None:
    claim = ToolClaim(0.8, (("loss", 0.1), ("bump", 0.5)), "pod.json")
    places = [place(1, 1.0), place(2, 1.0, kind="bump"), place(3, 1.0, kind="ovality")]
    digs = [dig(1, 1.3), dig(2, 1.3, kind=DugKind.BUMP), dig(3, 1.3, kind=DugKind.OVALITY)]
    assert [row.within for row in held(places, digs, claim).rows] == [False, True, None]
    assert "within loss ± 0.10 mm, bump ± 0.50 mm (pod.json)" in claim.statement()


def test_a_lower_limit_is_judged_only_where_it_is_too_deep() -> None:
    found = held([place(1, 1.0, at_least=True), place(2, 2.0, at_least=True)], [dig(1, 3.0), dig(2, 1.0)])
    assert [row.within for row in found.rows] == [None, False]
    assert found.sizing.n == 0 and found.sizing.left_out == 2 and found.judgement.n == 1


def test_another_kind_is_found_and_its_depth_not_compared() -> None:
    found = held([place(1, 1.0, kind="bump")], [dig(1, 1.0)])
    assert found.rows[0].outcome is Dug.FOUND and found.rows[0].same_kind is False
    assert (found.identified.hits, found.identified.n, found.sizing.n, found.judgement.n) == (0, 1, 0, 0)


def test_digs_without_uncertainty_are_taken_as_they_are_and_remarked() -> None:
    found = held([place(1, 1.0)], [dig(1, 1.2, NAN)])
    assert found.rows[0].tolerance_mm == pytest.approx(0.3) and "1 dig without an uncertainty" in found.remarks[0]


def test_from_one_dig_hardly_anything_can_be_told() -> None:
    found = held([place(1, 1.0)], [dig(1, 1.0)])
    lines = "\n".join(found.statement())
    assert found.judgement.outcome is Outcome.OPEN and found.judgement.level == 1 and found.judgement.needed == 16
    assert "Bias and slope cannot be told from 1 depths" in lines and "cannot be told, 1 of 5 errors needed" in lines


def test_nothing_found_asks_whether_it_is_the_same_pipe() -> None:
    found = held([place(i, 1.0) for i in range(1, 6)], [dig(i + 0.5, 1.0) for i in range(1, 4)])
    assert outcomes(found) == [Dug.MISSED] * 3 and found.judgement.n == 0
    assert "another pipe" in found.remarks[0]


def test_a_survey_that_lists_nothing_can_be_wrong_by_what_it_misses_alone() -> None:
    found = study(survey([]), [dig(1, 1.0), dig(2, NAN, NAN, DugKind.SOUND)], "digs.csv", OWN, 0.0)
    assert outcomes(found) == [Dug.MISSED, Dug.SOUND] and not found.next_digs


@pytest.mark.parametrize(
    ("digs", "why"),
    [
        ([dig(30, 1.0)], "its digs lie at 15000 to 15000 mm, none of them in the 0 to 2000 mm that results is"),
        ([dig(1 / 1000, 1.0), dig(2 / 1000, 1.0)], "lie where results lists places if z_mm is in metres, not mm"),
        ([dig(1 / 25.4, 1.0)], "lie where results lists places if z_mm is in inches, not mm"),
        ([dig(1, 1.0 / 25.4), dig(2, 2.0 / 25.4)], "reported depths are 25.4 times the dug ones. Is depth_mm in"),
        ([dig(1, 1.0, line=7), dig(2, 20.0, line=8)], "line 8: depth_mm is 20, more than the wall of 8 mm"),
        ([dig(1, 60.0, kind=DugKind.BUMP)], "line 2: depth_mm is 60, more than the pipe's radius of 50 mm"),
    ],
)
def test_digs_of_another_pipe_or_in_other_units_are_refused_in_one_line(digs: list[Dig], why: str) -> None:
    places = [place(1, 1.0), place(2, 2.0), place(3, 1.5)]
    with pytest.raises(AnnulusError, match=why) as error:
        study(survey(places, wall_mm=8.0), digs, "digs.csv", CLAIM, 100.0)
    assert "\n" not in str(error.value)


def test_metres_that_a_shift_would_bring_near_are_metres() -> None:
    """Two defects 33 mm apart: in metres both digs lie at 0, and 96 mm farther each is near enough to one."""
    places = [replace(place(1, 2.0), z_mm=80.0), replace(place(2, 2.0, kind="bump"), z_mm=113.0)]
    digs = [replace(dig(1, 2.0), z_mm=0.080), replace(dig(2, 2.0, kind=DugKind.BUMP), z_mm=0.113)]
    with pytest.raises(AnnulusError, match="if z_mm is in metres"):
        study(survey(places), digs, "digs.csv", CLAIM, 300.0)


def drawn(chance: np.random.Generator, n: int, sigma: float, claim: ToolClaim, dig_sigma: float = 0.05) -> Unity:
    """A study of n digs of a tool whose depths are off by sigma (k = 1)."""
    true = chance.uniform(0.6, 4.0, n)
    reported = true + chance.normal(0.0, sigma, n)
    found = true + chance.normal(0.0, dig_sigma, n)
    places = [place(i + 1, float(reported[i]), 2 * sigma) for i in range(n)]
    return held(places, [dig(i + 1, float(found[i]), 2 * dig_sigma) for i in range(n)], claim)


@pytest.mark.parametrize(
    ("studies", "n"), [(60, 30), *(pytest.param(500, n, marks=pytest.mark.deep) for n in (12, 20, 60))]
)
def test_a_true_claim_is_hardly_ever_rejected_and_a_false_one_hardly_ever_accepted(studies: int, n: int) -> None:
    """2.5 % each, and three standard deviations of what so many studies show."""
    chance = np.random.default_rng(n)
    most = 0.025 + 3 * math.sqrt(0.025 * 0.975 / studies)
    sigma = CLAIM.single_mm / float(stats.norm.ppf(0.9))  # 80 % within 0.3 mm, just so
    true = [drawn(chance, n, sigma, CLAIM).judgement.outcome for _ in range(studies)]
    false = [drawn(chance, n, 1.1 * sigma, CLAIM).judgement.outcome for _ in range(studies)]
    assert true.count(Outcome.REJECTED) <= most * studies
    assert false.count(Outcome.ACCEPTED) <= most * studies


def test_a_tool_twice_as_bad_as_claimed_is_rejected() -> None:
    sigma = CLAIM.single_mm / float(stats.norm.ppf(0.9))
    chance = np.random.default_rng(5)
    judged = [drawn(chance, 40, 2 * sigma, CLAIM).judgement.outcome for _ in range(40)]
    assert judged.count(Outcome.REJECTED) >= 36  # 39 of these; 0.978 of all: 26 of 40 within at most, of 0.48


def test_the_next_dig_is_of_a_kind_that_no_dig_has_verified() -> None:
    places = [place(1, 1.0), place(2, 4.0), place(3, 0.5, kind="bump")]
    found = held(places, [dig(1, 1.0)])
    assert [one.place.name for one in found.next_digs] == ["D3", "D2"]
    assert [one.new_kind for one in found.next_digs] == [True, False]


def test_of_one_kind_the_next_dig_is_what_narrows_bias_and_slope_most() -> None:
    """After two shallow digs a deep one; a place whose own k = 2 is large tells less than a shallower sure one."""
    places = [
        place(1, 1.0),
        place(2, 1.1),
        place(3, 4.0),
        place(4, 1.05),
        place(5, 4.2, 3.0),
        place(6, 9.9, at_least=True),
    ]
    found = held(places, [dig(1, 1.0), dig(2, 1.1)])
    assert [one.place.name for one in found.next_digs] == ["D3", "D4", "D5", "D6"]
    assert found.next_digs[0].remains < 0.5 and found.next_digs[-1].remains == 1.0
    assert "Next dig: D3, loss at 1.500 m" in "\n".join(found.statement())


def test_the_deeper_of_two_that_tell_as_much_comes_first() -> None:
    places = [place(1, 1.0, at_least=True), place(2, 2.0, at_least=True), place(3, 1.0)]
    assert [one.place.name for one in held(places, [dig(3, 1.0)]).next_digs] == ["D2", "D1"]


DEPTHS = st.floats(0.3, 8.0)
UNCERTAIN = st.floats(0.01, 1.0) | st.just(NAN)
KINDS = st.sampled_from([DugKind.LOSS, DugKind.BUMP, DugKind.ANY])
ROWS = st.lists(st.tuples(DEPTHS, UNCERTAIN, DEPTHS, UNCERTAIN, KINDS, st.booleans()), min_size=1, max_size=12)


@settings(max_examples=40, deadline=None)
@given(ROWS, st.sampled_from([CLAIM, OWN]))
def test_a_study_comes_back_from_its_file(
    rows: list[tuple[float, float, float, float, DugKind, bool]], claim: ToolClaim
) -> None:
    places = [place(i, reported, k2, at_least=low) for i, (reported, k2, _, _, _, low) in enumerate(rows, 1)]
    digs = [dig(i, depth, u, kind) for i, (_, _, depth, u, kind, _) in enumerate(rows[: len(rows) // 2 + 1], 1)]
    try:
        made = held(places, digs, claim)
    except AnnulusError as error:  # by chance as if in another unit
        assert "depth_mm in" in str(error)
        return
    again = unity_file.from_dict(unity_file.to_dict(made))
    assert unity_file.to_dict(again) == unity_file.to_dict(made)
    assert len(made.rows) == len(digs) and made.judgement.n <= len(digs)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"format": "annulus-pod/1"}, "its format is 'annulus-pod/1', expected annulus-unity/1"),
        ({"rows": [{"dig": {}}]}, "line is None, expected a whole number"),
        ({"remarks": ["x" * 501]}, "a remark must be a text of at most 500"),
        ({"claim": []}, "claim must be a mapping"),
        ({"line": {"n": 4}}, "line.confidence is None"),
    ],
)
def test_a_file_that_somebody_changed_is_refused_in_one_line(
    tmp_path: Path, change: dict[str, object], why: str
) -> None:
    path = tmp_path / "unity.json"
    path.write_text(json.dumps(unity_file.to_dict(held([place(1, 1.0)], [dig(1, 1.0)])) | change))
    with pytest.raises(AnnulusError, match=why) as error:
        unity_file.read_unity(path)
    assert "\n" not in str(error.value)
