"""A client stays with its daemon, whatever became of the line between them."""

import selectors
import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest
import zmq

from annulus_pipe.stream import access
from annulus_pipe.stream.access import connected


class Relay:
    """Passes bytes on between who connects to `address` and the daemon; `cut` ends nothing, and passes no more on."""

    def __init__(self, daemon: str) -> None:
        self._daemon = daemon.removeprefix("tcp://").split(":")
        self._door = socket.create_server(("127.0.0.1", 0))
        self.address = "tcp://{}:{}".format(*self._door.getsockname())
        self._watched = selectors.DefaultSelector()
        self._watched.register(self._door, selectors.EVENT_READ)
        self._lines: list[socket.socket] = []
        self._cut, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def cut(self) -> None:
        self._cut.set()
        while self._cut.is_set():
            time.sleep(0.005)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        for one in (self._door, *self._lines):
            one.close()
        self._watched.close()

    def _run(self) -> None:
        while not self._over.is_set():
            if self._cut.is_set():
                for line in [one for one in self._lines if one in self._watched.get_map()]:
                    self._watched.unregister(line)
                self._cut.clear()
            for key, _ in self._watched.select(0.01):
                if key.fileobj is self._door:
                    near = self._door.accept()[0]
                    far = socket.create_connection((self._daemon[0], int(self._daemon[1])))
                    self._lines += [near, far]
                    self._watched.register(near, selectors.EVENT_READ, far)
                    self._watched.register(far, selectors.EVENT_READ, near)
                else:
                    self._pass_on(key.fileobj, key.data)  # type: ignore[arg-type]

    def _pass_on(self, line: socket.socket, other: socket.socket) -> None:
        try:
            data = line.recv(65536)
            other.sendall(data)
        except OSError:
            data = b""
        if not data:
            for one in (line, other):
                if one.fileno() >= 0 and one in self._watched.get_map():
                    self._watched.unregister(one)
                one.close()
                if one in self._lines:  # its other end may have gone in this very round
                    self._lines.remove(one)


@pytest.fixture
def context() -> Iterator[zmq.Context[zmq.Socket[bytes]]]:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    yield context
    context.destroy(linger=0)


@pytest.fixture
def relayed() -> Iterator[Callable[[str], Relay]]:
    made: list[Relay] = []

    def make(daemon: str) -> Relay:
        made.append(Relay(daemon))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_a_daemon_whose_machine_lost_its_power_is_connected_to_again(
    context: zmq.Context[zmq.Socket[bytes]], relayed: Callable[[str], Relay], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing ends such a line: a page showed the last word of before for ever."""
    monkeypatch.setattr(access, "HEARTBEAT_S", 0.2)
    monkeypatch.setattr(access, "UNANSWERED_S", 1.0)
    daemon = context.socket(zmq.XPUB)
    daemon.bind("tcp://127.0.0.1:*")
    relay = relayed(daemon.getsockopt_string(zmq.LAST_ENDPOINT))
    client = connected(context, zmq.SUB, relay.address, None, 1000)
    client.subscribe(b"")

    def heard(word: bytes) -> bool:
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            daemon.send(word)
            if client.poll(20) and client.recv() == word:
                return True
        return False

    assert heard(b"before")
    relay.cut()
    assert heard(b"after")
