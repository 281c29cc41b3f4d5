"""A capacitive log as a picture: the three sectors along the pipe, ten metres a row, with what was found."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from annulus_pipe.hooks import Sheet
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.report.names import BUMP_BLUE, FAINT, FEATURE, INK, LOSS_RED, UNSEEN
from annulus_pipe.report.paper import WIDTH_IN, in_style, png
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.lane import Lane

ROW_M = 10.0
ROWS_MAX = 60  # a longer log has longer rows
COLOURS = {"air": LOSS_RED, "part": "#b36b1e", "water": BUMP_BLUE}  # those that are bores
SECTORS = ("#1c2733", "#2a7f62", "#8a5fb0")


def write_bores(
    path: Path,
    bores: Sequence[Mapping[str, Any]],
    others: Sequence[Mapping[str, Any]],
    z_mm: FloatArray,
    c_ff: FloatArray,
    seen: BoolArray,
) -> list[Path]:
    """Bores as JSON, a list, and a picture beside it with .png for a suffix; their paths.

    bores, others : odometer_mm, kind, extent_mm, and phi_deg where it is told. c_ff : (G, 3) by sector along z_mm (G,),
    drawn where seen (G,).
    """
    picture = path.with_suffix(".png")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(bores, allow_nan=False, indent=1) + "\n")
        with in_style():
            picture.write_bytes(png(_lanes([*others, *bores], z_mm / 1000, c_ff / 1000, seen)))
    except OSError as error:
        raise AnnulusError(f"{error.filename or path}: cannot be written ({error.strerror})") from None
    return [path, picture]


NOTE = (
    "What each sector reads through the wall: it falls beside air. A cross bore is a sewer that the pipe was drilled "
    "through; it is listed among the features. Probability: how often a place called so was that in simulated pipes of "
    "two drawers; of a street it says no more."
)


def sheet_of(lane: Lane) -> Sheet:
    """The same of a survey; its places are the map's."""
    shows = "Capacitance of each sector over distance, with what was found"
    summary = {"sectors": {"told": lane.remark, "places": [asdict(mark) for mark in lane.marks]}}
    return Sheet("Behind the wall: capacitive sectors", draw_lane(lane), shows, f"{NOTE} {lane.remark}", summary)


def draw_lane(lane: Lane) -> bytes:
    marks = [
        {"odometer_mm": one.z_mm, "extent_mm": one.length_mm, "kind": one.kind, "probability": one.probability}
        | ({"phi_deg": one.phi_deg} if math.isfinite(one.phi_deg) else {})
        for one in lane.marks
    ]
    with in_style():
        return png(_lanes(marks, lane.z_mm / 1000, lane.c_pf, lane.seen, "distance along the pipe, m"))


def _lanes(
    marks: Sequence[Mapping[str, Any]], z: FloatArray, c: FloatArray, seen: BoolArray, label: str = "odometer, m"
) -> Figure:
    row_m = max(ROW_M, float(np.ptp(z)) / ROWS_MAX)
    count = max(1, math.ceil(float(np.ptp(z)) / row_m - 0.05))
    figure = Figure(figsize=(WIDTH_IN, 1.0 + 1.25 * count), layout="constrained")
    rows = figure.subplots(count, sharey=True, squeeze=False)[:, 0]
    c = np.where(seen[:, None], c, np.nan)
    for k, axes in enumerate(rows):
        low = float(z[0]) + k * row_m
        high = low + row_m if k < count - 1 else float(z[-1]) if count == 1 else max(low + row_m, float(z[-1]))
        here = (z >= low) & (z <= high)
        for sector in range(c.shape[1]):
            axes.plot(z[here], c[here, sector], color=SECTORS[sector], lw=0.8, label=f"sector {sector + 1}")
        axes.fill_between(z[here], 0, 1, where=~seen[here], transform=axes.get_xaxis_transform(), color=UNSEEN, lw=0)
        axes.set(xlim=(low, high), ylabel="pF")
        axes.grid(visible=True, color=FAINT, lw=0.3, alpha=0.5)
        for one in marks:
            if low <= one["odometer_mm"] / 1000 < high:
                _mark(axes, one)
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=8, frameon=False)
    rows[-1].set_xlabel(label)
    return figure


def _mark(axes: Axes, one: Mapping[str, Any]) -> None:
    z, half = one["odometer_mm"] / 1000, 0.5 * max(one["extent_mm"], 20.0) / 1000
    bore = one["kind"] in COLOURS
    axes.axvspan(z - half, z + half, color=COLOURS.get(one["kind"], FEATURE), alpha=0.25 if bore else 0.1, lw=0)
    where = f" {clock(one['phi_deg'])}" if "phi_deg" in one and bore else ""
    likely = one.get("probability", math.nan)
    sure = f" {100 * likely:.0f} %" if bore and math.isfinite(likely) else ""
    axes.annotate(
        f"{one['kind']}{where}{sure}",
        (z, 0.03 if bore else 0.9),
        xycoords=("data", "axes fraction"),
        ha="center",
        fontsize=7,
        weight="bold" if bore else "normal",
        color=INK if bore else FAINT,
    )


def clock(phi_deg: float) -> str:
    """Hour on the wall as seen looking ahead: 270 is 12:00, 0 is 3:00, 90 is 6:00."""
    minutes = round(((phi_deg - 270.0) % 360) * 2 / 10) * 10 % 720
    return f"{(minutes // 60) or 12}:{minutes % 60:02d}"
