"""A port was not locked: a second program spoke on the daemon's line, and each took the other's answers. Fails without
the locks in link/port.py."""

import os
import pty
import socket
import subprocess
import sys
import tty

import pytest

from annulus_pipe.link.port import Port
from annulus_pipe.vocabulary import AnnulusError

SECOND = """
import sys
from annulus_pipe.link.port import Port
from annulus_pipe.vocabulary import AnnulusError
try:
    Port(sys.argv[1])
except AnnulusError as error:
    print(error)
"""


def second_program(url: str) -> str:
    """What another program is told that opens the port; empty when it gets it."""
    ran = subprocess.run([sys.executable, "-c", SECOND, url], capture_output=True, text=True, check=True, timeout=60)
    return ran.stdout.strip()


def test_a_tty_is_for_one_program_and_the_other_is_told_which() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    try:
        url = os.ttyname(slave)
        port = Port(url)
        told = second_program(url)
        assert told.startswith(f"{url}: in use by another program (process {os.getpid()}:")
        assert "\n" not in told
        with pytest.raises(AnnulusError, match="in use by another program"):
            Port(url)
        port.close()
        assert second_program(url) == ""
    finally:
        os.close(master)
        os.close(slave)


def test_a_socket_is_for_one_program_and_its_far_end_never_hears_of_the_other() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        port = Port(url)
        with server.accept()[0]:
            assert second_program(url).startswith(f"{url}: in use by another program, expected a free port")
            server.setblocking(False)
            with pytest.raises(BlockingIOError):
                server.accept()
        port.close()
        assert second_program(url) == ""
