"""The pair of ../shared/survey, drawn by a program that is not ours, scored as its own scorer does."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app

SURVEY = Path(__file__).resolve().parents[3] / "shared" / "survey"
pytestmark = [pytest.mark.skipif(not (SURVEY / "truth.json").is_file(), reason="no scenes here (../shared)")]


def test_all_growth_is_found_and_none_made_up(tmp_path: Path) -> None:
    out = tmp_path / "growth.json"
    maps = [str(SURVEY / f"survey-a-{year}.npz") for year in (2024, 2025)]
    ran = CliRunner().invoke(app, ["archive", "compare", *maps, "-o", str(out)])
    assert ran.exit_code == 0, ran.output
    said = subprocess.run(
        [sys.executable, str(SURVEY / "score.py"), str(out), str(SURVEY / "truth.json")],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*", said.replace("p95", "p"))]
    rms_mm, p95_mm, _, roll_deg, found, grown, false, error_mm = numbers
    assert rms_mm < 1.2 and p95_mm < 2.0 and roll_deg < 0.25, said
    assert (found, grown, false) == (14, 14, 0) and error_mm < 0.07, said
    assert len(json.loads(out.read_text())["unchanged"]) >= 10  # of 12 defects that are there and did not grow
