"""From a frame in hand to its label at a viewer, and what each process of the daemon needs, at 1664x1232 and 25 fps.

    python -m tools.bench.speed.latency [LOAD] [SECONDS]     LOAD: processes that do nothing but spin

The daemon records to this machine's disk and publishes; the head is the twin with pictures drawn beforehand, so that
what is measured is not what the twin leaves. Latency is a viewer's clock at the label minus the header's arrived_ns.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import zmq

from annulus.stream.publish import parse
from annulus.twin import head as twin_head
from annulus.twin import process as twin_process
from annulus.twin.render import Renderer
from annulus.twin.worlds import clean_world
from tools.bench.table import Row

FPS, SECONDS, WARM_S = 25.0, 40.0, 4.0
LOADS = (0, 3)
P50_MS, P999_MS = 3.0, 10.0
VARIANTS = 4  # of each picture, in turn
SPIN = "while True: pass"

NOTE = "Load: processes that spin, beside what else this machine does."


class Drawn(Renderer):
    """Each picture is drawn once a lamp and variant, and copied from then on, with a spot that no other has: a
    picture handed over twice would be a fault.
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
        mark = np.frombuffer(int(more.get("seed", 0)).to_bytes(4, "little"), np.uint8)
        out[600:640, 800:848] = np.repeat(mark, 12)
        return out


def serve() -> None:
    """The head's process."""
    world = clean_world()
    Drawn.start = world.pose(0.0)  # type: ignore[attr-defined]
    with patch.object(twin_process, "Renderer", Drawn):
        twin_process.main()


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
class Measured:
    latency_ms: list[float]
    labels: Mapping[str, int]
    cpu_percent: Mapping[str, float]  # of one core, by process


def measure(load: int, seconds: float = SECONDS) -> Measured:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="annulus-bench-", dir=".")))
        run = subprocess.Popen

        def popen(command: list[str], **how: Any) -> Any:
            ours = "from tools.bench.speed.latency import serve; serve()"
            return run([*command[:2], ours] if command[2:] == [START] else command, **how)

        with patch.object(twin_head.subprocess, "Popen", popen):
            head = stack.enter_context(twin_head.start_head(clean_world(), FPS, speed_mm_s=0.0))
        extra = f'[record]\nfolder = "."\n[publish]\naddress = "ipc://{folder.absolute()}/labels"\n'
        (folder / "head.toml").write_text(twin_head.head_toml(head, replace(clean_world())) + extra)
        viewer = zmq.Context.instance().socket(zmq.SUB)
        stack.callback(viewer.close, 0)
        viewer.subscribe(b"label")
        viewer.connect(f"ipc://{folder.absolute()}/labels")
        command = [sys.executable, "-c", "from annulus.cli import main; main()", "daemon", "--config"]
        daemon = run(
            [*command, str(folder / "head.toml")], stderr=None if os.environ.get("BENCH_DEBUG") else subprocess.DEVNULL
        )
        stack.callback(daemon.wait)
        stack.callback(daemon.terminate)
        _wait_for_labels(viewer)
        stack.enter_context(spinning(load))
        return _watch(viewer, daemon.pid, seconds)


START = "from annulus.twin.process import main; main()"  # what start_head runs


def _next_label(viewer: Any) -> Mapping[str, Any]:
    if not viewer.poll(60_000):
        raise RuntimeError("no label within a minute")
    header: Mapping[str, Any] = parse(viewer.recv_multipart())[2]
    return header


def _wait_for_labels(viewer: Any) -> None:
    while _next_label(viewer)["label"] == "unknown":
        pass


def _watch(viewer: Any, pid: int, seconds: float) -> Measured:
    latency, labels = list[float](), dict[str, int]()
    begin = time.monotonic() + WARM_S
    before: dict[str, float] = {}
    while time.monotonic() < begin + seconds:
        header = _next_label(viewer)
        now = time.monotonic_ns()
        if time.monotonic() < begin:
            continue
        before = before or _cpu_s(pid)
        said = header["reason"] or header["label"]
        labels[said] = labels.get(said, 0) + 1
        if header["label"] != "unknown":
            latency.append((now - header["arrived_ns"]) / 1e6)
    after = _cpu_s(pid)
    used = {name: 100.0 * (after[name] - before.get(name, 0.0)) / seconds for name in after}
    return Measured(sorted(latency), labels, used)


def _cpu_s(pid: int) -> dict[str, float]:
    """CPU seconds of the daemon and each of its children, by what they are."""
    found = {"daemon": _spent_s(pid)}
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        command = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
        name = next((word.decode() for word in command if word.startswith(b"annulus.")), child)
        found[name.rsplit(".", 1)[-1]] = found.get(name.rsplit(".", 1)[-1], 0.0) + _spent_s(int(child))
    return found


def _spent_s(pid: int) -> float:
    words = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def at(ordered: list[float], share: float) -> float:
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else float("inf")


def rows(loads: tuple[int, ...] = LOADS, seconds: float = SECONDS) -> list[Row]:
    out = []
    for load in loads:
        got = measure(load, seconds)
        p50, p99, p999 = (at(got.latency_ms, share) for share in (0.5, 0.99, 0.999))
        text = f"p50 {p50:.1f}, p99 {p99:.1f}, p99.9 {p999:.1f} ms of {len(got.latency_ms)} labels"
        target = f"p50 <= {P50_MS:g}, p99.9 <= {P999_MS:g} ms"
        ok = p50 <= P50_MS and p999 <= P999_MS
        out.append(Row(f"frame in hand to label published, load {load}", "-", target, text, ok))
        cpu = ", ".join(f"{name} {percent:.1f} %" for name, percent in got.cpu_percent.items())
        out.append(Row(f"CPU by process, load {load}", "-", "-", f"{cpu} of a core; {json.dumps(got.labels)}"))
    return out


if __name__ == "__main__":
    numbers = [float(word) for word in sys.argv[1:]]
    for row in rows((int(numbers[0]),) if numbers else LOADS, numbers[1] if len(numbers) > 1 else SECONDS):
        print(f"{row.what}: {row.measured}")
