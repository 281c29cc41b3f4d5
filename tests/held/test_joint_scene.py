"""The simulated CT of a joint, read, imaged, written and scored as its own scorer does (../shared/joints)."""

import importlib.util
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError

JOINTS = Path(__file__).resolve().parents[3] / "shared" / "joints"
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


def test_one_page_says_what_may_be_said(results: Path, tmp_path: Path) -> None:
    """With the image alone, then with the raster and the strengths of another pipe, which are not related."""
    folder = tmp_path / "joint"
    shutil.copytree(results, folder)
    for name in ("correlate.json", "correlate.png", "report.html"):
        (folder / name).unlink(missing_ok=True)
    run = CliRunner().invoke
    for steps, said, unsaid in (
        ([], ["2 voids, 1 inclusion, 1 gap", "no strengths were given"], ["Near-field scan"]),
        (
            [
                ["joint", "register", str(folder), str(JOINTS / "joint-a/microwave.npz")],
                ["joint", "correlate", str(folder), str(JOINTS / "joint-a/strength-other.csv")],
            ],
            ["Near-field scan", "W and the strengths", "of 8 dogbones"],
            ["strengths: related", "no strengths were given"],
        ),
    ):
        for step in steps:
            assert run(app, step).exit_code == 0
        done = run(app, ["joint", "report", str(folder), "--json"])
        assert done.exit_code == 0, done.output
        page = Path(json.loads(done.stdout)["report"]).read_text()
        assert all(text in page for text in said)
        assert not any(text in page for text in unsaid)
        assert not re.search(r'(src|href)="(?!data:)', page)  # nothing from elsewhere
    (folder / "beads.png").unlink()
    with pytest.raises(AnnulusError, match=r"beads\.png: No such file"):
        run(app, ["joint", "report", str(folder)], catch_exceptions=False)
    (folder / "features.json").write_text('{"found": [], "summary": {}}')
    shutil.copy(results / "beads.png", folder)
    with pytest.raises(AnnulusError, match="expected what `annulus joint image` writes"):
        run(app, ["joint", "report", str(folder)], catch_exceptions=False)
