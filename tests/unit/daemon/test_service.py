"""Promises to systemd: ready when it is, alive only while it turns and is of use."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from annulus_pipe.daemon.health import HeadHealth, Word
from annulus_pipe.daemon.service import PATIENCE_S, Service
from annulus_pipe.daemon.state import State

NUMBERS: dict[str, Any] = {"state": "scanning", "frames": {"projector": 80, "led": 20}}


class Systemd:
    """The other end of the notify socket, and a clock."""

    def __init__(self, folder: Path) -> None:
        self.address, self.now_s = str(folder / "notify"), 0.0
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.address)
        self.socket.setblocking(False)

    def heard(self) -> list[list[str]]:
        """A list of lines for each datagram since the last call."""
        said = []
        while True:
            try:
                said.append(self.socket.recv(4096).decode().splitlines())
            except BlockingIOError:
                return said

    def service(self, **more: str) -> Service:
        return Service({"NOTIFY_SOCKET": self.address, **more}, lambda: self.now_s)


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    systemd = Systemd(tmp_path)
    yield systemd
    systemd.socket.close()


def test_a_head_is_ready_when_it_is_up_and_says_when_it_ends(systemd: Systemd) -> None:
    service = systemd.service()
    for state in (State.POWERING, State.IDLE, State.ARMED, State.FAULT, State.ENDING):
        service.state(state, "the line\nis broken" if state is State.FAULT else "")
    assert systemd.heard() == [
        ["STATUS=powering"],
        ["READY=1", "STATUS=idle"],
        ["STATUS=armed"],
        ["STATUS=fault: the line is broken"],
        ["STOPPING=1", "STATUS=ending"],
    ]
    service.close()


def test_what_it_waits_for_before_it_is_ready_is_its_status(systemd: Systemd) -> None:
    service = systemd.service()
    service.event("priority", "frames are not put first here")
    service.state(State.IDLE, "")
    service.event("link", "line 0 fell silent")  # its state is more to be known
    assert systemd.heard() == [["STATUS=frames are not put first here"], ["READY=1", "STATUS=idle"]]
    service.close()


def test_the_watchdog_is_fed_by_the_loop_and_only_where_there_is_one(systemd: Systemd) -> None:
    fed, unwatched = systemd.service(WATCHDOG_USEC="30000000"), systemd.service()
    fed.telemetry(NUMBERS)
    assert systemd.heard() == [["STATUS=scanning, ok; 80 projector, 20 led", "WATCHDOG=1"]]
    unwatched.telemetry(NUMBERS)
    assert systemd.heard() == [["STATUS=scanning, ok; 80 projector, 20 led"]]
    other = systemd.service(WATCHDOG_USEC="30000000", WATCHDOG_PID="1")
    other.telemetry(NUMBERS)
    assert "WATCHDOG=1" not in systemd.heard()[0]


def test_a_failure_that_a_restart_mends_starves_the_watchdog_and_no_other_does(systemd: Systemd) -> None:
    def feeds(health: HeadHealth, seconds: float) -> list[bool]:
        service = systemd.service(WATCHDOG_USEC="1")
        fed = []
        for _ in range(round(seconds)):
            systemd.now_s += 1.0
            service.health(health)
            service.telemetry(NUMBERS)
            fed.append("WATCHDOG=1" in systemd.heard()[0])
        return fed

    assert all(feeds(HeadHealth(Word.FAILED, "camera 0 is gone"), 3 * PATIENCE_S))
    assert all(feeds(HeadHealth(Word.DEGRADED, "3 disk"), 3 * PATIENCE_S))
    fed = feeds(HeadHealth(Word.FAILED, "none recorded", restart_helps=True), 2 * PATIENCE_S)
    assert fed == [True] * round(PATIENCE_S) + [False] * round(PATIENCE_S)


def test_without_systemd_and_with_one_that_went_away_nothing_happens(systemd: Systemd) -> None:
    for service in (Service({}), systemd.service(WATCHDOG_USEC="1")):
        systemd.socket.close()
        service.state(State.IDLE, "")
        service.telemetry(NUMBERS)
        service.close()


def test_an_abstract_address_is_understood() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as far:
        far.bind("\0annulus-test-notify")
        far.settimeout(5.0)
        Service({"NOTIFY_SOCKET": "@annulus-test-notify"}).state(State.IDLE, "")
        assert far.recv(100) == b"READY=1\nSTATUS=idle"
