"""A scan of 20 GB of frames, reconstructed on one machine: what all its processes hold at most, and how long it takes.

    python -m tools.bench speed long_scan

The frames are few pictures under many places: 10 000 rows of frames.csv, 2.05 MB of mosaic each as a head sends them,
25 m of clean pipe in steps of 2.5 mm. What is read, measured, surveyed and written is all of it. Memory is what /proc
says of the command and all its children together, every half second: resident, what they share counted once.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2

from annulus_pipe.geometry.pose import Pose
from tests.unit.rings.drawn import Paint, calibration, draw
from tools.bench.table import Row

FRAMES, STEP_MM, RATIO = 10_000, 2.5, 4
PICTURES = 4
MOSAIC_MB = 1664 * 1232 / 1e6
MOST_MB = 2000.0
LOOK_S = 0.5  # a look stops what is looked at for some ms


def rows(frames: int = FRAMES) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="annulus-long-", dir="/var/tmp") as name:
        folder = Path(name)
        drawn_scan(folder / "scan", frames)
        before = {int(one.name) for one in Path("/proc").iterdir() if one.name.isdigit()}
        began = time.monotonic()
        command = [
            str(Path(sys.executable).with_name("annulus")),
            "reconstruct",
            str(folder / "scan"),
            "--json",
            "-o",
            str(folder / "out"),
            "--calibration",
            str(folder / "scan/calibration.json"),
        ]
        with (folder / "told").open("w") as told, (folder / "said").open("w") as said:
            running = subprocess.Popen(command, stdout=told, stderr=said)
            most = largest = 0.0
            while running.poll() is None:
                held = [_pss_mb(pid) for pid in _family(running.pid, before)]
                most, largest = max(most, sum(held)), max(largest, *held, 0.0)
                time.sleep(LOOK_S)
        took = time.monotonic() - began
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        worked = used.ru_utime + used.ru_stime
        if running.returncode:
            return [Row("reconstruct", "-", "status 0", f"status {running.returncode}: {_last(folder)}", False)]
        summary = json.loads((folder / "told").read_text())
        size = sum(one.stat().st_size for one in (folder / "out").rglob("*") if one.is_file()) / 1e6
    length = summary["scanned_mm"]["length"]
    return [
        Row("frames", "-", ">= 20 GB", f"{frames * MOSAIC_MB / 1000:.1f} GB", None if frames < FRAMES else True),
        Row("memory, all processes", "-", f"<= {MOST_MB:.0f} MB", f"{most:.0f} MB", most <= MOST_MB),
        Row("memory, the largest process", "-", "-", f"{largest:.0f} MB"),
        Row("windows", "-", "-", f"{len(summary.get('windows', []))}, {length / 1000:.1f} m of pipe"),
        Row("points", "-", "-", f"{summary['points'] / 1e6:.1f} million, {len(summary['defects'])} defects"),
        Row("time", "-", "-", f"{took:.0f} s, {1e3 * took / frames:.0f} ms a frame"),
        Row("processor, all processes", "-", "-", f"{worked:.0f} s, {1e3 * worked / length:.0f} s a metre"),
        Row("results", "-", "-", f"{size:.0f} MB"),
    ]


def _last(folder: Path) -> str:
    return (folder / "said").read_text().strip().rpartition("\n")[2]


def drawn_scan(folder: Path, frames: int, scale: float = 1.0) -> None:
    """A scan folder of so many frames of a clean pipe, in a lamp cycle of four to one."""
    folder.mkdir(parents=True)
    cal = calibration(scale=scale)
    (folder / "calibration.json").write_text(json.dumps(cal.to_dict()))
    for n in range(PICTURES):
        image = draw(cal, Pose(0.004 * n, -0.003 * n, 0.3 * n, -0.2 * n), paint=Paint(supersample=1, noise=2.0), seed=n)
        cv2.imwrite(str(folder / f"rings-{n}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    width = image.shape[1]
    cv2.imwrite(str(folder / "led.jpg"), cv2.GaussianBlur(image, (0, 0), width / 8) // 2 + 60)
    lines = ["index,file,light,z_mm"]
    for i in range(frames):
        led = i % (RATIO + 1) == RATIO
        lines.append(
            f"{i},{'led.jpg' if led else f'rings-{i % PICTURES}.jpg'},{'led' if led else 'projector'},{STEP_MM * i}"
        )
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")


def _family(first: int, before: set[int]) -> list[int]:
    """A process and all that came of it."""
    parents: dict[int, int] = {}
    for one in Path("/proc").iterdir():
        if one.name.isdigit() and int(one.name) not in before:
            try:
                parents[int(one.name)] = int((one / "stat").read_text().rpartition(")")[2].split()[1])
            except (OSError, IndexError):
                continue
    family = {first}
    while more := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= more
    return sorted(family)


def _pss_mb(pid: int) -> float:
    try:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024 * 1.048576
    except OSError:
        pass
    return 0.0
