"""Every picture of a report, as PNG bytes: which there are, and in which colours.

A picture is drawn in the file of its name: `maps`, `curves`, `long_pipe`, `halves`, `feature_pictures`, `course`; a
defect from close by in `cuts` and `photographs`, where the page asks for it. What they share is in `paper` and `marks`.
Bounded: a picture is 1440 dots wide, and a page has about 30 MB, however long the pipe is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import Normalize, to_rgb
from numpy.typing import NDArray

from annulus_pipe.hooks import Sheet, sheets
from annulus_pipe.job import Observation
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.numeric.rounding import DISTANCE, span
from annulus_pipe.report.course import draw_course
from annulus_pipe.report.curves import stations
from annulus_pipe.report.feature_pictures import draw_features
from annulus_pipe.report.halves import draw_halves, ends_of, stretch_of
from annulus_pipe.report.long_pipe import scale_of_sheets, sheet, sheets_of
from annulus_pipe.report.maps import cameras, height_of, scales, texture, unwrapped
from annulus_pipe.report.marks import marks_of
from annulus_pipe.report.names import UNSEEN, round_up
from annulus_pipe.report.paper import DEVIATION, Stretch, in_style
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.survey import Survey

SHORT_M = 3.3  # so much goes into one map without sheets


@dataclass(frozen=True, slots=True)
class ReportPictures:
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
    beside: tuple[Sheet, ...] = ()  # what wings have to show
    sheets: tuple[tuple[str, bytes], ...] = ()  # of a long pipe: caption, picture
    sheet_mm: float = 0.0
    sheet_scale: str = ""
    scale: str = ""  # of the maps of the whole
    stretch_mm: tuple[float, float] | None = None  # what `surface` shows of a long pipe


def draw(survey: Survey, observations: Sequence[Observation] = ()) -> ReportPictures:
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
    sheet_mm = lengths[0][1] - lengths[0][0] if lengths else 0.0
    rows = stretch_of(survey)
    with in_style():
        return ReportPictures(
            unwrapped=unwrapped(survey, whole, deviation, scale, marks, not long),
            texture=texture(survey, whole, marks, not long),
            stations=stations(survey, whole, marks),
            surface=draw_halves(survey, rows, rgb, marks, scale),
            deviation_rgb=rgb,
            scale_mm=scale,
            features=draw_features(survey),
            course=draw_course(survey),
            beside=sheets(survey),
            cameras=cameras(survey, whole) if len(survey.cameras) > 1 else None,
            sheets=tuple(
                (
                    f"Sheet {k} of {len(lengths)}: {span(first, last, DISTANCE)}",
                    sheet(survey, Stretch.of(survey, first, last), deviation, scale, marks),
                )
                for k, (first, last) in enumerate(lengths, start=1)
            ),
            sheet_mm=sheet_mm,
            sheet_scale=scale_of_sheets(survey, sheet_mm) if lengths else "",
            scale=scales(survey, whole.length_mm, height_of(survey, whole)),
            stretch_mm=ends_of(survey.wall, rows) if rows.stop - rows.start < len(survey.wall.z_mm) else None,
        )


def _scale(survey: Survey, deviation: NDArray[np.float32]) -> float:
    """Ends of the colour bar, mm: a round number that holds the deepest defect and never shows bare noise as colour."""
    largest = max((d.depth_mm / (2 if d.kind is Kind.OVALITY else 1) for d in survey.defects), default=0.0)
    seen = np.abs(deviation[np.isfinite(deviation)])
    usual = float(np.percentile(seen, 99)) if len(seen) else 0.0
    wanted = max(largest, usual, 10 * survey.noise_mm, 0.5)
    return round_up(wanted)
