"""What is known of the head now: the daemon's words, checked, passed on to viewers, and kept for who comes later."""

import time
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe import untrusted
from annulus_pipe.console import wire
from annulus_pipe.console.cloud import Cloud
from annulus_pipe.console.feed import LOST_S, Feed
from annulus_pipe.console.hub import STATUS, Hub, Viewer
from annulus_pipe.console.kept import CLOSEUPS_MAX, Bounded, CloseUp, Frames, WallPart, WallRows
from annulus_pipe.console.light import light
from annulus_pipe.numeric.palette import DEVIATION_LIVE_MM, deviation_table
from annulus_pipe.stream.frames import CAMERAS_MAX

KEPT = 100  # events and marks told to who comes later
LATEST = ("telemetry", "state", "health", "ended", "defects")  # topics of which the last word holds
HAPPENS = ("event", "mark", "ended")  # at a moment, which who comes later is told too
BLOCK = 20_000  # points; 300 kB
JPEG_MAX = 1 << 20
POINTS_MAX = 64 * 4096  # of a profile; wall.profile says so too, and would bring all of the wall
_NO_POINTS, _NO_COLOURS = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)


class Live:
    """Between the feed and the hub."""

    def __init__(self, feed: Feed, hub: Hub) -> None:
        self.feed, self.hub = feed, hub
        self.closeups = Bounded(CLOSEUPS_MAX)
        self.frames = Frames(self.closeups)
        self.defects: Mapping[str, Any] = {}
        self.cameras: list[Any] = []
        self.nominal_radius_mm: float | None = None
        self._cloud = Cloud()
        self._walls = {of: WallRows(of) for of in wire.WALLS}
        self._latest: dict[str, bytes] = {}
        self._recent: deque[bytes] = deque(maxlen=KEPT)
        self._table = deviation_table()
        self._scan: int | None = None  # whose points and wall these are
        feed.on_word = self._hear
        feed.on_restart = self.begin_anew
        feed.on_return = self._returned
        hub.on_wants = feed.want

    def alive(self) -> dict[str, Any]:
        age = self.feed.age_s()
        return {
            "daemon": age is not None and age <= LOST_S,
            "age_s": age,
            "viewers": len(self.hub.viewers),
            "lost": dict(self.feed.lost),
        }

    def welcome(self, viewer: Viewer) -> None:
        """All status that one who comes now must know."""
        for message in (*self._latest.values(), *self._recent):
            viewer.tell(STATUS, message)

    def latest(self, topic: str, body: Any) -> None:
        """Status of which the last word holds, to all viewers and to who comes later."""
        self._latest[topic] = message = wire.status(topic, body)
        self.hub.send(STATUS, message)

    def begin_anew(self) -> None:
        """Another daemon, or the same one from its beginning."""
        self._latest.clear()
        self._recent.clear()
        self._forget(None)

    def _returned(self) -> None:
        """Points that came before anybody said of which scan they are cannot be told from another daemon's."""
        if self._scan is None:
            self._forget(None)

    def catch_up(self, what: frozenset[str]) -> Iterator[bytes]:
        """The points so far and the wall, made while they are asked for."""
        while "points" in what:
            generation, at, flags = self._cloud.generation, 0, wire.ANEW
            while self._cloud.generation == generation:
                xyz, rgb = self._cloud.block(at, BLOCK)
                at += len(xyz)
                if at >= len(self._cloud):
                    yield wire.points(flags | wire.LAST, 0, xyz, rgb)
                    what = what - {"points"}
                    break
                yield wire.points(flags, 0, xyz, rgb)
                flags = 0
        if "wall" in what:
            for wall in self._walls.values():
                yield from wall.messages()

    def _forget(self, scan: int | None) -> None:
        """What was of the scan before."""
        self._scan = scan
        self._cloud.clear()
        self.frames.clear()
        self.closeups.clear()
        self.defects = {}
        self._latest.pop("defects", None)
        for wall in self._walls.values():
            wall.clear()
        self.hub.send("points", wire.points(wire.ANEW | wire.LAST, 0, _NO_POINTS, _NO_COLOURS))

    def _of_scan(self, number: object) -> None:
        if isinstance(number, int) and number != self._scan:
            if self._scan is None:
                self._scan = number
            else:
                self._forget(number)

    def _hear(self, topic: str, body: Any, part: bytes) -> None:
        """One word of the daemon's. ValueError when it is not as the daemon's README says."""
        kind = topic.partition("/")[0]
        hears = {
            "preview": self._preview,
            "rows": self._rows,
            "slits": self._slits,
            "wall": self._wall,
            "profile": self._profile,
            "closeup": self._closeup,
        }.get(kind)
        if hears is not None:
            hears(body, part)
            return
        content = untrusted.mapping(body, kind)
        if topic in HAPPENS:
            content = body = {"utc_s": time.time(), **content}  # an older daemon does not say when
        if topic in ("begun", "telemetry", "defects"):  # who came after the first has it of the others
            self._of_scan(content.get("scan"))
        if topic == "defects":
            self._defects(content)
        if kind == "sensor":
            self._latest[topic] = message = wire.status(topic, body)
            self.hub.newest(topic, STATUS, message)
        elif topic in LATEST:
            self.latest(topic, body)
        else:
            self._recent.append(message := wire.status(topic, body))
            self.hub.send(STATUS, message)

    def _preview(self, body: Any, part: bytes) -> None:
        camera, label, index, header = _header(body, "preview")
        z = header.get("z_mm")
        z_mm = None if z is None else untrusted.number(z, "preview: z_mm", 1e9)
        published = untrusted.number(header.get("published", time.time()), "preview: published", 1e12)
        if len(part) > JPEG_MAX or part[:2] != b"\xff\xd8":
            raise ValueError(f"preview: {len(part)} bytes, expected a JPEG of at most {JPEG_MAX}")
        self.frames.put(camera, index, part)
        message = wire.picture(camera, label, index, z_mm, published, part)
        self.hub.newest(("picture", camera, label), "pictures", message)

    def _rows(self, body: Any, part: bytes) -> None:
        camera, label, index, _ = _header(body, "rows")
        if len(part) % 4 or len(part) > 4096:
            raise ValueError(f"rows: {len(part)} bytes, expected float32")
        self.hub.newest(("rows", camera, label), "rows", wire.rows(camera, label, index, part))
        levels = light(camera, str(body.get("label")), index, part)
        self.hub.newest(("light", camera, label), "rows", wire.status("light", levels))

    def _slits(self, body: Any, part: bytes) -> None:
        camera, _, index, _ = _header(body, "slits")
        if len(part) % 5 or len(part) > 5 * 65535:
            raise ValueError(f"slits: {len(part)} bytes, expected five a point")
        self.hub.newest(("slits", camera), "slits", wire.slits(camera, index, part))

    def _wall(self, body: Any, part: bytes) -> None:
        wall = WallPart.parse(body, part)
        self._of_scan(wall.scan)
        self.nominal_radius_mm = wall.radius_mm
        self._walls[wall.of].put(wall)
        self.hub.send("wall", wall.message())

    def _profile(self, body: Any, part: bytes) -> None:
        content = untrusted.mapping(body, "profile")
        frame = untrusted.whole(content.get("frame"), "profile: frame", 0, 2**63 - 1)
        data = content.get("points", b"")
        if not isinstance(data, bytes) or len(data) % 12 or len(data) > 12 * POINTS_MAX:
            raise ValueError("profile: points must be three float32 each")
        xyz = np.frombuffer(data, "<f4").reshape(-1, 3)
        if not np.isfinite(xyz).all():
            raise ValueError("profile: points must be finite")
        if len(xyz):
            rgb = self._coloured(xyz)
            self._cloud.add(xyz, rgb)
            self.hub.send("points", wire.points(0, frame, xyz, rgb))

    def _coloured(self, xyz: NDArray[np.float32]) -> NDArray[np.uint8]:
        """(N, 3) by how far each point's radius is from the nominal, or from the usual one where that is not known."""
        radius = np.hypot(xyz[:, 0], xyz[:, 1])
        if self.nominal_radius_mm is None:
            self.nominal_radius_mm = float(np.median(radius))
        at = (radius - np.float32(self.nominal_radius_mm)) * np.float32(127.5 / DEVIATION_LIVE_MM) + np.float32(128.0)
        return np.asarray(self._table[np.clip(at, 0, 255).astype(np.uint8)])

    def _closeup(self, body: Any, part: bytes) -> None:
        closeup = CloseUp.parse(body, part)
        key = closeup.numbers["scan"], closeup.numbers["id"]
        self.closeups.put(key, closeup, closeup.size)

    def _defects(self, content: Mapping[str, Any]) -> None:
        self.defects = content
        found = content.get("defects")
        for one in found if isinstance(found, list) else ():
            frames = one.get("frames") if isinstance(one, Mapping) else None
            if isinstance(frames, list):
                self.frames.keep(
                    [index for index in frames if isinstance(index, int)], range(max(1, len(self.cameras)))
                )


def _header(body: Any, what: str) -> tuple[int, int, int, Mapping[str, Any]]:
    """camera, label, index, all of it."""
    header = untrusted.mapping(body, what)
    return (
        untrusted.whole(header.get("camera", 0), f"{what}: camera", 0, CAMERAS_MAX - 1),
        wire.LABELS.get(str(header.get("label")), 0),
        untrusted.whole(header.get("index"), f"{what}: index", 0, 2**32 - 1),
        header,
    )
