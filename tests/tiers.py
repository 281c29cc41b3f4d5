"""Two tiers of tests, and each file's cost. conftest.py hands the items here, test_house.py asks what is amiss."""

import json
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DURATIONS = Path(__file__).with_name("durations.json")

UNSPOKEN = pytest.StashKey[list[str]]()  # deep cases for which nothing in the gate stands


def read_durations() -> dict[str, dict[str, float]]:
    """By file, then "gate" or "deep": seconds of processor, its children's with it."""
    costs: dict[str, dict[str, float]] = json.loads(DURATIONS.read_text(encoding="utf-8"))
    return costs


def file_of(item: pytest.Item) -> str:
    return item.path.relative_to(ROOT).as_posix() if ROOT in item.path.parents else item.path.as_posix()


def _function(item: pytest.Item) -> str:
    return item.nodeid.partition("[")[0]


def part(items: list[pytest.Item]) -> None:
    """Takes the mark from the cases that `but` keeps in the gate."""
    met: dict[str, int] = defaultdict(int)
    for item in items:
        mark = next((mark for mark in item.own_markers if mark.name == "deep" and "but" in mark.kwargs), None)
        if mark is None:
            continue
        but, case = mark.kwargs["but"], item.nodeid.partition("[")[2].removesuffix("]")
        met[_function(item)] += 1
        if case == but if isinstance(but, str) else met[_function(item)] <= but:
            item.own_markers = [other for other in item.own_markers if other.name != "deep"]


def unspoken(items: list[pytest.Item]) -> list[str]:
    """The deep tests that neither have a case in the gate nor name a test that has one."""
    never = {_function(item) for item in items if item.get_closest_marker("skip") is not None}
    gate = {_function(item) for item in items if item.get_closest_marker("deep") is None} - never
    folders = {item.nodeid.partition("/")[2].partition("/")[0] for item in items}
    silent = set()
    for item in items:
        marks = list(item.iter_markers("deep"))
        stands = {str(mark.kwargs["gate"]) for mark in marks if "gate" in mark.kwargs}
        elsewhere = any(  # not collected now
            name.partition("/")[2].partition("/")[0] not in folders and (ROOT / name.partition("::")[0]).is_file()
            for name in stands
        )
        if marks and _function(item) not in gate and not stands & gate and not elsewhere:
            silent.add(f"{_function(item)}: no case in the gate, and {stands or 'nothing'} stands for it")
    return sorted(silent)


def renew(measured: dict[str, dict[str, float]]) -> None:
    """What ran is renewed, what did not stays, and files that are gone go."""
    costs = {name: cost for name, cost in read_durations().items() if (ROOT / name).is_file()}
    for name, new in measured.items():
        ran = {tier: round(seconds, 1) for tier, seconds in new.items()}
        costs[name] = {"gate": 0.0, "deep": 0.0} | costs.get(name, {}) | ran
    rows = ",\n".join(f'  "{name}": {json.dumps(cost)}' for name, cost in sorted(costs.items()))
    DURATIONS.write_text(f"{{\n{rows}\n}}\n", encoding="utf-8")
