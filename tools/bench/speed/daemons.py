"""The daemon itself killed and stopped, and its disk filled: `annulus daemon` in a process of its own, as a service
would run it, before a head of the twin's that outlives it.
"""

import os
import queue
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zmq

from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.daemon.ledger import ExitStatus
from annulus_pipe.daemon.state import State
from annulus_pipe.record.recording import open_recording
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.stream.publish import parse
from annulus_pipe.twin.head import HeadHandle, head_toml, start_head
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.speed.blows import FPS, MARK, WORLD, Disk, is_alive, left, lit, processes_of, shared
from tools.bench.speed.viewers import free_port

HOST_TIMEOUT_S = 0.5
DARK_S = HOST_TIMEOUT_S + 0.1 + 1.0 / FPS  # .., the last word before the blow, and a flash that has begun
STOP_S, PAUSE_S = 1.5, 0.2
ENDED_S = 4.0  # free space is asked for once a second, heeded once a second; then what is in hand is written
UP_S, GIVE_UP_S = 120.0, 30.0
DISK_MB, RESERVE_MB = 160, 20


@dataclass(slots=True)
class Outcome:
    """Of one row's blows: how soon it went on, how soon it was dark, and whatever is not as it should be."""

    took_s: list[float] = field(default_factory=list)
    dark_s: list[float] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    ended_s: list[float] = field(default_factory=list)  # of a scan that had to end: how soon it had


class Daemon:
    """A process, what it says on stderr, and a viewer of its labels."""

    def __init__(
        self,
        out: Path,
        head: HeadHandle,
        more: str,
        world: World = WORLD,
        workers: str = "count = 1",
        flash_us: float | None = None,
    ) -> None:
        self.publish = address = f"tcp://127.0.0.1:{free_port()}"
        save_calibration(out / "calibration.json", world.calibration())
        here = f'\n[publish]\naddress = "{address}"\n[workers]\n{workers}\n'
        toml = head_toml(head, world, Path("calibration.json")) + here + more
        if flash_us is not None:
            toml = toml.replace("_width_us = ", f"_width_us = {flash_us:.0f} # ")
        (out / "head.toml").write_text(toml)
        (sockets := out / "tmp").mkdir(exist_ok=True)
        self.sockets, self.mark = sockets, str(out)
        code = "from annulus_pipe.cli import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, "daemon", "--config", str(out / "head.toml")],
            env=os.environ | {MARK: self.mark, "TMPDIR": str(sockets)},
            stderr=subprocess.PIPE,
            text=True,
        )
        self.said: list[str] = []
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._viewer = self._context.socket(zmq.SUB)
        self._viewer.subscribe(b"label")
        self._viewer.connect(address)

    def labelled(self, since_ns: int, patience_s: float = GIVE_UP_S) -> float:
        """The monotonic second at which a viewer has the label of a frame that came after this moment."""
        end = time.monotonic() + patience_s
        while (rest_s := end - time.monotonic()) > 0 and self._viewer.poll(round(1000 * rest_s) + 1):
            header = parse(self._viewer.recv_multipart())[2]
            if header["label"] != "unknown" and header["arrived_ns"] > since_ns:
                return time.monotonic()
        raise AnnulusError(f"no label within {patience_s:g} s; the daemon said: {_news(self.heard())}")

    def children(self) -> list[int]:
        return [pid for pid in processes_of(self.mark) if pid != self.process.pid]

    def heard(self) -> list[str]:
        while not self._lines.empty():
            self.said.append(self._lines.get())
        return self.said

    def left(self, before: set[str]) -> list[str]:
        """Of one that has ended."""
        found = left(self.mark, before, self.process.pid)
        return [f"left: {one}" for one in [*found, *(str(one) for one in self.sockets.iterdir())]]

    def end(self) -> int:
        """As systemd would: its exit status."""
        with suppress(ProcessLookupError):
            self.process.terminate()
        return self.process.wait(60.0)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for pid in self.children():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._context.destroy(linger=0)

    def _listen(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            for line in lines:
                self._lines.put(line.rstrip())


@contextmanager
def running(
    out: Path, head: HeadHandle, more: str = '[record]\nfolder = "scans"\nmin_free_gb = 0\n', **how: Any
) -> Iterator[Daemon]:
    daemon = Daemon(out, head, more, **how)
    try:
        yield daemon
    finally:
        daemon.close()


@contextmanager
def _stage(seed: int) -> Iterator[tuple[Path, HeadHandle]]:
    with (
        tempfile.TemporaryDirectory(prefix="annulus-kills-") as out,
        start_head(WORLD, FPS, seed=seed, speed_mm_s=2.0) as head,
    ):
        yield Path(out), head


def killed(times: int, stop_children: bool = False, seed: int = 1) -> Outcome:
    """SIGKILL of the daemon; with all its children stopped before, if so wished. Another one takes the head over."""
    outcome, chance = Outcome(), random.Random(seed)
    with _stage(seed) as (out, head):
        for _ in range(times):
            before = shared()
            with running(out, head) as daemon:
                daemon.labelled(time.monotonic_ns(), UP_S)
                time.sleep(chance.uniform(0.3, 1.1))
                children = daemon.children()
                if stop_children:
                    for pid in children:
                        os.kill(pid, signal.SIGSTOP)
                daemon.process.kill()
                outcome.dark_s.append(dark_after(head, time.monotonic()))
                daemon.process.wait()
                outcome.problems += daemon.left(before)
                outcome.problems += [f"left: process {pid}" for pid in children if is_alive(pid)]
                _say("dark after", outcome.dark_s, outcome)
        outcome.problems += lit(head)
        outcome.problems += _unreadable(out / "scans")
    return outcome


def stopped(times: int, lasts_s: float, seed: int = 1) -> Outcome:
    """SIGSTOP of the daemon for so long, again and again, and in the end SIGTERM."""
    outcome, chance = Outcome(), random.Random(seed)
    with _stage(seed) as (out, head):
        before = shared()
        with running(out, head) as daemon:
            for _ in range(times):
                daemon.labelled(time.monotonic_ns(), UP_S)
                time.sleep(chance.uniform(0.3, 1.1))
                began = time.monotonic()
                daemon.process.send_signal(signal.SIGSTOP)
                if lasts_s > HOST_TIMEOUT_S:
                    outcome.dark_s.append(dark_after(head, began, lasts_s))
                time.sleep(max(0.0, began + lasts_s - time.monotonic()))
                daemon.process.send_signal(signal.SIGCONT)
                over_ns = time.monotonic_ns()
                outcome.took_s.append(daemon.labelled(over_ns) - over_ns / 1e9)
                _say("recovery", outcome.took_s, outcome)
            _end(daemon, outcome, before)
        outcome.problems += lit(head) + _unreadable(out / "scans")
    return outcome


def filled(times: int, seed: int = 1) -> Outcome:
    """Another program fills the disk in a moment: the scan ends, dark and readable, and the next one can begin."""
    outcome, chance = Outcome(), random.Random(seed)
    with _stage(seed) as (out, head):
        disk = Disk(out / "disk", DISK_MB)
        try:
            before = shared()
            control = f'[control]\naddress = "ipc://{out}/control"\nautostart = false\n'
            record = f'[record]\nfolder = "disk/scans"\nmin_free_gb = 0\nreserve_mb = {RESERVE_MB}\n'
            with running(out, head, record + control) as daemon, ControlClient(f"ipc://{out}/control") as client:
                until(lambda: client.state() is State.IDLE, "the daemon is not idle")
                for _ in range(times):
                    client.start()
                    daemon.labelled(time.monotonic_ns())
                    time.sleep(chance.uniform(1.0, 2.0))
                    _fill(disk.folder / "filler")
                    full_s = time.monotonic()
                    until(lambda: client.state() is State.IDLE, "the scan on a full disk does not end")
                    outcome.ended_s.append(time.monotonic() - full_s)
                    outcome.problems += [f"{lamp} is on" for lamp in head.counters()["lamps_on"]]
                    (disk.folder / "filler").unlink()
                    outcome.problems += _unreadable(disk.folder / "scans")
                    for recording in (disk.folder / "scans").glob("*.mcap"):  # beside the file of the head's health
                        recording.unlink()
                    _say("ended after", outcome.ended_s, outcome)
                _end(daemon, outcome, before)
            outcome.problems += lit(head)
        finally:
            disk.close()
    return outcome


def _news(said: list[str]) -> list[str]:
    """The last lines that are more than the same numbers again."""
    return [line for line in said if not line.startswith("idle: ")][-12:]


def _say(what: str, times_s: list[float], outcome: Outcome) -> None:
    """After each blow: a run that is cut short has told something."""
    print(f"{len(times_s)}: {what} {times_s[-1]:.2f} s", *outcome.problems, sep="; ", file=sys.stderr, flush=True)


def _end(daemon: Daemon, outcome: Outcome, before: set[str]) -> None:
    outcome.statuses.append(daemon.end())
    if outcome.statuses[-1] not in (ExitStatus.FINE, ExitStatus.INCOMPLETE):
        outcome.problems.append(f"exit status {outcome.statuses[-1]}: {daemon.heard()[-3:]}")
    outcome.problems += daemon.left(before)
    time.sleep(0.1)  # its last words are on their way
    said = daemon.heard()
    outcome.problems += [line for line in said if "does not add up" in line]
    if not any("frames = " in line for line in said):
        outcome.problems.append("it showed no ledger")


def dark_after(head: HeadHandle, began: float, watched_s: float = 1.5) -> float:
    """How long after `began` a lamp was last on, looked at for so many seconds."""
    time.sleep(max(0.0, began + watched_s - time.monotonic()))
    dark_s = head.counters()["dark_s"]
    return time.monotonic() - began - dark_s if dark_s else float("inf")


def _fill(path: Path) -> None:
    with suppress(OSError), path.open("wb", buffering=0) as file:
        for size in (1 << 20, 1 << 12):
            with suppress(OSError):
                while file.write(bytes(size)):
                    pass


def until(true: Callable[[], object], otherwise: str, patience_s: float = UP_S) -> None:
    """Raises AnnulusError with `otherwise` when it does not come true in time."""
    end = time.monotonic() + patience_s
    while True:
        with suppress(AnnulusError):
            if true():
                return
        if time.monotonic() > end:
            raise AnnulusError(otherwise)
        time.sleep(0.02)


def _unreadable(folder: Path) -> list[str]:
    """Recordings that no reader takes, however they ended."""
    found = []
    for path in sorted(folder.glob("scan-*-??????.mcap")):
        try:
            if not open_recording(path).frames:
                found.append(f"{path.name}: no frame in it")
        except AnnulusError as error:
            found.append(str(error))
    return found or ([] if any(folder.glob("*.mcap")) else ["no recording"])
