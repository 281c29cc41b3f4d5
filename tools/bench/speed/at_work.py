"""A scan under way for a benchmark: `annulus daemon` in a process of its own before the twin's head, a client of its
control socket, an ear at its publisher; and what is to be said of what it recorded.

    with at_work(WORLD, 12.5) as work:                  # it records, and has labelled frames
        work.client.mark("here")
    work.problems: what is not as it should be, once it has ended
"""

import random
import statistics
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zmq

from annulus_pipe.capture.photometry import Light, measure
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.daemon.state import State
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.stream.publish import parse
from annulus_pipe.twin.faults import NO_FAULTS, Faults
from annulus_pipe.twin.head import HeadHandle, start_head
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.vocabulary import Label
from tools.bench.speed.daemons import Daemon, running, until
from tools.bench.speed.live import children_of, drawn
from tools.bench.speed.viewers import cpu_s, free_port, rss_mb

UP_S = 120.0
SETTLED_S = 3.0  # until its spares are up, and all lamps known


class Ear:
    """A viewer at the daemon itself: every label, and telemetry, as they come."""

    def __init__(self, address: str) -> None:
        self.labels: dict[int, Mapping[str, Any]] = {}  # by index: of the first camera
        self.late_ms: list[float] = []  # from a frame in hand to its label here
        self.counted: Counter[str] | None = None  # labels since it was put there
        self.begin = 0  # what was said up to this frame, while everything came up, is nobody's promise
        self.turns: list[float] = []
        self.telemetry: Mapping[str, Any] = {}
        self.heard_s = 0.0  # when the last label came
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, 0)
        for topic in (b"label", b"telemetry"):
            self._socket.subscribe(topic)
        self._socket.connect(address)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    def unknown(self) -> int:
        return sum(body["label"] == "unknown" for index, body in list(self.labels.items()) if index > self.begin)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._context.destroy(linger=0)

    def _listen(self) -> None:
        while not self._ended.is_set():
            if not self._socket.poll(100):
                continue
            topic, _, body, _ = parse(self._socket.recv_multipart())
            if topic == "telemetry":
                self.telemetry = body
                self.turns.append(float(body.get("turn_ms") or 0.0))
            elif topic == "label":
                self.heard_s = time.monotonic()
                self.late_ms.append((time.monotonic_ns() - body["arrived_ns"]) / 1e6)
                if body.get("camera", 0) == 0:
                    self.labels[body["index"]] = body
                if self.counted is not None:
                    self.counted[body["label"]] += 1


@dataclass(slots=True)
class Work:
    out: Path
    head: HeadHandle
    daemon: Daemon
    client: ControlClient
    ear: Ear
    control: str
    problems: list[str] = field(default_factory=list)  # of the scan, once it has ended
    recorded: int = 0

    @property
    def pid(self) -> int:
        return self.daemon.process.pid

    @property
    def both(self) -> str:
        """PUBLISH,CONTROL."""
        return f"{self.daemon.publish},{self.control}"

    def pids(self, module: str) -> list[int]:
        """Its processes that run this module of the daemon's, spares too; the oldest first."""
        return [pid for name, pid in children_of(self.pid) if name == module]

    def begin(self) -> None:
        """A scan, until it is settled."""
        self.client.start()
        labels = len(self.ear.labels)
        until(lambda: any(b["label"] != "unknown" for b in list(self.ear.labels.values())[labels:]), "no label came")
        time.sleep(SETTLED_S)
        self.ear.begin = max(self.ear.labels)

    def end(self) -> None:
        """The scan, and the judgement of what it recorded."""
        self.client.stop()
        until(lambda: self.client.state() is State.IDLE, "the daemon is not idle")
        time.sleep(0.5)
        for path in recordings(self.out / "scans"):
            recording = open_recording(path)
            self.recorded += len(recording.frames)
            self.problems += judged(recording)

    def disturbed(self) -> tuple[int, float]:
        """Labels unknown so far, and for how long the head stood still because this machine was too busy, ms: what it
        shows then is nobody's fault.
        """
        return self.ear.unknown, float(self.head.counters()["stretched_ms"])

    def undisturbed(self, before: tuple[int, float]) -> tuple[bool, int]:
        """Since `before`: whether there is no unknown label more but one that the twin was late for; how many are."""
        unknown, stood_ms = self.disturbed()
        more = unknown - before[0]
        return more <= 1 or stood_ms > before[1], more

    def cpu_s(self) -> float:
        """Of the daemon, its children that live, and those it has buried."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        buried = (int(fields[13]) + int(fields[14])) / 100.0
        return sum(self.percents().values()) + buried

    def percents(self) -> dict[str, float]:
        """Seconds of processor so far, by what a process does."""
        found = {"daemon": cpu_s(self.pid)}
        for name, pid in children_of(self.pid):
            with suppress(OSError):
                found[name] = found.get(name, 0.0) + cpu_s(pid)
        return found

    def memory_mb(self) -> dict[str, float]:
        """Of the processes' own, by what they do, spares left out."""
        found = {}
        for name, pid in [*reversed(children_of(self.pid)), ("daemon", self.pid)]:
            with suppress(OSError, StopIteration):
                found[name] = rss_mb(pid)
        return found


@contextmanager
def at_work(
    world: World,
    fps: float,
    *,
    timing: FrameTiming | None = None,
    copied: bool = False,
    scan: bool = True,
    judge: bool = True,
    record: str = "",
    more: str = "",
    workers: str = "count = 1",
    speed_mm_s: float = 2.0,
    flash_us: float | None = None,
    faults: Faults = NO_FAULTS,
) -> Iterator[Work]:
    """`copied`: the head draws each picture once, see live.py. `scan`: one is under way, which is
    ended and judged (`judge`) here.
    """
    with ExitStack() as stack:
        out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="annulus-at-work-")))
        if copied:
            stack.enter_context(drawn(world))
        seed = random.randrange(1 << 16)
        head = stack.enter_context(start_head(world, fps, faults, timing=timing, seed=seed, speed_mm_s=speed_mm_s))
        control = f"tcp://127.0.0.1:{free_port()}"
        toml = f'[record]\nfolder = "scans"\nmin_free_gb = 0\n{record}\n{more}\n'
        toml += f'[control]\naddress = "{control}"\nautostart = false\n'
        how: dict[str, Any] = {"world": world, "workers": workers, "flash_us": flash_us}
        daemon = stack.enter_context(running(out, head, toml, **how))
        ear = Ear(daemon.publish)
        stack.callback(ear.close)
        client = stack.enter_context(ControlClient(control))
        until(lambda: client.state() is State.IDLE, f"the daemon is not idle: {daemon.heard()[-3:]}")
        work = Work(out, head, daemon, client, ear, control)
        if scan:
            work.begin()
        yield work
        if scan and judge:
            work.end()


def recordings(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.mcap") if "health" not in path.name)


def judged(recording: Recording) -> list[str]:
    """Damage, labels that the pictures contradict, frames that were taken and are not there."""
    problems = [f"damaged: {one.text}" for one in recording.check()]
    if recording.torn:
        problems.append("the recording is torn")
    problems += [f"frame {index} is called {label}, and is not" for index, label in misnamed(recording)]
    ledger = next(iter(reversed(list(recording.notes("/summary")))), {})
    lost = {k: v for k, v in {**ledger.get("before", {}), **ledger.get("after", {})}.items() if v}
    if not ledger or ledger.get("recorded") != len(recording.frames):
        problems.append(f"the ledger says {ledger.get('recorded')} recorded, the file has {len(recording.frames)}")
    if lost:
        problems.append(f"lost: {lost}")
    return problems


def misnamed(recording: Recording) -> Iterator[tuple[int, str]]:
    expected = {Label.PROJECTOR: Light.PROJECTOR, Label.LED: Light.LED}
    for frame in recording.frames:
        if frame.label in expected and measure(recording.read_raw(frame)[0]).light is not expected[frame.label]:
            yield frame.index, frame.label.value


def spread_ms(late_ms: list[float]) -> str:
    """p50 and p99 for people."""
    if len(late_ms) < 10:
        return f"only {len(late_ms)} labels"
    cuts = statistics.quantiles(late_ms, n=100)
    return f"p50 {cuts[49]:.1f}, p99 {cuts[98]:.1f}, at most {max(late_ms):.0f} ms of {len(late_ms)} labels"
