"""The daemon as a systemd service: it says when it is ready, how it is, and, by that, that it still turns.

The protocol is a datagram of NAME=value lines to the socket that NOTIFY_SOCKET names; sd_notify(3). The watchdog is fed
from the session's own loop: a loop that stands feeds nothing. Neither does one that has failed for PATIENCE_S in a way
that a fresh process may mend; a camera that is unplugged or a full disk is told, and no reason to be restarted.
"""

import contextlib
import os
import socket
import time
from collections.abc import Callable, Mapping
from typing import Any

from annulus_pipe.daemon.health import HeadHealth, Word
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.state import State

PATIENCE_S = 60.0


class Service(Observer):
    """One who listens. Without NOTIFY_SOCKET it says nothing."""

    def __init__(
        self, environment: Mapping[str, str] = os.environ, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        self._watched = environment.get("WATCHDOG_USEC", "").isdigit() and (
            environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        )
        self._now_s = now_s
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._health = HeadHealth(Word.OK)
        self._hopeless_s: float | None = None  # since when a restart might help
        self._ready = False
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    def state(self, state: State, why: str) -> None:
        lines = ["STATUS=" + _plain(f"{state}: {why}" if why else state)]
        if not self._ready and state in (State.IDLE, State.ARMED, State.FAULT):
            self._ready = True
            lines.insert(0, "READY=1")
        elif state is State.ENDING:
            lines.insert(0, "STOPPING=1")
        self._say(*lines)

    def event(self, kind: str, text: str) -> None:
        if not self._ready:  # what it waits for before it can begin; after that, its state is more to be known
            self._say("STATUS=" + _plain(text))

    def health(self, health: HeadHealth) -> None:
        self._health = health
        failed = health.word is Word.FAILED and health.restart_helps
        self._hopeless_s = (self._now_s() if self._hopeless_s is None else self._hopeless_s) if failed else None

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        """Once a second, from the loop."""
        frames = ", ".join(f"{count} {label}" for label, count in numbers["frames"].items())
        lines = ["STATUS=" + _plain(f"{numbers['state']}, {self._health}; {frames}")]
        alive = self._hopeless_s is None or self._now_s() - self._hopeless_s < PATIENCE_S
        if self._watched and alive:
            lines.append("WATCHDOG=1")
        self._say(*lines)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _say(self, *lines: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # systemd is busy, or gone: it is told again in a second
                self._socket.sendto("\n".join(lines).encode(), self._address)


def _plain(text: str) -> str:
    return " ".join(text.split())
