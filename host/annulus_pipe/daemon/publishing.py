"""What is observed, to viewers, by way of a process that strangers may talk to: one topic for each method of an
Observer.
"""

import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

from annulus_pipe.daemon.account import Account, ScanReport
from annulus_pipe.daemon.config import SocketConfig
from annulus_pipe.daemon.health import HeadHealth
from annulus_pipe.daemon.observer import Mark, Observer
from annulus_pipe.daemon.pools import Pool
from annulus_pipe.daemon.state import State
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.job import JobSheet
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.orphan import child
from annulus_pipe.stream.ring import RingSlot
from annulus_pipe.stream.workers import Shared, WorkerKind
from annulus_pipe.wall.profile import Profile

PUBLISHER_SHARE = 2  # slots; viewers can miss frames


class Publishing(Pool, Observer):
    """Topics and bodies are listed in README.md. They are numbered here: what a viewer missed shows, wherever it was
    lost.
    """

    def __init__(
        self,
        config: SocketConfig,
        shared: Shared,
        account: Account,
        observer: Observer,
        realtime: bool | None = False,
        calibration: Calibration | None = None,
    ) -> None:
        """`realtime` as head.toml says; `calibration` of the head, where slits are decoded live."""
        keys = config.keys
        plain = (
            None if keys is None else {"public": keys.public, "secret": keys.secret, "viewers": sorted(keys.viewers)}
        )
        self._setup: dict[str, Any] = {"address": config.address, "keys": plain, "realtime": realtime}
        self._setup["calibration"] = None if calibration is None else calibration.to_dict()
        self._setup["scan"] = None  # under way, for one that takes over
        self._sent: Counter[str] = Counter()
        self._notes_dropped = 0
        self._was_up = False  # before, nobody could listen: what is said then is lost to nobody
        command = child("annulus_pipe.daemon.publisher")
        kind = WorkerKind("publisher", command, self._setup, 1, PUBLISHER_SHARE, spares=1)
        super().__init__(kind, shared, account, observer)

    @property
    def address(self) -> str:
        """Where viewers connect: known once it is ready."""
        return str(self._setup["address"])

    def label(self, header: FrameHeader) -> None:
        """A frame's label, which needs no slot."""
        self._send("label", header.to_dict())

    def offer(self, header: FrameHeader, place: RingSlot) -> None:
        """A labelled frame; no viewer has it, and that is counted, when there is no room."""
        if not self._pool.offer(header, place, self._number(f"frame/{header.camera}")):
            self._account.lose("publisher_busy")

    def begun(self, scan: int) -> None:
        self._setup["scan"] = scan
        self._send("begun", {"scan": scan})

    def state(self, state: State, why: str) -> None:
        self._send("state", {"state": state.value, "why": why})

    def event(self, kind: str, text: str) -> None:
        self._send("event", {"kind": kind, "text": text, "utc_s": time.time()})

    def profile(self, profile: Profile) -> None:
        self._send("profile", profile.to_dict())

    def sample(self, sample: Sample) -> None:
        self._send(f"sensor/{sample.sensor}", sample.to_dict())

    def mark(self, mark: Mark) -> None:
        self._send("mark", {**mark.to_dict(), "utc_s": time.time()})

    def job(self, sheet: JobSheet) -> None:
        self._send("job", sheet.to_dict())

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        self._send("telemetry", numbers)

    def health(self, health: HeadHealth) -> None:
        self._send("health", health.to_dict())

    def ended(self, report: ScanReport) -> None:
        self._setup["scan"] = None
        recordings = [str(path) for path in report.recordings]
        self._send("ended", {"seconds": report.seconds, "recordings": recordings, "utc_s": time.time()})

    def made(self, topic: str, body: Mapping[str, Any], part: bytes = b"") -> None:
        """What another process made of the scan: the surveyor's topics."""
        self._send(topic, body, part)

    def _send(self, topic: str, body: Mapping[str, Any], part: bytes = b"") -> None:
        if not self._was_up:
            return
        number = self._number(topic)
        if not self._pool.alive:
            self._account.lose("publisher_notes")
            return
        self._pool.tell(topic, [number, dict(body), part])
        dropped = self._pool.counts["notes_dropped"]
        self._account.lose("publisher_notes", dropped - self._notes_dropped)
        self._notes_dropped = dropped

    def _number(self, topic: str) -> int:
        self._sent[topic] += 1
        return self._sent[topic] - 1

    def _came_up(self) -> None:
        self._was_up = True
        super()._came_up()

    def _done(self, header: FrameHeader, body: Any) -> None:
        pass

    def _reported(self, worker: int, body: list[Any]) -> None:
        self._setup["address"], floods = body  # one that takes over binds where this one did
        if floods:
            text = "a viewer asked for more topics than there are; all viewers were disconnected, and may come again"
            self._observer.event("publisher_flooded", text)
