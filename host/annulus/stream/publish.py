"""Frames, labels, profiles and telemetry to viewers over ZeroMQ PUB. A slow viewer loses messages, never the scan.

Every message is [topic, header, part]: header is msgpack {"n": running number within the topic, "body": ...}, part is
raw bytes or empty. PUB drops silently when a viewer's queue (two messages) is full: the holes in "n" are how the viewer
knows.
"""

from collections import Counter
from collections.abc import Collection
from typing import Any

import msgpack
import zmq

from annulus import untrusted
from annulus.stream.access import Doorkeeper, Keys

VIEWER_QUEUE = 2  # messages per viewer
BODY_MAX = 1 << 24


class Publisher:
    """Binds, sends without ever waiting, and lets in only whom the doorkeeper does."""

    def __init__(self, doorkeeper: Doorkeeper, address: str, keys: Keys | None = None) -> None:
        """Raises AnnulusError when the address is taken, is not one, or is remote and there are no keys."""
        self.sent: Counter[str] = Counter()
        self._socket = doorkeeper.context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.SNDHWM, VIEWER_QUEUE)
        self._socket.setsockopt(zmq.LINGER, 0)
        self.address = doorkeeper.bind(self._socket, address, keys, "publish")

    def send(self, topic: str, body: Any, part: Any = b"") -> None:
        """`body` is plain types and bytes; `part` is any buffer, copied by libzmq before this returns."""
        header = msgpack.packb({"n": self.sent[topic], "body": body})
        self.sent[topic] += 1
        self._socket.send_multipart([topic.encode(), header, part], zmq.NOBLOCK, copy=True)

    def close(self) -> None:
        self._socket.close()


def parse(parts: Collection[bytes]) -> tuple[str, int, Any, bytes]:
    """A viewer's side: [topic, header, part] -> topic, running number, body, part. ValueError on anything else."""
    if len(parts) != 3:
        raise ValueError(f"{len(parts)} parts, expected topic, header, part")
    topic, header, part = parts
    data = untrusted.unpack(header, BODY_MAX)
    if not isinstance(data, dict) or not isinstance(data.get("n"), int) or "body" not in data:
        raise ValueError('the header must hold "n" and "body"')
    return topic.decode("ascii", "replace"), data["n"], data["body"], part
