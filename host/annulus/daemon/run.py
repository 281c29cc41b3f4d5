"""`annulus daemon`: one head from the command line."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from annulus.daemon.cameras import open_camera
from annulus.daemon.config import load_config
from annulus.daemon.interrupt import Interrupt
from annulus.daemon.scan import Doors, Scan, ScanReport


def run_daemon(config_path: Path) -> None:
    """Scan until Ctrl-C or SIGTERM, then say what was made. Raises AnnulusError when the scan cannot begin."""
    with Interrupt() as interrupt:
        config = load_config(config_path)
        doors = Doors(event=_say, telemetry=lambda telemetry: _say(one_line(telemetry)))
        report = Scan(config, open_camera(config), doors=doors).run(lambda: interrupt.requested)
    for line in ending(report):
        _say(line)


def one_line(telemetry: Mapping[str, Any]) -> str:
    """The state of a scan for people."""
    frames = ", ".join(f"{count} {label}" for label, count in telemetry["frames"].items())
    drops = ", ".join(f"{count} {kind}" for kind, count in telemetry["drops"].items())
    return f"{telemetry['phase']}: {frames}; {telemetry['profiles']} profiles" + (f"; lost: {drops}" if drops else "")


def ending(report: ScanReport) -> list[str]:
    """What a scan was, line by line."""
    lines = [f"{report.seconds:.1f} s, frames: " + ", ".join(f"{n} {label}" for label, n in report.frames.items())]
    if report.unknown:
        lines.append("unknown: " + ", ".join(f"{count} {why}" for why, count in report.unknown.items()))
    lines.append("lost: " + (", ".join(f"{n} {kind}" for kind, n in report.drops.items()) or "nothing"))
    lines += [f"recording {path}" for path in report.recordings]
    return lines


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
