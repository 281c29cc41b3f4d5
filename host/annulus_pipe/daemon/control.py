"""The control socket: consoles start, stop, mark, tune and ask while the session runs. ZeroMQ ROUTER, one msgpack map a
request, one an answer.

    {"do": "start" | "stop" | "mark" | .., "text": .., "who": {"id": .., "name": ..}}    what there is: request.py
    {"ok": true | false, "state": "idle", "health": "ok", "error": "", ..}

Every request is answered once, a wrong one with what is wrong. Who may connect: as for viewers, see stream.access.
"""

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Self

import msgpack
import zmq

from annulus_pipe import untrusted
from annulus_pipe.daemon.command import Operator
from annulus_pipe.daemon.request import HOLD_S, PHOTO_MAX, REQUEST_MAX, SCAN_MAX, TEXT_MAX, Do, Request
from annulus_pipe.daemon.state import State
from annulus_pipe.job import JobSheet
from annulus_pipe.stream.access import ClientKeys, Doorkeeper, Keys, connected
from annulus_pipe.vocabulary import AnnulusError

__all__ = [
    "CARRIED_MAX",
    "PHOTO_MAX",
    "REQUEST_MAX",
    "TEXT_MAX",
    "ClientKeys",
    "ControlClient",
    "ControlSocket",
    "Do",
    "Request",
]

PARTS_MAX = 3  # sender, delimiter, request
CARRIED_MAX = ANSWER_MAX = 1 << 16  # bytes; what is larger ZeroMQ does not even take in
TAKEN_MAX = 16  # requests in one turn of the session
REQUESTS_MAX = 4  # of one connection, beside what its socket holds: each may be 64 KiB
ANSWERS_MAX = 100  # that wait for a client that does not read
ANSWER_S = 30.0  # a stop waits for workers and recorder


class ControlSocket:
    """The daemon's side. Waits for nobody: what a client does not fetch is dropped, and costs nobody else anything."""

    def __init__(self, doorkeeper: Doorkeeper, address: str, keys: Keys | None) -> None:
        """Raises AnnulusError when the address is taken, is not one, or is remote and there are no keys."""
        self._socket = doorkeeper.context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.RCVHWM, REQUESTS_MAX)
        self._socket.setsockopt(zmq.SNDHWM, ANSWERS_MAX)
        self._socket.setsockopt(zmq.LINGER, 500)  # the answer to the request that ended us
        self.address = doorkeeper.bind(self._socket, address, keys, "control", CARRIED_MAX)

    def poll(
        self,
        obey: Callable[[Request], Mapping[str, Any] | None],
        state: Callable[[], State],
        health: Callable[[], str] = lambda: "",
    ) -> int:
        """Have what was asked done, and answer. `obey` returns what the answer says besides, and raises AnnulusError
        when it cannot be done. Returns how many messages were no requests.
        """
        malformed = 0
        for _ in range(TAKEN_MAX):
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                break
            parts = [frame.bytes for frame in frames]
            error, besides = "", None
            try:
                besides = obey(replace(_parse(parts), peer=_peer(frames[-1])))
            except ValueError as wrong:
                malformed += 1
                error = str(wrong)
            except AnnulusError as refused:
                error = str(refused)
            status = {"ok": not error, "state": state().value, "health": health(), "error": error}
            answer = msgpack.packb({**(besides or {}), **status})
            with contextlib.suppress(zmq.ZMQError):  # it asks and does not listen
                self._socket.send_multipart([*parts[: 1 + (len(parts) > 1 and not parts[1])], answer], zmq.NOBLOCK)
        return malformed

    def close(self) -> None:
        self._socket.close()


def _peer(frame: zmq.Frame) -> str:
    """The address at the other end; one that is on this machine, and not by TCP, has none."""
    with contextlib.suppress(zmq.ZMQError, KeyError):
        return str(frame.get("Peer-Address"))
    return "this machine"


def _parse(parts: list[bytes]) -> Request:
    """The sender, an empty delimiter where it is a REQ socket, the request."""
    if not 2 <= len(parts) <= PARTS_MAX or (len(parts) == PARTS_MAX and parts[1]):
        raise ValueError(f"a request of {len(parts) - 1} parts, expected one")
    return Request.unpack(parts[-1])


class ControlClient:
    """A console's side: one request, one answer.

    with ControlClient("tcp://127.0.0.1:5602") as head:
        head.start()
        head.mark("joint", clock_deg=90.0)
        head.stop()
    """

    def __init__(self, address: str, keys: ClientKeys | None = None, who: Operator | None = None) -> None:
        """`who` asks, where several do; every request says so."""
        self.address, self._keys, self._who = address, keys, who
        self.scan: int | None = None  # the number of what this client began last
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._connect()

    def start(self) -> State:
        """Begin a scan. Each request returns the state after it, and raises AnnulusError with the daemon's reason."""
        return self._begin({})

    def trial(self, hold_s: float = HOLD_S) -> State:
        """Lamps and cameras on, nothing recorded, until nobody asked for more (`hold`) for so long."""
        return self._begin({"record": False, "hold_s": hold_s})

    def hold(self, hold_s: float = HOLD_S, scan: int | None = None) -> State:
        """The trial goes on for so long. `scan`: if it is that one; so with all requests that have it."""
        return self.ask({"do": "hold", "hold_s": hold_s, "scan": scan})

    def stop(self, scan: int | None = None) -> State:
        """End the scan, or the trial, that is under way; returns when its recording is closed."""
        return self.ask({"do": "stop", "scan": scan})

    def pause(self) -> State:
        """Lamps dark, no frames; the recording stays open, and the place is counted on."""
        return self.ask({"do": "pause"})

    def resume(self) -> State:
        """The scan that was paused goes on, in the same recording."""
        return self.ask({"do": "resume"})

    def mark(self, text: str, clock_deg: float | None = None, photo: bytes = b"") -> State:
        """Have this place recorded; clock_deg around the pipe, 0 = 12 o'clock, clockwise looking forward; a JPEG."""
        asked: dict[str, Any] = {"do": "mark", "text": text, "clock_deg": clock_deg}
        return self.ask({**asked, "photo": photo} if photo else asked)

    def zero(self) -> State:
        """The head's place is z = 0 from now on."""
        return self.ask({"do": "zero"})

    def state(self) -> State:
        return self.ask({"do": "state"})

    def about(self) -> Mapping[str, Any]:
        """What the head is: cameras, window, lamps, job, calibration, controller. See README.md."""
        return untrusted.mapping(self.answer({"do": "about"}).get("about"), "about")

    def job(self, sheet: JobSheet) -> State:
        """Who asked for the scan, where, which pipe: what is said here goes over what was known, from now on."""
        return self.ask({"do": "job", "job": sheet.to_dict()})

    def lamps(
        self, *, commit: bool, trial: bool = False, scan: int | None = None, **changed: float
    ) -> Mapping[str, Any]:
        """Flashes, in microseconds after the falling edge: `projector_delay_us=..`. Returns all of them as they would
        be, or, with `commit`, as they are; `trial`: until the trial ends, and outside the window too.
        """
        asked = {"do": "lamps", "lamps": changed, "commit": commit, "trial": trial, "scan": scan}
        return untrusted.mapping(self.answer(asked).get("lamps"), "lamps")

    def command(self, take: bool = False) -> State:
        """Begin to command, or go on; `take` it from another."""
        return self.ask({"do": "command", "take": take})

    def release(self) -> State:
        return self.ask({"do": "release"})

    def health(self) -> str:
        """How the head is: "ok", "degraded: why", "failed: why"."""
        return untrusted.text(self.answer({"do": "state"}).get("health", ""), "health", REQUEST_MAX)

    def ask(self, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> State:
        """Any request. Raises AnnulusError when it is refused, or nobody answers in time."""
        return State(untrusted.text(self.answer(request, timeout_s).get("state"), "state", 32))

    def answer(self, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> Mapping[str, Any]:
        """Any request, and all that is said to it. Raises AnnulusError as `ask`."""
        who = {}
        if self._who is not None:
            where = {"from": self._who.address} if self._who.address else {}
            who = {"who": {"id": self._who.id, "name": self._who.name, **where}}
        try:
            packed = msgpack.packb({**who, **request})
        except UnicodeEncodeError as error:
            raise AnnulusError(f"{self.address}: {error.object[error.start]!r} is half a sign") from None
        self._socket.send(packed)
        if not self._socket.poll(math.ceil(timeout_s * 1000)):
            self._socket.close(0)
            self._socket = self._connect()  # an answer that comes late must not be taken for the next one's
            raise AnnulusError(f"{self.address}: no answer within {timeout_s:g} s. Is a daemon with [control] running?")
        answer = untrusted.mapping(untrusted.unpack(self._socket.recv(), ANSWER_MAX), "answer")
        if answer.get("ok") is not True:
            raise AnnulusError(untrusted.text(answer.get("error"), "error", REQUEST_MAX))
        return answer

    def close(self) -> None:
        self._context.destroy(linger=0)

    def _begin(self, how: Mapping[str, Any]) -> State:
        answer = self.answer({"do": "start", **how})
        scan = answer.get("scan")
        self.scan = None if scan is None else untrusted.whole(scan, "scan", 0, SCAN_MAX)
        return State(untrusted.text(answer.get("state"), "state", 32))

    def _connect(self) -> "zmq.Socket[bytes]":
        return connected(self._context, zmq.REQ, self.address, self._keys, ANSWER_MAX)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
