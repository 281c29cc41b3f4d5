"""Sweeps of a probe at points and along dogbones, from files to files: resonances, and how far they moved."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.report.names import BUMP_BLUE, INK
from annulus_pipe.report.paper import WIDTH_IN, in_style, png
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.sweeps import moved, resonance
from annulus_pipe.wings.joints.sweep_file import read_places, read_sweep


def compare_sweeps(table: Path, out: Path, parameter: str) -> tuple[dict[str, Any], list[Path]]:
    """Each sweep's resonance, and its shift from the first line's (air, say). Writes sweeps.json and sweeps.png."""
    places = read_places(table)
    curves = [read_sweep(place.path, parameter) for place in places]
    found = []
    for place, curve in zip(places, curves, strict=True):
        try:
            found.append(resonance(*curve))
        except AnnulusError as error:
            raise AnnulusError(f"{place.path}: {error}") from None
    first = found[0]
    points = []
    for place, one in zip(places, found, strict=True):
        shift, sigma = one.f0_hz - first.f0_hz, math.hypot(one.f0_sigma_hz, first.f0_sigma_hz)
        elsewhere = None if place is places[0] else moved(first, one)
        numbers = {
            "z_mm": place.z_mm,
            "f0_hz": one.f0_hz,
            "f0_sigma_hz": one.f0_sigma_hz,
            "quality": one.quality,
            "depth": one.depth,
            "shift_hz": shift,
            "shift_sigma_hz": sigma,
        }
        known = {name: value if math.isfinite(value) else None for name, value in numbers.items()}
        points.append({"point": place.name, "file": str(place.path), **known, "moved": elsewhere})
    content = {"table": str(table), "parameter": parameter, "points": points}
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "sweeps.json").write_text(json.dumps(content, allow_nan=False))
        with in_style():
            (out / "sweeps.png").write_bytes(png(_drawn(content, curves)))
    except OSError as error:
        raise AnnulusError(f"{error.filename or out}: cannot be written ({error.strerror})") from None
    return content, [out / name for name in ("sweeps.json", "sweeps.png")]


def _drawn(content: dict[str, Any], curves: list[tuple[FloatArray, FloatArray]]) -> Figure:
    points = content["points"]
    figure = Figure(figsize=(WIDTH_IN, 0.42 * WIDTH_IN), layout="constrained")
    left, right = figure.subplots(1, 2)
    unit, name = (1e9, "GHz") if curves[0][0][-1] > 1e9 else (1e6, "MHz")
    for k, (frequency, magnitude) in enumerate(curves):
        label = points[k]["point"] if len(points) <= 8 else None
        with np.errstate(divide="ignore"):
            left.plot(frequency / unit, 20 * np.log10(magnitude), lw=0.9, label=label)
    left.set(xlabel=f"frequency, {name}", ylabel=f"{content['parameter'].upper()}, dB")
    if len(points) <= 8:
        left.legend(fontsize=7)
    along = all(one["z_mm"] is not None for one in points[1:]) and len(points) > 2
    known_at = [
        k for k, one in enumerate(points) if one["f0_hz"] is not None and (one["z_mm"] is not None or not along)
    ]
    at = [points[k]["z_mm"] if along else k for k in known_at]
    f0, sigma = ([points[k][key] / unit for k in known_at] for key in ("f0_hz", "f0_sigma_hz"))
    right.errorbar(at, f0, 2 * np.array(sigma), fmt="o", ms=4, color=BUMP_BLUE, ecolor=INK, lw=0.8)
    right.set(xlabel="along the dogbone, mm" if along else "", ylabel=f"resonance, {name}, k = 2")
    if not along:
        right.set_xticks(range(len(points)), [one["point"] for one in points], rotation=30, ha="right", fontsize=7)
    return figure
