"""The simulated CT of a joint, read, imaged, written and scored as its own scorer does (../shared/joints)."""

import importlib.util
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus.cli import app

JOINTS = Path(__file__).resolve().parents[4] / "shared" / "joints"
TRUTH = JOINTS / "joint-a-truth" / "truth.json"
pytestmark = pytest.mark.skipif(not TRUTH.is_file(), reason="no scenes here (../shared)")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("joint")
    done = CliRunner().invoke(app, ["joint", "image", str(JOINTS / "joint-a/ct.tif"), "-o", str(out), "--json"])
    assert done.exit_code == 0, done.output
    return out


@pytest.fixture(scope="module")
def score(results: Path) -> dict[str, Any]:
    spec = importlib.util.spec_from_file_location("score_joints", JOINTS / "score.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return dict(module.score(str(results / "features.json"), str(TRUTH)))


def test_lengths_are_as_true_as_was_asked(score: dict[str, Any]) -> None:
    assert score["outer_radius_rms_mm"] <= 0.02
    assert score["T_mm"]["rms"] <= 0.06
    for side in ("out", "in"):
        assert score[f"bead_{side}_height_mm"]["rms"] <= 0.05
        assert abs(score[f"bead_{side}_width_mm"]["bias"]) <= 0.15
    assert score["W_inner4_mm"]["rms"] <= 0.30
    assert abs(score["W_inner4_mm"]["bias"]) <= 0.1


def test_every_flaw_is_found_and_none_made_up(score: dict[str, Any]) -> None:
    assert all(found for _, found, _ in score["defects"])
    assert score["false"] <= 1


def test_the_zones_density_and_what_there_is_no_hilo_of(results: Path) -> None:
    said, true = (json.loads(path.read_text()) for path in (results / "features.json", TRUTH))
    by = true["by_angle"]
    drop = np.interp(said["phi_deg"], [*by["phi_deg"], 360], [*by["drop"], by["drop"][0]])
    assert np.sqrt(np.mean((np.array(said["haz"], float) - (1 - drop)) ** 2)) < 0.003
    assert np.abs(said["hilo_out"]).max() < 0.05
    off = np.array(said["W"], float) - np.interp(said["phi_deg"], by["phi_deg"], by["W_inner4_mm"])
    assert (np.abs(off) < 2 * np.array(said["W_sigma"], float)).mean() > 0.8


def test_a_wrong_voxel_size_is_told(tmp_path: Path) -> None:
    done = CliRunner().invoke(
        app, ["joint", "image", str(JOINTS / "joint-a/ct.tif"), "-o", str(tmp_path), "--voxel-mm", "0.3", "0.3", "0.3"]
    )
    assert done.exit_code != 0
    assert "is the voxel size of 0.3 x 0.3 x 0.3 mm right?" in str(done.exception)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["strength.csv", "strength-other.csv"])
def test_strengths_whose_zero_is_unknown_are_never_called_related(results: Path, name: str) -> None:
    done = CliRunner().invoke(app, ["joint", "correlate", str(results), str(JOINTS / "joint-a" / name)])
    assert done.exit_code == 0, done.output
    for word in ("p over the search", "least p", "n 8", "shift", "cannot be told"):
        assert word in done.output
    said = json.loads((results / "correlate.json").read_text())["features"]
    assert set(said) == {"W", "T"}
    assert not any(one["related"] for one in said.values())
    assert (results / "correlate.png").read_bytes().startswith(b"\x89PNG")
