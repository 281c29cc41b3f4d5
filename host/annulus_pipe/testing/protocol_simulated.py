"""What pyserial opens for simulated://NAME: a port whose other end is a world of this process, with its own time."""

import itertools
import math
from typing import Any, Protocol

import serial

STEP_NS = 250_000  # how far a world goes on before it is looked at again
FOREVER_NS = 60_000_000_000  # a read without time-out gives up after so long: nothing else would end it
READ_MAX = 65536


class FarEnd(Protocol):
    """The far end of the port. Time passes only in `pass_ns`."""

    def now_ns(self) -> int: ...

    def pass_ns(self, ns: int) -> None: ...

    def take(self, data: bytes) -> None:
        """Bytes from the host."""

    def give(self) -> bytes:
        """Bytes for the host that have arrived by now."""


_worlds: dict[str, FarEnd] = {}
_numbers = itertools.count(1)
serial.protocol_handler_packages.append("annulus_pipe.testing")  # where pyserial looks for protocol_*


def publish(world: FarEnd) -> str:
    """The URL under which pyserial finds this world."""
    url = f"simulated://{next(_numbers)}"
    _worlds[url] = world
    return url


def withdraw(url: str) -> None:
    _worlds.pop(url, None)


class Serial:
    """As much of a pyserial port as callers of serial_for_url use, and `now_ns`, the time of the world behind it."""

    def __init__(self, port: str | None = None, **settings: Any) -> None:
        self.port = port
        self.timeout: float | None = settings.get("timeout")
        self.write_timeout: float | None = settings.get("write_timeout")
        self.baudrate: int = settings.get("baudrate", 9600)
        self.is_open = False
        self._held = bytearray()

    def open(self) -> None:
        self._world()
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def now_ns(self) -> int:
        return self._world().now_ns()

    @property
    def in_waiting(self) -> int:
        self._held += self._world().give()
        return len(self._held)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes, letting the world go on until they are there or the time-out is over."""
        world = self._world()
        end = world.now_ns() + (FOREVER_NS if self.timeout is None else math.ceil(self.timeout * 1e9))
        while self.in_waiting < size and (left := end - world.now_ns()) > 0:
            world.pass_ns(min(left, STEP_NS))
        data = bytes(self._held[:size])
        del self._held[:size]
        return data

    def write(self, data: bytes) -> int:
        self._world().take(bytes(data))
        return len(data)

    def flush(self) -> None: ...

    def reset_input_buffer(self) -> None:
        self.read(READ_MAX if self.in_waiting else 0)

    def _world(self) -> FarEnd:
        if self.port not in _worlds:
            raise OSError(f"{self.port}: no such simulated head in this process")
        return _worlds[self.port]
