"""A drawn scene as a scan folder: pictures, frames.csv, calibration.json, limits.toml, and truth.json beside them."""

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench.blind.head import reach_of
from tools.bench.blind.pipe import Head, Scene, Stand
from tools.bench.blind.pov import frame_text, pipe_text, render
from tools.bench.blind.sensor import LED_PART, as_jpeg, expose, exposure
from tools.bench.blind.surface import Array

SMOOTH = ("+A0.03", "+AM1", "+R2", "-J")  # four rays a pixel, more than that of no use under a lens's blur
TRUTH = "truth.json"


def write_scan(scene: Scene, folder: Path) -> None:
    """Draw every frame of a scene into `folder`. A folder that has a truth.json is whole."""
    frames, work = folder / "frames", folder / "pov"
    for one in (frames, work):
        one.mkdir(parents=True, exist_ok=True)
    last = max(one.z_mm for one in scene.stands) + reach_of(scene.head, scene.pipe.radius_mm).far
    (work / "pipe.inc").write_text(pipe_text(scene, last), encoding="utf-8")
    factors: dict[str, float] = {}
    stood: dict[tuple[Any, ...], Array] = {}  # a head that stands still sees one picture, with noise of its own each
    rows = []
    for stand in scene.stands:
        light = _light(scene, stand, work, stood)
        part = LED_PART if stand.lamp == "led" else scene.sensor.exposure
        factor = factors.setdefault(stand.lamp, exposure(light, part))
        image = expose(light, factor, scene.sensor, np.random.default_rng([scene.seed, stand.index]))
        name = f"frames/{stand.index:06d}.jpg"
        (folder / name).write_bytes(as_jpeg(image, scene.sensor.jpeg))
        rows.append((stand.index, name, stand.lamp, f"{stand.reported_mm:.4f}"))
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("index", "file", "light", "z_mm"), *rows])
    radius = _calibrated_mm(scene)
    (folder / "calibration.json").write_text(json.dumps(calibration(scene.head, radius), indent=1), encoding="utf-8")
    (folder / "limits.toml").write_text(limits_text(scene), encoding="utf-8")
    for one in work.iterdir():
        one.unlink()
    work.rmdir()
    (folder / TRUTH).write_text(json.dumps(scene.to_dict(), indent=1), encoding="utf-8")


def _light(scene: Scene, stand: Stand, work: Path, stood: dict[tuple[Any, ...], Array]) -> Array:
    drift = stand.drift if scene.change.grows else 0.0
    key = (stand.lamp, stand.z_mm, stand.rx, stand.ry, stand.tx_mm, stand.ty_mm, drift)
    if key not in stood:
        text = work / "frame.pov"
        text.write_text(frame_text(scene, stand) + '#include "pipe.inc"\n', encoding="utf-8")
        if len(stood) > 2:
            stood.pop(next(iter(stood)))
        smooth = SMOOTH if stand.lamp == "projector" else ()  # the LED's light is for colour
        stood[key] = render(text, work / "frame.png", scene.head.width, scene.head.height, smooth)
    return stood[key]


def _calibrated_mm(scene: Scene) -> float:
    """The radius that is written in the calibration: the nominal one, which no pipe has."""
    inch = 2.0 * scene.pipe.radius_mm / 25.4
    return 25.4 / 2 * min((2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0), key=lambda one: abs(one - inch))


def calibration(head: Head, radius_mm: float) -> dict[str, Any]:
    """calibration.json: the head as it was when it was calibrated."""
    fisheye = head.model == "fisheye"
    return {
        "format": "annulus-calibration/1",
        "camera": {
            "model": head.model, "width": head.width, "height": head.height, "fx": head.focal_px, "fy": head.focal_px,
            "cx": head.centre_px[0], "cy": head.centre_px[1], "distortion": [0.0] * 4 if fisheye else [],
        },
        "pattern": {"colours": head.colours},
        "rings": [
            {"theta_full_deg": math.degrees(inner + outer), "axis": list(head.axis), "vertex_mm": list(head.vertex_mm)}
            for inner, outer in head.slits
        ],
        "pipe": {"radius_mm": radius_mm},
    }  # fmt: skip


def limits_text(scene: Scene) -> str:
    """limits.toml: one class, which does not conform."""
    lines = [f'title = "blind {scene.seed}"', "accept_severity = 0"]
    for section, quantities in scene.limits.items():
        for quantity, value in quantities.items():
            lines += [f"[[{section}]]", "severity = 1", f"{quantity} = {value}"]
    return "\n".join(lines) + "\n"
