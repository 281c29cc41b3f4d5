"""Whoever called keep_alive in a loop filled the line with pings (05b16e0). Fails without its own pace."""

import time
from types import SimpleNamespace

from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import Ping


class Line:
    """A session that notes what is sent and never has a backlog."""

    backlog = 0

    def __init__(self) -> None:
        self.sent: list[object] = []

    def send(self, command: object) -> None:
        self.sent.append(command)


def test_signs_of_life_are_paced_however_often_they_are_asked_for() -> None:
    client = Client.__new__(Client)  # a port that has only a clock: only the pace is looked at
    client._port = SimpleNamespace(now_ns=time.monotonic_ns)  # type: ignore[assignment]
    client.session, client._next_ping_ns = Line(), 0  # type: ignore[assignment]
    for _ in range(1000):
        client.keep_alive()
    assert 1 <= len(client.session.sent) <= 3 and isinstance(client.session.sent[0], Ping)
