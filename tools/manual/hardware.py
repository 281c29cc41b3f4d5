"""What the hardware page shows of the reference circuit: pictures, parts, how long its one-shots last."""

import subprocess
import sys
from functools import cache
from pathlib import Path

from tools.hardware.oneshot import LAMP, MICROWAVE

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build/manual-pictures"


@cache
def make() -> None:
    """Pictures, netlist and parts into FOLDER, by a process of its own: SKiDL keeps one circuit for all."""
    subprocess.run([sys.executable, "-m", "tools.hardware", str(FOLDER)], cwd=ROOT, check=True)


def parts() -> str:
    make()
    return (FOLDER / "hardware-parts.md").read_text("utf-8")


def times() -> str:
    rows = [
        f"| {name} | {shot.limit_s * scale:g} {unit} | {shot.shortest_s * scale:.1f} {unit}"
        f" | {shot.longest_s * scale:.1f} {unit} |"
        for name, shot, scale, unit in (("projector, LED", LAMP, 1e3, "ms"), ("microwave", MICROWAVE, 1e6, "us"))
    ]
    return "\n".join(["| gate | the controller's limit | shortest | longest |", "|---|---|---|---|", *rows, ""])
