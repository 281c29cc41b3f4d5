"""What is known of the head now: the daemon's words, passed on to viewers, and kept for who comes later."""

import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from annulus import untrusted
from annulus.console import wire
from annulus.console.feed import Feed
from annulus.console.hub import Hub, Viewer

LOST_S = 1.5
KEPT = 50  # events and marks told to who comes later
NO_POINTS, NO_COLOURS = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
STATUS = ("telemetry", "state", "health", "ended", "defects")


class Live:
    """Between the feed and the hub."""

    def __init__(self, feed: Feed, hub: Hub) -> None:
        self.feed, self.hub = feed, hub
        self._last: dict[str, bytes] = {}
        self._told: deque[bytes] = deque(maxlen=KEPT)
        feed.on_word = self.hear
        feed.on_restart = self.begin_anew
        hub.on_wants = feed.want

    def welcome(self, viewer: Viewer) -> None:
        """Everything that one who comes now must know."""
        for message in (*self._last.values(), *self._told):
            viewer.tell("status", message)

    def begin_anew(self) -> None:
        self._last.clear()
        self._told.clear()
        self.hub.send("points", wire.points(wire.ANEW | wire.LAST, 0, NO_POINTS, NO_COLOURS))

    def alive(self) -> Mapping[str, Any]:
        age = self.feed.age_s()
        return {
            "daemon": age is not None and age <= LOST_S,
            "age_s": age,
            "viewers": len(self.hub.viewers),
            "lost": dict(self.feed.lost),
        }

    def hear(self, topic: str, body: Any, part: bytes) -> None:
        """One word of the daemon's. ValueError when it is not as README.md says."""
        kind, _, which = topic.partition("/")
        if kind == "preview":
            header = untrusted.mapping(body, "preview")
            index, camera = int(header["index"]), int(which)
            message = wire.picture(
                camera, wire.LABELS[header["label"]], index, header["z_mm"], header.get("published", time.time()), part
            )
            self.hub.newest(("picture", camera), "pictures", message)
        elif kind == "rows":
            header = untrusted.mapping(body, "rows")
            self.hub.newest(
                ("rows", which), "rows", wire.rows(int(which), wire.LABELS[header["label"]], int(header["index"]), part)
            )
        elif kind == "slits":
            header = untrusted.mapping(body, "slits")
            self.hub.newest(("slits", which), "slits", wire.slits(int(which), int(header["index"]), part))
        elif kind == "wall":
            w = untrusted.mapping(body, "wall")
            size = 2 * w["columns"]
            lines = [part[i : i + size] for i in range(0, len(part), size)]
            message = wire.wall(w["of"], w["first"], w["step_mm"], w["radius_mm"], w["scan"], w["columns"], lines)
            self.hub.send("wall", message)
        elif kind == "profile":
            points = np.frombuffer(body["points"], "<f4").reshape(-1, 3)
            colour = np.frombuffer(body["colour"], np.uint8).reshape(-1, 3)
            self.hub.send("points", wire.points(0, body["frame"], points, colour))
        elif kind != "closeup":
            message = wire.status(topic, body)
            if topic in STATUS or kind == "sensor":
                self._last[topic] = message
                self.hub.newest(topic, "status", message) if kind == "sensor" else self.hub.send("status", message)
            else:
                self._told.append(message)
                self.hub.send("status", message)
