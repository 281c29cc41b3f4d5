"""The controller's own measurements are what its pins did: every sample of a look, against the emulator's pins."""

import random
import struct

import pytest
from emulated import BOOTED, LATENCY, MS, EmulatedBoard, configuration

from annulus_pipe.controller import (
    PIN_LED,
    PIN_MICROWAVE,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_PROJECTOR,
    PIN_STEP,
    PIN_SYNC,
    PIN_TRIGGER,
    TURNTABLE_LEAD_MS,
)
from annulus_pipe.link.messages import (
    LEVEL,
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    Commit,
    Edge,
    Info,
    Measure,
    Move,
    Samples,
    SamplesReply,
    Status,
    StatusCode,
    StatusReply,
)
from annulus_pipe.vocabulary import EdgeFlag

PERIOD = 200_000
TICKS = 512
BEGIN = 2  # ticks from the edge to the first sample of a look without delay


def samples(board: EmulatedBoard, latest: int = 0) -> tuple[SamplesReply, list[int]]:
    """Four pins in every tick of a look."""
    levels: list[int] = []
    for word in range(0, TICKS // 8, 8):
        reply = board.request(Samples(latest=latest, word=word))
        assert isinstance(reply, SamplesReply)
        levels += [(w >> shift) & 15 for w in struct.unpack("<8I", reply.bits) for shift in range(28, -1, -4)]
    return reply, levels


def pins_over(board: EmulatedBoard, first: int, begin: int) -> list[int]:
    """The same from the pins themselves; GP2 is wired to GP8."""
    levels = {pin: 0 for pin in range(first, first + 4)}
    at = 0
    out = []
    changes = sorted((tick, PIN_SYNC if pin == PIN_STEP else pin, level) for tick, pin, level in board.transitions)
    for tick in range(begin, begin + TICKS):
        while at < len(changes) and changes[at][0] <= tick:
            levels[changes[at][1]] = changes[at][2]
            at += 1
        out.append(sum(levels[first + i] << i for i in range(4)))
    return out


@pytest.fixture
def jumpered(board: EmulatedBoard) -> EmulatedBoard:
    """STEP plays the camera: edges one period apart."""
    board.wire((PIN_STEP, PIN_SYNC))
    board.identify()
    for command in (
        configuration(ratio=1, period=PERIOD, delay=50, width=100, led_width=2, readout=1000),
        Commit(generation=1),
    ):
        assert board.request(command).status == StatusCode.OK
    return board


@pytest.mark.parametrize("seed", range(4))
def test_a_look_is_what_the_pins_did_in_every_tick(jumpered: EmulatedBoard, seed: int) -> None:
    board = jumpered
    early = random.Random(seed).randrange(100, 300)
    assert board.request(Measure(1, PIN_STEP, 1, PIN_SYNC, PERIOD // 2 - early)).status == StatusCode.OK
    assert board.request(Arm(outputs=ArmFlag.LAMPS)).status == StatusCode.OK
    board.request(Move(position=4, period=PERIOD, hold=0))
    board.run(board.now + (3 + TURNTABLE_LEAD_MS) * MS)
    reply, levels = samples(board)
    assert (reply.looks, reply.differs) == (1, 0)
    begin = board.rises(PIN_STEP)[0] + PERIOD // 2 - early + BEGIN
    assert levels == pins_over(board, PIN_SYNC, begin)
    fall = levels.index(0)
    assert levels.index(1 << (PIN_PROJECTOR - PIN_SYNC)) - fall == 50 + LATENCY
    assert levels.count(1 << (PIN_PROJECTOR - PIN_SYNC)) == 100


def test_looks_are_compared_and_the_first_that_differs_is_kept(jumpered: EmulatedBoard) -> None:
    board = jumpered
    board.request(Measure(50, PIN_STEP, 0, PIN_SYNC, 0))
    board.request(Arm(outputs=ArmFlag.LAMPS))
    board.request(Move(position=20, period=PERIOD, hold=0))
    board.run(board.now + 30 * MS)
    first, projector = samples(board)
    latest, led = samples(board, latest=1)
    assert (first.looks, first.differs) == (latest.looks, latest.differs) == (2, 1)  # projector and LED in turn
    assert projector.count(1 << (PIN_PROJECTOR - PIN_SYNC)) == 100
    assert led.count(1 << (PIN_LED - PIN_SYNC)) == 2


def test_equal_looks_are_counted(jumpered: EmulatedBoard) -> None:
    board = jumpered
    board.request(Measure(12, PIN_STEP, 0, PIN_STEP, 0))  # neither lamp among these pins
    board.request(Move(position=20, period=PERIOD, hold=0))
    board.run(board.now + 50 * MS)
    reply, _ = samples(board)
    assert (reply.looks, reply.differs) == (12, 0)


def test_a_burst_is_seen_chip_by_chip(board: EmulatedBoard) -> None:
    board.identify()
    board.request(Measure(1, PIN_TRIGGER, 1, PIN_LED, 0))
    assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
    burst = Burst(code=BurstCode.BARKER13, chip=30, repeat=1, period=100_000, trigger_offset=-40)
    assert board.request(burst).status == StatusCode.OK
    board.run(board.now + 3 * MS)
    _, levels = samples(board)
    gate = [(level >> (PIN_MICROWAVE - PIN_LED)) & 1 for level in levels]
    on = [tick + BEGIN - 40 for tick in range(TICKS) if gate[tick]]
    assert on == [tick for tick in range(13 * 30) if "1111100110101"[tick // 30] == "1"]
    assert board.widths(PIN_MICROWAVE) == [150, 60, 30, 30]


def test_nobody_begins_to_measure_on_a_head_at_work(jumpered: EmulatedBoard) -> None:
    board = jumpered
    board.request(Arm(outputs=ArmFlag.LAMPS))
    assert board.request(Measure(1, PIN_STEP, 1, PIN_SYNC, 0)).status == StatusCode.BAD_STATE
    board.request(Arm(outputs=ArmFlag(0)))
    assert board.request(Measure(1, PIN_STEP, 1, PIN_SYNC, 0)).status == StatusCode.OK
    board.request(Arm(outputs=ArmFlag.LAMPS))
    assert board.request(Measure(1, PIN_STEP, 1, PIN_SYNC, 5)).status == StatusCode.OK
    assert board.request(Measure(1, PIN_STEP, 1, 27, 0)).status == StatusCode.OUT_OF_RANGE


def test_the_odometer_counts_on_after_a_measurement_and_after_a_new_host(board: EmulatedBoard) -> None:
    at = 0

    def turn(counts: int) -> int:
        nonlocal at
        for _ in range(abs(counts)):
            at += 1 if counts > 0 else -1
            a, b = ((1, 1), (0, 1), (0, 0), (1, 0))[-at % 4]  # A leads
            tick = board.now + 100
            board.input((tick, PIN_ODOMETER_A, a), (tick, PIN_ODOMETER_B, b))
            board.run(tick + 100)
        board.run(board.now + MS)
        status = board.request(Status())
        assert isinstance(status, StatusReply)
        return status.odometer

    board.run(BOOTED)
    board.identify()
    before = turn(24)
    assert abs(before) == 24
    board.request(Measure(1, PIN_STEP, 1, PIN_SYNC, 0))
    assert turn(8) == before  # it stands still
    board.request(Measure(0, 0, 0, 0, 0))
    assert turn(-6) == before - before // 24 * 6
    board.request(Measure(1, PIN_STEP, 1, PIN_SYNC, 0))
    board.identify()
    assert turn(5) == before - before // 24 * 1


def test_edges_that_a_measurement_left_uncounted_say_so(board: EmulatedBoard) -> None:
    board.run(BOOTED)
    board.identify()
    board.request(Info(level=LEVEL))

    def flags() -> list[bool]:
        board.events.clear()
        for _ in range(2):
            board.pulse(board.now + MS)
            board.run(board.now + 3 * MS)
        return [EdgeFlag.ODOMETER_FROZEN in edge.flags for edge in board.events if isinstance(edge, Edge)]

    flags()
    assert flags() == [False, False]
    board.request(Measure(1, PIN_STEP, 1, PIN_SYNC, 0))
    assert flags() == [True, True]
    board.request(Measure(0, 0, 0, 0, 0))
    assert flags() == [True, False]
