"""What outlives a reset, and what does not: the record of a crash, the boot byte, the nonce."""

import subprocess

import pytest
from emulated import BOOTED, ELF, MS, OUTPUTS, EmulatedBoard, arm

from annulus_pipe.controller import PIN_PROJECTOR
from annulus_pipe.link.messages import (
    LEVEL,
    RESET_MAGIC,
    BootCause,
    Crash,
    CrashKind,
    CrashReply,
    Info,
    InfoReply,
    Ping,
    Reset,
    RoundPart,
    Status,
)


def crash_of(board: EmulatedBoard) -> CrashReply:
    reply = board.request(Crash())
    assert isinstance(reply, CrashReply)
    return reply


def info_of(board: EmulatedBoard) -> InfoReply:
    reply = board.request(Info(level=LEVEL))
    assert isinstance(reply, InfoReply)
    return reply


def function_at(address: int) -> str:
    """The one that was called, whatever was inlined into it."""
    tool = ["arm-none-eabi-addr2line", "-f", "-i", "-e", str(ELF), hex(address)]
    return subprocess.run(tool, capture_output=True, text=True, check=True).stdout.splitlines()[-2]


def test_where_a_main_loop_hung_is_told_after_the_watchdog(board: EmulatedBoard) -> None:
    """The reset used to take every trace with it."""
    board.identify()
    assert crash_of(board).kind == CrashKind.NONE and info_of(board).crashes == 0
    at = board.trap("execute_status", "hang")
    board.send(Status())
    board.run(board.now + 105 * MS)
    assert len(board.resets) == 1
    assert board.identify().cause == BootCause.WATCHDOG
    crash = crash_of(board)
    assert (crash.kind, crash.crashes, crash.boot, crash.boots) == (CrashKind.STUCK, 1, 1, 2)
    assert crash.pc == at and function_at(crash.pc) == "execute_status"
    assert function_at(crash.lr & ~1) == "dispatch"
    assert (crash.part, crash.command) == (RoundPart.COMMAND, Status.ID)
    assert 10 < crash.rounds < 10_000
    assert 0 < crash.round_longest < 2 * MS
    assert info_of(board).crashes == 1


def test_a_hard_fault_leaves_outputs_low_at_once_and_a_record(board: EmulatedBoard) -> None:
    arm(board, delay=100_000, width=1_500_000, period=4_000_000)
    board.pulse(board.now + MS)
    board.run(board.now + 3 * MS)
    assert board.rises(PIN_PROJECTOR) and not board.falls(PIN_PROJECTOR)
    at = board.trap("execute_ping", "fault")
    board.send(Ping())
    board.run(board.now + 3 * MS)
    (fell,) = board.falls(PIN_PROJECTOR)
    assert len(board.resets) == 1 and fell <= board.resets[0]
    board.run(board.now + 10 * MS)
    board.identify()
    crash = crash_of(board)
    assert (crash.kind, crash.pc, crash.command) == (CrashKind.HARD_FAULT, at, Ping.ID)
    assert not any(board.rises(pin)[1:] for pin in OUTPUTS)


def test_a_loop_that_only_stood_still_has_no_place_and_one_that_came_back_no_record(board: EmulatedBoard) -> None:
    board.identify()
    board.stall(90 * MS)
    board.run(board.now + 95 * MS)
    assert not board.resets and crash_of(board).kind == CrashKind.NONE
    assert info_of(board).round_longest < 95 * MS
    board.stall(110 * MS)
    board.run(board.now + 110 * MS + BOOTED)
    assert len(board.resets) == 1
    crash = crash_of(board)
    assert (crash.kind, crash.crashes, crash.pc) == (CrashKind.STUCK, 1, 0)


def test_a_record_outlives_resets_but_not_the_power(board: EmulatedBoard) -> None:
    board.identify()
    board.trap("execute_ping", "hang")
    board.send(Ping())
    board.run(board.now + 100 * MS + BOOTED)
    first = crash_of(board)
    board.request(Reset(magic=RESET_MAGIC))
    board.run(board.now + BOOTED)
    again = crash_of(board)
    assert (again.kind, again.pc, again.boot) == (CrashKind.STUCK, first.pc, 1)
    assert (again.crashes, again.boots) == (1, 3)
    board.power_cycle()
    board.run(board.now + BOOTED)
    gone = crash_of(board)
    assert (gone.kind, gone.crashes, gone.boots, gone.pc) == (CrashKind.NONE, 0, 1, 0)


@pytest.mark.deep(
    gate="tests/emulator/test_boot.py::test_after_a_short_loss_of_power_the_ram_still_tells_the_boot_byte_apart"
)
def test_boot_bytes_of_power_ups_are_spread_though_the_ring_oscillator_is_not_fair(board: EmulatedBoard) -> None:
    """Eight of its bits in a row made 00h and FFh only, 24 power-ups long: the next boot looked like the last."""
    boots = set()
    for _ in range(24):
        boots.add(board.identify().boot)
        board.power_cycle()
        board.run(board.now + BOOTED)
    assert len(boots) > 18


def test_after_a_short_loss_of_power_the_ram_still_tells_the_boot_byte_apart(board: EmulatedBoard) -> None:
    board.identify()
    board.trap("execute_ping", "hang")
    board.send(Ping())
    board.run(board.now + 100 * MS + BOOTED)
    for _ in range(2):
        before = board.identify().boot
        board.power_cycle(short=True)
        board.run(board.now + BOOTED)
        assert board.identify().boot == (before + 1) % 256
        gone = crash_of(board)
        assert (gone.kind, gone.crashes, gone.boots) == (CrashKind.NONE, 0, 1)


@pytest.mark.deep(
    gate="tests/emulator/test_boot.py::test_after_a_short_loss_of_power_the_ram_still_tells_the_boot_byte_apart"
)
def test_no_boot_has_the_nonce_of_another(board: EmulatedBoard) -> None:
    nonces = set()
    for _ in range(24):
        nonces.add(info_of(board).nonce)
        board.power_cycle()
        board.run(board.now + BOOTED)
    assert len(nonces) == 24


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("cause", ["reset", "watchdog"])
def test_a_reset_always_changes_the_boot_byte_and_the_nonce(board: EmulatedBoard, cause: str) -> None:
    before, nonce = board.identify().boot, info_of(board).nonce
    if cause == "reset":
        board.request(Reset(magic=RESET_MAGIC))
        board.run(board.now + 10 * MS)
    else:
        board.stall(150 * MS)
        board.run(board.now + 160 * MS)
    assert board.identify().boot == (before + 1) % 256
    assert info_of(board).nonce != nonce
