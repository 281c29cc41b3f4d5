"""The result files of a flat wall: depth.npz, cloud, summary, and a page with its heights and their sigma."""

import json
import math
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.report.account import ScanAccount
from annulus_pipe.report.names import UNSEEN, round_up
from annulus_pipe.report.paper import DEVIATION, WIDTH_IN, in_style, png
from annulus_pipe.report.pdf import Paper
from annulus_pipe.report.ply import write_ply
from annulus_pipe.report.results import DEPTH, SUMMARY, staged, write_page
from annulus_pipe.report.sheet import minute, sheet
from annulus_pipe.report.summary import finite, versions
from annulus_pipe.wings.fringe.measure.plate import Plate

CLOUD_NOTE = "annulus point cloud of a plate, mm: first camera's frame at position 0; sigma = of the height, k = 1"
TEMPLATE = "annulus_pipe.wings.fringe/plate.html.j2"
SCALE_PERCENTILES = (0.5, 99.5)  # of the heights, at the ends of the colour bar
QUANTILES = (5, 50, 95)


def write_plate(plate: Plate, account: ScanAccount, out: Path, *, paper: Paper | None = None) -> dict[str, Any]:
    """Write every result file of a plate into the folder `out`. Returns what summary.json says. paper : of report.pdf.

    Files are made in a folder beside and moved into place at the end, summary.json last, as those of a pipe are.
    AnnulusError when `out` cannot be written.
    """
    started = time.perf_counter()
    with staged(out) as staging:
        np.savez(
            staging / DEPTH,
            x_mm=plate.x_mm,
            y_mm=plate.y_mm,
            height_mm=plate.height_mm,
            sigma_mm=plate.sigma_mm,
            light=plate.light,
            modulation=plate.modulation,
            distance_mm=plate.distance_mm,
        )
        _write_cloud(staging / "cloud.ply", plate)
        pictures = {"height.png": _heights(plate), "sigma.png": _sigma(plate)}
        for name, data in pictures.items():
            (staging / name).write_bytes(data)
        summary = _summary(plate, account, 1e3 * (time.perf_counter() - started))
        write_page(staging, _page(summary, pictures), paper)
        text = json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False)
        (staging / SUMMARY).write_text(text + "\n", encoding="utf-8")
    return summary


def _summary(plate: Plate, account: ScanAccount, files_ms: float) -> dict[str, Any]:
    known = np.isfinite(plate.height_mm)
    quantiles = np.percentile(plate.sigma_mm[known], QUANTILES) if known.any() else [math.nan] * 3
    off = plate.places_mm - plate.places_mm[0] - (plate.odometer_mm - plate.odometer_mm[0])
    timing = {**account.timing_ms, "results_files": files_ms}
    out: dict[str, Any] = {
        "format": "annulus-summary/1",
        "method": "fringe",
        "by": plate.by,
        "source": account.source,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "frames": dict(account.frames),
        "points": plate.points,
        "wall": {
            "kind": "plate",
            "distance_mm": plate.distance_mm,
            "x_mm": [float(plate.x_mm[k]) for k in (0, -1)],
            "y_mm": [float(plate.y_mm[k]) for k in (0, -1)],
            "cell_mm": float(plate.x_mm[1] - plate.x_mm[0]) if len(plate.x_mm) > 1 else None,
        },
        "height_mm": {
            "min": float(np.min(plate.height_mm[known])) if known.any() else None,
            "median": float(np.median(plate.height_mm[known])) if known.any() else None,
            "max": float(np.max(plate.height_mm[known])) if known.any() else None,
        },
        "sigma_mm": {f"p{p}": float(q) for p, q in zip(QUANTILES, quantiles, strict=True)},
        "completeness": round(plate.completeness, 5),
        "untold": dict(plate.untold),
        "places": {
            "flashes": len(plate.places_mm),
            "length_mm": float(np.ptp(plate.places_mm)),
            "off_odometer_mm": float(np.max(np.abs(off))),
            "sigma_mm": float(np.max(plate.places_sigma_mm)),
        },
        "drops": dict(account.drops),
        "timing_ms": {name: round(value, 3) for name, value in timing.items()},
        "versions": versions(),
        "warnings": [{"kind": str(w.kind), "text": w.text, "frames": list(w.frames)} for w in plate.findings],
    }
    plain: dict[str, Any] = finite(out)
    return plain


def _write_cloud(path: Path, plate: Plate) -> None:
    points = plate.cloud()
    known = np.isfinite(plate.height_mm)
    records = np.empty(
        len(points),
        dtype=[
            ("x", "<f4"),
            ("y", "<f4"),
            ("z", "<f4"),
            ("red", "u1"),
            ("green", "u1"),
            ("blue", "u1"),
            ("sigma", "<f4"),
        ],
    )
    for axis, name in enumerate("xyz"):
        records[name] = points[:, axis]
    grey = np.clip(plate.light[known], 0, 255).astype(np.uint8)
    for name in ("red", "green", "blue"):
        records[name] = grey
    records["sigma"] = plate.sigma_mm[known]
    write_ply(path, records, note=CLOUD_NOTE)


def _heights(plate: Plate) -> bytes:
    known = plate.height_mm[np.isfinite(plate.height_mm)]
    low, high = np.percentile(known, SCALE_PERCENTILES) if len(known) else (0.0, 0.0)
    usual = float(np.median(plate.sigma_mm[np.isfinite(plate.sigma_mm)])) if len(known) else 0.0
    scale = round_up(max(abs(low), abs(high), 4 * usual))
    # a plate is drawn as a pipe is: towards the head blue, away from it red
    return _map(plate, plate.height_mm, DEVIATION.reversed(), (-scale, scale), "height towards the head, mm", "both")


def _sigma(plate: Plate) -> bytes:
    known = plate.sigma_mm[np.isfinite(plate.sigma_mm)]
    top = round_up(float(np.percentile(known, 98))) if len(known) else 1.0
    return _map(plate, plate.sigma_mm, "viridis", (0.0, top), "sigma of the height (k = 1), mm", "max")


def _map(plate: Plate, values: FloatArray, colours: Any, ends: tuple[float, float], label: str, extend: str) -> bytes:
    half = (plate.x_mm[-1] - plate.x_mm[0]) / max(len(plate.x_mm) - 1, 1) / 2
    extent = (plate.x_mm[0] - half, plate.x_mm[-1] + half, plate.y_mm[-1] + half, plate.y_mm[0] - half)
    wide, tall = extent[1] - extent[0], extent[2] - extent[3]
    with in_style():
        figure = Figure(
            figsize=(WIDTH_IN, min(max(0.9 * (WIDTH_IN - 1.5) * tall / wide + 0.8, 2.5), 8.5)), layout="constrained"
        )
        axes = figure.add_subplot()
        axes.set_facecolor(UNSEEN)
        shown = axes.imshow(values, extent=extent, cmap=colours, vmin=ends[0], vmax=ends[1], interpolation="nearest")
        axes.set_aspect("equal" if 0.1 < tall / wide < 10 else "auto")
        axes.set_xlabel("x, along the motion, mm")
        axes.set_ylabel("y, mm")
        figure.colorbar(shown, ax=axes, label=label, extend=extend, fraction=0.04, pad=0.02)
        return png(figure)


def _page(summary: dict[str, Any], pictures: dict[str, bytes]) -> str:
    return sheet(
        TEMPLATE,
        pictures,
        s=summary,
        source=summary["source"],
        created=minute(summary["created"]),
        version=summary["versions"]["annulus"],
        running=f"Plate inspection: {summary['source']}",
    )
