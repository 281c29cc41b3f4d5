"""What a head is said to know of a pipe beforehand is what it then knows."""

import json
from pathlib import Path

import numpy as np
import pytest
from drawn_head import RADIUS_MM, head
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.stereo.outlook import outlook
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.vocabulary import AnnulusError


def test_one_camera_fails_at_its_tangents_and_both_nowhere() -> None:
    seen = outlook(head(1.0), RADIUS_MM)
    assert seen.sigma_mm.shape == (3, 7, 360)
    for camera in (0, 1):
        assert seen.sigma_mm[camera].max() > 20 * np.median(seen.sigma_mm[camera])
    assert seen.worst_mm.max() < 0.2
    assert (seen.sigma_mm[2] <= seen.sigma_mm[:2].min(axis=0) * (1 + 1e-9)).all()
    assert seen.is_covered


def test_a_pipe_that_the_head_does_not_fit_is_one_line() -> None:
    with pytest.raises(AnnulusError, match="does not fit a pipe of 20 mm"):
        outlook(head(1.0), 10.0)


def test_the_command_says_which_pipes_are_covered(tmp_path: Path) -> None:
    save_calibration(tmp_path / "head.json", head(1.0))
    asked = ["pattern", "design", "--head", "stereo", "--calibration", str(tmp_path / "head.json"), "-o", str(tmp_path)]
    done = CliRunner().invoke(app, [*asked, "--pipe-mm", "76.2-203.2", "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    assert [pipe["diameter_mm"] for pipe in told["pipes"]] == pytest.approx([76.2, 139.7, 203.2])
    assert (tmp_path / "outlook.png").stat().st_size > 10_000
    for wrong, line in (("7", "does not fit"), ("x", "expected a diameter")):
        failed = CliRunner().invoke(app, [*asked, "--pipe-mm", wrong])
        assert isinstance(failed.exception, AnnulusError)
        assert line in str(failed.exception)
