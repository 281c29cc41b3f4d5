"""The fuzzers hold for a few cases of each target, and see what they are there to see."""

from pathlib import Path

import pytest

from annulus_pipe.record import recording
from annulus_pipe.record.walk import Chunk
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.fuzz import targets
from tools.bench.fuzz.run import fuzz, one


@pytest.mark.parametrize("name", targets.TARGETS)
def test_a_few_hundred_cases_hold(name: str, tmp_path: Path) -> None:
    said = {number: one(name, 7, number, tmp_path / "case") for number in range(15 if name == "link" else 40)}
    assert not {number: text for number, text in said.items() if text}


def test_a_case_follows_from_its_number() -> None:
    from random import Random

    for target in targets.TARGETS.values():
        assert target.case(Random("1 x 5")) == target.case(Random("1 x 5"))


def test_a_checksum_that_nobody_looks_at_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(Chunk, "read", lambda self, file: recording.piece(file, self.offset, self.length))
    said = [one("mcap", 7, number, tmp_path / "case") for number in range(100)]
    assert any(text and text.startswith("Silent") for text in said)


def test_whoever_breaks_the_law_is_told_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def hold(data: bytes, folder: Path) -> None:
        bytearray(8 << 30)

    def die(data: bytes, folder: Path) -> None:
        import os

        os._exit(3)

    def shout(data: bytes, folder: Path) -> None:
        raise ValueError("a line\nand another")

    def refuse(data: bytes, folder: Path) -> None:
        raise AnnulusError("no")

    found = {}
    for read in (hold, die, shout, refuse):
        monkeypatch.setitem(targets.TARGETS, "x", targets.Target(lambda rng: b"", read))
        found[read.__name__] = fuzz("x", 1, cases=2)
    assert found["hold"].findings[0].startswith("MemoryError")
    assert found["die"].findings == {0: "the process died (3)", 1: "the process died (3)"}
    assert "ValueError" in found["shout"].findings[1]
    assert found["refuse"].findings == {} and found["refuse"].refused == found["refuse"].executions == 2
