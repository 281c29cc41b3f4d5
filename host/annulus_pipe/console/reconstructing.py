"""`annulus reconstruct`, again, as a child: one at a time, a few that wait, each of which can be given up.

The child works beside the head's daemon, so it gives way to everything (nice), writes into a folder that nobody sees
until it is whole, and does not outlive this program.
"""

import asyncio
import contextlib
import glob
import os
import shutil
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from annulus_pipe import untrusted
from annulus_pipe.vocabulary import AnnulusError

WAITING_MAX = 4
ENDED_MAX = 20  # that are still told of
TELL_S = 0.25
END_S = 5.0  # that a child has to end by itself
NICE = 10
LINE_MAX = 4096  # bytes
PLACES_MAX = 99

# a child that hears SIGTERM when this process is gone, however it went
_RUN = (
    "import os, signal; from annulus_pipe.stream.orphan import end_with_parent; os.nice({nice}); "
    "end_with_parent({parent}, signal.SIGTERM); from annulus_pipe.cli import main; main()"
)


@dataclass(slots=True, eq=False)
class ConsoleJob:
    """One reconstruction. `state`: waiting, running, done, failed, cancelled."""

    id: str
    scan: Path
    calibration: Path | None
    state: str = "waiting"
    what: str = ""  # is being done
    done: int = 0
    total: int = 0
    error: str = ""
    place: Path | None = None  # of what came out
    began_s: float | None = None  # monotonic, as all below
    step_s: float = 0.0
    ended_s: float | None = None
    cancelled: asyncio.Event = field(default_factory=asyncio.Event)

    def to_dict(self) -> dict[str, Any]:
        """Plain. `left_s`: of this step, from how fast it went so far; None where that cannot be said yet."""
        now = time.monotonic() if self.ended_s is None else self.ended_s
        left = None
        if self.state == "running" and 0 < self.done < self.total and now - self.step_s > 1.0:
            left = round((now - self.step_s) * (self.total - self.done) / self.done, 1)
        return {
            "id": self.id,
            "scan": untrusted.printable(self.scan.name),
            "state": self.state,
            "what": self.what,
            "calibration": None if self.calibration is None else untrusted.printable(self.calibration.name),
            "done": self.done,
            "total": self.total,
            "error": self.error,
            "place": None if self.place is None else untrusted.printable(self.place.name),
            "seconds": None if self.began_s is None else round(now - self.began_s, 1),
            "left_s": left,
        }


class Reconstructing:
    """The queue. `tell` is called with all of it whenever something changed."""

    def __init__(self, tell: Callable[[list[dict[str, Any]]], None], command: Sequence[str] | None = None) -> None:
        """command : in place of annulus itself; what it is to do comes after."""
        self._tell = tell
        self._command = command or (sys.executable, "-c", _RUN.format(nice=NICE, parent=os.getpid()))
        self._jobs: deque[ConsoleJob] = deque()
        self._count = 0
        self._told_s = 0.0
        self._wake = asyncio.Event()

    def jobs(self) -> list[dict[str, Any]]:
        return [job.to_dict() for job in self._jobs]

    def ask(self, scan: Path, calibration: Path | None) -> ConsoleJob:
        """Raises AnnulusError when too many wait."""
        if sum(job.state == "waiting" for job in self._jobs) >= WAITING_MAX:
            raise AnnulusError(f"{WAITING_MAX} reconstructions wait, expected fewer: cancel one or let them end")
        self._count += 1
        job = ConsoleJob(f"r{self._count}", scan, calibration)
        self._jobs.append(job)
        while len(self._jobs) > ENDED_MAX and self._jobs[0].ended_s is not None:
            self._jobs.popleft()
        self._wake.set()
        self._say(now=True)
        return job

    def cancel(self, number: str) -> None:
        """What it wrote is gone. Raises AnnulusError when there is none that could be given up."""
        job = next((one for one in self._jobs if one.id == number), None)
        if job is None or job.state not in ("waiting", "running"):
            raise AnnulusError("that reconstruction is over, or never was: there is nothing to cancel")
        job.cancelled.set()
        if job.state == "waiting":
            self._end(job, "cancelled")

    async def run(self) -> None:
        """One after the other, until cancelled."""
        while True:
            job = next((one for one in self._jobs if one.state == "waiting"), None)
            if job is None:
                self._wake.clear()
                await self._wake.wait()
                continue
            job.state, job.began_s = "running", time.monotonic()
            self._say(now=True)
            try:
                await self._reconstruct(job)
            except OSError as error:
                self._end(job, "failed", f"{job.scan.name}: {error.strerror}")

    async def _reconstruct(self, job: ConsoleJob) -> None:
        _sweep(job.scan)
        partial = job.scan.parent / f".{_stem(job.scan)}.{os.getpid()}.part"
        arguments = ["reconstruct", str(job.scan), "-o", str(partial), "--progress", "json"]
        if job.calibration is not None:
            arguments += ["--calibration", str(job.calibration)]
        try:
            child = await asyncio.create_subprocess_exec(
                *self._command,
                *arguments,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=asyncio.subprocess.PIPE,
                start_new_session=True,
            )
            try:
                heard, status = await self._follow(job, child)
            finally:
                await _end_group(child)
            if job.cancelled.is_set():
                self._end(job, "cancelled")
            elif status != 0 or not (partial / "summary.json").is_file():
                self._end(job, "failed", heard or f"it ended with status {status} and said nothing")
            else:
                job.place = _put(partial, job.scan)
                self._end(job, "done")
        finally:
            await asyncio.to_thread(shutil.rmtree, partial, ignore_errors=True)

    async def _follow(self, job: ConsoleJob, child: asyncio.subprocess.Process) -> tuple[str, int | None]:
        """What it said last that is no progress, and how it ended; None where it was given up first."""
        ended = asyncio.create_task(self._hear(job, child))
        given_up = asyncio.create_task(job.cancelled.wait())
        try:
            await asyncio.wait((ended, given_up), return_when=asyncio.FIRST_COMPLETED)
            return (ended.result(), await child.wait()) if ended.done() else ("", None)
        finally:
            ended.cancel()
            given_up.cancel()

    async def _hear(self, job: ConsoleJob, child: asyncio.subprocess.Process) -> str:
        assert child.stderr is not None
        last, rest = "", b""
        while data := await child.stderr.read(LINE_MAX):
            *lines, rest = (rest + data).split(b"\n")
            rest = rest[-LINE_MAX:]
            for line in lines:
                last = self._heard(job, line) or last
        return (self._heard(job, rest) or last).removeprefix("annulus: ")

    def _heard(self, job: ConsoleJob, line: bytes) -> str:
        """The line, where it is not of progress."""
        try:
            progress = untrusted.mapping(untrusted.parse_json(line, LINE_MAX), "progress")
            what = untrusted.printable(untrusted.text(progress.get("what"), "what", 60))
            done, total = (untrusted.whole(progress.get(name), name, 0, 1 << 40) for name in ("done", "total"))
        except ValueError:
            text = untrusted.one_line(line.decode("utf-8", "replace").strip())
            if text and not job.total:
                job.what = text  # what it waits for before the first frame
            self._say()
            return text
        if what != job.what or not job.total:
            job.what, job.step_s = what, time.monotonic()
        job.done, job.total = done, total
        self._say()
        return ""

    def _end(self, job: ConsoleJob, state: str, error: str = "") -> None:
        job.state, job.error, job.ended_s = state, error, time.monotonic()
        self._say(now=True)

    def _say(self, now: bool = False) -> None:
        if now or time.monotonic() - self._told_s >= TELL_S:
            self._told_s = time.monotonic()
            self._tell(self.jobs())


async def _end_group(child: asyncio.subprocess.Process) -> None:
    """The child and all that it started."""
    for by, wait_s in ((signal.SIGTERM, END_S), (signal.SIGKILL, END_S)):
        if child.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, by)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(wait_s):  # wait_for forgets a cancellation that comes as the child ends
                    await child.wait()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)  # workers that heard nothing


def _stem(scan: Path) -> str:
    return scan.stem if scan.suffix == ".mcap" else scan.name


def _put(partial: Path, scan: Path) -> Path:
    """Beside the scan, under a name that is free."""
    for number in range(1, PLACES_MAX + 1):
        place = scan.parent / f"{_stem(scan)}-results{'' if number == 1 else f'-{number}'}"
        if not place.exists():
            partial.rename(place)
            return place
    raise OSError(0, f"has {PLACES_MAX} results beside it, expected fewer")


def _sweep(scan: Path) -> None:
    """What a console left that was killed."""
    for path in scan.parent.glob(f".{glob.escape(_stem(scan))}.*.part"):
        number = path.name.rsplit(".", 2)[1]
        if number.isdigit() and int(number) != os.getpid() and not Path(f"/proc/{number}").exists():
            shutil.rmtree(path, ignore_errors=True)
