"""Truths, reports and trials as files: every number under a name with its unit, or one line of what was expected."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.qualification.trial_files import (
    pull_of_list,
    read_reports,
    read_trials,
    read_truths,
    trials_from,
    trials_json,
    truths_csv,
)
from annulus_pipe.qualification.trials import Pull, Reported, Trial, Trials, TrialState, TrueDefect
from annulus_pipe.vocabulary import AnnulusError

HEAD = "name,kind,z_mm,clock_deg,depth_mm,length_mm,width_mm"
MM = st.floats(0.01, 1e4).map(lambda one: float(f"{one:.6g}"))
TRUTH = st.builds(
    TrueDefect,
    name=st.text("abcdefgh 123-", min_size=1, max_size=12).map(lambda one: f"n{one.strip()}"),
    kind=st.sampled_from(("loss", "bump")),
    z_mm=MM,
    clock_deg=st.floats(0, 359).map(lambda one: float(f"{one:.6g}")),
    depth_mm=MM,
    length_mm=MM | st.just(math.nan),
    width_mm=MM | st.just(math.nan),
    beside_joint=st.none() | st.booleans(),
    pipe=st.sampled_from(("", "spool A")),
    laid=st.booleans(),
    depth_u_mm=MM | st.just(math.nan),
)


def written(folder: Path, text: str, name: str = "truths.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@settings(max_examples=40, deadline=None)
@given(st.lists(TRUTH, min_size=1, max_size=8, unique_by=(lambda one: (one.pipe, one.name), lambda one: one.z_mm)))
def test_truths_come_back_as_they_were_written(tmp_path_factory: pytest.TempPathFactory, truths: list) -> None:
    found = read_truths(written(tmp_path_factory.mktemp("t"), truths_csv(truths)))
    assert repr(found) == repr(tuple(truths))


@settings(max_examples=40, deadline=None)
@given(st.lists(TRUTH, max_size=5), st.sampled_from(list(TrialState)), MM | st.just(math.nan), st.booleans())
def test_trials_come_back_as_they_were_written(truths: list, state: TrialState, depth: float, at_least: bool) -> None:
    pull = Pull("one", "spool A", 0.0, 3000.0, 75.0, 0.5, "7", "1.0", "2026-11-29")
    trials = tuple(Trial(one, "one", state, "loss", depth, math.nan, at_least, 0.5) for one in truths)
    found = Trials(trials, (pull,), (("one", Reported("loss", 5.0, 6.0, 0.7, listed=True)),), 2, 1)
    assert repr(trials_from(json.loads(trials_json(found)))) == repr(found)


def refused(path: Path, read=read_truths) -> str:  # type: ignore[no-untyped-def]
    with pytest.raises(AnnulusError) as error:
        read(path)
    line = str(error.value)
    assert "\n" not in line and str(path) in line
    return line


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name,kind,z_mm,clock_deg\na,loss,1,2\n", "no column depth_mm"),
        ("kind,z_mm,clock_deg,depth_in\nloss,1,2,3\n", "'depth_in' is no column of it: expected depth_mm"),
        ("kind,z_m,clock_deg,depth_mm\nloss,1,2,3\n", "'z_m' is no column of it: expected z_mm"),
        ("kind,z_mm,clock_deg,depth\nloss,1,2,3\n", "'depth' is no column of it: expected depth_mm"),
        (f"{HEAD}\na,crack,1,2,3,4,5\n", "kind is 'crack', expected loss or bump"),
        (f"{HEAD}\na,loss,1,2,0,4,5\n", "line 2: depth_mm is 0.0"),
        (f"{HEAD}\na,loss,1,2,deep,4,5\n", "line 2: depth_mm is 'deep'"),
        (f"{HEAD}\na,loss,1,2,nan,4,5\n", "line 2: depth_mm is nan"),
        (f"{HEAD}\na,loss,1,2,3,4\n", "line 2: 6 cells, expected 7"),
        (f"{HEAD}\na,loss,1,2,3,4,5\na,loss,9,2,3,4,5\n", "'a' is there twice"),
        (
            f"{HEAD}\na,loss,1,2,3,4,5\nb,loss,1,-358,3,4,5\n",
            "line 3: 'b' lies where 'a' does, expected one row a defect",
        ),
        (f"{HEAD},laid\na,loss,1,2,3,4,5,perhaps\n", "laid is 'perhaps', expected yes or no"),
        (f"{HEAD},kind\na,loss,1,2,3,4,5,loss\n", "a column is there twice"),
        ("", "no column kind"),
    ],
)
def test_what_is_wrong_in_truths_is_said_in_one_line(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in refused(written(tmp_path, text))


def test_json_is_read_like_a_table(tmp_path: Path) -> None:
    row = {"kind": "loss", "z_mm": 210, "clock_deg": 90, "depth_mm": 1.5, "beside_joint": False}
    (one,) = read_truths(written(tmp_path, json.dumps({"defects": [row]}), "truths.json"))
    assert (one.name, one.depth_mm, one.beside_joint, one.laid) == ("1", 1.5, False, True)
    assert "no column depth_mm" in refused(written(tmp_path, '[{"kind": "loss", "z_mm": 1, "clock_deg": 1}]', "a.json"))
    assert "not JSON" in refused(written(tmp_path, "{", "b.json"))


def test_a_dig_sheet_is_of_what_was_reported(tmp_path: Path) -> None:
    (one,) = read_truths(written(tmp_path, f"{HEAD},dig\na,loss,1,2,3,4,5,dig 4\n"))
    assert not one.laid
    (one,) = read_truths(written(tmp_path, f"{HEAD}\nD3,loss,1,2,3,4,5\n"))  # as a report names its defects
    assert not one.laid


def test_reports_may_be_a_list_alone(tmp_path: Path) -> None:
    text = "kind,z_mm,clock_deg,depth_mm,at_least,state\nloss,1,2,3,yes,listed\nbump,4,5,,,undecided\n"
    first, second = read_reports(written(tmp_path, text, "list.csv"))
    assert first.at_least and first.listed and not second.listed and math.isnan(second.depth_mm)


def test_hits_and_misses_of_others_are_trials(tmp_path: Path) -> None:
    text = "kind,depth_mm,detected,reported_depth_mm\nloss,1.5,hit,1.4\nloss,0.5,0,\n"
    found = read_trials(written(tmp_path, text, "others.csv"))
    assert [one.state for one in found.trials] == [TrialState.DETECTED, TrialState.MISSED] and not found.pulls
    line = refused(written(tmp_path, "kind,depth_mm,detected\nloss,1,perhaps\n", "c.csv"), read_trials)
    assert "detected is 'perhaps', expected yes or no" in line
    assert "expected annulus-trials/1" in refused(written(tmp_path, "{}", "d.json"), read_trials)
    assert "cannot be read" in refused(tmp_path / "none.json", read_trials)


@pytest.mark.parametrize(
    ("scanned", "diameter", "limit", "expected"),
    [
        ((1000.0, 0.0), 150.0, math.nan, "scanned from 1000 to 0 mm"),
        ((math.nan, 1000.0), 150.0, math.nan, "scanned, mm, is nan"),
        ((0.0, math.inf), 150.0, math.nan, "scanned, mm, is inf"),
        ((0.0, 1e308), 150.0, math.nan, "scanned, mm, is 1e.308"),
        ((0.0, 1000.0), math.inf, math.nan, "its diameter, mm, is inf"),
        ((0.0, 1000.0), -3.0, math.nan, "its diameter, mm, is -3"),
        ((0.0, 1000.0), 150.0, -5.0, "its depth limit, mm, is -5"),
    ],
)
def test_what_a_list_is_of_is_bounded_as_its_trials_are(
    scanned: tuple[float, float], diameter: float, limit: float, expected: str
) -> None:
    """trials.json was written, and refused by `pod fit`."""
    with pytest.raises(AnnulusError, match=expected):
        pull_of_list("list", scanned, diameter, limit)


def test_two_lists_of_one_name_are_not_taken_for_one(tmp_path: Path) -> None:
    """Their rows were counted as defects that were passed twice."""
    (tmp_path / "other").mkdir()
    text = "kind,depth_mm,detected\nloss,1.5,hit\n"
    first, second = (read_trials(written(folder, text, "hits.csv")) for folder in (tmp_path, tmp_path / "other"))
    with pytest.raises(AnnulusError, match=r"hits\.csv: its trials are there twice"):
        first.joined(second)


def test_a_list_under_another_name_is_the_same_list(tmp_path: Path) -> None:
    """Twice the defects: the a90/95 of 80 fell by 5 %."""
    text = "kind,depth_mm,detected\n" + "".join(f"loss,{0.1 * i:.1f},{i % 2}\n" for i in range(1, 25))
    first, second = (read_trials(written(tmp_path, text, name)) for name in ("hits.csv", "more.csv"))
    with pytest.raises(AnnulusError, match=r"more\.csv: has the trials of hits\.csv anew"):
        first.joined(second)


def test_a_list_whose_depths_are_in_two_units_is_refused(tmp_path: Path) -> None:
    text = "kind,depth_mm,detected,reported_depth_mm\n" + "".join(f"loss,{i / 25.4:.4f},yes,{i}\n" for i in range(1, 6))
    assert "the truths' depths look like inches" in refused(written(tmp_path, text, "hits.csv"), read_trials)


def test_cells_parted_by_semicolons_are_said_to_be(tmp_path: Path) -> None:
    assert "parted by semicolons" in refused(written(tmp_path, "kind;depth_mm\nloss;1,5\n"))
