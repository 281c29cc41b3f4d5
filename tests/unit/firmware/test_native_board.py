"""The native board through ctypes, as the twin uses it."""

from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.controller import PIN_ENABLE, PIN_INTERLOCK, PIN_LED, PIN_PROJECTOR, PIN_SYNC
from annulus_pipe.twin.native import BYTE_TICKS, TRANSITION, NativeBoard
from annulus_pipe.vocabulary import AnnulusError

MS = 100_000


def test_power_brings_a_booted_event_at_line_speed() -> None:
    board = NativeBoard()
    board.run_until(5 * MS)
    assert board.serial_read() == b""
    board.power_on(boot=7)
    assert board.boot_tick == 5 * MS
    board.run_until(5 * MS + BYTE_TICKS - 1)
    assert board.serial_read() == b""
    board.run_until(6 * MS)
    wire = board.serial_read()
    assert wire[0] == 0 and wire[-1] == 0 and wire.count(0) == 2
    assert wire[2] == 0x87  # booted


def test_outputs_stay_off_while_nobody_armed_them() -> None:
    board = NativeBoard()
    board.power_on()
    for k in range(1, 20):
        board.input(40 * MS * k, PIN_SYNC, 0)
        board.input(40 * MS * k + MS, PIN_SYNC, 1)
    board.run_until(1000 * MS)
    assert len(board.pins()) == 0
    assert board.level(PIN_PROJECTOR) == board.level(PIN_LED) == 0
    assert board.level(PIN_ENABLE) == 1
    assert board.level(PIN_INTERLOCK) == 1


def test_the_same_calls_give_the_same_bytes() -> None:
    def run() -> bytes:
        board = NativeBoard()
        board.power_on()
        board.serial_write(bytes(range(200)))
        board.stall_cpu(3 * MS)
        for k in range(1, 9):
            board.input(k * 7 * MS, PIN_SYNC, k % 2)
        board.run_until(100 * MS)
        return board.serial_read()

    assert run() == run()


def test_a_hung_loop_is_restarted_by_the_watchdog_with_another_boot_byte() -> None:
    board = NativeBoard()
    board.power_on(boot=3)
    board.stall_cpu(10_000 * MS)
    board.run_until(150 * MS)
    assert 90 * MS < board.boot_tick < 110 * MS
    booted = board.serial_read().split(b"\0")
    assert any(frame[1:2] == b"\x87" for frame in booted)


def test_impossible_inputs_and_missing_libraries_are_one_clear_line(tmp_path: Path) -> None:
    board = NativeBoard()
    board.run_until(100)
    with pytest.raises(AnnulusError, match="GP2"):
        board.input(99, PIN_SYNC, 0)
    with pytest.raises(AnnulusError, match="GP3"):
        board.input(200, PIN_PROJECTOR, 1)
    assert board.lost()["inputs"] == 2
    with pytest.raises(AnnulusError, match="make setup"):
        NativeBoard(tmp_path / "nothing.so")
    NativeBoard()
    with pytest.raises(AnnulusError, match="only one"):
        board.run_until(5)


def test_transitions_come_as_a_structured_array() -> None:
    board = NativeBoard()
    assert board.pins().dtype == TRANSITION
    assert np.dtype(TRANSITION).itemsize == 16
