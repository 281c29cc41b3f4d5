"""Every promise that the rig asks of a board, asked of the image on the emulator: to the tick, without its slack."""

import re
import tomllib
from pathlib import Path

import pytest
from emulated import EmulatedBoard
from promises_on_image import PromiseBoard

from annulus_pipe.selftest.rig.promises import Promise
from annulus_pipe.selftest.rig.run import chosen

NAMES = re.compile(r"^def (test_\w+)", re.MULTILINE)
GATE = "no jitter under a flood and a train"


def cases() -> list[object]:
    deep = pytest.mark.deep(gate="tests/emulator/test_promises.py::test_the_image_keeps_what_the_rig_asks")
    return [pytest.param(p, id=p.name.replace(" ", "_"), marks=[] if p.name == GATE else deep) for p in chosen(None)]


@pytest.mark.parametrize("promise", cases())
def test_the_image_keeps_what_the_rig_asks(board: EmulatedBoard, promise: Promise) -> None:
    print(promise.check(PromiseBoard(board)))


def test_every_promise_stands_for_tests_that_are_there_and_every_test_is_listed() -> None:
    """rig.toml says which of the tests of this folder the rig asks of a board, and of every other why not."""
    listed = tomllib.loads(Path(__file__).with_name("rig.toml").read_text())
    here = [name for file in Path(__file__).parent.glob("test_*.py") for name in NAMES.findall(file.read_text())]
    named = {name for names in listed["asserted"].values() for name in names}
    assert named == {promise.name for promise in chosen(None)}
    impossible = [name for names in listed["impossible"].values() for name in names]
    assert sorted([*listed["asserted"], *impossible]) == sorted(here), "a test stands in one of the two lists, once"
    print(f"{len(listed['asserted'])} tests by {len(named)} promises, {len(impossible)} that a rig cannot ask")
