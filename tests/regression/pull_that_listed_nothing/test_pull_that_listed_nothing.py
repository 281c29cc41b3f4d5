"""A pull in which none of the defects was listed ended in an internal error when it was fitted, and one of three in a
warning of the drawing library's: the first asks for a picture of depths that nobody reported."""

import json
import warnings
from pathlib import Path

import pytest
from drawn_study import listed, write_results
from typer.testing import CliRunner

from annulus_pipe.cli.app import app

SPOOL = [(200.0 + 80 * i, 40.0 * i % 360, 0.2 + 0.1 * i) for i in range(12)]


@pytest.mark.parametrize("found", [0, 3])
def test_what_was_missed_is_a_result(found: int, tmp_path: Path) -> None:
    rows = [f"{i},loss,{z},{clock},{depth},20,20" for i, (z, clock, depth) in enumerate(SPOOL)]
    (tmp_path / "spool.csv").write_text(
        "name,kind,z_mm,clock_deg,depth_mm,length_mm,width_mm\n" + "\n".join(rows) + "\n"
    )
    undecided = [listed(*one) for one in SPOOL[6:8]]  # a place that may be nothing has a depth too
    write_results(tmp_path / "out", 152.4, {}, [listed(*one) for one in SPOOL[:found]], stations=240)
    summary = tmp_path / "out/summary.json"
    summary.write_text(json.dumps(json.loads(summary.read_text()) | {"undecided": undecided}))
    trials = tmp_path / "trials.json"
    match = ["pod", "match", str(tmp_path / "spool.csv"), str(tmp_path / "out"), "-o", str(trials)]
    assert CliRunner().invoke(app, match).exit_code == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = CliRunner().invoke(app, ["pod", "fit", str(trials), "-o", str(tmp_path / "pod")])
    assert done.exit_code == 0, done.exception
    assert "a90/95 not established" in done.stdout and (tmp_path / "pod/pod.html").is_file()
