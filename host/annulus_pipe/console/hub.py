"""Viewers, each with what waits for it: of pictures the newest only, of points all, bounded in bytes.

Sans-I/O. Whoever sends to a viewer calls `take` until it gives nothing, and then waits for `ready`. Messages are made
once, whoever many they go to. A viewer that is too slow for the points is not sent them late: it gets the cloud so far
instead, thinned, and is told that it missed some.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from annulus_pipe.console import wire

STATUS = "status"
WANTS = ("pictures", "points", "wall", "rows", "slits", STATUS)
BACKLOG_MAX = 4 << 20  # bytes that wait for one viewer; 20 s of points
STATUS_MAX = 2000  # messages of status among them

CatchUp = Callable[[frozenset[str]], Iterator[bytes]]


class Viewer:
    """One page's connection. `session` is the id of whose it is."""

    def __init__(self, session: str = "", catch_up: CatchUp = lambda wants: iter(())) -> None:
        self.session = session
        self.hidden = False
        self.dropped = 0  # messages of points that it was too slow for
        self.answered_s = 0.0  # when it last said something, monotonic
        self.ready = asyncio.Event()
        self._catch_up = catch_up
        self._wants = frozenset(WANTS)
        self._queue: deque[tuple[str, bytes]] = deque()
        self._newest: dict[object, bytes] = {}
        self._behind: Iterator[bytes] | None = None  # the cloud so far, and the wall
        self._bytes = self._statuses = 0
        self._turn = False
        self.refresh(frozenset({"points", "wall"}))

    @property
    def wants(self) -> frozenset[str]:
        return frozenset({STATUS}) if self.hidden else self._wants | {STATUS}

    @property
    def backlog(self) -> int:
        """Bytes."""
        return self._bytes

    def want(self, wants: frozenset[str] | None = None, hidden: bool | None = None) -> None:
        """What it wants from now on; what it did not want before it gets as it stands now."""
        before = self.wants
        self._wants = self._wants if wants is None else wants & frozenset(WANTS)
        self.hidden = self.hidden if hidden is None else hidden
        gone, new = before - self.wants, self.wants - before
        if gone:
            self._queue = deque(one for one in self._queue if one[0] not in gone)
            self._bytes = sum(len(message) for _, message in self._queue)
            self._newest = {key: one for key, one in self._newest.items() if key == "alive"}
            if "points" in gone:
                self._behind = None
        if new & {"points", "wall"}:
            self.refresh(new)

    def refresh(self, what: frozenset[str]) -> None:
        """Points and wall as they stand now, when there is nothing else to send."""
        self._behind = self._catch_up(what & self.wants)
        self.ready.set()

    def newest(self, key: object, what: str, message: bytes) -> None:
        """In place of the one with that key that was not sent yet."""
        if what in self.wants:
            self._newest[key] = message
            self.ready.set()

    def tell(self, what: str, message: bytes) -> None:
        """In the order they come. Points are not told to who is still being told the cloud so far: they are in it."""
        if what not in self.wants or (what == "points" and self._behind is not None):
            return
        self._queue.append((what, message))
        self._bytes += len(message)
        self._statuses += what == STATUS
        self.ready.set()
        if self._bytes > BACKLOG_MAX or self._statuses > STATUS_MAX:
            self._give_up()

    def take(self) -> bytes | None:
        """The next to send; None when there is none. Pictures and all else take turns."""
        self._turn = not self._turn
        if self._newest and (self._turn or not (self._queue or self._behind)):
            return self._newest.pop(next(iter(self._newest)))
        if self._queue:
            what, message = self._queue.popleft()
            self._bytes -= len(message)
            self._statuses -= what == STATUS
            return message
        if self._behind is not None:
            message_or_none = next(self._behind, None)
            if message_or_none is not None:
                return message_or_none
            self._behind = None
        if self._newest:
            return self._newest.pop(next(iter(self._newest)))
        self.ready.clear()
        return None

    def _give_up(self) -> None:
        kept = [one for one in self._queue if one[0] == STATUS][-STATUS_MAX // 2 :]
        while sum(len(message) for _, message in kept) > BACKLOG_MAX // 2:
            del kept[: len(kept) // 2 + 1]
        self.dropped += len(self._queue) - len(kept)
        self._queue = deque(kept)
        self._bytes, self._statuses = sum(len(message) for _, message in kept), len(kept)
        self.refresh(frozenset({"points", "wall"}))


class Hub:
    """All viewers."""

    def __init__(self) -> None:
        self.viewers: set[Viewer] = set()
        self.on_wants: Callable[[frozenset[str]], None] = lambda wants: None

    def add(self, viewer: Viewer) -> None:
        self.viewers.add(viewer)
        self.changed()

    def remove(self, viewer: Viewer) -> None:
        self.viewers.discard(viewer)
        self.changed()

    def changed(self) -> None:
        """After a viewer came, went, or wants something else."""
        self.on_wants(frozenset().union(*(viewer.wants for viewer in self.viewers)))

    def tell(self, topic: str, body: Any) -> None:
        """Status, to all viewers that are there now."""
        self.send(STATUS, wire.status(topic, body))

    def send(self, what: str, message: bytes) -> None:
        for viewer in self.viewers:
            viewer.tell(what, message)

    def newest(self, key: object, what: str, message: bytes) -> None:
        for viewer in self.viewers:
            viewer.newest(key, what, message)
