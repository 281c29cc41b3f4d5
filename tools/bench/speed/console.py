"""The console: what it costs with one viewer and with three, how soon they have a picture, and when a page shows it.

python -m tools.bench speed console
"""

import os
import time

from tools.bench.speed import page_at_work
from tools.bench.speed.viewers import Console, console_at_work, cpu_s, foremost, looked, rss_mb
from tools.bench.table import Row

FPS = 25.0
SECONDS = 25.0
CPU_MAX = {1: 4.0, 3: 6.0}  # percent of a core
P50_MS, P95_MS = 5.0, 15.0
RATE_LEAST = 0.97  # of pictures and profiles, of what is said

NOTE = (
    f"{FPS:g} pictures a second of half of 1664x1232 (38 kB), 3000 points a profile, wall, rows, slits and status; "
    "daemon (one that only talks), console and viewers each in a process of its own, ZeroMQ and WebSocket through "
    "loopback, all of them before whatever else the machine does. Processor time from /proc/PID/stat."
)


def rows() -> list[Row]:
    out: list[Row] = []
    with foremost(), console_at_work(FPS) as console:
        for viewers, most in CPU_MAX.items():
            out += _served(console, viewers, most)
        out.append(Row("console, resident", "-", "-", f"{rss_mb(console.pid):.0f} MB of its own"))
        out += page_at_work.rows(console)
    return out


def _served(console: Console, viewers: int, most: float) -> list[Row]:
    before, began = cpu_s(console.pid), time.monotonic()
    seen = looked(console.url, viewers, SECONDS)
    took = time.monotonic() - began
    cpu = 100.0 * (cpu_s(console.pid) - before) / took
    load, of = os.getloadavg()[0], f"{viewers} viewer{'s' if viewers > 1 else ''}"
    rate = seen["a_second"]
    text = ", ".join(f"{rate[kind]:.1f} {kind}" for kind in ("pictures", "points", "wall", "rows", "slits", "status"))
    profiles = FPS * 4 / 5
    enough = min(rate["pictures"] / FPS, rate["points"] / profiles) >= RATE_LEAST
    return [
        Row(
            f"processor of the console, {of}",
            "-",
            f"<= {most:g} %",
            f"{cpu:.1f} % of a core over {took:.0f} s, load {load:.1f}",
            cpu <= most,
        ),
        Row(
            f"published to received, {of}",
            "-",
            f"p50 <= {P50_MS:g}, p95 <= {P95_MS:g} ms",
            f"p50 {seen['p50_ms']:.1f}"
            f", p95 {seen['p95_ms']:.1f}, p99 {seen['p99_ms']:.1f}, at most {seen['max_ms']:.0f} ms of "
            f"{seen['pictures']} pictures",
            seen["p50_ms"] <= P50_MS and seen["p95_ms"] <= P95_MS,
        ),
        Row(
            f"delivered a second, {of}",
            "-",
            f"{FPS:g} pictures, {profiles:g} profiles",
            f"{text}; {seen['dropped']} dropped",
            enough and not seen["dropped"],
        ),
    ]
