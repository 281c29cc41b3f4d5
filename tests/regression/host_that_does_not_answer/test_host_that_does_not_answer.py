"""A `socket://` whose host had gone was called again on the loop's own thread: 5 s without a label, each second. Fails
with `Port(self.url)` in ControllerLine.pump."""

import socket
import threading
import time

import pytest

from annulus_pipe.daemon import controller_line
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.controller_line import ControllerLine, stage_of
from annulus_pipe.daemon.observer import Observer


class Host:
    """Takes the first call and hangs up; later callers wait until they are let go, and then are refused."""

    def __init__(self) -> None:
        self.calls = 0
        self.waiting = 0
        self.let_go = threading.Event()

    def called(self, *_: object, **__: object) -> socket.socket:
        self.calls += 1
        self.waiting += 1
        self.let_go.wait(60.0)
        self.waiting -= 1
        raise OSError("nobody answers")


def test_the_loop_goes_on_while_a_host_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller_line, "REOPEN_S", 0.0)
    host = Host()
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        line = ControllerLine(url, stage_of(HeadConfig()), Account(), Observer())
        monkeypatch.setattr(socket, "create_connection", host.called)
        server.accept()[0].close()
        end = time.monotonic() + 60.0
        while not host.calls and time.monotonic() < end:
            line.pump()
        for _ in range(20):
            line.pump()
        assert (host.calls, host.waiting) == (1, 1)  # still waiting, and nobody waited with it
        host.let_go.set()
        while host.calls < 2 and time.monotonic() < end:
            line.pump()  # and it is tried again
        assert host.calls >= 2
        assert line.trouble.startswith(f"{url}: ")
        line.close()
