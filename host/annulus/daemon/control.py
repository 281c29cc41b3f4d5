"""The control socket: a console starts, stops, marks and asks while the session runs. ZeroMQ ROUTER, one msgpack map a
request, one an answer.

    {"do": "start" | "stop" | "mark" | "zero" | "state", "text": .., "clock_deg": ..}   (text and clock_deg: of a mark)
    {"ok": true | false, "state": "idle", "health": "ok", "error": ""}

Every request is answered once, a wrong one with what is wrong. Who may connect: as for viewers, see stream.access.
"""

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self

import msgpack
import zmq

from annulus import untrusted
from annulus.daemon.state import State
from annulus.stream.access import Doorkeeper, Keys
from annulus.vocabulary import AnnulusError

REQUEST_MAX = 4096  # bytes
PARTS_MAX = 3  # sender, delimiter, request
CARRIED_MAX = 1 << 16  # bytes; what is larger ZeroMQ does not even take in
TEXT_MAX = 500  # characters
TAKEN_MAX = 16  # requests in one turn of the session
ANSWERS_MAX = 100  # that wait for a client that does not read
ANSWER_S = 30.0  # a stop waits for workers and recorder


class Do(StrEnum):
    START = "start"
    STOP = "stop"
    MARK = "mark"
    ZERO = "zero"
    STATE = "state"


@dataclass(frozen=True, slots=True)
class Request:
    """What a client wants. `text` and `clock_deg` belong to a mark."""

    do: Do
    text: str = ""
    clock_deg: float | None = None

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Check and convert. Raises ValueError naming what is wrong."""
        top = untrusted.mapping(data, "request")
        unknown = top.keys() - {"do", "text", "clock_deg"}
        do = top.get("do")
        if not isinstance(do, str) or do not in set(Do):
            raise ValueError(f"do is {str(do)[:40]!r}, expected one of {', '.join(Do)}")
        if unknown or (do != Do.MARK and len(top) > 1):
            raise ValueError(f"{do}: expected nothing more" + (", but text and clock_deg" if do == Do.MARK else ""))
        clock_deg = top.get("clock_deg")
        if clock_deg is not None:
            clock_deg = untrusted.number(clock_deg, "clock_deg", 360.0)
        return cls(Do(do), untrusted.text(top.get("text", ""), "text", TEXT_MAX), clock_deg)


class ControlSocket:
    """The daemon's side. Waits for nobody: what a client does not fetch is dropped, and costs nobody else anything."""

    def __init__(self, doorkeeper: Doorkeeper, address: str, keys: Keys | None) -> None:
        """Raises AnnulusError when the address is taken, is not one, or is remote and there are no keys."""
        self._socket = doorkeeper.context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.RCVHWM, ANSWERS_MAX)
        self._socket.setsockopt(zmq.SNDHWM, ANSWERS_MAX)
        self._socket.setsockopt(zmq.LINGER, 500)  # the answer to the request that ended us
        self.address = doorkeeper.bind(self._socket, address, keys, "control", CARRIED_MAX)

    def poll(
        self, obey: Callable[[Request], None], state: Callable[[], State], health: Callable[[], str] = lambda: ""
    ) -> int:
        """Have what was asked done, and answer. `obey` raises AnnulusError when it cannot be. Returns how many messages
        were no requests.
        """
        malformed = 0
        for _ in range(TAKEN_MAX):
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            error = ""
            try:
                obey(_parse(parts))
            except ValueError as wrong:
                malformed += 1
                error = str(wrong)
            except AnnulusError as refused:
                error = str(refused)
            answer = msgpack.packb({"ok": not error, "state": state().value, "health": health(), "error": error})
            with contextlib.suppress(zmq.ZMQError):  # it asks and does not listen
                self._socket.send_multipart([*parts[: 1 + (len(parts) > 1 and not parts[1])], answer], zmq.NOBLOCK)
        return malformed

    def close(self) -> None:
        self._socket.close()


def _parse(parts: list[bytes]) -> Request:
    """The sender, an empty delimiter where it is a REQ socket, the request."""
    if not 2 <= len(parts) <= PARTS_MAX or (len(parts) == PARTS_MAX and parts[1]):
        raise ValueError(f"a request of {len(parts) - 1} parts, expected one")
    return Request.from_dict(untrusted.unpack(parts[-1], REQUEST_MAX))


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """CURVE, Z85 text: the daemon's public key, and the client's own pair."""

    server: str
    public: str
    secret: str


class ControlClient:
    """A console's side: one request, one answer.

    with ControlClient("tcp://127.0.0.1:5602") as head:
        head.start()
        head.mark("joint", clock_deg=90.0)
        head.stop()
    """

    def __init__(self, address: str, keys: ClientKeys | None = None) -> None:
        self.address, self._keys = address, keys
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._connect()

    def start(self) -> State:
        """Begin a scan. Each request returns the state after it, and raises AnnulusError with the daemon's reason."""
        return self.ask({"do": "start"})

    def stop(self) -> State:
        """End the scan that is under way; returns when its recording is closed."""
        return self.ask({"do": "stop"})

    def mark(self, text: str, clock_deg: float | None = None) -> State:
        """Have this place recorded; clock_deg around the pipe, 0 = 12 o'clock, clockwise looking forward."""
        return self.ask({"do": "mark", "text": text, "clock_deg": clock_deg})

    def zero(self) -> State:
        """The head's place is z = 0 from now on."""
        return self.ask({"do": "zero"})

    def state(self) -> State:
        return self.ask({"do": "state"})

    def health(self) -> str:
        """How the head is: "ok", "degraded: why", "failed: why"."""
        return untrusted.text(self._answer({"do": "state"}).get("health", ""), "health", REQUEST_MAX)

    def ask(self, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> State:
        """Any request. Raises AnnulusError when it is refused, or nobody answers in time."""
        return State(untrusted.text(self._answer(request, timeout_s).get("state"), "state", 32))

    def _answer(self, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> Mapping[str, Any]:
        self._socket.send(msgpack.packb(dict(request)))
        if not self._socket.poll(math.ceil(timeout_s * 1000)):
            self._socket.close(0)
            self._socket = self._connect()  # an answer that comes late must not be taken for the next one's
            raise AnnulusError(f"{self.address}: no answer within {timeout_s:g} s. Is a daemon with [control] running?")
        answer = untrusted.mapping(untrusted.unpack(self._socket.recv(), REQUEST_MAX), "answer")
        if answer.get("ok") is not True:
            raise AnnulusError(untrusted.text(answer.get("error"), "error", REQUEST_MAX))
        return answer

    def close(self) -> None:
        self._context.destroy(linger=0)

    def _connect(self) -> "zmq.Socket[bytes]":
        socket = self._context.socket(zmq.REQ)
        socket.setsockopt(zmq.LINGER, 0)
        if self._keys is not None:
            socket.curve_serverkey = self._keys.server.encode()
            socket.curve_publickey, socket.curve_secretkey = self._keys.public.encode(), self._keys.secret.encode()
        socket.connect(self.address)
        return socket

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
