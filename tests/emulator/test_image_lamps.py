"""Promises about the lamps when edges come at the wrong moment, or too often, or not at all: read off the pins."""

import random

from emulated import MS, EmulatedBoard, arm, configuration

from annulus.controller import PIN_LED, PIN_SYNC
from annulus.link.messages import Edge, Lamp, StageReply, StatusCode, SyncFound, SyncLost

# ---- how long a lamp may be on ----


def test_a_flash_may_take_half_of_the_shortest_interval_and_not_of_the_period(board: EmulatedBoard) -> None:
    """Half of 40 ms was granted with edges accepted from 20 ms on: at 50 Hz the LED shone 99.9 % of the time."""
    board.identify()
    timing = {"ratio": 0, "period": 40 * MS, "tolerance": 500, "delay": 0, "readout": 0}
    refused = board.request(configuration(**timing, width=10 * MS + 1))
    assert isinstance(refused, StageReply)
    assert (refused.status, refused.detail) == (StatusCode.DUTY, Lamp.LED)
    arm(board, **timing, width=10 * MS)
    edges = [board.now + MS + i * (20 * MS + 3) for i in range(30)]
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 20 * MS)
    assert board.widths(PIN_LED) == [10 * MS] * 30


# ---- what is said of the edges ----


def test_an_edge_in_the_middle_of_a_round_is_no_lost_sync(board: EmulatedBoard) -> None:
    """An edge stamped after the round's own tick was read seemed 43 s old: one in 200, every 8 s at 25 fps."""
    period = 2 * MS
    arm(board, ratio=4, period=period, delay=30_000, width=20_000)
    rng = random.Random(5)
    first = board.now + MS
    edges = [first + i * period + rng.randrange(-4_000, 4_000) for i in range(1_500)]
    board.input(*[item for edge in edges for item in ((edge, PIN_SYNC, 0), (edge + 3_000, PIN_SYNC, 1))])
    board.run_alive(edges[-1] + MS)
    assert len(board.heard(Edge)) == 1_500
    assert len(board.heard(SyncFound)) == 1
    assert board.heard(SyncLost) == []
