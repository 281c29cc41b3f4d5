"""A model of a capacitive head as files: model.json, and pictures like Figures 10.3 and 10.5 and of the GTI's pipes."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.tri import Triangulation

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.report.names import BUMP_BLUE, FAINT, INK, LOSS_RED
from annulus_pipe.report.paper import WIDTH_IN, in_style, png
from annulus_pipe.vocabulary import AnnulusError

STRENGTH_V_M = (0.3, 300.0)  # shown of |E| at 1 V
AROUND_MM = 110.0  # shown of what surrounds the pipe
Map = tuple[FloatArray, FloatArray]  # (n, 2) mm and (n,) V/m


def write_model(
    folder: Path, figures: Mapping[str, Any], curves: Mapping[str, FloatArray], maps: Mapping[str, Map]
) -> list[Path]:
    """Writes model.json and the pictures into the folder, made if need be; their paths. AnnulusError where they cannot
    be written."""
    whole = {**figures, "curves": {name: np.asarray(curve).tolist() for name, curve in curves.items()}}
    with in_style():
        pictures = {
            "field.png": png(_fields(figures, maps)),
            "passing.png": png(_passing(figures, curves)),
            "bores.png": png(_bores(figures)),
        }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "model.json").write_text(json.dumps(whole, allow_nan=False, indent=1))
        for name, picture in pictures.items():
            (folder / name).write_bytes(picture)
    except OSError as error:
        raise AnnulusError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
    return [folder / name for name in ("model.json", *pictures)]


def _fields(figures: Mapping[str, Any], maps: Mapping[str, Map]) -> Figure:
    """Like Figure 10.3: in soil, at a pocket of air; along the pipe above, across it below."""
    figure = Figure(figsize=(WIDTH_IN, 8.4), layout="constrained")
    axes = figure.subplots(2, 2, height_ratios=(1.0, 1.6))
    pocket, along = figures["pocket"], figures["along"]
    titles = {
        "soil": f"in soil, eps {figures['soil_eps']:g}: {along['soil']['differential_pf']:.3f} pF",
        "bore": f"{pocket['length_mm']:g} mm of air: {pocket['change_ff']:+.0f} fF",
        "across_soil": f"across, in soil: {figures['across_pf']['soil'][0]:.3f} pF",
        "across_air": f"across, in air: {figures['across_pf']['air'][0]:.3f} pF",
    }
    drawn = None
    for one, (name, title) in zip(axes.flat, titles.items(), strict=True):
        points, strength = maps[name]
        across = name.startswith("across")
        near = np.abs(points).max(axis=1) < 1.3 * AROUND_MM
        drawn = one.tripcolor(
            Triangulation(*points[near].T),
            np.clip(strength[near], *STRENGTH_V_M),
            norm=LogNorm(*STRENGTH_V_M),
            cmap="inferno",
            shading="gouraud",
            rasterized=True,
        )
        (_across if across else _along)(one, figures)
        if name == "bore":
            for side in (-1, 1):
                one.plot(
                    [side * pocket["length_mm"] / 2] * 2, [figures["pipe"]["outer_radius_mm"], AROUND_MM], ":w", lw=1
                )
        one.set_title(title, fontsize=10)
    assert drawn is not None
    figure.colorbar(drawn, ax=axes, label="|E| at 1 V, V/m", shrink=0.7)
    figure.suptitle("Field of the sectors (one electrode of a pair at 1 V, its shield with it)", fontsize=11)
    return figure


def _along(axes: Axes, figures: Mapping[str, Any]) -> None:
    head, pipe = figures["head"], figures["pipe"]
    axes.axhspan(0, head["radius_mm"] - 1.6, color="#3c444d", lw=0)
    for side in (-1, 1):
        ends = np.sort(side * (head["apart_mm"] / 2 + np.array([0, head["electrode_mm"]])))
        axes.plot(ends, [head["radius_mm"]] * 2, color="#7fd1ff", lw=2.5)
    for radius in (pipe["inner_radius_mm"], pipe["outer_radius_mm"]):
        axes.axhline(radius, color="white", lw=0.7)
    axes.set(xlim=(-AROUND_MM, AROUND_MM), ylim=(0, AROUND_MM), xlabel="along the pipe, mm", ylabel="off its axis, mm")
    axes.set_aspect("equal")


def _across(axes: Axes, figures: Mapping[str, Any]) -> None:
    head, pipe = figures["head"], figures["pipe"]
    axes.add_patch(Circle((0, 0), head["radius_mm"] - 1.6, fc="#3c444d", ec="none", zorder=3))
    for looks in figures["looks_deg"]:
        phi = np.radians(looks + np.linspace(-0.5, 0.5, 40) * head["sector_deg"])
        axes.plot(head["radius_mm"] * np.cos(phi), head["radius_mm"] * np.sin(phi), color="#7fd1ff", lw=2.5, zorder=4)
    for radius in (pipe["inner_radius_mm"], pipe["outer_radius_mm"]):
        axes.add_patch(Circle((0, 0), radius, fc="none", ec="white", lw=0.7, zorder=3))
    axes.set(xlim=(-80, 80), ylim=(80, -80), xlabel="x, mm", ylabel="y (down), mm")
    axes.set_aspect("equal")


def _passing(figures: Mapping[str, Any], curves: Mapping[str, FloatArray]) -> Figure:
    """Like Figure 10.5, by place in place of time: from air into soil; and how deep the head sees."""
    figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(curves["place_mm"], curves["differential_pf"], color=BUMP_BLUE, label="pair driven against each other")
    left.set(xlabel="place of the head, mm (soil from 0 on)", ylabel="differential, pF")
    other = left.twinx()
    other.plot(curves["place_mm"], curves["mutual_pf"], color=LOSS_RED, ls="--", label="single-ended, mutual")
    other.set_ylabel("mutual, pF", color=LOSS_RED)
    left.axvline(0, color=FAINT, lw=0.8)
    left.set_title(f"from air into soil: {figures['swing_ff']:+.0f} fF differential", fontsize=10)
    handles = [*left.get_lines()[:1], *other.get_lines()]
    left.legend(handles=handles, frameon=False, fontsize=8.5, loc="center left")
    right.plot(curves["depth_mm"], 100 * curves["lost_share"], color=INK)
    half, theirs = figures["half_depth_mm"], figures["half_depth_prototype_mm"]
    right.plot([half], [50], "o", color=BUMP_BLUE, label=f"model: half within {half:.1f} mm")
    right.plot([theirs], [50], "x", color=LOSS_RED, ms=9, label=f"prototype's: {theirs:g} mm")
    right.set(xlabel="layer of air between wall and soil, mm", ylabel="of the swing lost, %", xlim=(0, None))
    right.set_ylim(0, 100)
    right.legend(frameon=False, fontsize=8.5, loc="lower right")
    right.set_title(
        f"the swing is {100 * figures['swing_of_standing']:.0f} % of what stands in air,\n"
        f"{100 * figures['swing_of_standing_shield_off']:.1f} % with the shield at earth",
        fontsize=10,
    )
    return figure


def _bores(figures: Mapping[str, Any]) -> Figure:
    """Pipes A, B and C: where the sewer lies, and what each sector loses or gains."""
    air = [row for row in figures["bores"] if row["fill"] == "air"]
    water = {row["case"]: row for row in figures["bores"] if row["fill"] == "water"}
    figure = Figure(figsize=(WIDTH_IN, 6.4), layout="constrained")
    axes = figure.subplots(2, len(air), height_ratios=(1.0, 1.3))
    for k, row in enumerate(air):
        _place(axes[0, k], figures, row)
        one = axes[1, k]
        at = np.arange(len(row["change_ff"]), dtype=float)
        for shift, values, colour, name in (
            (-0.25, row["change_ff"], BUMP_BLUE, "air"),
            (0.25, water[row["case"]]["change_ff"], "#4a9d8e", "water"),
        ):
            bars = one.bar(at + shift, values, 0.45, color=colour, label=name)
            one.bar_label(bars, labels=[_short(value) for value in values], fontsize=7.5, padding=2)
        theirs = [(n, value) for n, value in enumerate(row["prototype_ff"]) if value is not None]
        one.plot(
            [n - 0.25 for n, _ in theirs],
            [v for _, v in theirs],
            "_",
            color=LOSS_RED,
            ms=16,
            mew=2,
            label="prototype, air",
        )
        one.axhline(0, color=FAINT, lw=0.8)
        one.set(ylim=(-300, 80), xticks=at, xticklabels=[f"{deg:g}°" for deg in figures["looks_deg"]])
        one.set_xlabel("sector looks at")
        if k == 0:
            one.set_ylabel("change, fF")
        if k == len(air) - 1:
            one.legend(frameon=False, fontsize=8.5, loc="lower right")
    return figure


def _short(femtofarad: float) -> str:
    return f"{femtofarad:+.0f}" if abs(femtofarad) >= 0.95 else f"{femtofarad:+.1f}"


def _place(axes: Axes, figures: Mapping[str, Any], row: Mapping[str, Any]) -> None:
    """Across the pipe: the sewer is a strip there."""
    phi = np.radians(row["phi_deg"])
    normal = np.array([np.cos(phi), np.sin(phi)])
    corner = normal * (row["offset_mm"] - row["radius_mm"]) - 300 * np.array([np.sin(phi), -np.cos(phi)])
    axes.set_facecolor("#cdb89a")
    axes.add_patch(
        Rectangle(
            (float(corner[0]), float(corner[1])),
            600,
            2 * row["radius_mm"],
            angle=row["phi_deg"] - 90,
            fc="#f2f6fa",
            ec=FAINT,
            lw=0.8,
        )
    )
    pipe, head = figures["pipe"], figures["head"]
    axes.add_patch(Circle((0, 0), pipe["outer_radius_mm"], fc="#f3d34a", ec=INK, lw=0.8))
    axes.add_patch(Circle((0, 0), pipe["inner_radius_mm"], fc="white", ec=INK, lw=0.8))
    for looks in figures["looks_deg"]:
        turn = np.radians(looks + np.linspace(-0.5, 0.5, 30) * head["sector_deg"])
        axes.plot(head["radius_mm"] * np.cos(turn), head["radius_mm"] * np.sin(turn), color=BUMP_BLUE, lw=2.5)
    axes.set(xlim=(-120, 120), ylim=(150, -90), xticks=[], yticks=[])
    axes.set_aspect("equal")
    axes.set_title(f"pipe {row['pipe']}: {row['case']}", fontsize=10)
