"""Who is still there: finds every process that a test started, however it was started."""

import os
import time
import uuid
from pathlib import Path

import pytest

MARK = "ANNULUS_TEST_MARK"


class Traces:
    """Takes note of what is there before, and says what is left afterwards."""

    def __init__(self) -> None:
        self.mark = uuid.uuid4().hex
        self.environment = {**os.environ, MARK: self.mark}
        self._shm, self._tmp = _shared(), _temporary()

    def processes(self) -> list[str]:
        """Command lines of processes that carry the mark and are not this one."""
        wanted, found = f"{MARK}={self.mark}".encode(), []
        for folder in Path("/proc").iterdir():
            if folder.name.isdigit() and int(folder.name) != os.getpid():
                try:
                    if wanted in (folder / "environ").read_bytes():
                        found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode())
                except OSError:
                    continue  # ended, or not ours
        return found

    def left(self, patience_s: float = 5.0) -> dict[str, object]:
        """What is left, after a moment for the kernel to bury the dead. Empty when all is clean."""
        end = time.monotonic() + patience_s
        while (processes := self.processes()) and time.monotonic() < end:
            time.sleep(0.05)
        left = {
            "processes": processes,
            "shm": _shared() - self._shm,
            "temporary": _temporary() - self._tmp,
        }
        return {what: which for what, which in left.items() if which}


def _shared() -> set[str]:
    """Semaphores of multiprocessing come and go with other programs on the machine; annulus makes none while it scans."""
    return {name for name in os.listdir("/dev/shm") if not name.startswith("sem.mp-")}


def _temporary() -> set[str]:
    return {name for name in os.listdir("/tmp") if name.startswith("annulus-")}


@pytest.fixture
def traces() -> Traces:
    return Traces()
