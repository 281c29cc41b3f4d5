"""Promises of the table of scenes: what is off is marked, what is not asked is not, and a green page is read as one."""

import json
from pathlib import Path
from typing import Any

import pytest

from tools.bench.__main__ import main
from tools.bench.scenes.blind import blind_checks
from tools.bench.scenes.judge import feature_checks, pocket_bias, scene_checks, verdict

GREEN = '<div class="verdict sound">No defect\n above.\n  <small>Listed</small></div>'
RED = '<div class="verdict ">1 wall loss.\n  <small>Listed</small></div>'
TRUTH = {"scene": {"camera": {"width": 1664}, "pipe": {"radius": 76.2, "features": {"joint": {"hilo_mm": [1.5, 0.0]}}}}}


def score(**changed: Any) -> dict[str, Any]:
    sound = {"found": 1, "misnamed": 0, "missed": 0, "false": [], "gross_percent": 0.0, "k2": 0.5, "k2_centred": 0.95}
    return {**sound, "features": [{"name": "pocket"}], "points_in_openings": 900, **changed}


def pocket(depth: float, length: float, **changed: Any) -> dict[str, Any]:
    one = {"name": "pocket", "state": "found", "listed": [], "z": [100, 120], "clock_deg": 90, "floor_seen": True}
    return {
        **one,
        "depth": depth,
        "depth_true": 2.0,
        "length": length,
        "length_true": 20.0,
        "z_error": 0.0,
        "within_k2": True,
        **changed,
    }


def missed(checks: Any) -> list[str]:
    return [check.what for check in checks if check.ok is False]


def test_a_sound_scene_misses_nothing() -> None:
    assert not missed(scene_checks(score(), RED, 0))
    assert not missed(feature_checks(pocket(2.04, 23.0), TRUTH, []))


@pytest.mark.parametrize(
    ("changed", "page", "undecided", "what"),
    [
        ({"misnamed": 1}, RED, 0, "list"),
        ({"false": ["a bump"]}, RED, 0, "list"),
        ({"gross_percent": 0.06}, RED, 0, "gross"),
        ({"k2_centred": 0.98}, RED, 0, "k2"),
        ({"features": [{"name": "gap"}]}, RED, 0, "points in the gap"),
        ({}, GREEN, 0, "verdict"),
        ({"features": []}, GREEN, 1, "verdict"),
    ],
)
def test_what_is_asked_of_a_scene(changed: dict[str, Any], page: str, undecided: int, what: str) -> None:
    assert missed(scene_checks(score(**changed), page, undecided)) == [what]


def test_a_page_is_green_or_not() -> None:
    assert verdict(GREEN) == (True, "No defect above.") and verdict(RED) == (False, "1 wall loss.")
    assert not missed(scene_checks(score(features=[]), GREEN, 0))


def test_a_length_has_its_bound_and_depths_their_mean() -> None:
    assert missed(feature_checks(pocket(2.0, 26.0), TRUTH, [])) == ["length"]
    assert missed([pocket_bias([{"features": [pocket(2.08, 20.0)] * 3}])]) == ["mean depth of 3 pockets"]
    hidden = {"features": [pocket(1.0, 20.0, floor_seen=False), *[pocket(2.04, 20.0)] * 3]}
    assert not missed([pocket_bias([hidden])])


def test_a_joint_is_held_to_its_measures_and_the_clock_of_its_step() -> None:
    true = {"height_mm": 3.5, "hilo_mm": 1.5, "angle_deg": 1.0}
    joint = {
        "name": "joint",
        "state": "found",
        "listed": [],
        "z": [168.0, 176.0],
        "clock_deg": 0,
        "measures_true": true,
    }
    measured = {"height_mm": 3.2, "hilo_mm": 1.45, "angle_deg": 1.2}
    half = {"scene": {**TRUTH["scene"], "camera": {"width": 832}}}
    step = {"kind": "joint", "z_mm": 172.0, "clock_deg": 0.0, "hilo_clock_deg": 78.0}
    assert missed(feature_checks({**joint, "measured": [measured]}, TRUTH, [step])) == ["angle_deg", "hilo_clock_deg"]
    assert missed(feature_checks({**joint, "measured": [measured]}, half, [])) == []
    assert missed(feature_checks({**joint, "measured": [{}]}, TRUTH, [])) == list(true)


def test_a_folder_without_scenes_is_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", str(tmp_path)]) == 2
    assert "no score_real.py" in capsys.readouterr().err


def drawn(folder: Path, **changed: Any) -> tuple[Path, Path]:
    """A scan's truth and what a survey said of it: a joint, a pocket, a bend, each as it is but for what is changed."""
    joint = {"kind": "joint", "z_mm": 300.0, "length_mm": 8.0, "height_mm": 3.0, "width_mm": 8.0}
    loss = {"kind": "loss", "z_mm": 150.0, "length_mm": 20.0, "depth_mm": 2.0}
    bend = {"start_mm": 160.0, "radius_mm": 400.0, "angle_deg": 45.0}
    truth = {"named": [joint], "defects": [loss], "centreline": {"bends": [bend]}}
    found = {"features": [{**joint, **changed.get("joint", {})}], "defects": [{**loss, **changed.get("loss", {})}]}
    found["defects"] += changed.get("more", [])
    line = {"bends": [{**bend, **changed.get("bend", {})}], "line_mm": [[90.0, 0, 0, 90], [400.0, 0, 0, 400]]}
    for name, what in (("truth", truth), ("summary", found), ("centreline", line)):
        (folder / f"{name}.json").write_text(json.dumps(what), encoding="utf-8")
    (folder / "report.html").write_text(changed.get("page", RED), encoding="utf-8")
    return folder, folder


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        ({}, []),
        ({"joint": {"height_mm": 3.6}}, ["height_mm"]),
        ({"joint": {"kind": "groove"}}, ["joint 300"]),
        ({"loss": {"z_mm": 200.0}}, ["loss 150", "false"]),
        ({"loss": {"length_mm": 26.0}}, ["length"]),
        ({"bend": {"angle_deg": 45.4}}, ["bend angle_deg"]),
        ({"more": [{"kind": "bump", "z_mm": 240.0, "length_mm": 6.0, "depth_mm": 1.0}]}, ["false"]),
        ({"page": GREEN}, ["verdict"]),
    ],
)
def test_what_the_twin_drew_is_what_must_be_listed(tmp_path: Path, changed: dict[str, Any], what: list[str]) -> None:
    assert missed(blind_checks(*drawn(tmp_path, **changed))) == what


def test_an_unknown_blind_scene_is_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "--blind", "1", "--only", "elbow"]) == 2
    assert "there are butt" in capsys.readouterr().err
