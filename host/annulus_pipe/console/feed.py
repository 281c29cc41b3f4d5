"""What the daemon publishes, as it comes: subscribed to, taken apart, counted; how old the last word is.

libzmq's file descriptor is watched by the event loop itself: at 127 messages a second 1.0 % of a core, beside 1.3 %
with a thread that hands batches over and 1.4 % with zmq.asyncio's future for each message.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import zmq

from annulus_pipe.stream.access import ClientKeys, connected
from annulus_pipe.stream.publish import parse

ALWAYS = (
    "telemetry",
    "state",
    "health",
    "event",
    "mark",
    "job",
    "begun",
    "ended",
    "defects",
    "closeup",
    "wall",
    "profile",
    "sensor/",
    "label",
)
ON_DEMAND = {"pictures": "preview/", "rows": "rows/", "slits": "slits/"}  # by what viewers want
WORD_MAX = 1 << 24  # bytes of one part; a wall's slice has 1.5 MB
QUEUE = 200  # messages that wait for this process when it is busy
TURN_MAX = 100  # messages in one turn of the loop
UNREAD = b"label"  # says no more than that the daemon is there
SENSOR = b"sensor/"
SENSOR_S = 0.2  # a page shows numbers, which nobody reads faster; an IMU speaks a hundred times a second
COUNTED_MAX = 64  # topics whose holes are counted
LOST_S = 1.5  # without a word the daemon is taken for lost

Heard = Callable[[str, Any, bytes], None]
Context = zmq.Context[zmq.Socket[bytes]]


class Feed:
    """One daemon's published words."""

    def __init__(self, context: Context, address: str, keys: ClientKeys | None = None) -> None:
        self.address = address
        self.lost: Counter[str] = Counter()  # messages missed, by topic
        self.malformed = 0
        self.reads_labels = False
        self.heard_s: float | None = None  # monotonic; the daemon's last word
        self.on_word: Heard = lambda topic, body, part: None
        self.on_restart: Callable[[], None] = lambda: None
        self.on_return: Callable[[], None] = lambda: None  # from a silence of LOST_S: it may be another
        self._numbers: dict[str, int] = {}
        self._sensor_due: dict[bytes, float] = {}
        self._wanted: frozenset[str] = frozenset()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._socket = connected(context, zmq.SUB, address, keys, WORD_MAX)
        self._socket.setsockopt(zmq.RCVHWM, QUEUE)
        self._descriptor = int(self._socket.getsockopt(zmq.FD))
        for topic in ALWAYS:
            self._socket.subscribe(topic.encode())

    def want(self, wants: frozenset[str]) -> None:
        """What viewers want of what is made on demand only."""
        for what, topic in ON_DEMAND.items():
            if (what in wants) != (what in self._wanted):
                (self._socket.subscribe if what in wants else self._socket.unsubscribe)(topic.encode())
                for known in [one for one in self._numbers if one.startswith(topic)]:
                    del self._numbers[known]  # what was not asked for is not lost
        self._wanted = wants

    def age_s(self) -> float | None:
        return None if self.heard_s is None else time.monotonic() - self.heard_s

    def run(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to listen, on this loop."""
        self._loop = loop
        loop.add_reader(self._descriptor, self.listen)
        self.listen()

    def listen(self) -> None:
        """Take what is there. Also to be called now and then: libzmq's descriptor tells of a change only."""
        if self._socket.closed:
            return
        for _ in range(TURN_MAX):
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            self._take(parts)
        if self._loop is not None:
            self._loop.call_soon(self.listen)

    def close(self) -> None:
        """Safe to call twice."""
        if self._loop is not None and not self._loop.is_closed() and not self._socket.closed:
            self._loop.remove_reader(self._descriptor)
        self._socket.close(0)

    def _take(self, parts: list[bytes]) -> None:
        now = time.monotonic()
        if self.heard_s is not None and now - self.heard_s > LOST_S:
            self.heard_s = now
            self.on_return()
        if parts[0] == UNREAD and not self.reads_labels:
            self.heard_s = now
            return
        if parts[0].startswith(SENSOR):
            if now < self._sensor_due.get(parts[0], 0.0):
                return
            if parts[0] in self._sensor_due or len(self._sensor_due) < COUNTED_MAX:
                self._sensor_due[parts[0]] = now + SENSOR_S
        try:
            topic, number, body, part = parse(parts)
            if not topic.startswith("sensor/"):
                self._count(topic, number)
            self.heard_s = now
            self.on_word(topic, body, part)
        except ValueError:
            self.malformed += 1

    def _count(self, topic: str, number: int) -> None:
        last = self._numbers.get(topic)
        if last is not None and number > last + 1:
            self.lost[topic] += number - last - 1
        if topic == "telemetry" and last is not None and number <= last:
            self._numbers.clear()
            self.on_restart()
        if topic in self._numbers or len(self._numbers) < COUNTED_MAX:
            self._numbers[topic] = number
