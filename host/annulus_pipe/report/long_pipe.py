"""Sheets of a long pipe: over one stretch each its shape, colour, diameters, ovality and what was seen.

Bounded: a sheet shows `SHEET_M[0]` metres or, of a pipe for which `SHEETS_MAX` sheets do not suffice, the next length
for which they do.
"""

import math
from collections.abc import Sequence

from annulus_pipe.numeric.arrays import Float32Array
from annulus_pipe.report.curves import draw_diameters, draw_ovality, draw_seen
from annulus_pipe.report.maps import draw_colour, draw_shape, scales
from annulus_pipe.report.marks import WallMark
from annulus_pipe.report.paper import Stretch, png, stack
from annulus_pipe.wall.survey import Survey

SHEET_M = (3.0, 6.0, 15.0, 30.0, 60.0, 150.0, 300.0, 600.0)  # lengths of a sheet
SHEETS_MAX = 20
SHEET_PANELS = ((17.0, 48.0), (17.0, 48.0), (10.0, 26.0), (9.0, 17.0), (5.5, 8.0))  # with what is above each


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


def scale_of_sheets(survey: Survey, length_mm: float) -> str:
    """Of the maps of a sheet so long, in words."""
    return scales(survey, length_mm, SHEET_PANELS[0][1])


def sheet(survey: Survey, stretch: Stretch, deviation: Float32Array, scale: float, marks: Sequence[WallMark]) -> bytes:
    """One, as PNG."""
    figure, axes = stack(SHEET_PANELS, stretch)
    heights = [height for _, height in SHEET_PANELS]
    right = scale_of_sheets(survey, stretch.length_mm)
    draw_shape(figure, axes[0], survey, stretch, deviation, scale, marks, heights[0], right=right)
    draw_colour(axes[1], survey, stretch, marks, heights[1])
    draw_diameters(axes[2], survey, stretch, heights[2])
    draw_ovality(axes[3], survey, stretch, heights[3])
    draw_seen(axes[4], survey, stretch, heights[4])
    return png(figure)
