"""What goes dark, how soon, and for how long, read off the pins of the image a user flashes."""

import random

import pytest
from emulated import BOOTED, LATENCY, MS, OUTPUTS, EmulatedBoard, arm, edges_from

from annulus_pipe.controller import PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_STATUS, PIN_TRIGGER
from annulus_pipe.link.messages import (
    BOOTLOADER_NEEDS_USB,
    Arm,
    ArmFlag,
    BootCause,
    Booted,
    Bootloader,
    Burst,
    BurstCode,
    BurstDone,
    Clear,
    Edge,
    Fault,
    FaultCode,
    Ping,
    Reset,
    Status,
    StatusCode,
)


def test_a_silent_host_darkens_the_lamps_within_one_frame(board: EmulatedBoard) -> None:
    arm(board, ratio=0, period=1_000_000, delay=100_000, width=100_000, host_timeout=50)
    last_word = board.now
    edges = edges_from(board, 12, 1_000_000)
    for edge in edges:
        board.pulse(edge)
    board.run(edges[-1] + 1_000_000)
    assert board.falls(PIN_LED)[-1] <= last_word + 50 * MS + 1_000_000
    assert len(board.rises(PIN_LED)) >= 4
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.HOST_TIMEOUT]
    assert [edge.tick for edge in board.heard(Edge)][-1] >= edges[-1] - board.origin - 2  # the dark ones, too


@pytest.mark.deep(
    gate="tests/emulator/test_image_safety.py::test_a_stuck_processor_leaves_outputs_low_in_four_ms_and_through_the_reset"
)
def test_a_stuck_processor_is_reset_by_the_watchdog_with_all_outputs_low(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, width=2_000_000, period=8_000_000)
    before = board.identify().boot
    board.pulse(board.now + MS)
    assert (
        board.request(Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)).status
        == 0
    )
    stuck = board.now
    board.stall(200 * MS)
    board.run(stuck + 180 * MS)
    [reset] = board.resets
    assert stuck + 99 * MS <= reset <= stuck + 102 * MS
    assert [item for item in board.transitions if item[0] > reset and item[1] in OUTPUTS and item[2] == 1] == []
    last = {pin: level for _tick, pin, level in board.transitions}
    assert {last.get(pin, 0) for pin in OUTPUTS} == {0}
    board.run(stuck + 210 * MS)
    who = board.identify()
    assert who.cause == BootCause.WATCHDOG
    assert who.boot != before
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.WATCHDOG]
    assert board.request(Arm(outputs=ArmFlag.LAMPS)).status == StatusCode.UNSAFE


STARVED = 4 * MS  # from the processor's last round to microwave and trigger low, at most


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(6))
def test_a_stuck_processor_leaves_outputs_low_in_four_ms_and_through_the_reset(board: EmulatedBoard, seed: int) -> None:
    rng = random.Random(seed)
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, period=1_000_000, delay=100_000, width=200_000)
    for edge in (board.now + MS + i * 1_000_000 for i in range(30)):
        board.pulse(edge)
    burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=60_000, period=12_000, trigger_offset=100)
    assert board.request(burst).status == StatusCode.OK
    board.run(board.now + rng.randrange(1_000_000, 3_000_000))
    stuck = board.now
    board.stall(200 * MS)
    board.run(stuck + 180 * MS)
    [reset] = board.resets
    assert stuck < reset <= stuck + 102 * MS
    changes = {pin: [(tick, level) for tick, p, level in board.transitions if p == pin] for pin in OUTPUTS}
    for pin in (PIN_MICROWAVE, PIN_TRIGGER):
        last, level = changes[pin][-1]
        assert level == 0
        assert last <= stuck + STARVED
    # A flash under way ends by itself, and one more was loaded: it fires on its edge. Nothing after that.
    flashes = [tick for tick, level in changes[PIN_LED] if level == 1 and tick > stuck]
    assert len(flashes) <= 1
    assert changes[PIN_LED][-1][1] == 0
    assert changes[PIN_LED][-1][0] <= stuck + 1_000_000 + 100_000 + LATENCY + 200_000
    assert changes[PIN_PROJECTOR] == []
    board.run(stuck + 210 * MS)
    assert board.identify().cause == BootCause.WATCHDOG


@pytest.mark.parametrize("times", [2, pytest.param(8, marks=pytest.mark.deep)])
def test_a_main_loop_late_by_more_than_its_credit_cuts_the_microwave_and_says_so(
    board: EmulatedBoard, times: int
) -> None:
    rng = random.Random(8)
    arm(board)
    for _ in range(times):
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
        board.transitions.clear()
        board.events.clear()
        burst = Burst(code=BurstCode.SINGLE, chip=500, repeat=60_000, period=10_000, trigger_offset=0)
        assert board.request(burst).status == StatusCode.OK
        board.run(board.now + rng.randrange(100_000, 500_000))
        late = board.now
        board.stall(10 * MS)
        board.run(late + 15 * MS)
        assert late + STARVED // 2 - 10_000 <= board.falls(PIN_MICROWAVE)[-1] <= late + STARVED
        [done] = board.heard(BurstDone)
        assert done.fault == FaultCode.WATCHDOG
        widths = board.widths(PIN_MICROWAVE)
        assert done.done == sum(width == 500 for width in widths)
        assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.WATCHDOG]
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.UNSAFE
        assert board.request(Clear()).status == StatusCode.OK
    assert board.resets == []


def test_a_reset_by_the_host_says_so(board: EmulatedBoard) -> None:
    arm(board, ratio=0)
    before = board.identify().boot
    assert board.request(Reset(magic=0x7E5E7B00)).status == StatusCode.OK
    board.run(board.now + 2 * BOOTED)
    who = board.identify()
    assert who.cause == BootCause.HOST_RESET
    assert who.boot == (before + 1) % 256
    assert [event.cause for event in board.heard(Booted)] == [BootCause.POWER_ON, BootCause.HOST_RESET]


def attach_usb(board: EmulatedBoard) -> None:
    """A host enumerates the board, and nobody opens its port."""
    board.usb_do("attach")
    board.usb_do("close")
    end = board.now + 300 * MS
    while board.usb["state"] != "configured":
        assert board.now < end, board.usb
        board.run(board.now + 20 * MS)


@pytest.mark.deep(
    gate="tests/emulator/test_image_safety.py::test_the_boot_loader_is_entered_by_its_rom_call_with_every_output_low"
)
def test_the_boot_loader_is_entered_only_with_a_usb_host_whichever_line_asks(board: EmulatedBoard) -> None:
    """The boot ROM speaks USB only: over the UART alone `bootloader` was acknowledged, and the head silent for good."""
    board.identify()
    for change in ("", "suspend", "detach"):
        if change:
            attach_usb(board)
            board.usb_do(change)
            board.run(board.now + 10 * MS)
        reply = board.request(Bootloader(magic=0x7E5EB007))
        assert (reply.status, reply.detail) == (StatusCode.BAD_STATE, BOOTLOADER_NEEDS_USB), change
        board.run(board.now + 200 * MS)
        assert board.bootloader is None
        assert board.request(Status()).status == StatusCode.OK
        board.usb_do("detach")
    attach_usb(board)
    assert board.request(Bootloader(magic=0x7E5EB007)).status == StatusCode.OK
    board.run(board.now + 2 * MS)
    assert board.bootloader is not None


def test_the_boot_loader_is_entered_by_its_rom_call_with_every_output_low(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, width=2_000_000, period=8_000_000)
    before = board.identify().boot
    burst = Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)
    assert board.request(burst).status == StatusCode.OK
    at_work = board.request(Bootloader(magic=0x7E5EB007))
    assert (at_work.status, at_work.detail) == (StatusCode.BAD_STATE, 0)  # because of what it does, not for want of USB
    assert board.request(Status()).status == StatusCode.OK
    assert board.bootloader is None
    assert board.request(Arm(outputs=ArmFlag(0))).status == StatusCode.OK
    attach_usb(board)
    assert board.request(Bootloader(magic=0x7E5E7B00)).status == StatusCode.OUT_OF_RANGE
    assert board.request(Bootloader(magic=0x7E5EB007)).status == StatusCode.OK
    board.run(board.now + 2 * MS)
    assert board.bootloader is not None
    assert board.bootloader["high"] == []
    assert board.bootloader["activity"] == 1 << PIN_STATUS
    assert board.bootloader["disabled"] == 0  # drive and PICOBOOT are both there
    rises = [tick for pin in OUTPUTS for tick in board.rises(pin)]
    assert max(rises) < board.bootloader["tick"]
    board.send(Ping())
    board.run(board.now + 50 * MS)
    board.leave_bootloader()
    board.run(board.now + BOOTED)
    who = board.identify()
    assert who.cause == BootCause.HOST_RESET
    assert who.boot == (before + 1) % 256
