"""How long the disk lasts: what is free, how fast it goes, and when a recording must not begin or go on.

The rate is what free space really lost over the last half minute, whoever wrote it; before that is known, what the
cameras will send. Free space is asked for in a thread of its own, once a second: a disk that hangs hangs nobody else.
"""

import errno
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from annulus_pipe.daemon.config import RecordConfig
from annulus_pipe.vocabulary import AnnulusError

GB, MB = 1e9, 1e6
WINDOW_S = 30.0
TRUST_S = 10.0  # a rate measured over less is not believed
ASK_S = 1.0
FRESH_S = 0.1  # a disk that works has said what is free by then
MINUTES = (60, 30, 10, 5, 2)  # left: told once each, as the forecast falls below
HANGS_S = 10.0  # without an answer about free space


class DiskSpace(Protocol):
    """As much of os.statvfs's answer as counts."""

    @property
    def f_bavail(self) -> int: ...

    @property
    def f_frsize(self) -> int: ...


StatVfs = Callable[[str], DiskSpace]


@dataclass(frozen=True, slots=True)
class DiskState:
    """`free_bytes` is None while nobody could say, `minutes_left` also while nothing is being written."""

    free_bytes: int | None = None
    bytes_per_s: float = 0.0
    minutes_left: float | None = None

    def __str__(self) -> str:
        if self.free_bytes is None:
            return "free space not known"
        free = f"{self.free_bytes / GB:.1f} GB free"
        if self.minutes_left is None:
            return free
        return f"{free}, {self.minutes_left:.0f} min left at {self.bytes_per_s / MB:.0f} MB/s"

    def numbers(self) -> dict[str, float | None]:
        """For the telemetry."""
        return {
            "free_gb": None if self.free_bytes is None else round(self.free_bytes / GB, 3),
            "mb_per_s": round(self.bytes_per_s / MB, 2),
            "minutes_left": None if self.minutes_left is None else round(self.minutes_left, 1),
        }


def free_bytes(folder: Path, statvfs: StatVfs = os.statvfs) -> int:
    """Of the disk that the folder is on, or will be. Raises OSError."""
    space = statvfs(str(_there(folder)))
    return space.f_bavail * space.f_frsize


def require_writable(folder: Path) -> None:
    """Raises OSError where nothing can be written into it, or it cannot be made: a disk mounted read-only above all."""
    there = _there(folder)
    if not there.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    if not os.access(there, os.W_OK | os.X_OK):
        read_only = bool(os.statvfs(there).f_flag & os.ST_RDONLY)
        number = errno.EROFS if read_only else errno.EACCES
        raise OSError(number, os.strerror(number))


def _there(folder: Path) -> Path:
    """The folder, or its nearest parent that exists."""
    there = folder.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    return there


def require_space(folder: Path, limits: RecordConfig, expected_rate: float, statvfs: StatVfs = os.statvfs) -> None:
    """Raises AnnulusError, one line, when a scan must not begin there. `expected_rate`: bytes a second."""
    try:
        free = free_bytes(folder, statvfs)
    except OSError as error:
        raise AnnulusError(_refused(folder, error)) from None
    require_room(folder, limits, expected_rate, free)


def require_room(folder: Path, limits: RecordConfig, expected_rate: float, free: int) -> None:
    """The same, where it is known what is free."""
    if free < limits.min_free_gb * GB:
        raise AnnulusError(
            f"{folder}: {free / GB:.1f} GB free, expected at least {limits.min_free_gb:g} GB ([record] min_free_gb)"
        )
    room = max(0.0, free - limits.reserve_mb * MB)
    if expected_rate > 0 and room < limits.min_free_minutes * 60 * expected_rate:
        raise AnnulusError(
            f"{folder}: room for {room / expected_rate / 60:.0f} min at {expected_rate / MB:.0f} MB/s, expected at "
            f"least {limits.min_free_minutes:g} min ([record] min_free_minutes)"
        )


def short_of(folder: Path, limits: RecordConfig, expected_rate: float, free: int) -> str:
    """What to warn of before a scan that may begin: one line where it is expected to take longer than the disk lasts;
    empty where it is not.
    """
    room = max(0.0, free - limits.reserve_mb * MB)
    if expected_rate <= 0 or room >= limits.expect_minutes * 60 * expected_rate:
        return ""
    return (
        f"{folder}: room for {room / expected_rate / 60:.0f} min at {expected_rate / MB:.0f} MB/s, the scan is to "
        f"take {limits.expect_minutes:g} min: make room, or it ends before the pipe does"
    )


class Forecast:
    """Sans-I/O: told what is free, says what is left."""

    def __init__(self, reserve_bytes: float = 0.0) -> None:
        self._reserve = reserve_bytes
        self._seen: deque[tuple[float, int]] = deque()
        self._below = float("inf")  # the last threshold told

    def restart(self) -> None:
        """A scan begins: the rate measured before it is forgotten."""
        self._seen.clear()
        self._below = float("inf")

    def look(self, free: int, now_s: float, expected_rate: float = 0.0) -> DiskState:
        """`expected_rate`, bytes a second, is believed until a rate was measured."""
        self._seen.append((now_s, free))
        while self._seen[0][0] < now_s - WINDOW_S:
            self._seen.popleft()
        since, then = self._seen[0]
        rate = (then - free) / (now_s - since) if now_s - since >= TRUST_S else expected_rate
        if rate <= 0.0:
            return DiskState(free)
        return DiskState(free, rate, max(0.0, free - self._reserve) / rate / 60.0)

    def news(self, state: DiskState) -> str:
        """A line when fewer minutes are left than one of MINUTES, once for each; empty otherwise."""
        left = state.minutes_left
        if left is None:
            return ""
        below = min((minutes for minutes in MINUTES if left < minutes), default=float("inf"))
        if left > 1.5 * self._below:  # somebody made room: tell anew
            self._below = below
        if below >= self._below:
            return ""
        self._below = below
        return f"disk: {state}"

    def is_full(self, state: DiskState) -> bool:
        """Whether only the reserve is left."""
        return state.free_bytes is not None and state.free_bytes <= self._reserve


def _refused(folder: Path, error: OSError) -> str:
    return f"{folder}: {error.strerror}. Choose another folder for recordings."


class Asker:
    """Asks for free space every second, in a thread of its own."""

    def __init__(self, folder: Path, statvfs: StatVfs = os.statvfs) -> None:
        self._folder, self._statvfs = folder, statvfs
        self._done = False
        self._wake = threading.Event()  # somebody wants to know now
        self._turn = threading.Condition()
        self._wanted = self._served = 0  # times that somebody wanted to know, and did
        self._answer: tuple[float, int] | None = None
        self._problem = ""
        self._began_s = time.monotonic()
        threading.Thread(target=self._ask, name="free space", daemon=True).start()

    def latest(self) -> int | None:
        """None before the first answer, and when there was none for HANGS_S."""
        answer = self._answer
        return None if answer is None or time.monotonic() - answer[0] > HANGS_S else answer[1]

    def free(self, patience_s: float) -> int:
        """As it is now, room made a moment ago included; as of the last answer where none comes within FRESH_S.

        Only the first answer is waited for. Raises AnnulusError, one line, when none came.
        """
        with self._turn:
            self._wanted += 1
            wanted = self._wanted
            self._wake.set()
            patience_s = patience_s if self._answer is None else min(FRESH_S, patience_s)
            self._turn.wait_for(lambda: self._served >= wanted, patience_s)
        free = self.latest()
        if self._problem:
            raise AnnulusError(self._problem)
        if free is None:
            raise AnnulusError(
                f"{self._folder}: does not say what is free, expected an answer. Is the disk still there?"
            )
        return free

    @property
    def hangs(self) -> bool:
        """Whether nobody has answered for HANGS_S."""
        return time.monotonic() - (self._answer or (self._began_s,))[0] > HANGS_S

    @property
    def problem(self) -> str:
        """Why nothing could be recorded there, as of the last answer; empty where it could, or nobody has answered."""
        if self.hangs:
            return f"{self._folder}: does not say what is free. Is the disk still there?"
        return self._problem

    def close(self) -> None:
        self._done = True
        self._wake.set()

    def _read_only(self) -> str:
        """Why nothing can be written there; empty where something can."""
        try:
            require_writable(self._folder)
        except OSError as error:
            return _refused(self._folder, error)
        return ""

    def _ask(self) -> None:
        while not self._done:
            with self._turn:
                self._wake.clear()
                serves = self._wanted  # who wants to know later is not served by this answer
            try:
                free = free_bytes(self._folder, self._statvfs)
                self._problem = self._read_only()  # first: who has the answer has this, too
                self._answer = time.monotonic(), free
            except OSError as error:  # the last answer grows old
                self._problem = _refused(self._folder, error)
            with self._turn:
                self._served = serves
                self._turn.notify_all()
            self._wake.wait(ASK_S)
