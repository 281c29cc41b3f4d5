"""The interlock's second, antivalent input, on the image a user flashes: what it takes away, how soon, and when it is a
fault of its own. GP7: closed = low. GP13: closed = high.
"""

import random

import pytest
from emulated import MS, EmulatedBoard, arm

from annulus_pipe.controller import (
    INTERLOCK_DISAGREE_MS,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_SYNC,
    PIN_TRIGGER,
)
from annulus_pipe.link.messages import (
    RESET_MAGIC,
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstDone,
    Clear,
    Fault,
    FaultCode,
    Hardware,
    HardwareReply,
    Interlock,
    InterlockFlag,
    InterlockReply,
    Reset,
    Status,
    StatusCode,
)

CHIP = 30  # the shortest pulse
BOARD_STARVED_MS = 4  # of firmware/board.h
SECOND_MAX = 2 * CHIP  # the second input is seen every sixth cycle, and once in 2 ms after thirteen
LONG = (INTERLOCK_DISAGREE_MS + 1) * MS


def use_both(board: EmulatedBoard) -> None:
    board.identify()
    board.input((board.now + 1, PIN_INTERLOCK_ANTIVALENT, 1))
    board.run(board.now + 100)
    reply = board.request(Interlock(InterlockFlag.ANTIVALENT))
    assert isinstance(reply, InterlockReply)
    assert (reply.status, reply.inputs) == (StatusCode.OK, InterlockFlag.ANTIVALENT)


def start_train(board: EmulatedBoard) -> None:
    assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
    burst = Burst(code=BurstCode.SINGLE, chip=CHIP, repeat=60_000, period=600, trigger_offset=200)
    assert board.request(burst).status == StatusCode.OK


@pytest.mark.parametrize("pin, most", [(PIN_INTERLOCK, CHIP), (PIN_INTERLOCK_ANTIVALENT, SECOND_MAX)])
@pytest.mark.parametrize("times", [12, pytest.param(1_000, marks=pytest.mark.deep)])
def test_either_input_cuts_the_microwave_in_hardware(board: EmulatedBoard, pin: int, most: int, times: int) -> None:
    use_both(board)
    rng = random.Random(pin)
    unsafe = 1 if pin == PIN_INTERLOCK else 0
    worst = 0
    for _ in range(times):
        start_train(board)
        board.transitions.clear()
        opens = board.now + rng.randrange(20_000, 500_000)
        board.stall(opens - board.now + MS)  # the core is far too late for all of it
        board.input((opens, pin, unsafe), (opens + 100_000, pin, 1 - unsafe))
        board.run(opens + 2 * MS)
        after = [tick - opens for tick, p, _ in board.transitions if p in (PIN_MICROWAVE, PIN_TRIGGER)]
        worst = max(worst, *after, 0)
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.UNSAFE
        assert board.request(Clear()).status == StatusCode.OK
    print(f"GP{pin} to dark: {worst} ticks at most")
    assert worst <= most
    assert {fault.fault for fault in board.heard(Fault)} == {FaultCode.INTERLOCK}
    assert {done.fault for done in board.heard(BurstDone)} == {FaultCode.INTERLOCK}


def test_the_second_input_alone_darkens_lamps_within_a_round(board: EmulatedBoard) -> None:
    use_both(board)
    arm(board, ratio=0, period=4_000_000, delay=100_000, width=1_000_000)
    board.pulse(board.now + 1000)
    board.run(board.now + 500_000)
    assert board.falls(PIN_LED) == [] and len(board.rises(PIN_LED)) == 1
    opens = board.now + 77
    board.input((opens, PIN_INTERLOCK_ANTIVALENT, 0))
    board.run(opens + MS)
    took = board.falls(PIN_LED)[0] - opens
    print(f"GP13 to a lamp's end: {took / 100} us")
    assert took <= MS // 4
    assert board.heard(Fault)[0].fault == FaultCode.INTERLOCK


def test_a_contradiction_that_lasts_latches_and_clears_only_when_both_are_closed(board: EmulatedBoard) -> None:
    use_both(board)
    began = board.now
    board.input((began + 1, PIN_INTERLOCK, 1))  # nothing is armed: an open interlock by itself would be no fault
    board.run(began + LONG)
    [fault] = board.heard(Fault)
    assert fault.fault == FaultCode.INTERLOCK_DISAGREES
    assert fault.detail == InterlockFlag.ANTIVALENT | InterlockFlag.OPEN
    lasted = (fault.tick + board.origin - began) / MS
    assert INTERLOCK_DISAGREE_MS <= lasted <= INTERLOCK_DISAGREE_MS + 0.5
    assert board.request(Clear()).status == StatusCode.UNSAFE
    board.input((board.now + 1, PIN_INTERLOCK_ANTIVALENT, 0))  # now they agree on open
    board.run(board.now + MS)
    assert board.request(Clear()).status == StatusCode.UNSAFE
    assert board.request(Arm(outputs=ArmFlag.LAMPS)).status == StatusCode.UNSAFE
    board.input((board.now + 1, PIN_INTERLOCK_ANTIVALENT, 1), (board.now + 2 * MS, PIN_INTERLOCK, 0))
    board.run(board.now + 3 * MS)
    assert board.request(Clear()).status == StatusCode.OK
    assert board.request(Status()).fault == FaultCode.NONE  # type: ignore[attr-defined]
    assert len(board.heard(Fault)) == 1


def test_a_wire_that_comes_off_is_open_and_a_short_between_both_a_contradiction(board: EmulatedBoard) -> None:
    use_both(board)
    board.let_go(PIN_INTERLOCK_ANTIVALENT)  # the pad pulls it down
    board.run(board.now + LONG)
    hardware = board.request(Hardware())
    assert isinstance(hardware, HardwareReply)
    assert hardware.interlock == InterlockFlag.ANTIVALENT | InterlockFlag.ANTIVALENT_OPEN
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.INTERLOCK_DISAGREES]


def test_without_its_configuration_nobody_looks_at_the_second_input(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.MICROWAVE)
    start_train(board)
    for level in (1, 0, 1, 0):
        board.input((board.now + 1, PIN_INTERLOCK_ANTIVALENT, level))
        board.run_alive(board.now + LONG)
    board.input((board.now + 1, PIN_SYNC, 0), (board.now + 1000, PIN_SYNC, 1))
    board.run_alive(board.now + MS)
    assert board.heard(Fault) == []
    assert board.rises(PIN_MICROWAVE)[-1] > board.now - 2000


def test_a_processor_that_stands_still_starves_the_guard_of_two_as_well(board: EmulatedBoard) -> None:
    use_both(board)
    start_train(board)
    board.run(board.now + 5 * MS)
    stuck = board.now
    board.stall(10 * MS)
    board.run(stuck + 20 * MS)
    assert stuck + MS < board.falls(PIN_MICROWAVE)[-1] <= stuck + BOARD_STARVED_MS * MS
    [done] = board.heard(BurstDone)
    assert done.fault == FaultCode.WATCHDOG
    assert done.done == len(board.rises(PIN_TRIGGER))  # counted by the guard's own count of its credits


def test_an_armed_head_is_not_configured_and_then_the_guard_of_one_is_back(board: EmulatedBoard) -> None:
    use_both(board)
    start_train(board)
    assert board.request(Interlock(InterlockFlag(0))).status == StatusCode.BAD_STATE
    assert board.request(Arm(outputs=ArmFlag(0))).status == StatusCode.OK
    assert board.request(Interlock(InterlockFlag(0))).status == StatusCode.OK
    board.input((board.now + 1, PIN_INTERLOCK_ANTIVALENT, 0))
    start_train(board)
    board.run(board.now + LONG)
    opens = board.now + 5
    board.input((opens, PIN_INTERLOCK, 1))
    board.run(opens + MS)
    assert board.falls(PIN_MICROWAVE)[-1] <= opens + 6
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.INTERLOCK]


def test_a_restart_forgets_the_second_input(board: EmulatedBoard) -> None:
    use_both(board)
    board.send(Reset(magic=RESET_MAGIC))
    board.run(board.now + 20 * MS)
    board.identify()
    board.input((board.now + 1, PIN_INTERLOCK_ANTIVALENT, 0))
    board.run(board.now + LONG)
    hardware = board.request(Hardware())
    assert isinstance(hardware, HardwareReply)
    assert hardware.interlock == 0
    assert board.heard(Fault) == []
