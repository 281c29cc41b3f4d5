"""The self-test of a board, on the image a user flashes: it finds what firmware/README promises, misses what is not
wired, and says which promise is broken.
"""

import html
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import ROOT

from annulus_pipe.selftest.page import render_page, render_table, verdict_line
from annulus_pipe.selftest.promise import PromiseVerdict, Row
from annulus_pipe.selftest.run import SelfTest, WireGoes, run_selftest
from annulus_pipe.testing.heads import SimulatedHead
from tools.mutants import MUTANTS

STEP_TO_SYNC, GATE_TO_INTERLOCK = (8, 2), (5, 7)
EDGES = 100


def selftest_of(image: Path, *wires: tuple[int, int], moves: bool = True, edges: int = EDGES) -> SelfTest:
    with SimulatedHead("emulated", image=image, wires=wires) as head:

        def move(wire: WireGoes) -> bool:
            head.interlock(is_open=wire is WireGoes.OFF)
            if wire is WireGoes.TO_GATE:
                head.wire(*wires, GATE_TO_INTERLOCK)
            head.run(0.001)
            return True

        return run_selftest(head.url, name="emulated", edges=edges, move_wire=move if moves else lambda _: False)


def row(test: SelfTest, what: str) -> Row:
    (found,) = [row for row in test.rows if row.what.startswith(what)]
    return found


@pytest.fixture(scope="module")
def whole(image: Path) -> Iterator[SelfTest]:
    yield selftest_of(image, STEP_TO_SYNC)


@pytest.fixture(scope="module")
def bare(image: Path) -> Iterator[SelfTest]:
    yield selftest_of(image, moves=False)


@pytest.mark.deep(
    gate="tests/emulator/test_selftest.py::test_a_selftest_without_wires_says_what_it_needs_and_breaks_nothing"
)
def test_a_selftest_finds_what_the_readme_promises(whole: SelfTest) -> None:
    readme = (ROOT / "firmware/README.md").read_text(encoding="utf-8")
    (latency,) = re.findall(r"falling edge of GP2 to lamp \| delay \+ \*\*(\d+) ticks\*\*", readme)
    (reaction,) = re.findall(r"interlock opens to GP5 low \| (\d+) ticks at most", readme)
    assert [r for r in whole.rows if r.verdict is PromiseVerdict.BROKEN] == []
    assert {r.verdict for r in whole.rows} <= {PromiseVerdict.KEPT, PromiseVerdict.INFORMS, PromiseVerdict.NOT_TESTED}
    for lamp, flashes in (("LED", EDGES), ("projector", 14)):
        lowest, highest, seen = row(whole, f"Falling edge of sync to {lamp}").values
        assert lowest == highest == int(latency)
        assert seen >= flashes
    for r in whole.rows:
        if r.what.startswith(("Lamp width", "Microwave pulse")):
            assert r.values == (int(r.promise.split()[0]),), r  # to the tick
        if r.what.startswith("Code "):
            assert r.values == (0, 0), r
        if r.what.startswith("Trigger "):
            assert r.values == (int(r.what.split()[1]), 100), r
    lowest, highest, latched = row(whole, "Interlock opens to").values
    assert 1 <= lowest <= highest <= int(reaction)
    assert latched == 50
    assert row(whole, "Order").measured == "PPPPLPPPPLP"
    shortest, longest, _ = row(whole, "Time stamp").values
    assert longest - shortest <= 1


def test_a_selftest_without_wires_says_what_it_needs_and_breaks_nothing(bare: SelfTest) -> None:
    assert bare.broken == 0
    assert row(bare, "Falling edge of sync to LED").verdict is PromiseVerdict.NOT_WIRED
    assert row(bare, "Falling edge of sync to LED").why == "needs GP8 (pin 11) to GP2 (pin 4)"
    assert row(bare, "Interlock opens to").why == "needs GP7 (pin 10) to GP5 (pin 7)"
    assert row(bare, "Microwave pulse 0.3 us").verdict is PromiseVerdict.KEPT  # ground is all it wants


@pytest.mark.deep(
    gate="tests/emulator/test_selftest.py::test_a_selftest_without_wires_says_what_it_needs_and_breaks_nothing"
)
@pytest.mark.parametrize(
    ("mutant", "broken"),
    [
        ("lamp-one-tick-late", ["Falling edge of sync to LED on", "Falling edge of sync to projector on"]),
        ("hold-off-ignored", ["Hold-off"]),
        (
            "chip-of-49-ticks",
            ["Microwave pulse 0.3 us", "Code mpsl25, chips of 0.3 us", "Code barker13, chips of 0.3 us"],
        ),
    ],
)
def test_a_selftest_of_a_board_that_breaks_a_promise_says_which(
    image: Path, tmp_path: Path, mutant: str, broken: list[str]
) -> None:
    """A selftest that always passes proves nothing: here are boards that are wrong."""
    (fault,) = [m for m in MUTANTS if m.name == mutant]
    firmware = tmp_path / "firmware"
    shutil.copytree(ROOT / "firmware", firmware, ignore=shutil.ignore_patterns("build", "corpus"))
    source = firmware / fault.file
    text = source.read_text()
    assert fault.right in text
    source.write_text(text.replace(fault.right, fault.wrong))
    subprocess.run(["make", "--silent", "-C", str(firmware), "image", "GIT=mutant00"], check=True, capture_output=True)
    test = selftest_of(firmware / "build/annulus.uf2", STEP_TO_SYNC, moves=False, edges=20)
    assert [r.what for r in test.rows if r.verdict is PromiseVerdict.BROKEN] == broken


@pytest.mark.parametrize("of", ["bare", pytest.param("whole", marks=pytest.mark.deep)])
def test_the_page_and_the_table_say_the_same(request: pytest.FixtureRequest, of: str) -> None:
    test: SelfTest = request.getfixturevalue(of)
    page, table = html.unescape(render_page(test)), render_table(test.rows)
    assert verdict_line(test) in page
    for r in test.rows:
        assert r.what in page
        assert r.what in table
    assert not re.search(r"(src|href)=|<script", page)
    assert json.loads(json.dumps(test.to_dict()))["broken"] == 0
