"""A loss of power that left the boot byte as it was went unnoticed on the UART: the old clock placed the new edges."""

import random

import pytest

from annulus_pipe.controller import PIN_INTERLOCK, PIN_SYNC
from annulus_pipe.link.head import EdgeSeen, HeadControl
from annulus_pipe.link.messages import Stage
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.session import Rebooted
from annulus_pipe.twin.native import NativeBoard

MS = 100_000  # ticks
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)


class Rig:
    """A head on the native board, 25 frames a second, one millisecond a step; for a while the line brings nothing."""

    def __init__(self, byte: int) -> None:
        self.board = NativeBoard()
        self.byte = byte
        self.board.power_on(byte)
        self.board.input(0, PIN_INTERLOCK, 0)
        self.head = HeadControl(STAGE)
        self.seen: list[EdgeSeen] = []
        self.boots: list[Rebooted] = []
        self.falls: list[list[int]] = [[]]  # ns, by boot
        self.deaf_until = 0

    def power_cycle(self, deaf_ms: int) -> None:
        self.board.power_on(self.byte)
        self.falls.append([])
        self.deaf_until = self.board.tick + deaf_ms * MS

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            now = self.board.tick
            if now // MS % 40 == 20:
                self.board.input(now + 10, PIN_SYNC, 1)
            if now // MS % 40 == 39:
                self.board.input(now + 10, PIN_SYNC, 0)
                self.falls[-1].append((now + 10) * 10)
            self.board.serial_write(self.head.pending(now * 10))
            self.board.run_until(now + MS)
            said = self.board.serial_read()
            heard = b"" if self.board.tick < self.deaf_until else said
            for news in self.head.receive(heard, self.board.tick * 10):
                self.seen += [news] if isinstance(news, EdgeSeen) else []
                self.boots += [news] if isinstance(news, Rebooted) else []


@pytest.mark.parametrize("seed", range(12))
def test_the_same_boot_byte_again_is_noticed_and_no_edge_is_placed_by_the_old_clock(seed: int) -> None:
    """Seen red with 12 of 12 seeds: no reset was told of, as if the head had gone on."""
    rng = random.Random(seed)
    rig = Rig(rng.randrange(256))
    rig.run(rng.randrange(700, 4000))
    assert rig.head.phase is Phase.RUNNING
    rig.power_cycle(deaf_ms=rng.choice([0, 3, 20, 90, 250]))  # `booted` arrives, or is lost on the line
    before = rig.board.tick
    while len(rig.boots) < 2:
        rig.run(1)
        assert rig.board.tick - max(before, rig.deaf_until) < 350 * MS  # a few pings, or a repeat's patience
    rig.run(1500)
    assert rig.head.phase is Phase.RUNNING
    assert rig.head.boot_epoch == 2
    assert rig.head.session.counters.reboots_unfounded == 0
    for edge in rig.seen:  # edge k of a boot is its k-th fall, and nothing else
        true_ns = rig.falls[edge.boot_epoch - 1][edge.flash.edge]
        assert abs(edge.host_ns - true_ns) <= edge.error_ns + 20_000
    assert {edge.boot_epoch for edge in rig.seen} == {1, 2}
