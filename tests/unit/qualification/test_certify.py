"""`annulus certify`, from plan.toml to certificate and check, on results as `annulus reconstruct` writes them."""

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.qualification.certificate import Certificate, read_certificate
from annulus_pipe.qualification.signature import sign
from annulus_pipe.storage.results_folder import STATION_COLUMNS
from annulus_pipe.vocabulary import AnnulusError

PLAN = """
title = "three sleeves"
head = "7"
operators = ["Ames", "Bose"]
repeats = 3
one_pull = true
piece = [
  {name = "A", diameter_mm = 151.8, u_mm = 0.02, from_mm = 0, to_mm = 100},
  {name = "B", diameter_mm = 152.4, u_mm = 0.02, from_mm = 120, to_mm = 220},
  {name = "C", diameter_mm = 153.2, u_mm = 0.02, from_mm = 240, to_mm = 340},
]
"""
DIAMETERS = {"A": (151.8, 0.0), "B": (152.4, 120.0), "C": (153.2, 240.0)}
ORIGIN = {"calibration": {"fingerprint": "ab12cd34ef567890"}, "controller": {"version": "1.4.0", "git": "abc"}}
BIAS_PERCENT, REPEAT_PERCENT = 0.06, 0.02


def results(folder: Path, operator: str, percent: float, **more: Any) -> None:
    """summary.json and stations.csv of a pull through three sleeves, all diameters off by so many percent."""
    folder.mkdir(parents=True)
    rows = [(z + 2.5 + 5.0 * i, d * (1 + percent / 100)) for d, z in DIAMETERS.values() for i in range(20)]
    with (folder / "stations.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(STATION_COLUMNS)
        for z, d in rows:
            writer.writerow([z, d - 0.02, d + 0.02, d, 0.01, 0.01, 0.98, 0.1])
    summary = {
        "format": "annulus-summary/1",
        "job": {"head": "7", "operator": operator},
        "origin": ORIGIN,
        "versions": {"annulus": "0.1.0"},
        "frames": {"projector": 40},
        "points": 60_000,
        "stations": len(rows),
        "scanned_mm": {"from": 0.0, "to": 340.0, "length": 340.0},
        "diameter_mm": {"mean": 152.4},
        "scale": {"common_k2_percent": 0.2, "references": []},
    }
    (folder / "summary.json").write_text(json.dumps(summary | more))


@pytest.fixture(autouse=True)
def the_day_of_issue(monkeypatch: pytest.MonkeyPatch) -> None:
    """A certificate lapses; these tests do not."""
    monkeypatch.setattr("annulus_pipe.cli.certify._today", lambda: date(2026, 11, 29))


class Study:
    """A study in a folder: planned, its runs drawn from a seed."""

    def __init__(self, root: Path, seed: int = 1, worse: float = 1.0) -> None:
        self.root, self.plan, self.runs = root, root / "plan.toml", root / f"study{seed}" / "runs.csv"
        self.plan.write_text(PLAN)
        self.invoke("plan", self.plan, "-o", self.runs.parent)
        rng = np.random.default_rng(seed)
        rows = list(csv.DictReader(self.runs.open()))
        for row in rows:
            percent = BIAS_PERCENT * worse + rng.normal(0.0, REPEAT_PERCENT * worse)
            results(self.runs.parent / row["results"], row["operator"], percent)
            row["temperature_c"] = f"{rng.uniform(12.0, 20.0):.1f}"
        self.write(rows)

    def write(self, rows: list[dict[str, str]]) -> None:
        with self.runs.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)

    def rows(self) -> list[dict[str, str]]:
        return list(csv.DictReader(self.runs.open()))

    def invoke(self, *words: object, status: int = 0) -> str:
        done = CliRunner().invoke(app, ["certify", *map(str, words)])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        assert done.exit_code == status, done.output
        return done.output

    def issue(self) -> Path:
        if not (self.root / "lab.key").exists():
            self.invoke("key", "-o", self.root / "lab.key")
        self.invoke(
            "issue",
            self.plan,
            "--runs",
            self.runs,
            "--key",
            self.root / "lab.key",
            "-o",
            self.root,
            "--date",
            "2026-11-29",
        )
        return self.root / "certificate.json"


def test_from_plan_to_certificate_and_check(tmp_path: Path) -> None:
    study = Study(tmp_path)
    planned = study.invoke("plan", study.plan, "-o", tmp_path / "more")
    assert "as pieces of one pull err alike or not; 95 need more repeats" in planned
    certificate = read_certificate(study.issue())
    accuracy, scope = certificate.accuracy, certificate.scope
    assert accuracy.bias.holds(BIAS_PERCENT) and accuracy.s_r.holds(REPEAT_PERCENT)
    assert accuracy.worst < accuracy.U_drift and accuracy.U_drift > accuracy.U
    assert (scope.head, scope.calibration, scope.firmware) == ("7", "ab12cd34ef567890", "1.4.0 abc")
    assert scope.diameter_mm == (151.8, 153.2) and scope.temperature_c is not None
    assert (scope.issued, scope.until) == (date(2026, 11, 29), date(2027, 11, 29))
    assert len(certificate.runs) == 18 and certificate.form.points_per_picture == 1500
    page = (tmp_path / "certificate.html").read_text()
    assert certificate.number in page and "0.5 %" in page and "E691" in page
    assert "not lapsed" in study.invoke("verify", tmp_path / "certificate.json", "--public", tmp_path / "lab.key.pub")
    folder = study.runs.parent / study.rows()[0]["results"]
    printed = study.invoke("verify", tmp_path / "certificate.json", "--results", folder)
    assert "cannot be told" in printed and "the day is not known" in printed
    later = Study(tmp_path, seed=2)
    assert "yes" in later.invoke("check", tmp_path / "certificate.json", later.plan, "--runs", later.runs)
    worse = Study(tmp_path, seed=3, worse=6.0)
    refused = worse.invoke("check", tmp_path / "certificate.json", worse.plan, "--runs", worse.runs, status=1)
    assert "NO: it does not hold" in refused


def _copied(study: Study) -> None:
    first, second, *_ = (study.runs.parent / row["results"] for row in study.rows() if row["operator"] == "Ames")
    shutil.rmtree(second)
    shutil.copytree(first, second)


def _changed(**more: Any) -> Callable[[Study], None]:
    def change(study: Study) -> None:
        file = study.runs.parent / study.rows()[4]["results"] / "summary.json"
        file.write_text(json.dumps(json.loads(file.read_text()) | more))

    return change


def _reads(percent: float) -> Callable[[Study], None]:
    def change(study: Study) -> None:
        row = study.rows()[4]
        shutil.rmtree(study.runs.parent / row["results"])
        results(study.runs.parent / row["results"], row["operator"], percent)

    return change


def _rows(edit: Callable[[list[dict[str, str]]], Any]) -> Callable[[Study], None]:
    def change(study: Study) -> None:
        rows = study.rows()
        edit(rows)
        study.write(rows)

    return change


def _all_changed(**more: Any) -> Callable[[Study], None]:
    def change(study: Study) -> None:
        for row in study.rows():
            file = study.runs.parent / row["results"] / "summary.json"
            file.write_text(json.dumps(json.loads(file.read_text()) | more))

    return change


ANCHORED = {"references": [{"z_from_mm": 130.0, "z_to_mm": 200.0, "diameter_mm": 152.4, "used": True}]}


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (_rows(lambda rows: rows.pop()), "5 of 6 runs"),
        (_rows(lambda rows: rows.append(rows[0])), "is there twice"),
        (_rows(lambda rows: rows[3].update(operator="Cole")), "is not in the plan"),
        (_rows(lambda rows: rows[3].update(results=rows[2]["results"])), "has the results of run 3"),
        (_rows(lambda rows: rows[3].update(results="")), "has no results"),
        (_rows(lambda rows: rows[3].update(temperature_c="warm")), "line 5: temperature_c is 'warm', expected degrees"),
        (_rows(lambda rows: rows[3].update(temperature_c="nan")), "temperature_c is 'nan', expected degrees Celsius"),
        (_rows(lambda rows: rows[3].update(repeat="1.5")), "line 5: repeat is '1.5', expected a whole number"),
        (_copied, "has the results of run"),
        (_changed(job={"head": "8"}), "is of head 8, expected 7"),
        (_changed(versions={"annulus": "0.2.0"}), "its software is 0.2.0, that of run 1 0.1.0"),
        (_changed(scale=ANCHORED), "anchored by a reference section. Expected results without"),
        (_reads(33.0), "Is it of another piece"),
        (_all_changed(origin=ORIGIN | {"begun_utc": "2026-11-28T10:00:00+00:00"}), "is the scan of run 1, begun 2026-"),
        (_all_changed(job={"date": "2026-12-05"}), "the last run is of 2026-12-05, after the day of issue, 2026-11-29"),
        (_all_changed(job={"date": "9999-12-31"}), "the last run is of 9999-12-31, after the day of issue"),
        (_all_changed(job={"date": "2024-06-01"}), "holds until 2025-06-01, before 2026-11-29"),
    ],
)
def test_what_is_no_study_is_refused_in_one_line(tmp_path: Path, change: Callable[[Study], None], line: str) -> None:
    study = Study(tmp_path)
    change(study)
    with pytest.raises(AnnulusError, match=line) as refused:
        study.issue()
    assert "\n" not in str(refused.value) and not (tmp_path / "certificate.json").exists()


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('["Ames", "Bose"]', '["Ames"]', "operators: expected a list of 2 to 32 names"),
        ('["Ames", "Bose"]', '["Ames", "Ames"]', "two have one name"),
        ("repeats = 3", "repeats = 1", "repeats is 1, expected a whole number in 2..100"),
        ("u_mm = 0.02", "u_mm = 9.0", "u_mm .* is 9.0, expected a number in 0.0001..3.036"),
        ("diameter_mm = 151.8", "diameter_in = 5.98", "'diameter_in' is not known in piece 1"),
        ("from_mm = 120", "from_mm = 90", "overlap in one pull"),
        ("from_mm = 0,", "", "from_mm is None, expected a number"),
        ('head = "7"', "", "head must be a text"),
        ("piece = [", "piece = 7 #[", "."),
    ],
)
def test_what_is_no_plan_is_refused_in_one_line(tmp_path: Path, old: str, new: str, line: str) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.replace(old, new, 1))
    with pytest.raises(AnnulusError, match=line) as refused:
        Study.invoke(Study.__new__(Study), "plan", plan, "-o", tmp_path / "study")
    assert "\n" not in str(refused.value)


def _better(content: dict[str, Any]) -> None:
    content["accuracy"]["U"] /= 2


def _steadier(content: dict[str, Any]) -> None:
    content["accuracy"]["s_r"] = {name: one / 3 for name, one in content["accuracy"]["s_r"].items()}


def _wider(content: dict[str, Any]) -> None:
    content["scope"]["diameter_mm"] = [90.0, 300.0]


def _without_the_worst(content: dict[str, Any]) -> None:
    worst = max(content["runs"], key=lambda one: abs(one["error"]))
    content["runs"].remove(worst)


def _milder(content: dict[str, Any]) -> None:
    for one in content["runs"]:
        one["error"] /= 2


def _no_drift(content: dict[str, Any]) -> None:
    content["accuracy"]["U_drift"] = 0.01


def _surer(content: dict[str, Any]) -> None:
    content["budget"][0].update(u=1e-5)


def _even(content: dict[str, Any]) -> None:
    content["pieces"][0]["h"] = [0.0]


def _open_nowhere(content: dict[str, Any]) -> None:
    content["left_open"] = []


def _for_ever(content: dict[str, Any]) -> None:
    content["scope"]["until"] = "2199-01-01"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (_surer, "its u of repeats is 1e-05"),
        (_even, "its h of A is 0, .*and 1 more"),
        (_open_nowhere, "it leaves 0 points open"),
        (_for_ever, "until 2199-01-01, and a plan allows 60 months"),
        (_better, "its U is 0.* readings make it"),
        (_steadier, "its s_r is 0.*, and 2 more"),
        (_wider, "its range of diameters"),
        (_without_the_worst, "each once"),
        (_milder, "error of A in run 1 is"),
        (_no_drift, "less than without"),
    ],
)
def test_numbers_that_do_not_follow_from_readings_are_noticed_whoever_signed(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], line: str
) -> None:
    """Edited, and signed anew with a key of one's own: the signature holds."""
    made = json.loads(Study(tmp_path).issue().read_text())
    change(made["content"])
    forged = Certificate.from_dict(made)
    forged = replace(forged, signature=sign(forged.content(), tmp_path / "lab.key"))
    (tmp_path / "forged.json").write_text(json.dumps(forged.to_dict()))
    with pytest.raises(AnnulusError, match=f"does not follow from its own readings: .*{line}"):
        Study.invoke(Study.__new__(Study), "verify", tmp_path / "forged.json")


@pytest.mark.parametrize(("issued", "until"), [("0001-01-01", "2027-01-01"), ("2026-11-29", "9999-12-31")])
def test_days_of_no_calendar_of_ours_are_no_certificates(tmp_path: Path, issued: str, until: str) -> None:
    """A day less than year 1's first ended a report with an internal error."""
    made = json.loads(Study(tmp_path).issue().read_text())
    made["content"]["scope"].update(issued=issued, until=until)
    with pytest.raises(ValueError, match=r"expected a year in 2000\.\.2209"):
        Certificate.from_dict(made)


def test_a_certificate_is_not_issued_for_a_day_to_come(tmp_path: Path) -> None:
    """Of runs that state no day it would hold for as long as anybody likes."""
    study = Study(tmp_path)
    assert "the days of the runs" in read_certificate(study.issue()).left_open[0]
    key = ("--key", tmp_path / "lab.key", "-o", tmp_path / "late")
    with pytest.raises(AnnulusError, match="2027-03-01: lies in the future"):
        study.invoke("issue", study.plan, "--runs", study.runs, *key, "--date", "2027-03-01")


def test_a_certificate_is_not_checked_by_what_cannot_speak_against_it(tmp_path: Path) -> None:
    """Its own runs bear it out however bad a head is, and those of another program or a hotter pipe are not its."""
    study = Study(tmp_path)
    check = ("check", study.issue(), study.plan, "--runs")
    with pytest.raises(AnnulusError, match=r"has the results of run 1 of the certificate\. Expected later runs"):
        study.invoke(*check, study.runs)
    later = Study(tmp_path, seed=2)
    _all_changed(versions={"annulus": "9.9"})(later)
    with pytest.raises(AnnulusError, match=r"says nothing of run 1: it is of software 0\.1\.0, and this is 9\.9"):
        later.invoke(*check, later.runs)
    hot = Study(tmp_path, seed=3)
    _rows(lambda rows: rows[0].update(temperature_c="40"))(hot)
    with pytest.raises(AnnulusError, match=r"says nothing of run 1: it holds from .* degC"):
        hot.invoke(*check, hot.runs)


def test_an_old_study_that_is_issued_again_holds_no_longer(tmp_path: Path) -> None:
    study = Study(tmp_path)
    _all_changed(job={"date": "2026-03-31"})(study)
    assert read_certificate(study.issue()).scope.until == date(2027, 3, 31)
