"""Maps and curves along the pipe, one panel each, over one stretch of it: what single pictures and sheets are made of.

The picture is never finer than the paper: of a long stretch a map shows the farthest departure in each place, so that a
short defect is not lost between two dots, and the mean of the colours.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray
from scipy import ndimage

from annulus_pipe.numeric.arrays import BoolArray, Float32Array
from annulus_pipe.numeric.rounding import MEASURE, PERCENT, SHARE, quoted
from annulus_pipe.numeric.thinning import farthest
from annulus_pipe.report.marks import Mark, draw_marks, name_above
from annulus_pipe.report.paper import (
    BUMP_BLUE,
    DEVIATION,
    FAINT,
    FEATURE,
    HIDDEN,
    INK,
    LOSS_RED,
    UNSEEN,
    bar_beside,
    round_up,
)
from annulus_pipe.wall.defects import ALL_ROUND_DEG, Kind
from annulus_pipe.wall.stations import OVALITY_NAME
from annulus_pipe.wall.survey import Survey

DISTANCE_LABEL = "distance along the pipe, m"
ROWS_MAX = 2400  # of a map: two a dot
HUE_MM = 6.0  # over which a picture's hues are averaged
NOT_SEEN: dict[str, Any] = {"fc": UNSEEN, "hatch": "////", "ec": "#aab1b9", "lw": 0}
SHARED = "#3f8f5b"  # what several cameras saw, and what each did
OWN = ("#e0912f", "#7a5aa6", "#2f79c4", "#b3261e", "#8a6d3b", "#4b2e83", "#0b7285", "#d6336c") * 2
LEGEND_COLUMNS = 4


@dataclass(frozen=True, slots=True)
class Stretch:
    """Part of the pipe: what every panel of a picture shows. rows : of the grid."""

    first_mm: float
    last_mm: float
    rows: slice

    @classmethod
    def of(cls, survey: Survey, first_mm: float, last_mm: float) -> "Stretch":
        first, last = np.searchsorted(survey.wall.z_mm, (first_mm, last_mm))
        return cls(first_mm, last_mm, slice(int(first), int(last)))

    @property
    def length_mm(self) -> float:
        return self.last_mm - self.first_mm

    def extent_of(self, survey: Survey) -> tuple[float, float, float, float]:
        """Where its rows lie, m and degrees, as imshow wants it."""
        z = survey.wall.z_mm[self.rows]
        half = survey.wall.z_step_mm / 2
        return (z[0] - half) / 1000, (z[-1] + half) / 1000, 360.0, 0.0


def lay(panels: Sequence[Any], stretch: Stretch) -> None:
    """One axis for all of them, named at the last."""
    for axes in panels:
        axes.set_xlim(stretch.first_mm / 1000, stretch.last_mm / 1000)
        axes.tick_params(labelbottom=axes is panels[-1])
    panels[-1].set_xlabel(DISTANCE_LABEL)
    panels[-1].ticklabel_format(axis="x", useOffset=False)


def lay_map(axes: Any, stretch: Stretch) -> None:
    """Distance against clock position; what is drawn on it nowhere was not seen."""
    axes.set_facecolor(UNSEEN)
    axes.set_ylim(360, 0)
    axes.set_yticks(range(0, 361, 30), labels=[f"{h % 12 or 12}:00" if h % 3 == 0 else "" for h in range(13)])
    axes.set_ylabel("clock, looking forward")
    first, last = stretch.first_mm / 1000, stretch.last_mm / 1000
    axes.add_patch(Rectangle((first, 0), last - first, 360, fill=False, hatch="////", ec="#aab1b9", lw=0))
    axes.grid(axis="y", color=INK, alpha=0.10, lw=0.6)


def title(axes: Any, text: str, handles: Sequence[Patch], height_mm: float, *, right: str = "") -> None:
    """Above a panel: its title, below it what its shades mean."""
    up = 1 + 4.2 / height_mm
    lift = 1 + (9.6 if handles else 4.8) / height_mm
    axes.text(0, lift, text, transform=axes.transAxes, fontsize=11, fontweight="bold", va="bottom")
    if right:
        axes.text(1.0, lift, right, transform=axes.transAxes, fontsize=9, ha="right", va="bottom", color=FAINT)
    if handles:
        axes.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(0.0, up),
            ncols=len(handles),
            frameon=False,
            fontsize=8.5,
            borderaxespad=0.0,
            borderpad=0.0,
            handlelength=1.6,
            columnspacing=1.4,
        )


def draw_shape(
    figure: Figure,
    axes: Any,
    survey: Survey,
    stretch: Stretch,
    deviation: Float32Array,
    scale: float,
    marks: Sequence[Mark],
    height_mm: float,
    *,
    names: bool = True,
    right: str = "",
) -> None:
    """The deviation of the radius from the mean circle, (Z, A) mm of the whole pipe; its colours end at +-scale."""
    lay_map(axes, stretch)
    hidden = False
    handles = [Patch(label="not seen: in a shadow of the head's parts, or out of its light", **NOT_SEEN)]
    if stretch.rows.start < stretch.rows.stop:
        extent = stretch.extent_of(survey)
        shown = axes.imshow(
            np.ma.masked_invalid(farthest(deviation[stretch.rows], ROWS_MAX).T),
            cmap=DEVIATION,
            vmin=-scale,
            vmax=scale,
            extent=extent,
            aspect="auto",
            interpolation="nearest",
            zorder=2,
        )
        hidden = _draw_hidden(axes, survey, stretch)
        bar_beside(figure, axes, shown, "deviation, mm\n− inwards    outwards +")
    if hidden:
        handles.append(Patch(color=HIDDEN, label="hidden by a step"))
    axes.set_xlim(stretch.first_mm / 1000, stretch.last_mm / 1000)
    draw_marks(axes, marks, height_mm, names=names)
    if not names:
        name_above(axes, marks)
    diameter = quoted(2 * survey.wall.mean_radius_mm, MEASURE)
    title(axes, f"Deviation from the mean circle, Ø {diameter}", handles, height_mm, right=right)


def draw_colour(
    axes: Any,
    survey: Survey,
    stretch: Stretch,
    marks: Sequence[Mark],
    height_mm: float,
    *,
    names: bool = True,
    right: str = "",
) -> None:
    """The wall in its own light."""
    lay_map(axes, stretch)
    axes.set_xlim(stretch.first_mm / 1000, stretch.last_mm / 1000)
    if survey.texture is None:
        axes.text(0.5, 0.5, f"no usable frames in {survey.light}", transform=axes.transAxes, ha="center", fontsize=13)
    elif stretch.rows.start < stretch.rows.stop:
        axes.imshow(
            calm(mean_colour(survey.texture[stretch.rows]), _cell_mm(survey, stretch)).swapaxes(0, 1),
            extent=stretch.extent_of(survey),
            aspect="auto",
            interpolation="antialiased",
            zorder=2,
        )
    axes.set_xlim(stretch.first_mm / 1000, stretch.last_mm / 1000)
    draw_marks(axes, marks, height_mm, names=names)
    if not names:
        name_above(axes, marks)
    handles = [Patch(label="not seen", **NOT_SEEN)]
    title(axes, f"Wall in {survey.light}, brightness evened out", handles, height_mm, right=right)


def draw_cameras(figure: Figure, both: Sequence[Any], survey: Survey, stretch: Stretch, height_mm: float) -> None:
    """Which camera saw each cell, and how well those that did know its radius."""
    wall = survey.wall
    for axes in both:
        lay_map(axes, stretch)
    every = max(-(-len(wall.z_mm) // ROWS_MAX), 1)
    who = wall.seen_by(len(survey.cameras))[::every]
    names = [*(f"camera {one} alone" for one in survey.cameras), "more than one"]
    shades = [*OWN[: len(survey.cameras)], SHARED]
    extent, more = stretch.extent_of(survey), len(names) + 0.5
    both[0].imshow(
        np.ma.masked_equal(who.T, 0),
        cmap=ListedColormap(shades[: len(names)]),
        vmin=0.5,
        vmax=more,
        extent=extent,
        aspect="auto",
        interpolation="nearest",
        zorder=2,
    )
    _draw_hidden(both[0], survey, stretch)
    share = survey.seen_by_fraction()
    patches = [
        Patch(color=shade, label=f"{name}: {quoted(100 * part, SHARE)}")
        for shade, name, part in zip(shades, names, share.values(), strict=False)
    ]
    none = f"none: {quoted(100 * (1 - survey.seen_fraction), SHARE)}"
    patches += [Patch(color=HIDDEN, label="hidden by a step"), Patch(label=none, **NOT_SEEN)]
    columns = min(len(patches), LEGEND_COLUMNS)
    lines = -(-len(patches) // columns)
    both[0].legend(
        handles=patches, loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=columns, frameon=False, fontsize=8.5
    )
    both[0].set_title("Which camera saw the wall", loc="left", fontsize=11, fontweight="bold", pad=16 * (lines + 0.6))
    known = wall.sigma_mm[np.isfinite(wall.sigma_mm)]
    top = round_up(float(np.percentile(known, 98))) if len(known) else 1.0
    shown = both[1].imshow(
        np.ma.masked_invalid(wall.sigma_mm[::every].T),
        cmap="viridis_r",
        vmin=0,
        vmax=top,
        extent=extent,
        aspect="auto",
        interpolation="nearest",
        zorder=2,
    )
    title(both[1], "How well a point's radius is known, one standard deviation", [], height_mm)
    bar_beside(figure, both[1], shown, "mm")


def draw_diameters(axes: Any, survey: Survey, stretch: Stretch, height_mm: float) -> None:
    """Smallest, mean and largest diameter of every station."""
    stations, nominal_mm = survey.stations, survey.nominal_diameter_mm
    part = _part(survey, stretch)
    z = stations.z_mm[part] / 1000
    low, high = stations.diameter_min_mm[part], stations.diameter_max_mm[part]
    axes.fill_between(z, low, high, color="#9fb8d1", alpha=0.6, lw=0)
    axes.plot(z, low, color=BUMP_BLUE, lw=1.0, label="smallest")
    axes.plot(z, high, color=LOSS_RED, lw=1.0, label="largest")
    axes.plot(z, stations.diameter_mean_mm[part], color=INK, lw=1.8, label="mean")
    calibrated = f"calibrated pipe {quoted(nominal_mm, MEASURE)}"
    axes.axhline(nominal_mm, color=FAINT, lw=0.9, ls=(0, (5, 4)), label=calibrated)
    axes.set_ylabel("diameter, mm")
    axes.ticklabel_format(axis="y", useOffset=False)
    _lay_curves(axes, survey, height_mm)


def draw_ovality(axes: Any, survey: Survey, stretch: Stretch, height_mm: float) -> None:
    stations, limit = survey.stations, survey.detection.limits.ovality_percent
    part = _part(survey, stretch)
    z = stations.z_mm[part] / 1000
    axes.plot(
        z, stations.ovality_percent[part], color=FAINT, lw=1.0, label=f"{OVALITY_NAME} as measured, defects included"
    )
    axes.plot(z, stations.shape_ovality_percent[part], color=INK, lw=1.8, label="pipe's shape, defects left out")
    above = f"listed above {quoted(limit, PERCENT)}"
    axes.axhline(limit, color=LOSS_RED, lw=0.9, ls=(0, (5, 4)), label=above)
    axes.set_ylabel("ovality, %")
    axes.set_ylim(bottom=0)
    _lay_curves(axes, survey, height_mm)


def draw_seen(axes: Any, survey: Survey, stretch: Stretch, height_mm: float) -> None:
    stations = survey.stations
    part = _part(survey, stretch)
    seen = 100 * stations.valid_fraction[part]
    axes.fill_between(stations.z_mm[part] / 1000, seen, step="mid", color="#7d94a8", alpha=0.8, lw=0)
    axes.set_ylim(0, 100)
    axes.set_ylabel("seen, %")
    _lay_curves(axes, survey, height_mm)


def _lay_curves(axes: Any, survey: Survey, height_mm: float) -> None:
    axes.grid(color=INK, alpha=0.10, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    for first, last, colour in _bands(survey):
        axes.axvspan(first / 1000, last / 1000, color=colour, alpha=0.09, lw=0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1 + 3.8 / height_mm),
            ncols=4,
            frameon=False,
            fontsize=8.5,
            borderaxespad=0.0,
            borderpad=0.0,
            columnspacing=1.4,
        )


def _bands(survey: Survey) -> Iterator[tuple[float, float, str]]:
    for defect in survey.defects:
        if defect.kind is not Kind.OVALITY:
            yield *defect.z_range_mm, LOSS_RED if defect.kind is Kind.LOSS else BUMP_BLUE
    for feature in survey.features:
        if feature.arc_deg >= ALL_ROUND_DEG:
            yield *feature.z_range_mm, FEATURE


def _part(survey: Survey, stretch: Stretch) -> BoolArray:
    z = survey.stations.z_mm
    return np.asarray((z >= stretch.first_mm) & (z <= stretch.last_mm))


def _draw_hidden(axes: Any, survey: Survey, stretch: Stretch) -> bool:
    """What a step hides, as one dark grey; whether there is any."""
    hidden = survey.shadowed[stretch.rows][:: max(-(-(stretch.rows.stop - stretch.rows.start) // ROWS_MAX), 1)]
    axes.imshow(
        np.ma.masked_equal(hidden.T, False),
        cmap=ListedColormap([HIDDEN]),
        extent=stretch.extent_of(survey),
        aspect="auto",
        interpolation="nearest",
        zorder=3,
    )
    return bool(hidden.any())


def mean_colour(rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """At most ROWS_MAX rows of it, each the mean of the seen ones; colours are 0 where alpha is."""
    if len(rgba) <= ROWS_MAX:
        return rgba
    mean = cv2.resize(rgba, (rgba.shape[1], ROWS_MAX), interpolation=cv2.INTER_AREA).astype(np.float32)
    alpha = mean[..., 3:]
    colour = np.clip(mean[..., :3] * 255 / np.maximum(alpha, 1), 0, 255)
    return np.concatenate([colour, np.where(alpha > 0, 255, 0)], axis=2).astype(np.uint8)


def calm(rgba: NDArray[np.uint8], cell_mm: tuple[float, float]) -> NDArray[np.uint8]:
    """The same with hues of the neighbourhood, `HUE_MM` wide, at each place's own lightness.

    Where the light was weak a pixel's noise is most of its hue, and a wall far ahead is a rainbow; lightness has the
    marks and the print. cell_mm : size of a cell along and round the pipe.
    """
    lab = cv2.cvtColor(np.ascontiguousarray(rgba[..., :3]), cv2.COLOR_RGB2LAB)
    seen = (rgba[..., 3] > 0).astype(np.float32)
    sigma = [HUE_MM / 2 / cell for cell in cell_mm]
    weight = ndimage.gaussian_filter(seen, sigma, mode=("nearest", "wrap"))
    for channel in (1, 2):
        hue = (lab[..., channel].astype(np.float32) - 128.0) * seen
        mean = ndimage.gaussian_filter(hue, sigma, mode=("nearest", "wrap")) / np.maximum(weight, 1e-6)
        lab[..., channel] = np.clip(np.rint(mean) + 128.0, 0, 255).astype(np.uint8)
    return np.dstack([cv2.cvtColor(lab, cv2.COLOR_LAB2RGB), rgba[..., 3]])


def _cell_mm(survey: Survey, stretch: Stretch) -> tuple[float, float]:
    """Of a map's cell, along and round the pipe."""
    wall = survey.wall
    rows = max(stretch.rows.stop - stretch.rows.start, 1)
    return wall.z_step_mm * max(rows / ROWS_MAX, 1.0), math.radians(wall.clock_step_deg) * wall.mean_radius_mm
