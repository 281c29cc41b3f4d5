"""pod.json: what a head detects, as a report quotes it, and what a study cannot tell."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import poisson

from annulus_pipe.qualification.applicability import Applicability, HeadInUse
from annulus_pipe.qualification.pod import Detectability, FalseCalls, detectability, pod_json, read_pod
from annulus_pipe.qualification.sizes import plan_sizes, spools
from annulus_pipe.qualification.trials import (
    GATE_MM,
    Pull,
    Reported,
    Trial,
    Trials,
    TrialState,
    TrueDefect,
    UnseenPlace,
    match,
)
from annulus_pipe.report.pod_page import pictures
from annulus_pipe.vocabulary import AnnulusError

PULL = Pull("pull 1", "spool A", 0.0, 20_000.0, 75.0, 0.5, "7", "0.9", "2026-11-29")


def truths(count: int, laid: bool = True) -> list[TrueDefect]:
    rng = np.random.default_rng(1)
    depths = rng.permutation(np.linspace(0.1, 3.0, count))
    return [
        TrueDefect(f"{i}", "loss", 200.0 + 150 * i, 47.0 * i % 360, float(one), 20.0, 20.0, i % 3 == 0, "spool A", laid)
        for i, one in enumerate(depths)
    ]


def reports(laid: list[TrueDefect], seed: int = 2) -> list[Reported]:
    """Of a head that lists what reads deeper than 0.5 mm; one in twenty is named wrong, one report is of nothing."""
    rng = np.random.default_rng(seed)
    read = [one.depth_mm + 0.15 * rng.standard_normal() for one in laid]
    found = [
        Reported("bump" if i % 20 == 19 else "loss", one.z_mm + 2, one.clock_deg, depth, 0.2, 20.0, 15.0)
        for i, (one, depth) in enumerate(zip(laid, read, strict=True))
        if depth > 0.5
    ]
    return [*found, Reported("loss", 19_000.0, 10.0, 0.6, 0.2, 10.0, 10.0)]


@cache
def study() -> Detectability:
    laid = truths(90)
    return detectability(match(laid, reports(laid), PULL))


def test_a_report_has_plain_lines() -> None:
    lines = study().statement("loss")
    assert lines[0].startswith("a90/95 0.") and "mm (depth of wall loss; 90 laid from 0.10 to 3.00 mm, " in lines[0]
    assert lines[0].endswith("detected; ASTM E2862)")
    assert any("by what was reported of depths" in one and "ASTM E3023" in one for one in lines)
    assert any("beside a joint" in one for one in lines) and any("away from joints" in one for one in lines)
    assert any(one.startswith("named right: ") for one in lines) and any("tolerance at 80 %" in one for one in lines)
    assert all("\n" not in one and len(one) < 160 for one in lines)
    assert study().statement("bump") == ("a90/95 not established (bumps): none was laid",)
    length = study().row("loss", "length")
    assert length is not None and length.fit.why == "all laid were of one size: it says nothing of others"
    assert "0 per 100 m (0 to 332, 95 % confidence)" in FalseCalls.of(0, 1.11).statement()


def test_the_true_a90_lies_below_what_is_stated() -> None:
    row = study().row("loss")
    true = 0.5 + 1.2816 * 0.15
    assert row is not None and row.fit.a9095_mm is not None and true < row.fit.a9095_mm < 1.5
    assert row.response is not None and row.response.a9095_mm is not None
    assert true < row.response.a9095_mm < row.fit.a9095_mm


def test_pod_json_comes_back_as_it_was_written_and_without_statsmodels(tmp_path: Path) -> None:
    path = tmp_path / "pod.json"
    path.write_text(pod_json(study()), encoding="utf-8")
    assert pod_json(read_pod(path)) == pod_json(study())
    assert repr(read_pod(path)) == repr(study())
    code = f"from annulus_pipe.qualification.pod import read_pod; read_pod(__import__('pathlib').Path({str(path)!r}))"
    code += "; import sys; assert 'statsmodels' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"format": "annulus-pod/9"}, "its format is 'annulus-pod/9', expected annulus-pod/1"),
        ({"rows": 3}, "rows must be a list"),
        ({"rows": [{"dimension": "age", "where": "all"}]}, "rows[0] is of 'age'"),
        ({"bore_mm": [1]}, "bore_mm must be a list of 2"),
        ({"left_out": {"not_seen": -1}}, "left_out.not_seen is -1"),
        ({"pulls": ["x" * 1000]}, "pulls must be a text"),
    ],
)
def test_a_changed_file_is_refused_in_one_line(tmp_path: Path, change: dict[str, object], expected: str) -> None:
    path = tmp_path / "pod.json"
    path.write_text(json.dumps(study().to_dict() | change), encoding="utf-8")
    with pytest.raises(AnnulusError) as error:
        read_pod(path)
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_false_calls_have_the_exact_interval_of_a_count() -> None:
    none = FalseCalls.of(0, 30.0)
    assert none.lower == 0.0 and none.upper == pytest.approx(-math.log(0.025) / 30 * 100)
    some = FalseCalls.of(7, 100.0)
    assert poisson.sf(6, some.lower) == pytest.approx(0.025) and poisson.cdf(7, some.upper) == pytest.approx(0.025)
    assert "does not" not in some.statement() and "not established" in FalseCalls.of(0, 0.0).statement()


def test_passing_a_spool_again_makes_nobody_surer_of_its_sizes() -> None:
    laid = truths(60)
    one = match(laid, reports(laid), PULL)
    other = match(laid, reports(laid), Pull("pull 2", "spool A", 0.0, 20_000.0, 75.0, 0.5, "7", "0.9"))
    once, twice = (detectability(its).row("loss") for its in (one, one.joined(other)))
    assert once is not None and twice is not None and (twice.fit.laid, twice.fit.trials) == (60, 120)
    assert once.fit.a9095_mm is not None and twice.fit.a9095_mm == pytest.approx(once.fit.a9095_mm, rel=1e-4)
    with pytest.raises(AnnulusError, match="its trials are there twice"):
        one.joined(one)
    elsewhere = match(truths(59), [], Pull("pull 3", "spool A", 0.0, 20_000.0, 75.0))
    with pytest.raises(AnnulusError, match="Expected a name of its own for each spool"):
        one.joined(elsewhere)


def test_digs_tell_of_sizes_and_of_detection_nothing() -> None:
    laid = truths(40, laid=False)
    with pytest.raises(AnnulusError, match="dug up because they were reported"):
        detectability(match(laid, reports(laid), PULL))


def test_what_was_not_judged_is_counted_and_all_of_it_is_no_study() -> None:
    outside = Trials((Trial(truths(1)[0], "p", TrialState.OUTSIDE),))
    with pytest.raises(AnnulusError, match="none of 1 trials was judged"):
        detectability(outside)


def test_it_speaks_of_its_own_head_program_and_width_of_pipe() -> None:
    assert study().standing(HeadInUse("7", software="0.9", diameter_mm=150.0)) == (Applicability.APPLIES, ())
    for use, standing, reason in (
        (HeadInUse("8", software="0.9", diameter_mm=150.0), Applicability.DOES_NOT, "it is of head 7, and this is 8"),
        (HeadInUse("7", diameter_mm=150.0), Applicability.OPEN, "the scan does not say which software (0.9)"),
        (HeadInUse("7", software="0.9", diameter_mm=100.0), Applicability.DOES_NOT, "and the diameter is 100 mm"),
    ):
        found, reasons = study().standing(use)
        assert found is standing and reason in reasons[0]


def test_all_detected_says_a_share_and_no_size() -> None:
    laid = truths(30)
    trials = tuple(Trial(one, "p", TrialState.DETECTED, "loss") for one in laid)
    lines = detectability(Trials(trials)).statement("loss")
    assert lines[0].startswith("a90/95 not established (depth of wall loss): all were detected")
    assert lines[1].startswith(
        "15 of 15 between 1.60 and 3.00 mm were detected: POD on average over these at least 81 %"
    )


def test_a_plan_reaches_what_is_wanted_and_lays_defects_apart() -> None:
    plan = plan_sizes(1.5, 0.6, 0.9)
    assert plan.reached >= 0.8 and len(plan.depths_mm) >= 60 and plan.depths_mm[-1] > 1.5
    laid = spools(plan, "loss", 20.0, 20.0, spool_mm=3000.0)
    assert len(laid) > 1 and sum(map(len, laid)) == len(plan.depths_mm)
    for its in laid:
        places = [one.z_mm for one in its]
        assert min(np.diff(places)) > 2 * (GATE_MM + 20.0 / 2) and places[-1] + 10 <= 3000.0
    assert spools(plan, "loss", 20.0, 20.0, spool_mm=3000.0) == laid


def test_defects_lie_side_by_side_round_a_pipe_of_known_diameter() -> None:
    """A 6-inch pipe has room for five of 20 mm: a spool of 1.2 m in place of one of 5."""
    plan = plan_sizes(1.5, 0.6, 0.9)
    (its,) = spools(plan, "loss", 20.0, 20.0, bore_mm=152.4)
    assert len(its) == len(plan.depths_mm) and its[-1].z_mm < 200 + 80 * math.ceil(len(its) / 5)
    assert sorted(one.depth_mm for one in its) == pytest.approx(sorted(plan.depths_mm), abs=0.006)
    for i, one in enumerate(its):
        for other in its[:i]:
            apart = abs((one.clock_deg - other.clock_deg + 180.0) % 360.0 - 180.0) * math.radians(1.0) * 76.2
            assert max(apart, abs(one.z_mm - other.z_mm)) > 2 * (GATE_MM + 20.0 / 2)


@pytest.mark.parametrize(
    ("wanted", "a50", "a90", "deepest", "expected"),
    [
        (0.8, 0.6, 0.9, math.inf, "expected each above the one before"),
        (1.2, 0.6, 0.9, 1.0, "nothing is stated beyond the largest laid"),
        (0.92, 0.6, 0.9, math.inf, "takes more than 600 defects"),
    ],
)
def test_a_plan_that_cannot_be_says_why(wanted: float, a50: float, a90: float, deepest: float, expected: str) -> None:
    with pytest.raises(AnnulusError, match=expected):
        plan_sizes(wanted, a50, a90, deepest_mm=deepest)


def test_a_page_of_misses_that_have_a_depth() -> None:
    """Places without a name have one: the picture of depths asked for the deepest of none that were detected."""
    undecided = [replace(one, listed=False) for one in reports(truths(30))]
    trials = match(truths(30), undecided, PULL)
    assert list(pictures(detectability(trials), trials)) == ["pod-loss"]


def test_a_spool_that_is_passed_again_has_no_more_wall_to_call_falsely() -> None:
    """A spool without a false call in 20 m, passed 20 times, had a bound of 0.9 per 100 m; of 20 m it is 18."""
    laid = truths(30)
    reported = reports(laid)[:-1]
    once = match(laid, reported, PULL)
    again = once
    for number in range(2, 21):
        again = again.joined(match(laid, reported, replace(PULL, name=f"pull {number}", pipe="")))
    first, last = (detectability(one).false_calls for one in (once, again))
    assert (first.inspected_m, last.inspected_m, last.pipe_m) == (20.0, 400.0, 20.0)
    assert first.upper == pytest.approx(last.upper) == pytest.approx(18.4, abs=0.1)
    assert "0 in 400 m (20 m of pipe, passed again)" in last.statement() and "again" not in first.statement()


def test_wall_that_was_not_seen_is_no_wall_without_a_false_call() -> None:
    holes = (UnseenPlace(10_000.0, 20_000.0), UnseenPlace(-500.0, 5_000.0, 90.0, 90.0))
    pull = replace(PULL, holes=holes)
    assert pull.seen_mm == 20_000.0 - 10_000.0 - 1_250.0
    assert detectability(match(truths(30), reports(truths(30)), pull)).false_calls.inspected_m == 8.75
