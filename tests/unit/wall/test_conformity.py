"""Promises of the verdict: never a pass that the uncertainty does not carry, and a wrong limits.toml is one line."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from annulus_pipe.cli.limits_file import load_limits
from annulus_pipe.job import WORDS, JobSheet
from annulus_pipe.untrusted import parse_toml
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.conformity import QUANTITIES, Criteria, Decision, decide, judge
from annulus_pipe.wall.defects import Defect, Detection, Kind, Limits
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.stations import Stations
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wall.unjudged import Unjudged

QUICK = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow], max_examples=200)
ANY = st.floats(-1e3, 1e3) | st.just(math.nan) | st.just(math.inf)
LIMITS = """
title = "The client's"
accept_severity = 1
[[loss]]
severity = 1
depth_mm = 1.0
[[loss]]
severity = 3
depth_mm = 2.0
[[bump]]
severity = 2
height_percent_diameter = 2
[[joint]]
severity = 4
hilo_mm = 1.5
[[ovality]]
severity = 2
percent = 3
[[bore]]
severity = 5
smallest_mm = 145
"""


def criteria(text: str = LIMITS) -> Criteria:
    return Criteria.from_dict(parse_toml(text.encode()))


@QUICK
@given(ANY, ANY, st.floats(-1e3, 1e3), st.booleans(), st.booleans())
def test_nothing_conforms_that_may_be_over_and_nothing_fails_that_may_be_under(
    value: float, k2: float, limit: float, lower: bool, at_least: bool
) -> None:
    decision = decide(value, k2, limit, lower=lower, at_least=at_least)
    worst, best = (value - k2, value + k2) if lower else (value + k2, value - k2)
    if decision is Decision.CONFORMS:
        assert (worst > limit if lower else worst < limit) and not at_least
    elif decision is Decision.FAILS:
        assert best <= limit if lower else best >= limit
    if not (math.isfinite(value) and math.isfinite(k2)):
        assert decision is Decision.UNDECIDED


@pytest.mark.parametrize(
    ("value", "k2", "decision"),
    [(1.5, 0.4, "conforms"), (1.5, 0.5, "undecided"), (2.1, 0.2, "undecided"), (2.25, 0.25, "does not conform")],
)
def test_the_guard_band_is_the_expanded_uncertainty(value: float, k2: float, decision: str) -> None:
    assert decide(value, k2, 2.0) == decision


def test_a_pipe_is_judged_by_its_worst_and_each_thing_by_its_own() -> None:
    pipe = survey(
        defects=(loss(0.7, 0.1), loss(1.5, 0.1), loss(1.9, 0.3), loss(3.0, 0.2), bump(1.0, 0.1)),
        features=(joint(0.3, 0.1), joint(math.nan, math.nan)),
    )
    verdict = judge(pipe, criteria())
    said = [(one.severity, str(one.decision)) for one in verdict.items if one.group == "defect"]
    assert said == [(0, "conforms"), (1, "conforms"), (1, "undecided"), (3, "does not conform"), (0, "conforms")]
    assert verdict.items[2].severities == (1, 1, 3)
    assert [str(one.decision) for one in verdict.items if one.group == "feature"] == ["conforms", "undecided"]
    assert verdict.decision is Decision.FAILS
    assert any("8.0 % of the wall was not seen" in one for one in verdict.remarks)


def test_a_lower_limit_of_a_depth_is_never_accepted() -> None:
    shallow = Defect(Kind.LOSS, 10, 0, 5, 5, 0.7, 25, floor_seen=False, depth_k2_mm=0.1)
    (item, *_) = judge(survey(defects=(shallow,)), criteria()).items
    assert item.decision is Decision.UNDECIDED


def test_a_place_that_may_be_nothing_never_fails_a_pipe() -> None:
    verdict = judge(survey(undecided=(loss(5.0, 2.9), loss(0.6, 0.5))), criteria())
    assert [str(one.decision) for one in verdict.items if one.group == "undecided"] == ["undecided", "conforms"]
    assert verdict.decision is Decision.UNDECIDED


def test_a_limit_below_what_is_listed_cannot_be_accepted() -> None:
    fine = criteria("[[loss]]\nseverity = 1\ndepth_mm = 0.2\n")
    verdict = judge(survey(), fine)
    assert verdict.decision is Decision.UNDECIDED
    assert "lies below the least depth that is listed" in verdict.remarks[0]


def test_a_sound_pipe_conforms_as_far_as_it_was_seen() -> None:
    verdict = judge(survey(), criteria())
    assert verdict.decision is Decision.CONFORMS
    bore = next(one for one in verdict.items if one.kind == "bore")
    assert bore.value == pytest.approx(151.0) and bore.z_mm == 5.0
    demanding = criteria("seen_percent = 95\n" + LIMITS)
    assert judge(survey(), demanding).decision is Decision.UNDECIDED


def test_a_narrow_station_fails_the_bore() -> None:
    narrow = criteria("[[bore]]\nseverity = 2\nsmallest_mm = 152\n")
    (item,) = judge(survey(), narrow).items
    assert item.decision is Decision.FAILS and item.severity == 2


@QUICK
@given(
    st.lists(st.tuples(st.floats(0.05, 9), st.floats(0, 3), st.booleans()), max_size=5),
    st.floats(0.3, 5),
    st.integers(0, 3),
)
def test_a_pipe_conforms_only_if_every_depth_does(
    depths: list[tuple[float, float, bool]], limit: float, accepted: int
) -> None:
    text = f"accept_severity = {accepted}\n[[loss]]\nseverity = 3\ndepth_mm = {limit!r}\n"
    defects = tuple(Defect(Kind.LOSS, 10, 0, 5, 5, d, 25, seen, k2) for d, k2, seen in depths)
    verdict = judge(survey(defects=defects), criteria(text))
    if verdict.decision is Decision.CONFORMS and accepted < 3:
        assert all(d + k2 < limit and seen for d, k2, seen in depths) and limit > 0.3
    if any(d - k2 >= limit for d, k2, _ in depths) and accepted < 3:
        assert verdict.decision is Decision.FAILS


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[[dent]]\nseverity = 1\ndepth_mm = 1\n", "dent is not known, expected one of title"),
        ("[[loss]]\nseverity = 1\ndepth = 1\n", r"\[\[loss\]\] depth is not known, expected severity and one of"),
        ("[[loss]]\nseverity = 9\ndepth_mm = 1\n", r"\[\[loss\]\] severity is 9, expected a whole number in 1..5"),
        ('[[loss]]\nseverity = 1\ndepth_mm = "1"\n', r"\[\[loss\]\] depth_mm is '1', expected a number in 0..100000"),
        ("[[loss]]\nseverity = 1\n", r"\[\[loss\]\] expected severity and one of"),
        ("title = 'x'\n", "names no limit"),
        ("loss = 3\n", r'"loss" must be a section'),
        ("[[loss]]\nseverity = 1\ndepth_percent_wall = 10\n", "needs wall_mm"),
        ("[[loss]]\nseverity = 2\ndepth_mm = 1\n[[loss]]\nseverity = 1\ndepth_mm = 2\n", "severity must begin"),
        ("[[bore]]\nseverity = 1\nsmallest_mm = 1\n[[bore]]\nseverity = 2\nsmallest_mm = 2\n", "must begin at a worse"),
        ("[[loss]]\nseverity = 1\ndepth_mm = nan\n", "depth_mm is nan"),
        ("accept_severity = true\n", "accept_severity is True|names no limit"),
        ("\x1b[2J", "not TOML"),
    ],
)
def test_wrong_limits_are_one_line(text: str, match: str, tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(AnnulusError, match=rf"limits\.toml: .*{match}") as told:
        load_limits(path)
    assert str(told.value).isprintable()


def test_no_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="cannot be read"):
        load_limits(tmp_path / "none.toml")


def loss(depth: float, k2: float) -> Defect:
    return Defect(Kind.LOSS, 10, 0, 5, 5, depth, 25, True, k2)


def bump(height: float, k2: float) -> Defect:
    return Defect(Kind.BUMP, 10, 0, 5, 5, height, 25, True, k2)


def joint(hilo: float, k2: float) -> Feature:
    return Feature(FeatureKind.JOINT, 10, 5, measures=(FeatureMeasure("hilo_mm", hilo, k2),))


def survey(
    defects: tuple[Defect, ...] = (),
    undecided: tuple[Defect, ...] = (),
    features: tuple[Feature, ...] = (),
    unjudged: tuple[Unjudged, ...] = (),
) -> Survey:
    """As much of one as is asked."""
    n = 4
    shape = np.tile([76.0, 0, 0, 0.1, 0], (n, 1))
    flat = np.full((n, 36), 0.01, np.float32)
    wall = SimpleNamespace(
        shape_mm=shape,
        z_mm=np.arange(n) * 5.0,
        seen=np.ones((n, 36), bool),
        sigma_mm=flat,
        cell_noise_mm=flat,
        shape_sigma_mm=lambda: flat,
        shape_covariance=np.tile(1e-6 * np.eye(5), (n, 1, 1)),
        shape_limit_mm=0.4,
        oval_part=0.0,
    )
    steady = np.full(n, 152.0)
    low = np.array([152.0, 151.0, 152.0, 152.0])
    k2, none = np.full(n, 0.1), np.zeros(n)
    stations = Stations(wall.z_mm, low, steady, steady, none, none, none + 1, *[k2] * 3, *[steady] * 6)
    told: dict[str, Any] = {
        "wall": wall,
        "stations": stations,
        "detection": Detection(defects, np.zeros((n, 36), np.int32), Limits(), undecided),
        "features": features,
        "defects": defects,
        "diameter_mean_mm": 152.0,
        "nominal_diameter_mm": 152.4,
        "depth_limit_mm": 0.3,
        "size_limit_mm": 7.6,
        "seen_fraction": 0.92,
        "unjudged": unjudged,
    }
    return cast(Survey, SimpleNamespace(**told))


def test_the_manuals_examples_are_read() -> None:
    manual = Path(__file__).resolve().parents[3] / "docs/manual"
    told = load_limits(manual / "limits.toml")
    assert told.accepted == 1 and told.limit("loss", "depth_percent_wall") == 10.0
    assert math.isnan(told.limit("loss", "depth_mm")), "that class is accepted"
    page = (manual / "limits.md").read_text(encoding="utf-8")
    for kind, quantities in QUANTITIES.items():
        assert f"`[[{kind}]]`" in page and all(f"`{name}`" in page for name in quantities)
    job = JobSheet.from_dict(parse_toml(page.split("```toml\n")[1].split("```")[0].encode()))
    assert job.to_dict().keys() == WORDS.keys()
