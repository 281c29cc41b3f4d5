"""Frames, labels, profiles and telemetry to viewers over ZeroMQ. A slow viewer loses messages, never the scan.

Every message is [topic, header, part]: header is msgpack {"n": running number within the topic, "body": ...}, part is
raw bytes or empty. What a viewer's queue (two messages) has no room for within a moment is dropped silently: the holes
in "n" are how the viewer knows.

libzmq files every subscription in the sender's thread and memory, 60 bytes for each of its own: 20 MB of them took a
gigabyte and 20 s. So none may be longer than CARRIED_MAX, few wait (the more wait, the longer libzmq is at them before
it comes back), and whoever asks for more of what there is not than STRANGE_MAX, or of what there may be than
STANDING_MAX, has everybody's connections closed: that frees the memory, and viewers connect again by themselves.
"""

import contextlib
import time
from collections.abc import Collection
from typing import Any

import msgpack
import zmq

from annulus_pipe import untrusted
from annulus_pipe.stream.access import Doorkeeper, Keys
from annulus_pipe.vocabulary import AnnulusError

VIEWER_QUEUE = 2  # messages per viewer
PATIENCE_S = 0.005  # that words wait for room in them; guarded by test_no_word_is_lost_to_who_reads
LOOK_S = 0.0001  # between two looks for it
STUCK_S = 1.0  # without patience, after a viewer who does not read
BODY_MAX = 1 << 24
CARRIED_MAX = 512  # bytes of anything a viewer sends; a CURVE handshake takes 400
STRANGE_MAX = 1 << 16  # bytes of subscriptions to topics that there are not, of all viewers
STANDING_MAX = 1 << 16  # bytes of those to topics that there may be, and that stand
TOPICS = (
    b"frame/",
    b"label",
    b"profile",
    b"sensor/",
    b"mark",
    b"job",
    b"state",
    b"telemetry",
    b"event",
    b"begun",
    b"ended",
    b"health",
    b"preview/",
    b"rows/",
    b"slits/",
    b"wall",
    b"defects",
    b"closeup",
)


class Publisher:
    """Binds, sends without ever waiting, and lets in only whom the doorkeeper does."""

    def __init__(self, doorkeeper: Doorkeeper, address: str, keys: Keys | None = None) -> None:
        """Raises AnnulusError when the address is taken, is not one, or is remote and there are no keys."""
        self.floods = 0  # times that everybody's connection was closed
        self._doorkeeper, self._keys = doorkeeper, keys
        self._strange = 0
        self._impatient_until_s = 0.0
        self._standing: set[bytes] = set()  # what viewers ask for
        self._standing_bytes = 0
        self.address = address
        self._socket: zmq.Socket[bytes] | None = self._bound()

    def send(self, topic: str, number: int, body: Any, part: Any = b"") -> None:
        """`body` is plain types and bytes; `part` is any buffer, copied by libzmq before this returns.

        Whole frames are dropped where there is no room at once. Anything else waits a moment for libzmq's own thread to
        empty the queues of those who read: words come in bursts of more than a queue holds, and a state that a viewer
        missed it would not hear again. Who does not read costs PATIENCE_S once in STUCK_S, whoever many there are.
        """
        if self._socket is None:
            return
        parts = [topic.encode(), msgpack.packb({"n": number, "body": body}), part]
        now = time.monotonic()
        if not topic.startswith("frame/") and now >= self._impatient_until_s:
            self._socket.setsockopt(zmq.XPUB_NODROP, 1)
            while time.monotonic() - now < PATIENCE_S:
                try:
                    self._socket.send_multipart(parts, zmq.NOBLOCK, copy=True)
                    return
                except zmq.Again:
                    time.sleep(LOOK_S)
            self._impatient_until_s = now + STUCK_S
        self._socket.setsockopt(zmq.XPUB_NODROP, 0)
        self._socket.send_multipart(parts, zmq.NOBLOCK, copy=True)

    def listen(self) -> frozenset[bytes]:
        """See what viewers ask for. Call regularly; does not wait. Returns what prefixes of topics somebody has asked
        for since the last call, also such as others had asked for before.
        """
        if self._socket is None:
            with contextlib.suppress(AnnulusError):  # libzmq has not quite let go of the address: the next time
                self._socket = self._bound()
            return frozenset()
        asked = set()
        with contextlib.suppress(zmq.Again):
            while not self._flooded:
                message = self._socket.recv(zmq.NOBLOCK)
                if self._heard(message):
                    asked.add(message[1:])
        if self._flooded:
            self.floods += 1
            self.close()
        return frozenset(asked)

    def wanted(self, topic: str) -> bool:
        """Whether some viewer has asked for it, as far as `listen` has heard."""
        name = topic.encode()
        return any(name[:length] in self._standing for length in range(len(name) + 1))

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close(0)
            self._socket = None

    @property
    def _flooded(self) -> bool:
        return self._strange > STRANGE_MAX or self._standing_bytes > STANDING_MAX

    def _heard(self, message: bytes) -> bool:
        """libzmq tells of each who asks for a prefix, and when nobody does any more. Returns whether it was one that
        asks for something there may be.
        """
        prefix = message[1:]
        if not _is_known(prefix):
            self._strange += len(message)
            return False
        if message[:1] == b"\1" and prefix not in self._standing:
            self._standing.add(prefix)
            self._standing_bytes += len(message)
        elif message[:1] == b"\0" and prefix in self._standing:
            self._standing.remove(prefix)
            self._standing_bytes -= len(message)
        return message[:1] == b"\1"

    def _bound(self) -> zmq.Socket[bytes]:
        self._strange = self._standing_bytes = 0
        self._standing.clear()
        socket = self._doorkeeper.context.socket(zmq.XPUB)
        socket.setsockopt(zmq.SNDHWM, VIEWER_QUEUE)
        socket.setsockopt(zmq.XPUB_VERBOSE, 1)  # who comes later is told of, too
        socket.setsockopt(zmq.RCVHWM, 1)
        socket.setsockopt(zmq.LINGER, 0)
        self.address = self._doorkeeper.bind(socket, self.address, self._keys, "publish", CARRIED_MAX)
        return socket


def _is_known(prefix: bytes) -> bool:
    return any(topic.startswith(prefix) or (topic[-1:] == b"/" and prefix.startswith(topic)) for topic in TOPICS)


def parse(parts: Collection[bytes]) -> tuple[str, int, Any, bytes]:
    """A viewer's side: [topic, header, part] -> topic, running number, body, part. ValueError on anything else."""
    if len(parts) != 3:
        raise ValueError(f"{len(parts)} parts, expected topic, header, part")
    topic, header, part = parts
    data = untrusted.unpack(header, BODY_MAX)
    if not isinstance(data, dict) or not isinstance(data.get("n"), int) or "body" not in data:
        raise ValueError('the header must hold "n" and "body"')
    return topic.decode("ascii", "replace"), data["n"], data["body"], part
