"""Frames, labels, profiles and telemetry to viewers over ZeroMQ PUB. A slow viewer loses messages, never the scan.

Every message is [topic, header, part]: header is msgpack {"n": running number within the topic, "body": ...}, part is
raw bytes or empty. PUB drops silently when a viewer's queue (two messages) is full: the holes in "n" are how the viewer
knows.
"""

import ipaddress
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import msgpack
import zmq
from zmq.utils import z85

from annulus import untrusted
from annulus.vocabulary import AnnulusError

VIEWER_QUEUE = 2  # messages per viewer
BODY_MAX = 1 << 24


@dataclass(frozen=True, slots=True)
class Keys:
    """CURVE: the server's key pair, and the public keys of the viewers let in (Z85 text, 40 characters each)."""

    public: str
    secret: str
    viewers: frozenset[str]

    def __post_init__(self) -> None:
        for key in (self.public, self.secret, *self.viewers):
            try:
                valid = len(key) == 40 and len(z85.decode(key)) == 32
            except (KeyError, ValueError):
                valid = False
            if not valid:
                raise AnnulusError("a CURVE key must be 40 characters of Z85, as `zmq.curve_keypair()` makes them")


class Publisher:
    """Binds, sends without ever waiting, and lets in only loopback or viewers with a known CURVE key."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], address: str, keys: Keys | None = None) -> None:
        """Raises AnnulusError when the address is taken, is not one, or is remote and there are no keys."""
        if keys is None and not is_loopback(address):
            raise AnnulusError(f"publish address {address} is not loopback: viewers from outside need CURVE keys")
        self.sent: Counter[str] = Counter()
        self._door: zmq.Socket[bytes] | None = None
        self._viewers = frozenset(key.encode() for key in keys.viewers) if keys else frozenset()
        self._socket = context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.SNDHWM, VIEWER_QUEUE)
        self._socket.setsockopt(zmq.LINGER, 0)
        try:
            if keys is not None:
                self._door = context.socket(zmq.REP)  # ZAP: libzmq asks here before it lets anyone in (RFC 27)
                self._door.setsockopt(zmq.LINGER, 0)
                self._door.bind("inproc://zeromq.zap.01")
                self._socket.curve_server = True
                self._socket.curve_secretkey = keys.secret.encode()
                self._socket.zap_domain = b"annulus"
            self._socket.bind(address)
        except zmq.ZMQError as error:
            self.close()
            raise AnnulusError(
                f"cannot publish on {address}: {error.strerror}. Expected tcp://ADDRESS:PORT that is free."
            ) from None
        self.address: str = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def send(self, topic: str, body: Any, part: Any = b"") -> None:
        """`body` is plain types and bytes; `part` is any buffer, copied by libzmq before this returns."""
        header = msgpack.packb({"n": self.sent[topic], "body": body})
        self.sent[topic] += 1
        self._socket.send_multipart([topic.encode(), header, part], zmq.NOBLOCK, copy=True)

    def admit(self) -> None:
        """Answer viewers waiting at the door. Call regularly; does not wait."""
        while self._door is not None and self._door.poll(0):
            request = self._door.recv_multipart()
            version, number = request[0], request[1]
            mechanism, key = (request[5], request[6]) if len(request) == 7 else (b"", b"")
            known = mechanism == b"CURVE" and len(key) == 32 and z85.encode(key) in self._viewers
            verdict = (b"200", b"OK") if known else (b"400", b"viewer's key is not on the list")
            self._door.send_multipart([version, number, *verdict, b"", b""])

    def close(self) -> None:
        self._socket.close()
        if self._door is not None:
            self._door.close()


def is_loopback(address: str) -> bool:
    """True for addresses only this machine reaches."""
    if address.startswith(("inproc://", "ipc://")):
        return True
    host = urlsplit(address).hostname
    if host == "localhost":
        return True
    try:
        return host is not None and ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def parse(parts: Collection[bytes]) -> tuple[str, int, Any, bytes]:
    """A viewer's side: [topic, header, part] -> topic, running number, body, part. ValueError on anything else."""
    if len(parts) != 3:
        raise ValueError(f"{len(parts)} parts, expected topic, header, part")
    topic, header, part = parts
    data = untrusted.unpack(header, BODY_MAX)
    if not isinstance(data, dict) or not isinstance(data.get("n"), int) or "body" not in data:
        raise ValueError('the header must hold "n" and "body"')
    return topic.decode("ascii", "replace"), data["n"], data["body"], part
