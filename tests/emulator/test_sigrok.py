"""An outside reader, Debian's sigrok-cli, finds on the pins what we say is there."""

import itertools
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from emulated import BOOTED, MS, EmulatedBoard, configuration

from annulus_pipe.controller import PIN_MICROWAVE
from annulus_pipe.link.messages import Arm, ArmFlag, Burst, BurstCode, Commit


def decoded(vcd: Path, decoder: str, annotation: str) -> list[str]:
    command = ["sigrok-cli", "-i", str(vcd), "-I", "vcd", "-P", decoder, "-A", annotation]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    return [line.split(": ", 1)[1] for line in lines]


def seconds(text: str) -> float:
    number, unit = re.match(r"([\d.]+) (\S+)", text).groups()  # type: ignore[union-attr]
    return float(number) * {"s": 1.0, "ms": 1e-3, "μs": 1e-6, "ns": 1e-9}[unit]


def test_sigrok_finds_the_same_widths_and_the_same_bytes(image: Path, tmp_path: Path) -> None:
    if shutil.which("sigrok-cli") is None:
        pytest.fail("sigrok-cli is missing: Debian's sigrok-cli, which `make test` installs")
    vcd = tmp_path / "run.vcd"
    board = EmulatedBoard(image, vcd)
    board.run(BOOTED)
    board.identify()
    for command in (configuration(), Commit(generation=1), Arm(outputs=ArmFlag.MICROWAVE)):
        board.request(command)
    board.request(Burst(code=BurstCode.BARKER13, chip=50, repeat=3, period=100_000, trigger_offset=0))
    board.run(board.now + 5 * MS)
    board.close()
    ours = sorted(tick for tick, pin, _ in board.transitions if pin == PIN_MICROWAVE)
    gaps = [(later - earlier) * 10e-9 for earlier, later in itertools.pairwise(ours)]
    theirs = [seconds(text) for text in decoded(vcd, "timing:data=microwave", "timing=time")]
    assert theirs[-len(gaps) :] == pytest.approx(gaps)
    uart = decoded(vcd, "uart:rx=uart_tx:baudrate=1000000", "uart=rx-data")
    assert bytes(int(byte, 16) for byte in uart) == bytes(byte for _, byte in board.sent)
