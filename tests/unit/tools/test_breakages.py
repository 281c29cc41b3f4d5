"""A fault is drawn from a seed, is one, stands where code is, and is said to be noticed where a test notices it."""

import ast
import os
from pathlib import Path

import pytest

from tools import breakages
from tools.breakages import Bench, host_sources, noticed_by
from tools.faults import Breakage, drawn

SOURCE = {
    "host/annulus_pipe/a.py": '''"""Not 1 < 2."""
LIMIT: "1 + 1" = 3

@cached(size=5)
def f(x: int = 4, y: "a < b" = None) -> "1 < 2":
    """Nor 3 * 4."""
    say("slow" if 1 else f"{x + 1}")
    if not x and (x +
                  1 < LIMIT * 2.5):
        LIMIT -= y
        return x if y else 7
    return None

if __name__ == "__main__":
    f(1)
''',
    "host/annulus_pipe/b.py": '"""Do not edit."""\nX = 1\n',
    "host/annulus_pipe/link/messages.py": "X = 1\n",
    "host/annulus_pipe/controller.py": "X = 1\n",
}
NOW = {
    "4",
    "5",
    "3.75",
    "2",
    "8",  # numbers of the source and one more, or half as much again
    "not x or x + 1 < LIMIT * 2.5",
    "x",
    "x - 1",
    "x + 1 <= LIMIT * 2.5",
    "LIMIT / 2.5",
    "LIMIT += y",
    "not (not x and x + 1 < LIMIT * 2.5)",
    "None",
    "not y",
}


def test_one_seed_has_the_same_faults_and_another_has_others() -> None:
    assert drawn(SOURCE, 1, 5) == drawn(SOURCE, 1, 5)
    assert drawn(SOURCE, 1, 5) != drawn(SOURCE, 2, 5)


def test_every_fault_is_one_and_stands_where_code_is() -> None:
    faults = drawn(SOURCE, 3, 100)
    assert {fault.now for fault in faults} == NOW
    for fault in faults:
        assert ast.dump(ast.parse(fault.source)) != ast.dump(ast.parse(SOURCE[fault.file]))
        assert (fault.file, fault.room) == ("host/annulus_pipe/a.py", "a")


def test_what_means_the_same_is_not_drawn() -> None:
    assert {fault.now for fault in drawn({"a.py": "def f():\n    return 7 + 0\n"}, 1, 9)} == {"8", "1", "None"}


def test_the_hosts_own_sources_have_places_and_none_is_generated() -> None:
    sources = {name: text for name, text in host_sources().items() if name.count("/") == 2 or "/link/" in name}
    files = {fault.file for fault in drawn(sources, 7, 3)}
    assert {"host/annulus_pipe/link/messages.py", "host/annulus_pipe/controller.py"} <= sources.keys()
    assert files and not files & {"host/annulus_pipe/link/messages.py", "host/annulus_pipe/controller.py"}


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """Of a package of one line, whose room has two tests, one of which fails whatever the line says."""
    (tmp_path / "a.py").write_text("def twice(x):\n    return x * 2\n")
    (tmp_path / "tests/unit/a").mkdir(parents=True)
    (tmp_path / "tests/unit/a/test_a.py").write_text(
        "from a import twice\n\ndef test_two():\n    assert twice(2) == 4\n\ndef test_wrong():\n    assert False\n"
    )
    env = {**os.environ, "PYTHONPATH": str(tmp_path), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    return Bench(tmp_path, 60.0, env, workers=())


def test_the_house_is_not_asked_and_no_test_of_the_room_twice(bench: Bench) -> None:
    stages = {name: arguments for name, arguments, _ in bench.stages("a", room_only=False, deep=True)}
    assert list(stages) == ["room", "gate", "deep"]
    assert "--ignore=tests/unit/a" in stages["gate"] and "--ignore=tests/unit/a" not in stages["deep"]
    assert all("--ignore=tests/unit/test_house.py" in stages[name] for name in ("gate", "deep"))


TWO, WRONG = "tests/unit/a/test_a.py::test_two", "tests/unit/a/test_a.py::test_wrong"


def test_pytest_is_run_where_the_fault_is_and_the_first_failure_is_named(bench: Bench) -> None:
    (bench.other / "a.py").write_text("def twice(x):\n    return x * 3\n")
    assert noticed_by(bench.other, ["tests/unit/a", f"--deselect={WRONG}"], 60.0, bench.env) == TWO


def test_a_stage_that_hangs_is_ended_and_said(bench: Bench) -> None:
    assert noticed_by(bench.other, ["tests/unit/a"], 0.02, bench.env) == "nothing but the time: more than 0.02 s"


@pytest.mark.parametrize(("now", "verdict"), [("3", ("room", TWO)), ("2.0", ("nobody", ""))])
def test_a_fault_is_caught_or_survives_and_a_test_that_fails_anyway_has_noticed_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, now: str, verdict: tuple[str, str]
) -> None:
    def run(other: Path, arguments: list[str], timeout_s: float, env: dict[str, str]) -> str:
        names = {WRONG: True, TWO: "* 3" in (other / "a.py").read_text()}
        asked = [name for name in names if name in arguments] or [
            name for name in names if f"--deselect={name}" not in arguments
        ]
        return next((name for name in asked if names[name]), "")

    monkeypatch.setattr(breakages, "noticed_by", run)
    fault = Breakage("host/annulus_pipe/a.py", 2, "2", now, f"def twice(x):\n    return x * {now}\n")
    (bench.other / "host/annulus_pipe").mkdir(parents=True)
    (bench.other / "a.py").rename(bench.other / fault.file)
    (bench.other / "a.py").symlink_to(bench.other / fault.file)
    assert bench.judged(fault) == verdict
    assert bench.excused == [WRONG]
    assert (bench.other / "a.py").read_text().endswith("x * 2\n")
