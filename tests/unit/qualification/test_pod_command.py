"""`annulus pod` from end to end: a plan, results made by hand, what became of each defect, pod.json and its page."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.cli.pulls import read_pull
from annulus_pipe.qualification.pod import read_pod

RADIUS_MM, LIMIT_MM = 75.0, 0.4


def run(*arguments: object, status: int = 0) -> str:
    done = CliRunner().invoke(app, ["pod", *map(str, arguments)])
    if done.exit_code != status:
        raise AssertionError(f"{done.exit_code}: {done.output}{done.exception!r}")
    return done.output if status == 0 else str(done.exception)


def results(folder: Path, truths: Path, *, pipe: str = "spool 1", factor: float = 1.0) -> Path:
    """Of a head that lists what reads LIMIT_MM deep or more; its map lacks a strip at six o'clock."""
    rng = np.random.default_rng(5)
    rows = list(csv.DictReader(truths.read_text(encoding="utf-8").splitlines()))
    read = [float(row["depth_mm"]) + 0.1 * rng.standard_normal() for row in rows]
    listed = [
        {
            "kind": row["kind"],
            "z_mm": float(row["z_mm"]) + 2.0,
            "clock_deg": float(row["clock_deg"]),
            "length_mm": 20.0,
            "arc_deg": 15.0,
            "depth_mm": factor * depth,
            "depth_k2_mm": 0.05,
            "floor_seen": True,
        }
        for row, depth in zip(rows, read, strict=True)
        if depth > LIMIT_MM
    ]
    folder.mkdir()
    cells = np.zeros((3000, 360), np.int16)
    cells[:, 160:200] = -32768
    np.savez(folder / "wall.npz", deviation_um=cells, z_step_mm=2.0, radius_mm=RADIUS_MM)
    summary = {
        "format": "annulus-summary/1",
        "job": {"pipe": pipe, "head": "7"},
        "scanned_mm": {"from": 0.0, "to": 6000.0},
        "diameter_mm": {"mean": 2 * RADIUS_MM},
        "limits": {"depth_mm": LIMIT_MM},
        "versions": {"annulus": "0.9"},
        "created": "2026-11-29T01:02:03+00:00",
        "defects": listed,
        "undecided": [],
        "not_seen": [],
    }
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    run("plan", "--want", 0.8, "--a90", 0.55, "--a50", 0.4, "-o", folder / "plan")
    results(folder / "results-1", folder / "plan/spool-1.csv")
    run("match", folder / "plan/spool-1.csv", folder / "results-1", "-o", folder / "trials.json")
    run("fit", folder / "trials.json", "-o", folder / "pod")
    return folder


def test_a_study_ends_in_what_a_report_quotes(study: Path) -> None:
    found = read_pod(study / "pod/pod.json")
    row = found.row("loss")
    assert row is not None and row.fit.a9095_mm is not None and LIMIT_MM < row.fit.a9095_mm < 0.8
    assert (found.heads, found.versions, found.bore_mm) == (("7",), ("0.9",), (150.0, 150.0))
    assert found.left_out.not_seen > 0 and row.fit.laid + found.left_out.not_seen >= 60
    assert found.false_calls.count == 0 and found.false_calls.inspected_m == pytest.approx(6.0)


def test_the_page_needs_no_other_file(study: Path) -> None:
    page = (study / "pod/pod.html").read_text(encoding="utf-8")
    assert "a90/95" in page and "<script" not in page and "http" not in page.replace("http-equiv", "")
    for name in ("pod-loss", "depth-loss"):
        assert (study / f"pod/{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_strip_that_was_not_seen_is_the_maps_word(study: Path) -> None:
    pull, _, _, _ = read_pull(study / "results-1")
    assert pull.seen is not None and not pull.holes
    assert pull.seen.at(np.array([100.0, 100.0, 7000.0]), np.array([180.0, 90.0, 90.0])).tolist() == [
        False,
        True,
        False,
    ]


def test_answers_are_json_where_that_is_asked_for(study: Path) -> None:
    answer = json.loads(run("fit", study / "trials.json", "-o", study / "again", "--axis", "log", "--json"))
    assert answer["format"] == "annulus-pod/1" and answer["rows"][0]["fit"]["axis"] == "log size"


@pytest.mark.parametrize(("claim", "outcome"), [(0.3, "accepted"), (0.02, "rejected")])
def test_a_claimed_tolerance_is_judged(study: Path, claim: float, outcome: str) -> None:
    """Depths are read with a standard deviation of 0.1 mm."""
    printed = run("fit", study / "trials.json", "-o", study / outcome, "--claim", claim)
    assert 'The claim "80' in printed and f"is {outcome}." in printed
    sizing = dict(read_pod(study / outcome / "pod.json").sizing)["loss"]
    assert sizing.claim is not None and str(sizing.claim.judgement.outcome) == outcome
    assert sizing.claim.tolerance_mm == claim and sizing.claim.judgement.level == 3
    assert "goes with --claim" in run("fit", study / "trials.json", "-o", "x", "--certainty", 0.9, status=1)


def test_truths_of_another_pipe_or_unit_are_refused_in_one_line(study: Path, tmp_path: Path) -> None:
    spool = study / "plan/spool-1.csv"
    other = results(tmp_path / "other", spool, pipe="main 7")
    assert "results of pipe main 7, and the truths are of spool 1" in run(
        "match", spool, other, "-o", "t.json", status=1
    )
    inches = results(tmp_path / "inches", spool, factor=1 / 25.4)
    assert "times as deep" in run("match", spool, inches, "-o", "t.json", status=1)
    assert "expected results of" in run("match", spool, tmp_path, "-o", "t.json", status=1).lower()
    assert "needs --scanned" in run("match", spool, spool, "-o", "t.json", status=1)
