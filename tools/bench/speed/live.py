"""A daemon at work for a benchmark: it records to this machine's disk and publishes what the twin's head shows it.

The head draws each picture once and copies it from then on, so that what is measured is not what the twin leaves. Head
and viewer stand for what does not run on the head's computer, and have real-time priority where that is allowed.
"""

import mmap
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import zmq

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.stream.publish import parse
from annulus_pipe.twin import head as twin_head
from annulus_pipe.twin import process as twin_process
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import clean_world, stereo_world
from annulus_pipe.twin.worlds.world import World
from tools.bench.speed.hops import ENVIRONMENT

VARIANTS = 4  # of each picture, in turn
EDGE_ROWS = 24  # the first and last that photometry samples are among them
SPIN = "while True: pass"
TWIN_LEVEL, VIEWER_LEVEL = 1, 20  # of SCHED_FIFO: below the daemon's, and above
MEMORY = "/dev/shm"


class Drawn(Renderer):
    """Each picture is drawn once a lamp and variant, and copied from then on, with a noise of its first and last rows
    that no other has: a picture handed over twice would be a fault, or one with another's last row.
    """

    def render(self, pose: Any, z_mm: float, projector: Any = 0.0, led: Any = 0.0, **more: Any) -> Any:
        out = more.pop("out", None)
        if out is None:
            return super().render(pose, z_mm, projector, led, **more)
        cache = self.__dict__.setdefault("cache", {})
        key = (bool(np.any(projector)), bool(np.any(led)), more.get("seed", 0) % VARIANTS)
        if key not in cache:
            cache[key] = super().render(self.start, 0.0, float(key[0]), float(key[1]), seed=key[2])
        out[:] = cache[key]
        noise = np.random.default_rng(more.get("seed", 0)).integers(0, 2, (2, EDGE_ROWS, out.shape[1]), np.uint8)
        out[:EDGE_ROWS] ^= noise[0]
        out[-EDGE_ROWS:] ^= noise[1]
        return out


def serve(cameras: int, tty: bool) -> None:
    """The head's process; it has so many cameras, its line is a tty or a socket."""
    Drawn.start = plain_world(cameras).pose(0.0)  # type: ignore[attr-defined]
    _raised(TWIN_LEVEL)
    line = twin_process.PtyLine if tty else twin_process.TcpLine
    with patch.multiple(twin_process, Renderer=Drawn, PtyLine=line):
        twin_process.main()


def _raised(level: int) -> None:
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(level))


def plain_world(cameras: int = 1) -> World:
    """Of one camera, or of a head of two whose second is there more than once."""
    if cameras == 1:
        return clean_world()
    world = stereo_world()
    return replace(world, others=tuple(replace(world.others[0], id=number) for number in range(1, cameras)))


@contextmanager
def drawn(world: World, tty: bool = True) -> Iterator[None]:
    """Heads that are started meanwhile, of a `plain_world`, draw each picture once."""
    ours = f"from tools.bench.speed.live import serve; serve({len(world.cameras)}, {tty})"
    run = subprocess.Popen

    def popen(command: list[str], **how: Any) -> Any:
        return run([*command[:2], ours] if command[2:] == [START] else command, **how)

    with patch.object(twin_head.subprocess, "Popen", popen):
        yield


@contextmanager
def spinning(load: int) -> Iterator[None]:
    processes = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(load)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


@dataclass(frozen=True, slots=True)
class Live:
    viewer: Any  # of labels and telemetry
    pid: int  # the daemon's
    stamps: Path  # folder, see hops.py


@contextmanager
def daemon_at_work(
    world: World,
    fps: float,
    timing: FrameTiming | None = None,
    changed: Mapping[str, str] | None = None,
    tty: bool = True,
) -> Iterator[Live]:
    """Once it has said its first label. `changed`: in head.toml, words for others. `tty`: the controller's line is one,
    else a socket.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="annulus-bench-", dir=".")))
        stamps = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="annulus-bench-", dir=MEMORY)))
        with drawn(world, tty):
            head = stack.enter_context(twin_head.start_head(world, fps, timing=timing, speed_mm_s=0.0))
        extra = f'[record]\nfolder = "."\n[publish]\naddress = "ipc://{folder.absolute()}/labels"\n'
        toml = twin_head.head_toml(head, world) + extra
        for words, others in (changed or {}).items():
            toml = toml.replace(words, others)
        (folder / "head.toml").write_text(toml)
        viewer = stack.enter_context(_viewer(f"ipc://{folder.absolute()}/labels"))
        command = [sys.executable, "-m", "tools.bench.speed.hops", "annulus_pipe.cli", "daemon", "--config"]
        daemon = subprocess.Popen(
            [*command, str(folder / "head.toml")],
            stderr=None if os.environ.get("BENCH_DEBUG") else subprocess.DEVNULL,
            env=os.environ | {ENVIRONMENT: str(stamps)},
        )
        stack.callback(daemon.wait)
        stack.callback(daemon.terminate)
        wait_for_labels(viewer)
        yield Live(viewer, daemon.pid, stamps)


def children_of(pid: int) -> list[tuple[str, int]]:
    """A daemon's processes, by what they do, the oldest first."""
    found = []
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        try:
            command = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
        except OSError:  # gone by now
            continue
        name = next((word.decode() for word in command if word.startswith(b"annulus_pipe.")), child)
        found.append((name.rsplit(".", 1)[-1], int(child)))
    return found


def touch_memory(size: int) -> None:
    """A virtual machine gets memory from its host when it first touches it, which takes 3 ms for 2 MB and is counted
    as the recorder's time. So pages for the recording are touched beforehand.
    """
    with mmap.mmap(-1, size) as memory:
        if hasattr(mmap, "MADV_NOHUGEPAGE"):
            memory.madvise(mmap.MADV_NOHUGEPAGE)
        np.frombuffer(memory, np.uint8)[:: mmap.PAGESIZE] = 1


START = "from annulus_pipe.twin.process import main; main()"  # what start_head runs


@contextmanager
def _viewer(address: str) -> Iterator[Any]:
    """Its threads too have real-time priority: what is measured is when it could have had a label."""
    context = zmq.Context()
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(VIEWER_LEVEL))
        context.set(zmq.THREAD_SCHED_POLICY, os.SCHED_FIFO)
        context.set(zmq.THREAD_PRIORITY, VIEWER_LEVEL)
    viewer = context.socket(zmq.SUB)
    for topic in (b"label", b"telemetry"):
        viewer.subscribe(topic)
    viewer.connect(address)
    try:
        yield viewer
    finally:
        context.destroy(linger=0)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def following(viewer: Any) -> tuple[str, Mapping[str, Any]]:
    if not viewer.poll(60_000):
        raise RuntimeError("nothing from the daemon within a minute")
    topic, _, body, _ = parse(viewer.recv_multipart())
    return topic, body


def wait_for_labels(viewer: Any) -> None:
    while (said := following(viewer))[0] != "label" or said[1]["label"] == "unknown":
        pass
