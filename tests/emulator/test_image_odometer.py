"""The odometer of the image against its two lines: at every edge, between edges, and when it cannot follow."""

import random

import pytest
from emulated import MS, EmulatedBoard, arm

from annulus_pipe.controller import PIN_ODOMETER_A, PIN_ODOMETER_B, PIN_SYNC
from annulus_pipe.link.messages import Edge, Fault, FaultCode, Health, HealthReply, Lamp, Status, StatusReply

GRAY = ((1, 1), (0, 1), (0, 0), (1, 0))  # A falls first: up, from both high
ODOMETER_DMA = 2  # the channel of firmware/rp2040/hardware.h
CLEAR_OF_AN_EDGE = 60  # ticks in which a transition may be told before or after it


class Cable:
    """Turns the wheel: input edges for a step at a tick, and the truth."""

    def __init__(self) -> None:
        self.place = 0

    def step(self, tick: int, by: int) -> list[tuple[int, int, int]]:
        before, after = GRAY[self.place % 4], GRAY[(self.place + by) % 4]
        self.place += by
        lines = zip((PIN_ODOMETER_A, PIN_ODOMETER_B), before, after, strict=True)
        return [(tick, pin, level) for pin, old, level in lines if old != level]

    def move(self, board: EmulatedBoard, steps: int, every: int, begin: int | None = None) -> int:
        """So many steps, one after the other; tick after the last."""
        tick = board.now + 100 if begin is None else begin
        edges = []
        for _ in range(abs(steps)):
            edges += self.step(tick, 1 if steps > 0 else -1)
            tick += every
        board.input(*edges)
        return tick


def status(board: EmulatedBoard) -> StatusReply:
    reply = board.request(Status())
    assert isinstance(reply, StatusReply)
    return reply


def health(board: EmulatedBoard) -> HealthReply:
    reply = board.request(Health())
    assert isinstance(reply, HealthReply)
    return reply


def odometer_faults(board: EmulatedBoard) -> list[int]:
    """Their details."""
    return [fault.detail for fault in board.heard(Fault) if fault.fault == FaultCode.ODOMETER]


def test_there_and_back_without_a_camera_reads_zero(board: EmulatedBoard) -> None:
    """Only edges and `status` decoded, from a ring of 512: 300 there and 300 back between two of them read -176."""
    board.identify()
    cable = Cable()
    board.run(cable.move(board, 300, 2_000))
    board.run(cable.move(board, -300, 2_000))
    assert status(board).odometer == 0
    board.run(cable.move(board, -700, 1_000))
    board.pulse(board.now + 100)
    board.run(board.now + MS)
    assert [edge.odometer for edge in board.heard(Edge)] == [-700]
    assert odometer_faults(board) == []


def test_any_motion_is_exact_at_every_edge_while_the_host_asks_and_asks(board: EmulatedBoard) -> None:
    """`status` decoded past edges whose stamps had not yet been fetched."""
    board.identify()
    cable, rng, truth = Cable(), random.Random(17), []
    tick = board.now + MS
    for _ in range(150):
        edge = tick + rng.randrange(150_000, 250_000)
        steps = []
        direction = rng.choice((-1, 1))
        while tick < edge - CLEAR_OF_AN_EDGE:
            steps += cable.step(tick, direction)
            direction = -direction if rng.random() < 0.02 else direction
            tick += rng.choice((150, 300, 500, 1_000))  # 100 to 660 kHz
        truth.append(cable.place)
        board.input(*steps, (edge, PIN_SYNC, 0), (edge + 3_000, PIN_SYNC, 1))
        tick = edge + CLEAR_OF_AN_EDGE
        board.run(edge - rng.randrange(4_000, 9_000))  # so that the answer is made as the edge comes
        board.send(Status())
    board.run(tick + 3 * MS)
    assert [edge.odometer for edge in board.heard(Edge)] == truth
    assert odometer_faults(board) == []


def test_what_a_stalled_processor_could_not_follow_is_counted_and_said(board: EmulatedBoard) -> None:
    arm(board, ratio=0)
    cable = Cable()
    board.run(cable.move(board, 40, 2_000) + MS)
    board.stall(50 * MS)
    stalled = board.now
    cable.move(board, 1_000, 4_000)
    board.pulse(stalled + 10 * MS)
    board.run_alive(stalled + 60 * MS)
    counted = health(board)
    assert counted.odometer_impossible == 0
    assert 1_000 - 512 <= counted.odometer_lost <= 1_000 - 400
    assert odometer_faults(board) == [counted.odometer_lost]
    now = status(board)
    assert now.odometer == 1_040 - counted.odometer_lost
    assert now.fault == FaultCode.NONE
    board.run(cable.move(board, -200, 2_000))
    assert status(board).odometer == 840 - counted.odometer_lost  # from there on it follows again
    assert [edge.lamp for edge in board.heard(Edge)] == [Lamp.LED]  # and nothing is disarmed by it


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("late", [8_000, 10_000, 12_000, 16_000])
def test_what_is_overwritten_while_it_is_read_is_counted(board: EmulatedBoard, late: int) -> None:
    """440 up wait to be decoded; while they are, 500 down come at 12.5 MHz: 755 off and 53 counted."""
    board.identify()
    cable = Cable()
    begin = board.now
    board.stall(2 * MS)
    cable.move(board, 440, 400, begin + 1_000)
    board.run_alive(cable.move(board, -500, 8, begin + 2 * MS + late) + 5 * MS)
    counted = health(board)
    assert abs(status(board).odometer - cable.place) <= counted.odometer_lost
    assert counted.odometer_impossible == 0
    assert odometer_faults(board)[0] > 0


def test_lines_that_change_together_are_counted_and_said_but_not_in_a_flood(board: EmulatedBoard) -> None:
    board.identify()
    cable = Cable()
    for _ in range(30):
        board.input(*cable.step(board.now + 100, 2))
        board.run(board.now + MS)
    board.run(board.now + 100 * MS)
    assert health(board).odometer_impossible == 30
    said = odometer_faults(board)
    assert said[0] == 1
    assert said[-1] == 30
    assert len(said) == 2  # 30 ms of them, one report in 100 ms
    assert status(board).odometer == 0


@pytest.mark.deep(
    gate="tests/emulator/test_image_odometer.py::test_any_motion_is_exact_at_every_edge_while_the_host_asks_and_asks"
)
def test_the_count_of_transitions_begins_anew_after_two_thousand_million(board: EmulatedBoard) -> None:
    """The channel that counts them ended for good after 2^32 - 1 transfers: the odometer stood still."""
    board.identify()
    cable = Cable()
    board.run(cable.move(board, 1_024, 1_000) + MS)
    board.poke_dma_count(ODOMETER_DMA, 2**30 + 512)  # as after that many more: not what is tested here
    board.run(board.now + 2 * MS)
    board.poke_dma_count(ODOMETER_DMA, 1_024)
    board.run(board.now + 300 * MS)
    before, lost = status(board).odometer, health(board).odometer_lost
    said = len(odometer_faults(board))
    begin, tick, truth = cable.place, board.now + MS, []
    for steps in (700, 500, -300, 1_000, -900, 700, 1_200):  # past the end, which is at the 1025th
        tick = cable.move(board, steps, 700, tick) + 200
        truth.append(cable.place - begin)
        board.pulse(tick, low=1_000)
        tick += 2_000
    board.run(tick + MS)
    assert [edge.odometer - before for edge in board.heard(Edge)] == truth
    assert health(board).odometer_lost == lost
    assert len(odometer_faults(board)) == said
