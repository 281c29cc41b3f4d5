"""What console and page keep of a long scan: all that a daemon says in hours, said in minutes.

    python -m tools.bench.speed.console_hours [HOURS] [FASTER]     8 h, 12 times as fast, take 40 minutes

Everything is said as often as in the time it is of, pictures too; only the head hurries. Memory is looked at after a
collection, and the most of each ten minutes of scan is held against the most of the ten that follow the first.
"""

import os
import sys
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zmq

from annulus_pipe.stream.publish import parse
from tools.bench.speed.page_at_work import chromium_at, heap_mb, renderer_mb
from tools.bench.speed.viewers import Console, console_at_work, foremost, rss_mb
from tools.bench.table import Row

HOURS, FASTER = 1.0, 12.0
FPS = 25.0
WINDOW_S = 600.0  # of scan
EVERY_S = 2.0
FLAT_MB = 5.0
SCAN_H = 8.0

NOTE = (
    f"{FPS:g} frames a second of scan, 3000 points each, pictures, wall, rows, slits, defects and status, said faster "
    "than they would be. The list of defects and their close-ups fill for the first hour, at one every half "
    "metre: the slope of a shorter run is none of 8 h."
)


@dataclass(slots=True)
class Kept:
    at_s: list[float] = field(default_factory=list)  # of scan
    mb: list[float] = field(default_factory=list)

    def most(self) -> dict[int, float]:
        """In each ten minutes of scan."""
        out: dict[int, float] = {}
        for at, mb in zip(self.at_s, self.mb, strict=True):
            out[int(at // WINDOW_S)] = max(mb, out.get(int(at // WINDOW_S), 0.0))
        return out

    def slope(self) -> float:
        """MB an hour after the first ten minutes: of lines through two looks that are far apart the median."""
        keep = [(at / 3600.0, mb) for at, mb in zip(self.at_s, self.mb, strict=True) if at >= WINDOW_S]
        hours, mb = np.array(keep).T
        first, then = np.triu_indices(len(mb), max(1, len(mb) // 3))
        return float(np.median((mb[then] - mb[first]) / (hours[then] - hours[first])))


class Clock:
    """How far the scan is, as the daemon says."""

    def __init__(self, address: str) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.subscribe(b"telemetry")
        self._socket.connect(address)
        self._at_s = 0.0

    def __enter__(self) -> "Clock":
        return self

    def __exit__(self, *_: object) -> None:
        self._context.destroy(linger=0)

    def at_s(self) -> float:
        while self._socket.poll(0 if self._at_s else 10_000):
            self._at_s = float(parse(self._socket.recv_multipart())[2]["seconds"])
        return self._at_s


def watched(console: Console, hours: float) -> tuple[dict[str, Kept], dict[str, Any]]:
    """Console and page until the scan is so old; and what the page says in the end."""
    kept = {name: Kept() for name in ("console", "page's heap", "page's process")}
    with chromium_at(console.url) as tab, Clock(console.publish) as clock:
        while (at := clock.at_s()) < 3600.0 * hours:
            looks = (rss_mb(console.pid), heap_mb(tab), renderer_mb())
            for one, mb in zip(kept.values(), looks, strict=True):
                one.at_s.append(at)
                one.mb.append(mb)
            tab.wait_for_timeout(1e3 * EVERY_S)
        said = tab.evaluate("() => ({...window.annulus.stats, alive: window.annulus.latest?.alive ?? null})")
        return kept, dict(said)


def rows(hours: float = HOURS, faster: float = FASTER) -> list[Row]:
    with foremost(), console_at_work(FPS, faster) as console:
        began = time.monotonic()
        kept, said = watched(console, hours)
        took = time.monotonic() - began
    out = []
    for name, one in kept.items():
        most = one.most()
        later = {window: mb for window, mb in most.items() if window >= 1}
        first, last = later[min(later)], later[max(later)]
        slope = one.slope()
        grown = max(later.values()) - first
        text = (
            f"{first:.1f} MB in minutes 10 to 20, {last:.1f} MB at the end, at most {grown:+.1f} MB; slope "
            f"{slope:+.2f} MB an hour, {SCAN_H * slope:+.1f} MB in {SCAN_H:g} h"
        )
        judged = name != "page's process"  # of which the browser gives back when it likes
        flat = max(grown, SCAN_H * slope) <= FLAT_MB
        out.append(
            Row(
                f"{name}, {hours:g} h of scan",
                "-",
                f"<= {FLAT_MB:g} MB more than after ten minutes",
                text,
                flat if judged else None,
            )
        )
    lost = said.get("alive") or {}
    text = f"{said['points'] / 1e6:.2f} million points held, {said['pictures']} pictures drawn; {lost}"
    out.append(Row(f"{hours:g} h in {took:.0f} s", "-", "-", f"{text}; load {os.getloadavg()[0]:.1f}"))
    return out


if __name__ == "__main__":
    for row in rows(*map(float, sys.argv[1:])):
        print(f"{row.what}: {row.measured}", "" if row.ok is None else "met" if row.ok else "missed", flush=True)
