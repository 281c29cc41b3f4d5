"""Who is still there: finds every process that a test started, however it was started."""

import os
import tempfile
import time
import uuid
from collections.abc import Iterator, Set
from pathlib import Path

MARK = "ANNULUS_TEST_MARK"


class Traces:
    """Takes note of what is there before, and says what is left afterwards."""

    def __init__(self) -> None:
        self.mark = uuid.uuid4().hex
        self.temporary = Path(tempfile.mkdtemp(prefix="traces-"))
        self.environment = {**os.environ, MARK: self.mark, "TMPDIR": str(self.temporary)}
        self._shm = set(os.listdir("/dev/shm"))

    def processes(self) -> list[str]:
        """Command lines of processes that carry the mark and are not this one."""
        wanted, found = f"{MARK}={self.mark}".encode(), []
        for folder in other_processes():
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
        left = {"processes": processes, "shm": left_in_shm(self._shm), "temporary": set(os.listdir(self.temporary))}
        return {what: which for what, which in left.items() if which}


def left_in_shm(before: Set[str]) -> set[str]:
    """Segments that were not there before and that no other process has: those of other programs come and go, and so
    do multiprocessing's semaphores, of which a scan makes none.
    """
    new = {name for name in os.listdir("/dev/shm") if not name.startswith("sem.mp-")} - before
    for folder in other_processes() if new else ():
        try:
            maps = (folder / "maps").read_text()
        except OSError:
            continue
        new = {name for name in new if f"/dev/shm/{name}\n" not in maps}
    return new


def other_processes() -> Iterator[Path]:
    """Their folders in /proc."""
    return (folder for folder in Path("/proc").iterdir() if folder.name.isdigit() and int(folder.name) != os.getpid())
