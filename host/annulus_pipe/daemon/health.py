"""One word for a head that nobody watches: `ok`, `degraded: why`, `failed: why`, from everything that is counted.

    failed      what is being done is not being done: a fault, a camera that is gone, a recording that does not grow
    degraded    it is being done, but not all of it: losses, unknown frames, a disk that fills, a sensor fallen silent
    ok          neither, over the last WINDOW_S

What was lost in the last WINDOW_S counts, so that the word comes back by itself. What is merely not reconstructed live
(it is recorded) and what strangers send (it is refused) is counted, and no matter of health.
"""

import json
import os
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

WINDOW_S = 10.0
UNKNOWN_SHARE = 0.1  # of the frames of the window; a soak of every fault at once stays below 0.025
FRAMES_LEAST = 50  # in the window, before a share says anything
DISK_MINUTES = 10.0
HARMLESS = frozenset(
    {
        "worker_busy",
        "publisher_busy",
        "worker_late",
        "surveyor_notes",
        "control_malformed",
        "sensor_malformed",
        "sensor_fault",
    }
)
WHY_MAX = 3  # reasons in one line


class Word(StrEnum):
    OK = "ok"
    DEGRADED = "degraded"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class HeadHealth:
    word: Word
    why: str = ""
    restart_helps: bool = False  # whether a fresh process could mend what failed

    def __str__(self) -> str:
        return f"{self.word}: {self.why}" if self.why else self.word.value

    def to_dict(self) -> dict[str, str]:
        return {"health": self.word.value, "why": self.why}


@dataclass(frozen=True, slots=True)
class _LastSeen:
    at_s: float
    frames: int
    unknown: int
    recorded: int
    lost: Mapping[str, int]


class HealthWatch:
    """Sans-I/O: told the telemetry about once a second, says the word."""

    def __init__(self, records: bool = True) -> None:
        """`records`: whether scans are to be recorded."""
        self._records = records
        self._seen: deque[_LastSeen] = deque()

    def judge(self, telemetry: Mapping[str, Any], why_fault: str, now_s: float) -> HeadHealth:
        """`telemetry` as Session.telemetry gives it; why_fault: of a head in fault."""
        frames: Mapping[str, int] = telemetry["frames"]
        seen = _LastSeen(
            now_s, sum(frames.values()), frames.get("unknown", 0), telemetry["recorded"], telemetry["drops"]
        )
        if self._seen and seen.frames < self._seen[-1].frames:
            self._seen.clear()  # a new scan has a new account
        self._seen.append(seen)
        while len(self._seen) > 1 and self._seen[1].at_s <= now_s - WINDOW_S:
            self._seen.popleft()  # the first one left is as old as the window, or the oldest there is
        failed, helps = self._failures(telemetry, why_fault, self._seen[0], seen)
        if failed:
            return HeadHealth(Word.FAILED, _line(failed), helps)
        degraded = self._troubles(telemetry, self._seen[0], seen)
        return HeadHealth(Word.DEGRADED, _line(degraded)) if degraded else HeadHealth(Word.OK)

    def _failures(
        self, telemetry: Mapping[str, Any], why_fault: str, then: _LastSeen, now: _LastSeen
    ) -> tuple[list[str], bool]:
        found = []
        if telemetry["state"] == "fault":
            found.append(why_fault or "the head is in fault")
        helps = False
        tried = telemetry.get("trial") is not None
        scanning = self._records and not tried and telemetry["state"] in ("armed", "scanning", "fault")
        grows = now.frames == then.frames or now.recorded > then.recorded
        if scanning and not grows and now.at_s - then.at_s >= WINDOW_S:
            found.append(f"{now.frames - then.frames} frames in {now.at_s - then.at_s:.0f} s and none recorded")
            helps = True
        return found, helps and len(found) == 1

    def _troubles(self, telemetry: Mapping[str, Any], then: _LastSeen, now: _LastSeen) -> list[str]:
        new = {kind: count - then.lost.get(kind, 0) for kind, count in now.lost.items() if kind not in HARMLESS}
        found = [f"{count} {kind}" for kind, count in sorted(new.items(), key=lambda one: -one[1]) if count > 0]
        frames, unknown = now.frames - then.frames, now.unknown - then.unknown
        if frames >= FRAMES_LEAST and unknown > UNKNOWN_SHARE * frames:
            found.append(f"{unknown} of {frames} frames unknown")
        disk = telemetry.get("disk") or {}
        left = disk.get("minutes_left")
        if left is not None and left < DISK_MINUTES:
            found.append(f"disk: {left:.0f} min left")
        if disk.get("refuses"):
            found.append(f"no scan can begin: {disk['refuses']}")
        elif disk.get("hangs"):
            found.append("disk: does not say what is free")
        return found


def _line(reasons: list[str]) -> str:
    more = len(reasons) - WHY_MAX
    return "; ".join(reasons[:WHY_MAX]) + (f"; {more} more" if more > 0 else "")


def health_path(record_folder: Path | None) -> Path | None:
    """Where the word is written for other programs: beside the recordings, or in the user's runtime folder."""
    if record_folder is not None:
        return record_folder / "health.json"
    runtime = os.environ.get("RUNTIME_DIRECTORY", os.environ.get("XDG_RUNTIME_DIR", ""))
    return Path(runtime) / "annulus-health.json" if runtime else None


class HealthFile:
    """The word as a file, replaced as a whole about once a second; older than 10 s, nobody is alive who writes it.

    It is written by a thread of its own, always the latest: a disk that hangs holds up nobody but this file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._latest: bytes | None = None
        self._news = threading.Condition()
        self._done = False
        self.problem = ""  # why it could not be written last, one line
        self._thread = threading.Thread(target=self._work, name="health file", daemon=True)
        self._thread.start()

    def write(self, health: HeadHealth, state: str, disk: Mapping[str, Any]) -> None:
        """Never waits."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        body = {**health.to_dict(), "state": state, "utc": now, "pid": os.getpid(), "disk": dict(disk)}
        with self._news:
            self._latest = json.dumps(body).encode() + b"\n"
            self._news.notify()

    def close(self, patience_s: float = 1.0) -> None:
        """What was said last is written, if the disk is quick."""
        with self._news:
            self._done = True
            self._news.notify()
        self._thread.join(patience_s)

    def _work(self) -> None:
        while True:
            with self._news:
                while self._latest is None and not self._done:
                    self._news.wait()
                latest, self._latest = self._latest, None
            if latest is None:
                return
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
                fresh.write_bytes(latest)
                fresh.replace(self._path)
                self.problem = ""
            except OSError as error:
                self.problem = f"{self._path}: cannot be written ({error.strerror})"
