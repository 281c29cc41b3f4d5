"""How the head is, looked at once a second: the disk's forecast and the one word, told to whoever listens."""

import time
from collections.abc import Mapping
from typing import Any

from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.disk import MB, Asker, DiskState, Forecast, require_room, short_of
from annulus_pipe.daemon.health import HeadHealth, HealthFile, HealthWatch, Word, health_path
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.priority import share_priority
from annulus_pipe.record.codec import SHARE
from annulus_pipe.vocabulary import AnnulusError

RESERVE_S = 3.0  # of frames at least: what is in hand when a scan ends must still find room
FIRST_ANSWER_S = 1.0  # a disk that does not say what is free by then is none to record on


class Turns:
    """How long the loop's turns take, sleep apart: who is in its hands waits so long at worst."""

    def __init__(self) -> None:
        self._since = self._ever = 0.0  # s

    def took(self, seconds: float) -> None:
        if seconds > self._since:
            self._since = seconds
            self._ever = max(self._ever, seconds)

    def restart(self) -> None:
        """What has been is told."""
        self._since = 0.0

    def numbers(self) -> dict[str, float]:
        """For the telemetry: the longest since it was last told, and ever."""
        return {"turn_ms": round(1e3 * self._since, 2), "turn_ms_longest": round(1e3 * self._ever, 2)}


class Vitals:
    """Of one session, scan or no scan."""

    def __init__(self, config: HeadConfig, bytes_per_s: float, observer: Observer) -> None:
        """`bytes_per_s`: what the cameras send."""
        self._folder, self._limits, self._observer = config.record_folder, config.record, observer
        self._rate = bytes_per_s * SHARE[config.record.codec]
        self._forecast = Forecast(max(config.record.reserve_mb * MB, RESERVE_S * bytes_per_s))
        self._watch = HealthWatch(records=config.record_folder is not None)
        self._asker = None if config.record_folder is None else Asker(config.record_folder)
        self._disk = DiskState()
        self.health = HeadHealth(Word.OK)  # as of the last look
        path = health_path(config.record_folder)
        self._file = None if path is None else HealthFile(path)
        self._reported = self._refuses = ""

    def require_space(self) -> None:
        """Before a scan. Raises AnnulusError, one line, when it must not begin."""
        if self._folder is not None and self._asker is not None:
            free = self._asker.free(FIRST_ANSWER_S)
            require_room(self._folder, self._limits, self._rate, free)
            if short := short_of(self._folder, self._limits, self._rate, free):
                self._observer.event("disk", short)
            self._forecast.restart()

    def numbers(self) -> dict[str, Any]:
        """Of the disk, for the telemetry."""
        if self._asker is None:
            return {}
        return {**self._disk.numbers(), "hangs": self._asker.hangs, "refuses": self._refuses}

    def _refusal(self, free: int | None) -> str:
        """Why a scan would not begin now, as `require_space` would say; empty where it would."""
        assert self._asker is not None and self._folder is not None
        if free is None or self._asker.problem:
            return self._asker.problem
        try:
            require_room(self._folder, self._limits, self._rate, free)
        except AnnulusError as error:
            return str(error)
        return ""

    def look(self, telemetry: Mapping[str, Any], why_fault: str, scanning: bool) -> str:
        """Once a second. Returns why the scan under way must end, one line; empty when it need not."""
        now = time.monotonic()
        share_priority()
        self.health = health = self._watch.judge(telemetry, why_fault, now)
        self._observer.health(health)
        if self._file is not None:
            self._file.write(health, telemetry["state"], telemetry["disk"])
            if self._file.problem != self._reported:
                self._reported = self._file.problem
                if self._reported:
                    self._observer.event("health", self._reported)
        free = self._asker.latest() if self._asker is not None else None
        self._refuses = "" if scanning or self._asker is None else self._refusal(free)
        if free is None:
            self._disk = DiskState()
            return ""
        self._disk = self._forecast.look(free, now, self._rate if scanning else 0.0)
        if not scanning:
            return ""
        if news := self._forecast.news(self._disk):
            self._observer.event("disk", news)
        if self._forecast.is_full(self._disk):
            return f"{self._folder}: only {free / MB:.0f} MB free: the scan is ended while its recording can be closed"
        return ""

    def close(self) -> None:
        if self._asker is not None:
            self._asker.close()
        if self._file is not None:
            self._file.close()
