"""The serial line a simulated head offers: a pty for the native controller, TCP for the emulated one. Never blocks."""

import contextlib
import os
import socket
import termios
import tty
from typing import Protocol

_READ_MAX = 4096


class Line(Protocol):
    """One host at most at its other end."""

    url: str  # for pyserial

    def waitables(self) -> list[int]:
        """File descriptors that become readable when there is something to do."""

    def read(self) -> bytes:
        """What the host has sent."""

    def write(self, data: bytes) -> int:
        """How many bytes were taken."""

    def close(self) -> None: ...


class PtyLine:
    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)

    def waitables(self) -> list[int]:
        return [self._master]

    def read(self) -> bytes:
        data = b""
        with contextlib.suppress(BlockingIOError, OSError):
            while more := os.read(self._master, _READ_MAX):
                data += more
        return data

    def write(self, data: bytes) -> int:
        with contextlib.suppress(BlockingIOError):
            return os.write(self._master, data)
        return 0

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)


class TcpLine:
    """On this machine only. Who connects later takes the line over; bytes that nobody was there to read are gone."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        self._host: socket.socket | None = None
        self.arrivals = 0  # hosts that have connected so far
        self.url = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def waitables(self) -> list[int]:
        return [self._server.fileno(), *([self._host.fileno()] if self._host else [])]

    def read(self) -> bytes:
        with contextlib.suppress(OSError):  # nobody waits, or nobody any more
            arrived, _ = self._server.accept()
            self.hang_up()
            arrived.setblocking(False)
            arrived.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._host = arrived
            self.arrivals += 1
        data = b""
        try:
            while self._host is not None:
                more = self._host.recv(_READ_MAX)
                if not more:
                    self.hang_up()
                data += more
        except BlockingIOError:
            pass
        except OSError:
            self.hang_up()
        return data

    def write(self, data: bytes) -> int:
        if self._host is None:
            return len(data)
        try:
            return self._host.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self.hang_up()
            return len(data)

    def close(self) -> None:
        self.hang_up()
        self._server.close()

    def hang_up(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None
