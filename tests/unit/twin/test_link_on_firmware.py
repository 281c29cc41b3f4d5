"""The host's link and the controller's own C code, over a line that spoils bytes both ways, in virtual time."""

import random

import pytest

from annulus_pipe.controller import PIN_INTERLOCK, PIN_LED, PIN_PROJECTOR, PIN_SYNC
from annulus_pipe.link.head import EdgeSeen, HeadControl
from annulus_pipe.link.messages import Identify, Stage, StatusCode
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.session import Answer, EventsLost, Rebooted
from annulus_pipe.twin.native import NativeBoard
from annulus_pipe.vocabulary import AnnulusError, Lamp

MS = 100_000  # ticks
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)


class Rig:
    """A head on the native board, 25 frames a second, one millisecond a step."""

    def __init__(self, seed: int, rate: float) -> None:
        try:
            self.board = NativeBoard()
        except AnnulusError as error:
            pytest.skip(str(error))
        self.board.power_on(5)
        self.board.input(0, PIN_INTERLOCK, 0)
        self.head = HeadControl(STAGE)
        self.random, self.rate = random.Random(seed), rate
        self.news: list[object] = []
        self.falls: list[int] = []

    def invalidate(self, data: bytes) -> bytes:
        return bytes(b ^ (1 << self.random.randrange(8)) if self.random.random() < self.rate else b for b in data)

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            now = self.board.tick
            if now // MS % 40 == 20:
                self.board.input(now + 10, PIN_SYNC, 1)
            if now // MS % 40 == 39:
                self.board.input(now + 10, PIN_SYNC, 0)
                self.falls.append(now + 10)
            self.board.serial_write(self.invalidate(self.head.pending(now * 10)))
            self.board.run_until(now + MS)
            self.news += self.head.receive(self.invalidate(self.board.serial_read()), self.board.tick * 10)


@pytest.mark.parametrize("seed", range(3))
def test_on_a_bad_line_the_head_runs_and_every_edge_is_placed_where_it_fell(seed: int) -> None:
    rig = Rig(seed, rate=0.003)
    rig.run(5000)
    rig.rate = 0.0
    rig.run(2500)
    assert rig.head.phase is Phase.RUNNING
    assert sum(rig.head.session.counters.corrupt.values()) > 5 and rig.head.session.counters.repeats > 0
    seen = [news for news in rig.news if isinstance(news, EdgeSeen)]
    assert not [news for news in rig.news if isinstance(news, Rebooted) and news.previous is not None]
    indices = sorted(edge.flash.edge for edge in seen)
    lost = sum(news.count for news in rig.news if isinstance(news, EventsLost))
    assert len(indices) == len(set(indices)) >= len(rig.falls) - 6 - lost
    for edge in seen:
        assert abs(edge.host_ns - rig.falls[edge.flash.edge] * 10) <= 1_500_000  # a look at the line takes 1 ms


def test_the_lamps_that_edges_announce_are_those_the_pins_show() -> None:
    rig = Rig(0, rate=0.0)
    rig.run(1500)
    rises = [(int(t["tick"]), int(t["pin"])) for t in rig.board.pins() if t["level"]]
    fired = {tick: pin for tick, pin in rises if pin in (PIN_PROJECTOR, PIN_LED)}
    announced = {}
    for news in rig.news:
        if isinstance(news, EdgeSeen) and news.flash.lamp is not Lamp.DARK:
            pin = PIN_LED if news.flash.lamp is Lamp.LED else PIN_PROJECTOR
            announced[rig.falls[news.flash.edge] + news.flash.delay_ticks] = pin
    assert len(announced) > 25
    for at, pin in announced.items():
        near = [p for tick, p in fired.items() if abs(tick - at) <= 10]
        assert near == [pin]


def test_a_watchdog_reset_is_mended_within_two_frames() -> None:
    rig = Rig(0, rate=0.0)
    rig.run(500)
    rig.board.power_on(6, cause=1)
    rig.board.input(rig.board.tick, PIN_INTERLOCK, 0)
    rig.run(80)
    assert rig.head.phase is Phase.RUNNING and rig.head.rearms == 1


def test_a_flash_that_does_not_fit_is_refused_by_the_controller_itself() -> None:
    rig = Rig(0, rate=0.0)
    rig.head.configure(Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 10_000, 500_000, 575_000, 250_000))
    rig.run(100)
    assert rig.head.phase is Phase.REFUSED
    assert rig.head.problem.startswith("projector flash 100..5100 us leaves the window 2000..12000 us")


def test_the_firmware_of_another_schema_answers_but_is_not_armed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("annulus_pipe.link.session.SCHEMA_HASH", 0x12345678)
    monkeypatch.setattr("annulus_pipe.link.problems.SCHEMA_HASH", 0x12345678)
    rig = Rig(0, rate=0.0)
    rig.run(300)
    assert rig.head.phase is Phase.MISMATCH and "expected 1, 12345678" in rig.head.problem
    (answer, *_) = [n for n in rig.news if isinstance(n, Answer) and isinstance(n.command, Identify)]
    assert answer.reply.status is StatusCode.SCHEMA
