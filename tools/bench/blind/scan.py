"""A drawn scene as a scan folder: pictures, frames.csv, calibration.json, limits.toml, and truth.json beside them."""

import csv
import json
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
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
LIGHTS = ("povray", "mitsuba")  # who draws


def write_scan(scene: Scene, folder: Path, light: str = "povray") -> None:
    """Draw every frame of a scene into `folder` by one of LIGHTS. A folder that has a truth.json is whole."""
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    if light == "povray":
        with tempfile.TemporaryDirectory(dir=folder) as work:
            last = max(one.z_mm for one in scene.stands) + reach_of(scene.head, scene.pipe.radius_mm).far
            (Path(work) / "pipe.inc").write_text(pipe_text(scene, last), encoding="utf-8")
            write_frames(scene, folder, lambda stand: _by_povray(scene, stand, Path(work)), {})
        return
    from tools.light.camera import Camera  # Mitsuba is there for developers only
    from tools.light.draw import effects_of, smaller

    scene = smaller(scene)
    camera = Camera(scene, effects_of(scene))
    write_frames(scene, folder, camera.photograph, {"light": asdict(camera.effects)}, camera.back_mm())


def write_frames(
    scene: Scene,
    folder: Path,
    photograph: Callable[[Stand], Array],
    more: Mapping[str, Any],
    back_mm: Sequence[float] | None = None,
) -> None:
    """The same by whatever makes (H, W, 3) of linear light, blue first, of a stand. more : what truth.json has beside
    the scene; back_mm : how far behind the projector each ring seems to come from."""
    factors: dict[str, float] = {}
    stood: dict[tuple[Any, ...], Array] = {}  # a head that stands still sees one picture, with noise of its own each
    rows = []
    for stand in scene.stands:
        drift = stand.drift if scene.change.grows else 0.0
        key = (stand.lamp, stand.z_mm, stand.rx, stand.ry, stand.tx_mm, stand.ty_mm, drift)
        if key not in stood:
            if len(stood) > 2:
                stood.pop(next(iter(stood)))
            stood[key] = photograph(stand)
        light = stood[key]
        part = LED_PART if stand.lamp == "led" else scene.sensor.exposure
        factor = factors.setdefault(stand.lamp, exposure(light, part))
        image = expose(light, factor, scene.sensor, np.random.default_rng([scene.seed, stand.index]))
        name = f"frames/{stand.index:06d}.jpg"
        (folder / name).write_bytes(as_jpeg(image, scene.sensor.jpeg))
        rows.append((stand.index, name, stand.lamp, f"{stand.reported_mm:.4f}"))
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("index", "file", "light", "z_mm"), *rows])
    radius = _calibrated_mm(scene)
    head = calibration(scene.head, radius, back_mm)
    (folder / "calibration.json").write_text(json.dumps(head, indent=1), encoding="utf-8")
    (folder / "limits.toml").write_text(limits_text(scene), encoding="utf-8")
    (folder / TRUTH).write_text(json.dumps({**scene.to_dict(), **more}, indent=1), encoding="utf-8")


def _by_povray(scene: Scene, stand: Stand, work: Path) -> Array:
    text = work / "frame.pov"
    text.write_text(frame_text(scene, stand) + '#include "pipe.inc"\n', encoding="utf-8")
    smooth = SMOOTH if stand.lamp == "projector" else ()  # the LED's light is for colour
    return render(text, work / "frame.png", scene.head.width, scene.head.height, smooth)


def _calibrated_mm(scene: Scene) -> float:
    """The radius that is written in the calibration: the nominal one, which no pipe has."""
    inch = 2.0 * scene.pipe.radius_mm / 25.4
    return 25.4 / 2 * min((2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0), key=lambda one: abs(one - inch))


def calibration(head: Head, radius_mm: float, back_mm: Sequence[float] | None = None) -> dict[str, Any]:
    """calibration.json: the head as it was when it was calibrated, each ring from where it seems to come."""
    behind = [0.0] * len(head.slits) if back_mm is None else back_mm
    vertices = [[float(v - back * a) for v, a in zip(head.vertex_mm, head.axis, strict=True)] for back in behind]
    fisheye = head.model == "fisheye"
    return {
        "format": "annulus-calibration/1",
        "camera": {
            "model": head.model,
            "width": head.width,
            "height": head.height,
            "fx": head.focal_px,
            "fy": head.focal_px,
            "cx": head.centre_px[0],
            "cy": head.centre_px[1],
            "distortion": [0.0] * 4 if fisheye else [],
        },
        "pattern": {"colours": head.colours},
        "rings": [
            {"theta_full_deg": math.degrees(inner + outer), "axis": list(head.axis), "vertex_mm": vertex}
            for (inner, outer), vertex in zip(head.slits, vertices, strict=True)
        ],
        "pipe": {"radius_mm": radius_mm},
    }


def limits_text(scene: Scene) -> str:
    """limits.toml: one class, which does not conform."""
    lines = [f'title = "blind {scene.seed}"', "accept_severity = 0"]
    for section, quantities in scene.limits.items():
        for quantity, value in quantities.items():
            lines += [f"[[{section}]]", "severity = 1", f"{quantity} = {value}"]
    return "\n".join(lines) + "\n"
