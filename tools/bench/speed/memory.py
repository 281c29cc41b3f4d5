"""What each process of a scan keeps for good: a real daemon with small pictures at many frames a second, recording and
publishing, and how its memory grows.

    python -m tools.bench.speed.memory [SECONDS] [FPS]     8 h at 25 a second: 2400 s at 300

Counted is memory of a process's own (RssAnon); the ring is everybody's. It grows in steps where more had to wait than
ever before, and those are no leak: the slope is the median of the slopes between any two looks that are far apart, and
its error half of what lies between their quartiles. Hours are of 90 000 frames: an hour at 25 a second.
"""

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.twin.worlds import clean_world
from tools.bench.speed.live import children_of, daemon_at_work, following
from tools.bench.speed.viewers import rss_mb
from tools.bench.table import Row

FPS, WIDTH = 150.0, 208
EXPOSED, READ, FLASH = 0.9, 0.075, 0.15  # of the time between two frames
SECONDS, WARM_S, EVERY_S = 200.0, 40.0, 1.0
HOUR = 90_000  # frames
GROWTH_MAX_MB = 1.0  # an hour; the recorder grew by 50

NOTE = f"At {FPS:g} frames a second of {WIDTH} pixels' width; an hour is {HOUR} frames."


@dataclass(slots=True)
class Kept:
    """Of one process."""

    frames: list[int] = field(default_factory=list)
    mb: list[float] = field(default_factory=list)

    def slope(self) -> tuple[float, float]:
        """MB an hour, and its error."""
        hours, mb = np.array(self.frames) / HOUR, np.array(self.mb)
        first, then = np.triu_indices(len(mb), max(1, len(mb) // 3))
        low, middle, high = np.quantile((mb[then] - mb[first]) / (hours[then] - hours[first]), (0.25, 0.5, 0.75))
        return float(middle), float(high - low) / 2.0


def measure(seconds: float = SECONDS, fps: float = FPS) -> tuple[dict[str, Kept], Mapping[str, int], float]:
    """By process; labels; the share of frames taken that were recorded."""
    kept: dict[str, Kept] = {}
    period_us = 1e6 / fps
    timing = FrameTiming(fps, EXPOSED * period_us, READ * period_us)
    flash = {"_width_us = ": f"_width_us = {FLASH * period_us:.0f} # "}
    with daemon_at_work(clean_world().scaled(WIDTH), fps, timing, flash) as live:
        begin = time.monotonic() + WARM_S
        next_look, telemetry = begin, dict[str, object]()
        frames = 0
        while time.monotonic() < begin + seconds:
            topic, body = following(live.viewer)
            if topic == "telemetry":
                telemetry = dict(body)
                continue
            frames += 1
            if (now := time.monotonic()) < next_look:
                continue
            next_look = now + EVERY_S
            for name, pid in {**dict(reversed(children_of(live.pid))), "daemon": live.pid}.items():  # no spares
                one = kept.setdefault(name, Kept())
                one.frames.append(frames)
                one.mb.append(rss_mb(pid))
        ledger, labels = telemetry["ledger"], telemetry["frames"]
        assert isinstance(ledger, Mapping) and isinstance(labels, Mapping)
        return kept, labels, float(telemetry["recorded"]) / max(1, ledger["taken"])  # type: ignore[arg-type]


def rows(seconds: float = SECONDS, fps: float = FPS) -> list[Row]:
    kept, labels, recorded = measure(seconds, fps)
    out = []
    for name, one in sorted(kept.items()):
        slope, error = one.slope()
        text = f"{slope:+.2f} +- {error:.2f} MB an hour, {one.mb[-1]:.0f} MB after {one.frames[-1]} frames"
        ok = slope - error <= GROWTH_MAX_MB
        out.append(Row(f"{name} grows by", "-", f"<= {GROWTH_MAX_MB:g} MB an hour", text, ok))
    told = ", ".join(f"{count} {label}" for label, count in labels.items())
    out.append(Row("frames", "-", "-", f"{told}; {recorded:.1%} of those taken are recorded"))
    return out


if __name__ == "__main__":
    for row in rows(*map(float, sys.argv[1:])):
        print(f"{row.what}: {row.measured}")
