"""Promises of the head's process: it keeps the order of things, and says so when it cannot keep the time."""

import time
from collections.abc import Iterator
from dataclasses import asdict

import pytest

from annulus_pipe.twin import process
from annulus_pipe.twin.faults import NO_FAULTS
from annulus_pipe.twin.head import head_timing, run_head
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import AnnulusError


@pytest.fixture
def head() -> Iterator[process.TwinHead]:
    order = {
        "world": demo_world().scaled(104).to_dict(),
        "timing": asdict(head_timing(25.0)),
        "faults": asdict(NO_FAULTS),
        "seed": 1,
        "speed_mm_s": 0.0,
        "drift_ppm": 30.0,
        "threads": 1,
        "board": "native",
    }
    head = process.TwinHead(order)
    yield head
    head.close()


def test_a_controller_gets_nothing_before_the_host_has_sent_it(
    head: process.TwinHead, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent, got = list[int](), list[int]()

    def read() -> bytes:
        time.sleep(0.06)  # the machine was busy, and the host spoke at the end of it
        sent.append(time.monotonic_ns())
        return b"\0"

    monkeypatch.setattr(head.serial, "read", read)
    monkeypatch.setattr(head.board, "serial_write", lambda data: got.append(head.clock.ns(head.board.tick)))
    for _ in range(3):
        assert head.listen()
    assert [at + process.TICK_NS >= then for at, then in zip(got, sent, strict=True)] == [True] * 3


def test_a_head_that_was_held_up_stretches_its_time_and_says_by_how_much(head: process.TwinHead) -> None:
    head.advance()
    before, at_ns, stretched_before_ms = head.board.tick, head.clock.ns(head.board.tick), head.stretched_ms
    time.sleep(process.LATE_S + 0.2)
    head.advance()
    stretched_ms = head.stretched_ms - stretched_before_ms
    passed_s = (head.board.tick - before) * process.TICK_S
    assert stretched_ms >= 200.0 and passed_s == pytest.approx(process.LATE_S, abs=0.001)
    moved_ns = head.clock.ns(before) - at_ns
    assert moved_ns == pytest.approx(stretched_ms * 1e6, abs=1e3), "its clock tells the same"


def test_a_head_that_there_is_none_of_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(AnnulusError, match="'nose': expected one of ring, stereo"):
        run_head(3.0, 1, None, "native", 6.0, None, head="nose")
