"""One small picture of every feature, and of what could not be decided: the map about it, or the radius along it."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from annulus_pipe.numeric.arrays import BoolArray
from annulus_pipe.numeric.rounding import clock_face
from annulus_pipe.report.names import BUMP_BLUE, FAINT, FEATURE, INK, LOSS_RED, UNSEEN, letter, question, round_up
from annulus_pipe.report.paper import DEVIATION, DISTANCE_LABEL, DPI, png
from annulus_pipe.wall.defects import ALL_ROUND_DEG
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.survey import Survey

SIZE_IN = (4.2, 2.7)
AROUND_OF_RADIUS = 0.35  # part of the radius: how much of its surroundings a picture shows, on each side
LONGEST_OF_RADIUS = 6.0  # a longer one is shown by a stretch about its middle
SEEN = 0.2  # part of the circle: fewer directions make no middle, least and greatest of a station


def draw_features(survey: Survey) -> tuple[tuple[str, bytes], ...]:
    """Name and PNG of every feature that can be seen from inside, then of every undecided place, in their order."""
    features = [
        (letter(i), f.z_range_mm, f.clock_deg, f.arc_deg)
        for i, f in enumerate(survey.features)
        if f.kind is not FeatureKind.CROSS_BORE
    ]
    places = [(question(i), d.z_range_mm, d.clock_deg, d.arc_deg) for i, d in enumerate(survey.detection.undecided)]
    return tuple((name, _picture(survey, z, clock, arc)) for name, z, clock, arc in (*features, *places))


def _picture(survey: Survey, z_range: tuple[float, float], clock_deg: float, arc_deg: float) -> bytes:
    figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    wall = survey.wall
    around = AROUND_OF_RADIUS * wall.mean_radius_mm
    middle, half = sum(z_range) / 2, LONGEST_OF_RADIUS / 2 * wall.mean_radius_mm
    first, last = max(z_range[0], middle - half) - around, min(z_range[1], middle + half) + around
    rows = (wall.z_mm >= first) & (wall.z_mm <= last)
    if not rows.any():
        axes.text(0.5, 0.5, "nothing of it was seen", transform=axes.transAxes, ha="center")
        axes.set_axis_off()
    elif arc_deg >= ALL_ROUND_DEG:
        _profile(axes, survey, rows, z_range)
    else:
        _crop(figure, axes, survey, rows, z_range, clock_deg, arc_deg)
    return png(figure)


def _profile(axes: Any, survey: Survey, rows: BoolArray, z_range: tuple[float, float]) -> None:
    """The radius along the pipe: the middle over the clock, and from the least to the greatest."""
    radius, z = survey.wall.radius_mm[rows].astype(float), survey.wall.z_mm[rows] / 1000
    enough = np.isfinite(radius).mean(axis=1) >= SEEN
    low, middle, high = (np.full(len(z), np.nan) for _ in range(3))
    if enough.any():
        low[enough], middle[enough], high[enough] = np.nanpercentile(radius[enough], [0, 50, 100], axis=1)
    axes.fill_between(z, low, high, color="#9fb8d1", alpha=0.6, lw=0, label="least to greatest")
    axes.plot(z, low, color=BUMP_BLUE, lw=0.8)
    axes.plot(z, high, color=LOSS_RED, lw=0.8)
    axes.plot(z, middle, color=INK, lw=1.6, label="middle over the clock")
    axes.axvspan(z_range[0] / 1000, z_range[1] / 1000, color=FEATURE, alpha=0.10, lw=0)
    axes.set_xlim(z[0], z[-1] if len(z) > 1 else z[0] + 0.001)
    axes.set_xlabel(DISTANCE_LABEL)
    axes.locator_params(axis="x", nbins=5)
    axes.set_ylabel("radius, mm")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(color=INK, alpha=0.10, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=7.5, loc="best")


def _crop(
    figure: Figure,
    axes: Any,
    survey: Survey,
    rows: BoolArray,
    z_range: tuple[float, float],
    clock_deg: float,
    arc_deg: float,
) -> None:
    """The map of the deviation about it, 12 o'clock no edge, in colours of its own."""
    wall = survey.wall
    step = wall.clock_step_deg
    reach = min(arc_deg / 2 + np.degrees(AROUND_OF_RADIUS), 180.0)
    offset = np.arange(-np.floor(reach / step), np.floor(reach / step) + 1) * step
    columns = np.floor(((clock_deg + offset) % 360.0) / step).astype(int) % len(wall.clock_deg)
    deviation = wall.deviation_mm()[rows][:, columns]
    known = np.abs(deviation[np.isfinite(deviation)])
    scale = round_up(max(float(np.percentile(known, 98)) if len(known) else 0.0, 10 * survey.noise_mm, 0.5))
    z = wall.z_mm[rows] / 1000
    half = wall.z_step_mm / 2000
    top, bottom = offset[0] - step / 2, offset[-1] + step / 2
    axes.set_facecolor(UNSEEN)
    image = axes.imshow(
        np.ma.masked_invalid(deviation.T),
        cmap=DEVIATION,
        vmin=-scale,
        vmax=scale,
        aspect="auto",
        extent=(z[0] - half, z[-1] + half, bottom, top),
        interpolation="nearest",
    )
    first, last = (end / 1000 for end in z_range)
    axes.add_patch(Rectangle((first, -arc_deg / 2), last - first, arc_deg, fill=False, ec=FEATURE, lw=1.2))
    ticks = np.linspace(-arc_deg / 2, arc_deg / 2, 3)
    axes.set_yticks(ticks, labels=[clock_face(clock_deg + tick) for tick in ticks])
    axes.set_xlim(z[0] - half, z[-1] + half)
    axes.set_ylim(bottom, top)
    axes.set_xlabel(DISTANCE_LABEL)
    axes.locator_params(axis="x", nbins=5)
    axes.tick_params(colors=INK, labelsize=9)
    bar = figure.colorbar(image, ax=axes, pad=0.02, fraction=0.06)
    bar.set_label("deviation, mm", fontsize=9)
    bar.outline.set_edgecolor(FAINT)
