"""Blows at a scan under way, one after the other, and how soon each is got over. The scan runs in this process, its
children are real, and so is the disk; the head is the twin's.

A blow strikes, may take something away for a while, and is over when what it struck at works again on a frame that was
in hand after the blow: labelled, recorded, reconstructed, or at a viewer.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import zmq

from annulus_pipe.daemon.account import ScanReport
from annulus_pipe.daemon.config import RecordConfig, SocketConfig
from annulus_pipe.daemon.ledger import ExitStatus
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.session import Session
from annulus_pipe.daemon.state import State
from annulus_pipe.demo import demo_config
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import StateFlag
from annulus_pipe.link.messages import Status as AskStatus
from annulus_pipe.record.recording import open_recording
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.publish import parse
from annulus_pipe.twin.head import HeadHandle, start_head
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import Label
from tools.bench.speed.viewers import free_port

FPS = 12.5
WORLD = demo_world(travel_mm=330.0).scaled(416)
ROLES = ("camera", "recorder", "publisher", "worker")
SPARES = tuple(f"{role} spare" for role in ROLES)
PAUSE_S = 0.2  # shorter than what is taken for a stop
AWAY_S, FROZEN_S = 30.0, 3.0
CALM_S = (0.3, 1.1)  # between two blows, drawn
CALM_BY_S, GIVE_UP_S = 240.0, 30.0
MARK = "ANNULUS_KILLS"


class Scene(Observer):
    """How far each outlet of the scan has come. `session` is put in once it is made."""

    session: Session

    def __init__(self, head: HeadHandle, folder: Path, disk: "Disk | None") -> None:
        self.head, self.folder, self.disk = head, folder, disk
        self.labelled_ns = self.seen_ns = 0  # the last labelled frame: when it came; of those a viewer heard of
        self.profiles = 0
        self.told: list[str] = []
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._viewer = self._context.socket(zmq.SUB)
        self.address = f"tcp://127.0.0.1:{free_port()}"
        self._viewer.subscribe(b"label")
        self._viewer.connect(self.address)

    def frame(self, header: FrameHeader, image: object) -> None:
        if header.label is not Label.UNKNOWN:
            self.labelled_ns = max(self.labelled_ns, header.arrived_ns)

    def profile(self, profile: object) -> None:
        self.profiles += 1

    def event(self, kind: str, text: str) -> None:
        self.told.append(text)

    def hear(self) -> None:
        """What the viewer was sent."""
        while self._viewer.poll(0):
            header = parse(self._viewer.recv_multipart())[2]
            if header["label"] != "unknown":
                self.seen_ns = max(self.seen_ns, header["arrived_ns"])

    def close(self) -> None:
        self._context.destroy(linger=0)


@dataclass(frozen=True, slots=True)
class Blow:
    """`name` is the row it counts in. What is taken away is given back after `lasts_s`: recovery counts from there."""

    name: str
    strike: Callable[[Scene], None]
    works: Callable[[Scene, "Struck"], bool]
    give_back: Callable[[Scene], None] = lambda scene: None
    lasts_s: float = 0.0
    replaces: str = ""  # the role whose process is another one afterwards
    needs: str = ""  # who must be up besides every role itself


@dataclass(slots=True)
class Struck:
    """A blow that has fallen, and where the outlets stood when its victim was replaced."""

    blow: Blow
    victim: int
    at_s: float
    over_ns: int = 0  # when what was taken was given back
    recorded: int = -1
    profiles: int = -1


class Course:
    """A session's `stop`: strikes whenever all is well, until no blow is left."""

    def __init__(self, scene: Scene, blows: Sequence[Blow], seed: int, until_s: float) -> None:
        self._until_s = until_s
        self.took_s: dict[str, list[float]] = {blow.name: [] for blow in blows}
        self.replaced: Counter[str] = Counter()  # processes, by role, that had to be
        self.pids: set[int] = set()
        self.stuck = ""  # why it was ended early
        self._scene, self._left, self._random = scene, list(blows), random.Random(seed)
        self._struck: Struck | None = None
        self._restless_s = self._well_s = time.monotonic()
        self._calm_s = self._random.uniform(*CALM_S)

    def __call__(self) -> bool:
        scene, now = self._scene, time.monotonic()
        scene.hear()
        processes = scene.session.processes
        self.pids.update(pid for pids in processes.values() for pid in pids)
        if self._struck is not None:
            return self._recovers(self._struck, processes, now)
        if not self._is_calm(processes):
            self._well_s = now
            if now - self._restless_s > CALM_BY_S:
                self.stuck = f"no calm for {CALM_BY_S:g} s: {scene.session.state}, {processes}, {scene.told[-3:]}"
            return bool(self.stuck)
        if now - self._well_s < self._calm_s:
            return False
        if not self._left or now > self._until_s:
            return True
        blow = self._left.pop(0)
        self.replaced[blow.replaces] += 1
        self._struck = Struck(blow, (processes.get(blow.replaces) or [0])[0], now)
        blow.strike(scene)
        return False

    def finish(self) -> None:
        """Nothing stays taken away."""
        if self._struck is not None and not self._struck.over_ns:
            self._struck.blow.give_back(self._scene)

    def _is_calm(self, processes: dict[str, list[int]]) -> bool:
        scene = self._scene
        needed = self._left[0].needs if self._left else ""
        there = all(processes.get(role) for role in (*ROLES, needed) if role)
        works = scene.session.telemetry()["recorded"] > 0 and scene.seen_ns > 0 and scene.profiles > 0
        return there and works and scene.session.labelled >= 10 and scene.session.state is State.SCANNING

    def _recovers(self, struck: Struck, processes: dict[str, list[int]], now: float) -> bool:
        scene, blow = self._scene, struck.blow
        if not struck.over_ns:
            if now - struck.at_s < blow.lasts_s:
                return False
            blow.give_back(scene)
            struck.over_ns = time.monotonic_ns() if blow.lasts_s else round(struck.at_s * 1e9)
        there = processes.get(blow.replaces, [])
        if struck.recorded < 0 and (not blow.replaces or (there and struck.victim not in there)):
            struck.recorded, struck.profiles = scene.session.telemetry()["recorded"], scene.profiles
        took_s = now - struck.over_ns / 1e9
        if struck.recorded >= 0 and scene.labelled_ns > struck.over_ns and blow.works(scene, struck):
            self.took_s[blow.name].append(took_s)
            print(f"{blow.name}: {took_s:.2f} s, {len(self._left)} to come", file=sys.stderr, flush=True)
        elif took_s > GIVE_UP_S:
            self.took_s[blow.name].append(GIVE_UP_S)
            self.stuck = f"{blow.name}: not over after {GIVE_UP_S:g} s: {processes}, {scene.told[-3:]}"
            return True
        else:
            return False
        self._struck = None
        self._restless_s = self._well_s = now
        self._calm_s = self._random.uniform(*CALM_S)
        return False


# ---- the blows ----


def process_blows() -> Iterator[Blow]:
    """Each role killed, stopped for good, and stopped for a moment; and its spare, which nobody must miss."""
    for role in ROLES:
        for number in (signal.SIGKILL, signal.SIGSTOP):
            yield Blow(
                f"{role} {number.name}", _signal(role, number), _WORKS[role], replaces=role, needs=f"{role} spare"
            )
        yield _pause(role, _WORKS[role])
    for spare in SPARES:
        for number in (signal.SIGKILL, signal.SIGSTOP):
            yield Blow(f"{spare} {number.name}", _signal(spare, number), _all_work, needs=spare)
        yield _pause(spare, _all_work)


def _pause(role: str, works: Callable[[Scene, Struck], bool]) -> Blow:
    def stop(scene: Scene) -> None:
        pid = scene.session.processes[role][0]
        go_on = threading.Timer(PAUSE_S, _go_on, (pid,))  # not by the session's loop, which may be held up itself
        go_on.start()
        os.kill(pid, signal.SIGSTOP)

    return Blow(f"{role} paused", stop, works, lasts_s=PAUSE_S, needs=role)


def _go_on(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)


def _signal(role: str, number: signal.Signals) -> Callable[[Scene], None]:
    return lambda scene: os.kill(scene.session.processes[role][0], number)


def _records(scene: Scene, struck: Struck) -> bool:
    return scene.session.telemetry()["recorded"] > struck.recorded


def _is_seen(scene: Scene, struck: Struck) -> bool:
    return scene.seen_ns > struck.over_ns


def _reconstructs(scene: Scene, struck: Struck) -> bool:
    return scene.profiles > struck.profiles


def _all_work(scene: Scene, struck: Struck) -> bool:
    return _records(scene, struck) and _is_seen(scene, struck) and _reconstructs(scene, struck)


def _has_grown(scene: Scene, struck: Struck) -> bool:
    """The recording is a file again, made after the blow, with some frames in it."""
    files = [path.stat() for path in scene.folder.glob("*.mcap")]
    return any(
        one.st_size > 3 * WORLD.camera.width * WORLD.camera.height and _written(one) > struck.at_s for one in files
    )


def _written(file: os.stat_result) -> float:
    return file.st_mtime - time.time() + time.monotonic()


_WORKS: dict[str, Callable[[Scene, Struck], bool]] = {
    "camera": lambda scene, struck: True,
    "recorder": _records,
    "publisher": _is_seen,
    "worker": _reconstructs,
}


class Disk:
    """A file system of its own in a file, which can be frozen, and be gone. Needs root."""

    def __init__(self, folder: Path, megabytes: int) -> None:
        self.folder, self._image = folder, folder.with_suffix(".img")
        folder.mkdir()
        with self._image.open("wb") as image:
            image.truncate(megabytes << 20)
        _run("mkfs.ext4", "-q", "-E", "lazy_itable_init=1,nodiscard", self._image)
        self.put_in()

    def put_in(self) -> None:
        _run("mount", "-o", "loop", self._image, self.folder)

    def pull_out(self) -> None:
        """Whoever has a file open there may write on, and nobody will find it."""
        _run("umount", "--lazy", self.folder)

    def freeze(self) -> None:
        """Whoever writes waits, uninterruptibly."""
        _run("fsfreeze", "--freeze", self.folder)

    def thaw(self) -> None:
        _run("fsfreeze", "--unfreeze", self.folder)

    def close(self) -> None:
        subprocess.run(["umount", "--lazy", self.folder], stderr=subprocess.DEVNULL)


def _run(*command: str | Path) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def other_blows() -> Iterator[Blow]:
    """What is not a process: the recording's folder, its disk, the camera."""
    yield Blow("folder removed", lambda scene: shutil.rmtree(scene.folder), _has_grown)
    yield Blow("camera gone for 30 s", lambda scene: scene.head.unplug(AWAY_S), _all_work, lasts_s=AWAY_S)


def disk_blows() -> Iterator[Blow]:
    """Of scans whose recording lies on a Disk."""
    yield Blow("disk stands for 3 s", _on_disk(Disk.freeze), _all_work, _on_disk(Disk.thaw), FROZEN_S)
    yield Blow("disk pulled out", _on_disk(Disk.pull_out), _has_grown)
    yield Blow("disk put back in", _on_disk(Disk.put_in), _has_grown)


def _on_disk(do: Callable[[Disk], None]) -> Callable[[Scene], None]:
    def strike(scene: Scene) -> None:
        assert scene.disk is not None
        do(scene.disk)

    return strike


# ---- a scan under them ----


@dataclass(frozen=True, slots=True)
class Outcome:
    took_s: dict[str, list[float]]
    report: ScanReport
    problems: list[str] = field(default_factory=list)  # whatever is not as it should be after the scan


def struck(blows: Sequence[Blow], seed: int = 1, on_disk: bool = False, until_s: float = float("inf")) -> Outcome:
    """One scan under these blows, in this order, and what is to be said of it. No blow falls after `until_s`."""
    with ExitStack() as stack:
        out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="annulus-kills-")))
        head = stack.enter_context(start_head(WORLD, FPS, seed=seed, speed_mm_s=2.0))
        disk = None
        if on_disk:
            disk = Disk(out / "disk", 4096)
            stack.callback(disk.close)
        scene = Scene(head, (disk.folder if disk is not None else out) / "scans", disk)
        stack.callback(scene.close)
        stack.enter_context(marked(str(out)))
        before = shared()
        config = replace(
            demo_config(head, WORLD, out),
            record_folder=scene.folder,
            workers=1,
            slots=24,
            publish=SocketConfig(scene.address, None),
            record=RecordConfig(min_free_gb=0, sync_s=1.0),
        )
        session = scene.session = Session(config, observer=scene, name="scan")
        course = Course(scene, blows, seed, until_s)
        try:
            report = session.run(course)
        finally:
            course.finish()
        problems = [course.stuck] if course.stuck else []
        problems += [f"left: {one}" for one in left(str(out), before, os.getpid())]
        problems += [f"left: process {pid}" for pid in course.pids if is_alive(pid)]
        problems += _wrong_in(session, report, course.replaced)
        if not any("folder" in blow.name or "disk p" in blow.name for blow in blows):
            readable = len(open_recording(scene.folder / "scan.mcap").frames)
            if readable < report.ledger.recorded:
                problems.append(f"{report.ledger.recorded} frames recorded, {readable} can be read")
        problems += lit(head)
        return Outcome(course.took_s, report, problems)


def _wrong_in(session: Session, report: ScanReport, replaced: Counter[str]) -> list[str]:
    found = [report.ledger.problem] if report.ledger.problem else []
    found += [f"in hand: {report.telemetry['in_hand']}"] if any(report.telemetry["in_hand"].values()) else []
    for role in ROLES:
        was = report.drops.get(f"{role}s_replaced", 0)
        if was != replaced[role]:
            why = Counter(text for text in report.events if "takes over" in text or "is replaced" in text)
            found.append(f"{was} {role}s replaced, expected {replaced[role]}: {dict(why)}")
    if session.status not in (ExitStatus.FINE, ExitStatus.INCOMPLETE):
        found.append(f"status {session.status.name}: {[finding.text for finding in report.findings]}")
    return found


def lit(head: HeadHandle) -> list[str]:
    """By the head's own pins and by its word; that it answers says that its port is nobody's."""
    found = [f"lamp {lamp} is on" for lamp in head.counters()["lamps_on"]]
    with Client(head.port_url) as client:
        answer: Any = client.request(AskStatus())
    return found + (["the lamps are armed"] if StateFlag.LAMPS_ARMED in answer.state else [])


@contextmanager
def marked(mark: str) -> Iterator[None]:
    """Children are known by their environment."""
    os.environ[MARK] = mark
    try:
        yield
    finally:
        del os.environ[MARK]


def shared() -> set[str]:
    """Segments; semaphores of multiprocessing come and go with other programs on the machine, a scan makes none."""
    return {one.name for one in Path("/dev/shm").iterdir() if one.is_file() and not one.name.startswith("sem.mp-")}


def _mapped(names: set[str]) -> set[str]:
    """Of these segments, those that some process has: other programs come and go."""
    found = set[str]()
    for folder in Path("/proc").iterdir() if names else ():
        with suppress(OSError):
            maps = (folder / "maps").read_text()
            found |= {name for name in names if f"/dev/shm/{name}\n" in maps}
    return found


def left(mark: str, before: set[str], owner: int, patience_s: float = 5.0) -> list[str]:
    """Processes with this mark, segments, and folders of sockets, after a moment for the kernel to bury the dead."""
    end = time.monotonic() + patience_s
    while (alive := processes_of(mark)) and time.monotonic() < end:
        time.sleep(0.05)
    folders = Path(tempfile.gettempdir()).glob(f"annulus-{owner}-*")
    new = shared() - before
    found = [f"process {pid}: {_command(pid)}" for pid in alive]
    return [*found, *sorted(new - _mapped(new)), *map(str, folders)]


def _command(pid: int) -> str:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
        return next((word.decode() for word in words if word.startswith(b"annulus_pipe.")), words[0].decode())
    except OSError:
        return "gone by now"


def processes_of(mark: str) -> list[int]:
    """This one is not among them: its environment is as it was when it began."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit() and f"{MARK}={mark}\0".encode() in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:
            continue
    return found


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0] != "Z"
    except OSError:
        return False
