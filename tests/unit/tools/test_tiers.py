"""What is in the gate and what is deep, and which deep tests a change calls for."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import tiers

from tools import room, touched

ROOT = Path(__file__).resolve().parents[3]


def item(nodeid: str, *marks: pytest.MarkDecorator) -> Any:
    """Of what pytest collects, as much as the tiers look at."""
    one = SimpleNamespace(nodeid=nodeid, own_markers=[mark.mark for mark in marks])
    one.iter_markers = lambda name: [mark for mark in one.own_markers if mark.name == name]
    one.get_closest_marker = lambda name: next(iter(one.iter_markers(name)), None)
    return one


def deep(items: list[Any]) -> list[str]:
    return [one.nodeid.partition("::")[2] for one in items if one.get_closest_marker("deep")]


def test_the_first_case_or_the_one_that_is_named_stays_in_the_gate() -> None:
    first, named = pytest.mark.deep(but=1), pytest.mark.deep(but="b")
    items = [item(f"tests/unit/a.py::test_x[{case}]", first) for case in "abc"]
    items += [item(f"tests/unit/a.py::test_y[{case}]", named) for case in "abc"]
    tiers.part(items)
    assert deep(items) == ["test_x[b]", "test_x[c]", "test_y[a]", "test_y[c]"]
    assert tiers.unspoken(items) == []


def test_a_deep_test_that_nothing_in_the_gate_stands_for_is_named() -> None:
    gate = item("tests/unit/a.py::test_gate")
    by = pytest.mark.deep(gate="tests/unit/a.py::test_gate")
    by_a_deep_one = pytest.mark.deep(gate="tests/unit/a.py::test_held")
    by_none = pytest.mark.deep(gate="tests/unit/a.py::test_gone")
    items = [gate, item("tests/unit/a.py::test_held", by)]
    assert tiers.unspoken(items) == []
    wrong = [item("tests/unit/a.py::test_p", by_a_deep_one), item("tests/unit/a.py::test_q", by_none)]
    wrong.append(item("tests/unit/a.py::test_r[1]", pytest.mark.deep))
    assert [line.partition(":: ")[0].split("::")[1].split(":")[0] for line in tiers.unspoken(items + wrong)] == [
        "test_p",
        "test_q",
        "test_r",
    ]


COSTS = {
    "tests/unit/wall/test_axis.py": {"gate": 1.0, "deep": 20.0},
    "tests/unit/report/test_page.py": {"gate": 1.0, "deep": 30.0},
    "tests/unit/geometry/test_pose.py": {"gate": 1.0, "deep": 5.0},
    "tests/unit/rings/test_slits.py": {"gate": 1.0, "deep": 0.0},
    "tests/system/test_scan.py": {"gate": 17.0, "deep": 50.0},
    "tests/emulator/test_usb.py": {"gate": 4.0, "deep": 60.0},
}


@pytest.fixture
def costs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiers, "read_durations", lambda: COSTS)


def test_a_change_calls_for_its_own_room_first_then_those_above_and_never_those_below(costs: None) -> None:
    far = touched.touched(["host/annulus_pipe/wall/axis.py"], touched.floors())
    assert sorted(far, key=far.__getitem__) == [
        "tests/unit/wall/test_axis.py",
        "tests/unit/report/test_page.py",
        "tests/system/test_scan.py",
    ]
    assert touched.fitting(far, 51.0) == ["tests/unit/wall/test_axis.py", "tests/unit/report/test_page.py"]
    assert touched.touched(["README.md"], touched.floors()) == {}
    assert "tests/emulator/test_usb.py" in touched.touched(["firmware/core/safety.c"], touched.floors())
    by_a_helper = touched.touched(["tests/emulator/emulated.py"], touched.floors())
    assert list(by_a_helper) == ["tests/emulator/test_usb.py"]


def test_the_firmwares_own_attack_and_real_drivers_are_called_for_by_a_change_of_it() -> None:
    called = touched.touched(["firmware/core/safety.c"], touched.floors())
    assert {"tests/unit/firmware/test_attack.py", "tests/guest/test_v4l2.py"} <= called.keys()


@pytest.mark.parametrize("asked", [["no-such-commit"], ["--minutes", "-1"], ["--minutes", "nan"]])
def test_touched_refuses_what_it_cannot_use(asked: list[str]) -> None:
    ran = subprocess.run([sys.executable, "-m", "tools.touched", *asked], cwd=ROOT, capture_output=True, text=True)
    assert ran.returncode == 2 and "Traceback" not in ran.stderr and ran.stderr.strip()


def test_a_gate_test_that_is_misspelt_or_never_runs_stands_for_nothing() -> None:
    misspelt = pytest.mark.deep(gate="tests/untis/wall/test_axis.py::test_a_narrower_pipe_is_no_gap")
    skipped = item("tests/unit/a.py::test_gate", pytest.mark.skip(reason="too busy"))
    by = pytest.mark.deep(gate="tests/unit/a.py::test_gate")
    items = [skipped, item("tests/unit/a.py::test_p", misspelt), item("tests/unit/a.py::test_q", by)]
    assert len(tiers.unspoken(items)) == 2


def test_a_room_that_is_none_is_one_line_with_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"no room 'walls'\. There are: .*wall"):
        room.steps("walls")
    for outside in ("", "..", "../../tests", "wall/axis.py", "Wall"):
        with pytest.raises(ValueError, match="There are"):
            room.steps(outside)
    assert any("tests/unit/wall" in word for command in room.steps("wall") for word in command)


@pytest.mark.parametrize("broken", ["exit 3", "kill -9 $$"])
def test_a_room_fails_if_any_of_its_checks_does(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "steps", lambda _: [["sh", "-c", broken], ["true"]])
    assert room.main(["wall"]) != 0
    monkeypatch.setattr(room, "steps", lambda _: [["true"], ["true"]])
    assert room.main(["wall"]) == 0
