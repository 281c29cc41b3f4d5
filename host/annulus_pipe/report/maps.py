"""Maps of the wall, clock position against distance: deviation, colour, which camera saw what.

The picture is never finer than the paper: of a long stretch a map shows the farthest departure in each place, so that a
short defect is not lost between two dots, and the mean of the colours.
"""

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import Float32Array
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.rounding import MEASURE, SHARE, quoted
from annulus_pipe.numeric.thinning import farthest
from annulus_pipe.report.marks import WallMark, draw_marks, name_above
from annulus_pipe.report.names import FAINT, HIDDEN, INK, UNSEEN, round_up
from annulus_pipe.report.paper import AXES_MM, DEVIATION, Stretch, bar_beside, png, scale_of, stack
from annulus_pipe.wall.survey import Survey

ROWS_MAX = 2400  # of a map: two a dot
HUE_MM = 6.0  # over which a picture's hues are averaged
ABOVE_MM = 17.0  # a map's title, legend and brackets
MAP_MM = (60.0, 92.0)  # least and greatest height of a map
NOT_SEEN: dict[str, Any] = {"fc": UNSEEN, "hatch": "////", "ec": "#aab1b9", "lw": 0}
SHARED = "#3f8f5b"  # what several cameras saw, and what each did
OWN = ("#e0912f", "#7a5aa6", "#2f79c4", "#b3261e", "#8a6d3b", "#4b2e83", "#0b7285", "#d6336c") * 2
LEGEND_COLUMNS = 4


def unwrapped(
    survey: Survey, whole: Stretch, deviation: Float32Array, scale: float, marks: Sequence[WallMark], names: bool
) -> bytes:
    """The deviation of the whole pipe, as PNG."""
    height = height_of(survey, whole)
    figure, (axes,) = stack([(ABOVE_MM, height)], whole)
    right = scales(survey, whole.length_mm, height)
    draw_shape(figure, axes, survey, whole, deviation, scale, marks, height, names=names, right=right)
    return png(figure)


def texture(survey: Survey, whole: Stretch, marks: Sequence[WallMark], names: bool) -> bytes:
    """The colour of the whole pipe, as PNG."""
    height = height_of(survey, whole)
    figure, (axes,) = stack([(ABOVE_MM, height)], whole)
    draw_colour(axes, survey, whole, marks, height, names=names, right=scales(survey, whole.length_mm, height))
    return png(figure)


def height_of(survey: Survey, stretch: Stretch) -> float:
    """Of a map, mm on paper: true to scale where that fits a page."""
    round_mm = 2 * math.pi * survey.wall.mean_radius_mm
    return float(np.clip(AXES_MM * round_mm / max(stretch.length_mm, 1.0), *MAP_MM))


def scales(survey: Survey, length_mm: float, height_mm: float) -> str:
    """In words, of a map so long and so high on paper."""
    round_mm = 2 * math.pi * survey.wall.mean_radius_mm
    return f"{scale_of(length_mm, AXES_MM)} along, {scale_of(round_mm, height_mm)} round"


def draw_shape(
    figure: Figure,
    axes: Any,
    survey: Survey,
    stretch: Stretch,
    deviation: Float32Array,
    scale: float,
    marks: Sequence[WallMark],
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
        values = np.ma.masked_invalid(farthest(deviation[stretch.rows], ROWS_MAX).T)
        shown = _lay(axes, survey, stretch, values, cmap=DEVIATION, vmin=-scale, vmax=scale)
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
    marks: Sequence[WallMark],
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
        values = calm(mean_colour(survey.texture[stretch.rows]), _cell_mm(survey, stretch)).swapaxes(0, 1)
        _lay(axes, survey, stretch, values, interpolation="antialiased")
    axes.set_xlim(stretch.first_mm / 1000, stretch.last_mm / 1000)
    draw_marks(axes, marks, height_mm, names=names)
    if not names:
        name_above(axes, marks)
    handles = [Patch(label="not seen", **NOT_SEEN)]
    title(axes, f"Wall in {survey.light}, brightness evened out", handles, height_mm, right=right)


def cameras(survey: Survey, stretch: Stretch) -> bytes:
    """Which camera saw each cell, and how well those that did know its radius, as PNG."""
    wall = survey.wall
    height_mm = 0.8 * height_of(survey, stretch)
    figure, both = stack([(ABOVE_MM + 6, height_mm), (10.0, height_mm)], stretch)
    for axes in both:
        lay_map(axes, stretch)
    every = max(-(-len(wall.z_mm) // ROWS_MAX), 1)
    who = wall.seen_by(len(survey.cameras))[::every]
    names = [*(f"camera {one} alone" for one in survey.cameras), "more than one"]
    shades = [*OWN[: len(survey.cameras)], SHARED]
    colours = ListedColormap(shades[: len(names)])
    _lay(both[0], survey, stretch, np.ma.masked_equal(who.T, 0), cmap=colours, vmin=0.5, vmax=len(names) + 0.5)
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
    sigma = np.ma.masked_invalid(wall.sigma_mm[::every].T)
    shown = _lay(both[1], survey, stretch, sigma, cmap="viridis_r", vmin=0, vmax=top)
    title(both[1], "How well a point's radius is known, one standard deviation", [], height_mm)
    bar_beside(figure, both[1], shown, "mm")
    return png(figure)


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


def _lay(axes: Any, survey: Survey, stretch: Stretch, values: Any, **more: Any) -> Any:
    """Values or colours, (A, Z), over the stretch."""
    return axes.imshow(
        values, extent=stretch.extent_of(survey), aspect="auto", **({"interpolation": "nearest", "zorder": 2} | more)
    )


def _draw_hidden(axes: Any, survey: Survey, stretch: Stretch) -> bool:
    """What a step hides, as one dark grey; whether there is any."""
    hidden = survey.shadowed[stretch.rows][:: max(-(-(stretch.rows.stop - stretch.rows.start) // ROWS_MAX), 1)]
    _lay(axes, survey, stretch, np.ma.masked_equal(hidden.T, False), cmap=ListedColormap([HIDDEN]), zorder=3)
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
