"""Sensors that another process serves: samples over ZeroMQ PUB, in two parts.

    sensors = RemoteSensors("ipc:///run/head/sensors")
    for sample in sensors.poll(): ...

The first part is the sensor's name, the second msgpack of `Sample.to_dict()`. What is anything else is left out and
counted. A server that goes away is silence; one that comes back is heard again.
"""

import re
import time
from collections.abc import Sequence

import zmq

from annulus_pipe import untrusted
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.vocabulary import AnnulusError

SAMPLE_MAX = 16384  # bytes
TAKEN_MAX = 256  # samples in one poll, so that a babbling server holds nobody up
SENSORS_MAX = 16  # names behind one address
RECONNECT_S = 2.0  # of silence: after a message over the limit ZeroMQ does not connect again by itself
AHEAD_NS = 1_000_000_000  # a sample from further in the future has another clock
NAME = re.compile(r"[A-Za-z0-9_.-]{1,32}")  # becomes part of a topic


class RemoteSensors:
    """A Sensor whose samples may be of several sensors. `name` is the address."""

    def __init__(self, address: str) -> None:
        """Raises AnnulusError when `address` is none. Whether somebody serves there only silence can tell."""
        self.name = address
        self._heard_s = time.monotonic()
        self.malformed = 0  # messages that were no sample
        self._known: set[str] = set()
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, 1000)
        self._socket.setsockopt(zmq.MAXMSGSIZE, SAMPLE_MAX)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.subscribe(b"")
        try:
            self._socket.connect(address)
        except zmq.ZMQError as error:
            self.close()
            raise AnnulusError(
                f"{address}: no address of sensors ({error.strerror}). Expected ipc://PATH or tcp://HOST:PORT."
            ) from None

    def poll(self) -> list[Sample]:
        """What has come since the last call, oldest first. Does not wait."""
        samples = []
        now = time.monotonic()
        for _ in range(TAKEN_MAX):
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            self._heard_s = now
            try:
                samples.append(self._sample(parts))
            except ValueError:
                self.malformed += 1
        if now - self._heard_s > RECONNECT_S:
            self._heard_s = now
            self._socket.disconnect(self.name)
            self._socket.connect(self.name)
        return samples

    def close(self) -> None:
        self._context.destroy(linger=0)

    def _sample(self, parts: Sequence[bytes]) -> Sample:
        if len(parts) != 2:
            raise ValueError(f"{len(parts)} parts, expected name and sample")
        sample = Sample.from_dict(untrusted.unpack(parts[1], SAMPLE_MAX))
        if parts[0] != sample.sensor.encode() or not NAME.fullmatch(sample.sensor):
            raise ValueError("a sample under another's name, or under none")
        if sample.host_ns > time.monotonic_ns() + AHEAD_NS:
            raise ValueError("a sample from the future")
        if sample.sensor not in self._known and len(self._known) == SENSORS_MAX:
            raise ValueError(f"more than {SENSORS_MAX} sensors")
        self._known.add(sample.sensor)
        return sample
