"""From a frame in hand to its label at a viewer, and what each process of the daemon needs, at 1664x1232 and 25 fps.

    python -m tools.bench.speed.latency [LOAD] [SECONDS] [socket]     LOAD: processes that do nothing but spin

Latency is a viewer's clock at the label minus the header's arrived_ns; the daemon's processes stamp what passes
(hops.py), so a table says where the time goes. The rest: live.py.

What a tty brings is handed on by a worker of the kernel's that has ordinary priority, and polling a tty waits for it:
on a busy machine edges and their labels are late by that. With `socket` the controller's line is one, and has no such
worker: what is left is ours.
"""

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from annulus_pipe.twin.worlds import clean_world
from tools.bench.speed.hops import Stamps
from tools.bench.speed.live import children_of, daemon_at_work, following, spinning, touch_memory
from tools.bench.speed.viewers import cpu_s
from tools.bench.table import Row

FPS, SECONDS, WARM_S = 25.0, 40.0, 4.0
RUNS = ((0, True), (3, True), (3, False))  # load, and whether the controller's line is a tty
P50_MS, P999_MS = 3.0, 10.0

NOTE = (
    f"Load n: n processes that do nothing but spin, on {os.cpu_count()} cores, beside twin, daemon and viewer: the "
    "load average that the machine would have without any of those."
)
HOPS = (
    ("picture copied and measured", "in hand", "told"),
    ("daemon hears of it", "told", "had"),
    ("edge heard after the frame", "had", "closed"),
    ("daemon labels it once it can", "ready", "settled"),
    ("label made", "settled", "labelled"),
    ("handed to the publisher", "labelled", "sent"),
    ("publisher wakes", "sent", "taken"),
    ("packed and published", "taken", "published"),
    ("on its way to the viewer", "published", "seen"),
    ("frame in hand -> published", "in hand", "published"),
    ("frame in hand -> seen", "in hand", "seen"),
)
TURN_MS = 20.0


@dataclass(frozen=True, slots=True)
class Measured:
    labels: Mapping[str, int]
    cpu_percent: Mapping[str, float]  # of one core, by process
    hops: Mapping[str, list[float]]  # ms, in order of size
    turn_ms: float  # the longest of the daemon's loop
    load: float  # as the kernel averages it over the last minute


def measure(load: int, seconds: float = SECONDS, tty: bool = True) -> Measured:
    world = clean_world()
    touch_memory(int((seconds + 3 * WARM_S) * FPS * world.camera.width * world.camera.height))
    with daemon_at_work(world, FPS, tty=tty) as live, spinning(load):
        seen, labels, turns_ms, cpu = _watch(live.viewer, live.pid, seconds)
        hops = _by_hop(seen, Stamps.read(live.stamps))
        return Measured(labels, cpu, hops, max(turns_ms, default=float("nan")), os.getloadavg()[0])


@dataclass(frozen=True, slots=True)
class Seen:
    header: Mapping[str, Any]
    at_ns: int


def _watch(viewer: Any, pid: int, seconds: float) -> tuple[list[Seen], dict[str, int], list[float], dict[str, float]]:
    """Labels that are not unknown, all by what was said, the longest turn of each second, CPU by process."""
    seen, labels, turns_ms = list[Seen](), dict[str, int](), list[float]()
    begin = time.monotonic() + WARM_S
    before: dict[str, float] = {}
    while time.monotonic() < begin + seconds:
        topic, body = following(viewer)
        now = time.monotonic_ns()
        if time.monotonic() < begin:
            continue
        before = before or _cpu_s(pid)
        if topic == "telemetry":
            turns_ms.append(float(body.get("turn_ms", "nan")))
            continue
        said = body["reason"] or body["label"]
        labels[said] = labels.get(said, 0) + 1
        if body["label"] != "unknown":
            seen.append(Seen(body, now))
    after = _cpu_s(pid)
    return seen, labels, turns_ms, {n: 100.0 * (after[n] - before.get(n, 0.0)) / seconds for n in after}


def _by_hop(seen: list[Seen], stamps: Stamps) -> dict[str, list[float]]:
    """Milliseconds of each of HOPS, in order of size."""
    of = {what: dict(when) for what, when in stamps.of.items()}
    of["in hand"] = {one.header["arrived_ns"]: one.header["arrived_ns"] for one in seen}
    of["seen"] = {one.header["arrived_ns"]: one.at_ns for one in seen}
    of["closed"], of["ready"] = {}, {}
    for one in seen:  # a frame can be labelled when it is here and the edge that closes it has been heard
        key, closing = one.header["arrived_ns"], of["edge"].get(one.header["edge"] + 1)
        if closing is not None and key in of["had"]:
            of["closed"][key] = of["ready"][key] = max(of["had"][key], closing)
    return {hop: Stamps(of).between(list(of["in hand"]), first, then) for hop, first, then in HOPS}


def _cpu_s(pid: int) -> dict[str, float]:
    """CPU seconds of the daemon and each of its children, by what they are."""
    found = {"daemon": cpu_s(pid)}
    for name, child in children_of(pid):
        found[name] = found.get(name, 0.0) + cpu_s(child)
    return found


def at(ordered: list[float], share: float) -> float:
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else float("inf")


def rows(runs: tuple[tuple[int, bool], ...] = RUNS, seconds: float = SECONDS) -> list[Row]:
    out = []
    for load, tty in runs:
        got = measure(load, seconds, tty)
        run = f"load {load}, {'tty' if tty else 'socket'}"
        for hop, _, _ in HOPS:
            p50, p99, p999 = (at(got.hops[hop], share) for share in (0.5, 0.99, 0.999))
            text = f"p50 {p50:.2f}, p99 {p99:.1f}, p99.9 {p999:.1f} ms"
            is_whole = hop == HOPS[-1][0]
            target = f"p50 <= {P50_MS:g}, p99.9 <= {P999_MS:g} ms" if is_whole else "-"
            ok = p50 <= P50_MS and p999 <= P999_MS if is_whole else None
            counted = f" of {len(got.hops[hop])} labels" if is_whole else ""
            out.append(Row(f"{run}: {hop}", "-", target, text + counted, ok))
        out.append(
            Row(
                f"{run}: longest turn of the daemon's loop",
                "-",
                f"< {TURN_MS:g} ms",
                f"{got.turn_ms:.1f} ms",
                got.turn_ms < TURN_MS,
            )
        )
        cpu = ", ".join(f"{name} {percent:.1f} %" for name, percent in sorted(got.cpu_percent.items()))
        told = f"{cpu} of a core; load average {got.load:.1f}; {json.dumps(got.labels)}"
        out.append(Row(f"{run}: CPU by process", "-", "-", told))
    return out


if __name__ == "__main__":
    numbers = [float(word) for word in sys.argv[1:] if word != "socket"]
    runs = ((int(numbers[0]), "socket" not in sys.argv),) if numbers else RUNS
    for row in rows(runs, numbers[1] if len(numbers) > 1 else SECONDS):
        print(f"{row.what}: {row.measured}")
