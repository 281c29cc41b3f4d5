"""The log of a head that nobody watches: what happens, one line each, in a file whose size is bounded.

    2026-03-04T09:15:02.113Z WARNING link /dev/ttyACM0: the line went away (Input/output error), expected the controller

Lines are written by a thread of their own; when the disk is slower than the news, lines are dropped and counted.
"""

import contextlib
import logging
import logging.handlers
import queue
import threading
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from annulus_pipe.daemon.account import ScanReport
from annulus_pipe.daemon.config import LogConfig
from annulus_pipe.daemon.health import HeadHealth, Word
from annulus_pipe.daemon.observer import Commanded, Observer
from annulus_pipe.daemon.state import State
from annulus_pipe.vocabulary import AnnulusError

WAITING_MAX = 1000  # lines
TELEMETRY_S = 60.0
LEVELS: Mapping[str, int] = {  # of events; others are INFO
    **dict.fromkeys(("fault", "link", "reset", "sync", "sensor", "disk", "events_lost", "camera"), logging.WARNING),
    **dict.fromkeys(("lamps", "scan", "ending", "recorder_died", "worker_died", "recorder_failed"), logging.ERROR),
}
_HEALTH = {Word.OK: logging.INFO, Word.DEGRADED: logging.WARNING, Word.FAILED: logging.ERROR}


class LogFile(Observer):
    """One who listens, and writes."""

    def __init__(self, config: LogConfig) -> None:
        """Raises AnnulusError when the file cannot be opened."""
        try:
            config.file.parent.mkdir(parents=True, exist_ok=True)
            self._file = _LogFile(
                config.file, maxBytes=round(config.max_mb * 1e6), backupCount=config.keep, encoding="utf-8"
            )
        except OSError as error:
            raise AnnulusError(f"{config.file}: the log cannot be written ({error.strerror})") from None
        self._file.setFormatter(_Lines())
        self.dropped = 0  # lines that found no room
        self._waiting: queue.Queue[logging.LogRecord | None] = queue.Queue(WAITING_MAX)
        self._writer = threading.Thread(target=self._write, name="log", daemon=True)
        self._writer.start()
        self._word: tuple[Word, str] = Word.OK, ""
        self._next_telemetry_s = 0.0

    def say(self, level: int, kind: str, text: str) -> None:
        """One line. Never waits."""
        if self.dropped and self._waiting.qsize() < WAITING_MAX // 2:
            dropped, self.dropped = self.dropped, 0
            self.say(logging.WARNING, "log", f"{dropped} lines before this one found no room")
        record = logging.LogRecord("annulus", level, "", 0, " ".join(text.split()), None, None)
        record.kind = kind
        try:
            self._waiting.put_nowait(record)
        except queue.Full:
            self.dropped += 1

    def state(self, state: State, why: str) -> None:
        level = logging.WARNING if state is State.FAULT else logging.INFO
        self.say(level, "state", f"{state}: {why}" if why else state.value)

    def event(self, kind: str, text: str) -> None:
        self.say(LEVELS.get(kind, logging.INFO), kind, text)

    def commanded(self, what: Commanded) -> None:
        self.say(logging.INFO, "asked", str(what))

    def health(self, health: HeadHealth) -> None:
        if health.word is not self._word[0]:
            self.say(_HEALTH[health.word], "health", str(health))
        self._word = health.word, health.why

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        if (now := time.monotonic()) >= self._next_telemetry_s:
            self._next_telemetry_s = now + TELEMETRY_S
            frames = ", ".join(f"{count} {label}" for label, count in numbers["frames"].items())
            drops = ", ".join(f"{count} {kind}" for kind, count in numbers["drops"].items()) or "nothing"
            self.say(logging.INFO, "telemetry", f"{numbers['state']}: {frames}; lost: {drops}")

    def ended(self, report: ScanReport) -> None:
        where = ", ".join(str(path) for path in report.recordings) or "not recorded"
        self.say(logging.INFO, "ended", f"{report.seconds:.1f} s: {where}")

    def close(self, patience_s: float = 2.0) -> None:
        """What waits is written, if the disk is quick."""
        with contextlib.suppress(queue.Full):
            self._waiting.put(None, timeout=patience_s)
            self._writer.join(patience_s)

    def _write(self) -> None:
        while (record := self._waiting.get()) is not None:
            self._file.handle(record)
            if self._file.failed:
                self._file.failed = False
                self.dropped += 1
        self._file.close()


class _LogFile(logging.handlers.RotatingFileHandler):
    failed = False  # the last line could not be written

    def handleError(self, record: logging.LogRecord) -> None:
        self.failed = True


class _Lines(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        at = datetime.fromtimestamp(record.created, UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]
        return f"{at}Z {record.levelname} {getattr(record, 'kind', '-')} {record.getMessage()}"
