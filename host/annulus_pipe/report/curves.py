"""Curves along the pipe: diameters, ovality, and how much of the wall was seen, at every station."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray
from annulus_pipe.numeric.rounding import MEASURE, PERCENT, quoted
from annulus_pipe.report.marks import WallMark, name_above
from annulus_pipe.report.names import BUMP_BLUE, FAINT, FEATURE, INK, LOSS_RED
from annulus_pipe.report.paper import Stretch, png, stack
from annulus_pipe.wall.defects import ALL_ROUND_DEG, Kind
from annulus_pipe.wall.stations import OVALITY_NAME
from annulus_pipe.wall.survey import Survey

PANELS = ((10.0, 40.0), (9.0, 26.0), (4.0, 12.0))  # mm on paper: room above each, its height


def stations(survey: Survey, whole: Stretch, marks: Sequence[WallMark]) -> bytes:
    """All three of the whole pipe, as PNG."""
    figure, axes = stack(PANELS, whole)
    for draw, one, (_, height) in zip((draw_diameters, draw_ovality, draw_seen), axes, PANELS, strict=True):
        draw(one, survey, whole, height)
    name_above(axes[0], marks)
    return png(figure)


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
