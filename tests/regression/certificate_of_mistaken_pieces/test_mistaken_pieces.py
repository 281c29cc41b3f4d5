"""A plan in inches was certified at 2400 %, two pieces that were mistaken for one another at 15 %, and one run's
results stood for two runs."""

import shutil
from pathlib import Path

import pytest
from drawn_study import PIECES, fill_in, write_plan
from typer.testing import CliRunner, Result

from annulus_pipe.cli.app import app


def certify(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["certify", *map(str, arguments)])


@pytest.fixture
def study(tmp_path: Path) -> Path:
    plan = write_plan(tmp_path / "plan.toml")
    assert certify("plan", plan, "-o", tmp_path / "study").exit_code == 0
    fill_in(tmp_path / "study/runs.csv", stated=False)
    assert certify("key", "-o", tmp_path / "lab.key").exit_code == 0
    return tmp_path


def refusal(folder: Path) -> str:
    issued = certify(
        "issue", folder / "plan.toml", "--runs", folder / "study/runs.csv", "--key", folder / "lab.key", "-o", folder
    )
    assert issued.exit_code == 1 and not (folder / "certificate.json").exists()
    return str(issued.exception)


def test_a_plan_in_inches_is_refused(study: Path) -> None:
    write_plan(study / "plan.toml", {name: round(mm / 25.4, 2) for name, mm in PIECES.items()})
    assert "diameters look like inches" in refusal(study)


def test_pieces_that_were_mistaken_are_refused(study: Path) -> None:
    write_plan(study / "plan.toml", {"A": PIECES["B"], "B": PIECES["A"], "C": PIECES["C"]})
    assert "mm of piece" in refusal(study) and "That is the size of" in refusal(study)


def test_one_piece_of_another_size_is_refused(study: Path) -> None:
    write_plan(study / "plan.toml", PIECES | {"C": 170.0})
    assert "of piece C, 170 mm. Is it of another piece?" in refusal(study)


def test_results_that_stand_for_two_runs_are_refused(study: Path) -> None:
    for name in ("summary.json", "stations.csv"):
        shutil.copy(study / "study/results/001" / name, study / "study/results/002" / name)
    assert "is the scan of run 1" in refusal(study)


def test_a_head_that_errs_by_two_percent_is_certified_so(study: Path, tmp_path: Path) -> None:
    """Wrong, and consistently: that is what a certificate is for."""
    shutil.rmtree(study / "study")
    assert certify("plan", study / "plan.toml", "-o", study / "study").exit_code == 0
    fill_in(study / "study/runs.csv", bias_percent=-2.9, stated=False)
    issued = certify(
        "issue", study / "plan.toml", "--runs", study / "study/runs.csv", "--key", study / "lab.key", "-o", study
    )
    assert issued.exit_code == 0 and "bias \u22122.9 %" in issued.stdout
