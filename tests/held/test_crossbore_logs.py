"""The logs of ../shared/crossbore, drawn by a program that is not ours, scored as its own scorer does."""

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app

LOGS = Path(__file__).resolve().parents[3] / "shared" / "crossbore"
pytestmark = pytest.mark.skipif(not (LOGS / "score.py").is_file(), reason="no scenes here (../shared)")


def scored(name: str, tmp_path: Path) -> dict[str, Any]:
    ran = CliRunner().invoke(app, ["bore", "detect", str(LOGS / f"{name}.csv.gz"), "-o", str(tmp_path / "found.json")])
    assert ran.exit_code == 0, ran.output
    spec = importlib.util.spec_from_file_location("score_bores", LOGS / "score.py")
    assert spec is not None and spec.loader is not None
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    told = json.loads((tmp_path / "found.json").read_text())
    score: dict[str, Any] = scorer.score([(told, json.loads((LOGS / f"{name}.truth.json").read_text()))])
    return score


def test_with_pose_and_loss_all_are_found_and_named(tmp_path: Path) -> None:
    score = scored("crossbore-a2", tmp_path)
    assert (score["found"], score["bores"], score["false"], score["near_reported"]) == (8, 8, 0, 0)
    assert score["class_right"] == 1 and score["position_rms_mm"] < 8 and score["angle_rms_deg"] < 14


def test_without_pose_what_shows_air_is_found_and_nothing_made_up(tmp_path: Path) -> None:
    score = scored("crossbore-a1", tmp_path)
    assert score["found_of_by_kind"]["air eps>10"] == [3, 3]
    assert score["false"] == 0 and score["near_reported"] == 0
    assert score["class_right"] >= 0.9 and score["position_rms_mm"] < 14
