"""What the image does about erratum RP2040-E15: bulk in early in a frame only, and back again when the USB block hangs.

The emulator stops on a packet that is handed over for bulk in during the last fifth of a frame.
"""

import random

import pytest
from emulated import BOOTED, MS, OUTPUTS, EmulatedBoard, arm

from annulus_pipe.controller import PIN_LED, TICKS_PER_US
from annulus_pipe.link.codec import Frame, encode
from annulus_pipe.link.messages import (
    ArmFlag,
    Burst,
    BurstCode,
    Clear,
    FaultCode,
    Health,
    HealthReply,
    Ping,
    Status,
    StatusCode,
    StatusReply,
)

GONE = 25 * MS  # twenty frames in a row are missing, and then some rounds
BACK = 400 * MS  # 10 ms unplugged, the hub's debounce, enumeration


def attached(board: EmulatedBoard) -> int:
    """So often its host has seen a device plugged in: once, and once more after every reset of the USB block."""
    board.run(board.now + MS)
    count = board.usb["attached"]
    assert isinstance(count, int)
    return count


def hangs(board: EmulatedBoard) -> int:
    """As the controller counts them."""
    health = board.request(Health())
    assert isinstance(health, HealthReply)
    return health.usb_hangs


def hang(board: EmulatedBoard) -> int:
    board.usb_do("hang")
    return board.now


def come_back(board: EmulatedBoard) -> None:
    end = board.now + BACK
    while board.usb["open"]:
        assert board.now < end, board.usb
        board.run(board.now + MS)
    while not board.usb["open"]:
        assert board.now < end, board.usb
        board.run(board.now + 5 * MS)


@pytest.mark.parametrize("count", [10, pytest.param(400, marks=pytest.mark.deep)])
def test_bulk_in_is_never_handed_over_late_in_a_frame(board: EmulatedBoard, count: int) -> None:
    """Answers due at every age of a frame. The old image handed over at any: the emulator stopped it at the first.

    A later one looked at the clock up to the very end of its time, and was late by what passes from there to the
    hand-over: half a microsecond in one of some thousand packets.
    """
    board.plug_in()
    board.identify()
    rng = random.Random(15)
    for _ in range(count):
        board.run(board.now + rng.randrange(2 * MS))
        asked = board.now
        board.request(Ping(), within=2 * MS)
        assert board.now <= asked + 2 * MS
    board.write(b"".join(encode(Frame(Status(), i & 0xFF)) for i in range(5 * count // 2)))
    while board.usb["waiting"]:
        board.run(board.now + MS)
    assert attached(board) == 1
    latest = board.usb["latest"]
    print(f"handed over latest {latest / TICKS_PER_US:.1f} us into a frame")
    assert latest < 790 * TICKS_PER_US  # as late as it may, and with a reserve for interrupts
    assert count < 400 or latest > 750 * TICKS_PER_US


@pytest.mark.deep(gate="tests/emulator/test_usb_frames.py::test_bulk_in_is_never_handed_over_late_in_a_frame")
def test_a_late_round_does_not_take_a_frame_for_a_young_one(board: EmulatedBoard) -> None:
    """The frame number is new after a pause of the processor, but nobody saw when it became so."""
    board.plug_in()
    board.identify()
    rng = random.Random(16)
    for _ in range(200):
        board.send(Ping())
        board.run(board.now + rng.randrange(MS))
        board.stall(rng.randrange(4 * MS))
        board.run(board.now + 6 * MS)
    assert board.identify().status == StatusCode.OK


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("busy", "turns"), [(True, 1), (True, 3), (False, 3)], ids=["once", "flooded", "quiet"])
def test_when_the_usb_block_hangs_all_goes_dark_and_the_port_comes_back(
    board: EmulatedBoard, busy: bool, turns: int
) -> None:
    """The old image stayed deaf until its power was taken away, and armed until the host's timeout."""
    board.plug_in()
    rng = random.Random(17)
    for turn in range(turns):
        arm(
            board,
            ArmFlag.LAMPS | ArmFlag.MICROWAVE,
            ratio=0,
            period=1_000_000,
            delay=100_000,
            width=400_000,
            readout=0,
            host_timeout=5000,
        )
        train = Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)
        assert board.request(train).status == StatusCode.OK
        for i in range(20):
            board.pulse(board.now + MS + i * 1_000_000)
        board.run(board.now + 25 * MS + rng.randrange(10 * MS))
        if busy:
            board.write(b"".join(encode(Frame(Status(), i & 0xFF)) for i in range(300)))
            board.run(board.now + rng.randrange(5 * MS))
        hung = hang(board)
        come_back(board)
        dark = max(tick for tick, pin, _ in board.transitions if pin in OUTPUTS)
        print(f"dark {(dark - hung) / MS:.1f} ms after the hang, port open {(board.now - hung) / MS:.0f} ms after it")
        assert hung < dark < hung + GONE
        board.identify()
        status = board.request(Status())
        assert isinstance(status, StatusReply)
        assert status.fault == FaultCode.HOST_TIMEOUT
        assert board.request(Clear()).status == StatusCode.OK
        assert attached(board) == 2 + turn
        assert hangs(board) == 1 + turn
    assert board.resets == []  # the controller itself ran on


def test_a_hang_leaves_what_the_other_line_commands_alone(board: EmulatedBoard) -> None:
    board.plug_in()
    board.over_usb = False
    arm(board, ratio=0, period=1_000_000, delay=100_000, width=100_000)
    hang(board)
    edges = [board.now + MS + i * 1_000_000 for i in range(30)]  # it is back when they are over
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 10 * MS)
    assert len(board.rises(PIN_LED)) == len(edges)
    assert attached(board) == 2
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert status.fault == FaultCode.NONE


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("asleep", [10, 21, 35, 500], ids=lambda ms: f"{ms}ms")
def test_a_suspended_bus_and_its_slow_awakening_are_no_hang(board: EmulatedBoard, asleep: int) -> None:
    """No frames come while the bus sleeps, nor for the 40 ms in which a host wakes it."""
    board.plug_in()
    board.identify()
    board.usb_do("suspend")
    board.run(board.now + asleep * MS)
    board.usb_do("resume")
    board.run(board.now + 200 * MS)
    assert board.identify().status == StatusCode.OK
    assert attached(board) == 1


@pytest.mark.deep(gate="tests/emulator/test_usb_frames.py::test_a_suspended_bus_and_its_slow_awakening_are_no_hang")
def test_neither_a_missing_host_nor_a_bus_reset_is_a_hang(board: EmulatedBoard) -> None:
    board.run(BOOTED + 300 * MS)  # plugged into nothing
    board.plug_in()
    for _ in range(3):
        board.usb_do("reset")
        come_back(board)
        assert board.identify().status == StatusCode.OK
        board.run(board.now + 200 * MS)
    assert attached(board) == 1
    board.usb_do("detach")
    board.run(board.now + 500 * MS)
    board.plug_in()
    assert board.identify().status == StatusCode.OK
    assert (attached(board), hangs(board)) == (2, 0)


def test_an_answer_that_nobody_fetched_is_not_for_who_opens_the_port_next(board: EmulatedBoard) -> None:
    """Handed over already, or late in a frame kept back for the next one; and the toggles go on."""
    board.plug_in()
    board.identify()
    for phase in range(0, 1000, 120):
        board.run(board.now + 20 * MS + phase * TICKS_PER_US)
        board.send(Ping())
        while board.usb["waiting"]:
            board.run(board.now + 2 * TICKS_PER_US)
        board.usb_do("close")
        board.run(board.now + 5 * MS)
        board.replies.clear()
        board.usb_do("open")
        board.run(board.now + 5 * MS)
        assert not board.replies, f"{phase} us into a frame"
        assert board.identify().status == StatusCode.OK
