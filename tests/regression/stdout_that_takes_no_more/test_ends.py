"""A full disk under stdout, or a closed one, was "internal error, please report it", and a reader that went away
ended a command now with status 141, now with 1."""

import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-c", "from annulus_pipe.cli import main; main()"]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("arguments", [["timing", "--help"], ["archive", "query", "--named", "list"], ["--version"]])
def test_a_full_disk_is_one_line(arguments: list[str]) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([*COMMAND, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == ("annulus: stdout: cannot be written (No space left on device); what it has is not all.\n")


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("arguments", [["timing", "--help"], ["archive", "query", "--named", "list"], ["--version"]])
def test_a_reader_that_is_gone_ends_it_without_a_word(arguments: list[str]) -> None:
    with subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as command:
        assert command.stdout is not None and command.stderr is not None
        command.stdout.close()
        assert command.stderr.read() == b""
    assert command.returncode == 141


@pytest.mark.deep(gate="tests/regression/stdout_that_takes_no_more/test_ends.py::test_a_full_disk_is_one_line")
def test_closed_streams_and_a_full_log(tmp_path: Path) -> None:
    for redirect, status in ((">&-", 1), (">/dev/null 2>/dev/full", 0), (">/dev/null 2>&-", 0)):
        line = f'"{sys.executable}" -c "from annulus_pipe.cli import main; main()" --version {redirect}'
        done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
        assert done.returncode == status and "internal error" not in done.stderr and "Traceback" not in done.stderr
