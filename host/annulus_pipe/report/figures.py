"""The report's pictures, as PNG bytes.

Bounded: a picture is 1440 dots wide, a sheet shows `SHEET_M[0]` metres or, of a pipe for which `SHEETS_MAX` sheets do
not suffice, the next length for which they do. A page has at most `SHEETS_MAX` sheets and about 30 MB, however long the
pipe is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import Normalize, to_rgb
from numpy.typing import NDArray

from annulus_pipe.job import Observation
from annulus_pipe.numeric.arrays import Float32Array, Image
from annulus_pipe.numeric.rounding import DISTANCE, span
from annulus_pipe.report.course import draw_course
from annulus_pipe.report.feature_pictures import draw_features
from annulus_pipe.report.halves import draw_halves, ends_of, stretch_of
from annulus_pipe.report.maps import (
    Stretch,
    draw_cameras,
    draw_colour,
    draw_diameters,
    draw_ovality,
    draw_seen,
    draw_shape,
    lay,
)
from annulus_pipe.report.marks import Mark, marks_of, name_above
from annulus_pipe.report.paper import AXES_MM, DEVIATION, UNSEEN, in_style, png, round_up, scale_of, stack
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wings.crossbore.picture import draw_lane

SHEET_M = (3.0, 6.0, 15.0, 30.0, 60.0, 150.0, 300.0, 600.0)  # lengths of a sheet
SHEETS_MAX = 20
SHORT_M = 3.3  # so much goes into one map without sheets
ABOVE_MM = 17.0  # a map's title, legend and brackets
MAP_MM = (60.0, 92.0)  # least and greatest height of a map
SHEET_PANELS = ((17.0, 48.0), (17.0, 48.0), (10.0, 26.0), (9.0, 17.0), (5.5, 8.0))  # with what is above each


@dataclass(frozen=True, slots=True)
class Pictures:
    """PNG files as bytes; `deviation_rgb` is the map's colour of every cell, (Z, A, 3) uint8; `scale_mm` its ends."""

    unwrapped: bytes
    texture: bytes
    stations: bytes
    surface: tuple[tuple[str, bytes], ...]  # caption, picture
    deviation_rgb: Image
    scale_mm: float
    features: tuple[tuple[str, bytes], ...]  # letter or question mark, picture
    course: bytes | None  # of a pipe that is not one straight, even tube
    cameras: bytes | None  # which of several saw what, and how well
    lane: bytes | None = None  # of sectors that look through the wall
    sheets: tuple[tuple[str, bytes], ...] = ()  # of a long pipe: caption, picture
    sheet_mm: float = 0.0
    sheet_scale: str = ""
    scale: str = ""  # of the maps of the whole
    stretch_mm: tuple[float, float] | None = None  # what `surface` shows of a long pipe


def draw(survey: Survey, observations: Sequence[Observation] = ()) -> Pictures:
    """Every picture of one report. observations : what an operator marked, put on the maps."""
    deviation = survey.wall.deviation_mm()
    scale = _scale(survey, deviation)
    filled = np.nan_to_num(deviation, nan=0.0)
    rgb = (DEVIATION(Normalize(-scale, scale)(filled))[..., :3] * 255).astype(np.uint8)
    rgb[~np.isfinite(deviation)] = np.round(255 * np.array(to_rgb(UNSEEN)))  # seen, but beside no circle that is known
    marks = marks_of(survey, observations)
    whole = Stretch.of(survey, *survey.wall.extent[:2])
    long = whole.length_mm > 1000 * SHORT_M
    lengths = sheets_of(*survey.wall.extent[:2]) if long else []
    rows = stretch_of(survey)
    with in_style():
        sheets = tuple(
            (
                f"Sheet {k} of {len(lengths)}: {span(first, last, DISTANCE)}",
                _sheet(survey, Stretch.of(survey, first, last), deviation, scale, marks),
            )
            for k, (first, last) in enumerate(lengths, start=1)
        )
        return Pictures(
            _unwrapped(survey, whole, deviation, scale, marks, not long),
            _texture(survey, whole, marks, not long),
            _stations(survey, whole, marks),
            draw_halves(survey, rows, rgb, marks, scale),
            rgb,
            scale,
            draw_features(survey),
            draw_course(survey),
            _cameras(survey, whole) if len(survey.cameras) > 1 else None,
            None if survey.lane is None else draw_lane(survey.lane),
            sheets,
            lengths[0][1] - lengths[0][0] if lengths else 0.0,
            _scales(survey, lengths[0][1] - lengths[0][0], SHEET_PANELS[0][1]) if lengths else "",
            _scales(survey, whole.length_mm, _height(survey, whole)),
            ends_of(survey.wall, rows) if rows.stop - rows.start < len(survey.wall.z_mm) else None,
        )


def sheets_of(first_mm: float, last_mm: float) -> list[tuple[float, float]]:
    """Stretches of one length, which begin at whole multiples of it, so that two scans of one pipe have the same."""
    for metres in (*SHEET_M, math.inf):
        length = 1000 * metres if math.isfinite(metres) else (last_mm - first_mm) / (SHEETS_MAX - 1)
        begin = math.floor(first_mm / length)
        begin -= begin * length > first_mm  # the quotient was rounded up to a whole number
        count = math.ceil(last_mm / length) - begin
        if count <= SHEETS_MAX:
            return [((begin + k) * length, (begin + k + 1) * length) for k in range(count)]
    raise AssertionError("a finite pipe has a finite number of sheets")


def _scale(survey: Survey, deviation: NDArray[np.float32]) -> float:
    """Ends of the colour bar, mm: a round number that holds the deepest defect and never shows bare noise as colour."""
    largest = max((d.depth_mm / (2 if d.kind is Kind.OVALITY else 1) for d in survey.defects), default=0.0)
    seen = np.abs(deviation[np.isfinite(deviation)])
    usual = float(np.percentile(seen, 99)) if len(seen) else 0.0
    wanted = max(largest, usual, 10 * survey.noise_mm, 0.5)
    return round_up(wanted)


def _height(survey: Survey, stretch: Stretch) -> float:
    """Of a map, mm on paper: true to scale where that fits a page."""
    round_mm = 2 * math.pi * survey.wall.mean_radius_mm
    return float(np.clip(AXES_MM * round_mm / max(stretch.length_mm, 1.0), *MAP_MM))


def _scales(survey: Survey, length_mm: float, height_mm: float) -> str:
    round_mm = 2 * math.pi * survey.wall.mean_radius_mm
    return f"{scale_of(length_mm, AXES_MM)} along, {scale_of(round_mm, height_mm)} round"


def _unwrapped(
    survey: Survey, whole: Stretch, deviation: Float32Array, scale: float, marks: tuple[Mark, ...], names: bool
) -> bytes:
    height = _height(survey, whole)
    figure, (axes,) = stack([(ABOVE_MM, height)])
    lay([axes], whole)
    right = _scales(survey, whole.length_mm, height)
    draw_shape(figure, axes, survey, whole, deviation, scale, marks, height, names=names, right=right)
    return png(figure)


def _texture(survey: Survey, whole: Stretch, marks: tuple[Mark, ...], names: bool) -> bytes:
    height = _height(survey, whole)
    figure, (axes,) = stack([(ABOVE_MM, height)])
    lay([axes], whole)
    draw_colour(axes, survey, whole, marks, height, names=names, right=_scales(survey, whole.length_mm, height))
    return png(figure)


def _cameras(survey: Survey, whole: Stretch) -> bytes:
    height = 0.8 * _height(survey, whole)
    figure, both = stack([(ABOVE_MM + 6, height), (10.0, height)])
    lay(both, whole)
    draw_cameras(figure, both, survey, whole, height)
    return png(figure)


def _stations(survey: Survey, whole: Stretch, marks: tuple[Mark, ...]) -> bytes:
    panels = ((10.0, 40.0), (9.0, 26.0), (4.0, 12.0))
    figure, axes = stack(panels)
    lay(axes, whole)
    for draw_one, one, (_, height) in zip((draw_diameters, draw_ovality, draw_seen), axes, panels, strict=True):
        draw_one(one, survey, whole, height)
    name_above(axes[0], marks)
    return png(figure)


def _sheet(survey: Survey, stretch: Stretch, deviation: Float32Array, scale: float, marks: tuple[Mark, ...]) -> bytes:
    """Shape, colour, diameters, ovality and what was seen over one stretch."""
    figure, axes = stack(SHEET_PANELS)
    lay(axes, stretch)
    heights = [height for _, height in SHEET_PANELS]
    right = _scales(survey, stretch.length_mm, heights[0])
    draw_shape(figure, axes[0], survey, stretch, deviation, scale, marks, heights[0], right=right)
    draw_colour(axes[1], survey, stretch, marks, heights[1])
    draw_diameters(axes[2], survey, stretch, heights[2])
    draw_ovality(axes[3], survey, stretch, heights[3])
    draw_seen(axes[4], survey, stretch, heights[4])
    return png(figure)
