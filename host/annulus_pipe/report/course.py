"""The pipe's course: centreline.json, and a picture of it."""

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from annulus_pipe.report.maps import DISTANCE_LABEL
from annulus_pipe.report.paper import BUMP_BLUE, DPI, FEATURE, INK, SHEET_IN, in_style, letter, png
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.survey import Survey

STEP_MM = 10.0  # between points of the line in the file
LEAST_SPAN_MM = 1.0  # of the radius in the picture: what is even looks even


def centreline(survey: Survey) -> dict[str, Any]:
    """What centreline.json says: pieces of the line, bends, the line as points, the camera's path; mm and degrees.

    Space is the frame of the first straight: x right, y down, z forward. An offset or turn is against the end of the
    piece before, right and down; `plane_deg` is atan2(down, right) of where a bend turns to.
    """
    line = survey.centreline
    start, end = survey.scanned_mm
    chainage = np.unique(np.append(np.arange(start, end, STEP_MM), end))
    points = line.to_space(np.column_stack([np.zeros((len(chainage), 2)), chainage]))
    return {
        "format": "annulus-centreline/1",
        "frame": "x right, y down, z forward along the first straight, mm",
        "pipe_radius_mm": round(survey.wall.mean_radius_mm, 4),
        "straight": line.is_straight,
        "pieces": [
            {
                "start_mm": round(piece.start_mm, 3),
                "radius_mm": round(piece.radius_mm, 4),
                "taper_mm_per_mm": round(piece.taper, 6),
                "offset_mm": [round(v, 4) for v in piece.offset_mm],
                "turn_deg": [round(math.degrees(v), 4) for v in piece.turn],
                "curvature_per_m": [round(1e3 * v, 6) for v in piece.curvature],
            }
            for piece in (line.pieces if not line.is_straight else ())
        ],
        "bends": [
            {one.name: round(one.value, 4) for one in bend.measures}
            | {one.k2_name: round(one.k2, 4) for one in bend.measures}
            for bend in survey.features
            if bend.kind is FeatureKind.BEND
        ],
        "line_mm": [[round(float(v), 3) for v in (s, *p)] for s, p in zip(chainage, points, strict=True)],
        "camera_path": [[frame, *(round(float(v), 3) for v in place)] for frame, place in _camera_path(survey)],
    }


def _camera_path(survey: Survey) -> list[tuple[int, np.ndarray[Any, Any]]]:
    """Frame and place in space of every projector frame with a pose, mm."""
    out = []
    for profile in sorted(survey.profiles, key=lambda one: one.frame):
        if profile.pose is not None:
            local = profile.pose.to_pipe(np.zeros((1, 3)))
            in_pipe = survey.centreline.from_head(local, profile.z_mm)
            out.append((profile.frame, survey.centreline.to_space(in_pipe)[0]))
    return out


def draw_course(survey: Survey) -> bytes | None:
    """The line from above and from the side, and the radius along it, as PNG; None of one straight, even pipe."""
    if survey.centreline.is_straight and survey.centreline.is_even:
        return None
    with in_style():
        return png(_course(survey))


def _course(survey: Survey) -> Figure:
    line = survey.centreline
    start, end = survey.scanned_mm
    chainage = np.linspace(start, end, 400)
    space = line.to_space(np.column_stack([np.zeros((len(chainage), 2)), chainage])) / 1000
    figure = Figure(figsize=(SHEET_IN, 3.8), dpi=DPI, layout="constrained")
    above, side, radius = figure.subplots(1, 3)
    for axes, column, name in ((above, 0, "right"), (side, 1, "down")):
        axes.plot(space[:, 2], space[:, column], color=INK, lw=1.8)
        for number, feature in enumerate(survey.features):
            at = line.to_space(np.array([[0.0, 0.0, feature.z_mm]]))[0] / 1000
            axes.plot(at[2], at[column], "o", color=FEATURE, ms=5)
            axes.annotate(letter(number), (at[2], at[column]), (0, 7), textcoords="offset points", ha="center")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.12)
        axes.invert_yaxis()
        axes.set_xlabel("along the first straight, m")
        axes.set_ylabel(f"{name}, m")
        axes.grid(color=INK, alpha=0.10, lw=0.6)
    above.set_title("centre line from above", loc="left", fontsize=10)
    side.set_title("from the left side", loc="left", fontsize=10)
    along = survey.wall.shape_mm[:, 0]
    radius.plot(survey.wall.z_mm / 1000, along, color=BUMP_BLUE, lw=1.4)
    middle, half = (along.max() + along.min()) / 2, max(0.6 * float(np.ptp(along)), LEAST_SPAN_MM / 2)
    radius.set_ylim(middle - half, middle + half)
    radius.set_title("radius along it", loc="left", fontsize=10)
    radius.set_xlabel(DISTANCE_LABEL)
    radius.set_ylabel("radius, mm")
    radius.ticklabel_format(axis="y", useOffset=False)
    radius.grid(color=INK, alpha=0.10, lw=0.6)
    return figure
