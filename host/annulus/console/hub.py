"""Viewers, each with what waits for it: of pictures the newest only, of points all, bounded in bytes.

Sans-I/O: whoever sends calls `take` until it gives nothing, and waits for `ready`.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from annulus.console import wire

WANTS = ("pictures", "points", "wall", "rows", "slits", "status")
BACKLOG_MAX = 8 << 20  # bytes of points, wall and status that wait for one viewer


class Viewer:
    """One page's connection."""

    def __init__(self, session: str) -> None:
        self.session = session
        self.wants: frozenset[str] = frozenset(WANTS)
        self.hidden = False
        self.dropped = 0  # messages of points that it was too slow for
        self.ready = asyncio.Event()
        self.answered_s = 0.0  # when it last said something, monotonic
        self._queue: deque[tuple[str, bytes]] = deque()
        self._newest: dict[object, bytes] = {}
        self._bytes = 0

    def wanting(self, what: str) -> bool:
        return what == "status" or (what in self.wants and not self.hidden)

    def newest(self, key: object, what: str, message: bytes) -> None:
        """In place of the one with that key that was not sent yet."""
        if self.wanting(what):
            self._newest[key] = message
            self.ready.set()

    def tell(self, what: str, message: bytes) -> bool:
        """In the order they come. Returns False when the backlog is full: nothing of its points waits any more."""
        if not self.wanting(what):
            return True
        self._queue.append((what, message))
        self._bytes += len(message)
        self.ready.set()
        if self._bytes <= BACKLOG_MAX:
            return True
        kept = [one for one in self._queue if one[0] == "status"]
        self.dropped += len(self._queue) - len(kept)
        self._queue = deque(kept)
        self._bytes = sum(len(one) for _, one in kept)
        return False

    @property
    def backlog(self) -> int:
        return self._bytes

    def take(self) -> bytes | None:
        """The next to send; None when there is none."""
        if self._queue:
            _, message = self._queue.popleft()
            self._bytes -= len(message)
            return message
        if self._newest:
            return self._newest.pop(next(iter(self._newest)))
        self.ready.clear()
        return None


class Hub:
    """All viewers."""

    def __init__(self) -> None:
        self.viewers: set[Viewer] = set()
        self.on_wants: Callable[[frozenset[str]], None] = lambda wants: None
        self.on_overrun: Callable[[Viewer], None] = lambda viewer: None

    def add(self, viewer: Viewer) -> None:
        self.viewers.add(viewer)
        self.changed()

    def remove(self, viewer: Viewer) -> None:
        self.viewers.discard(viewer)
        self.changed()

    def changed(self) -> None:
        """After a viewer came, went, or wants something else."""
        self.on_wants(frozenset(what for what in WANTS if any(one.wanting(what) for one in self.viewers)))

    def tell(self, topic: str, body: Any) -> None:
        """Status, to all viewers."""
        self.send("status", wire.status(topic, body))

    def send(self, what: str, message: bytes) -> None:
        for viewer in list(self.viewers):
            if not viewer.tell(what, message):
                self.on_overrun(viewer)

    def newest(self, key: object, what: str, message: bytes) -> None:
        for viewer in self.viewers:
            viewer.newest(key, what, message)


def sent_in_order(viewer: Viewer, messages: Iterable[tuple[str, bytes]]) -> None:
    for what, message in messages:
        viewer.tell(what, message)
