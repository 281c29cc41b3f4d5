"""The pipe's course: its centre line from above and from the side, and the radius along it."""

import numpy as np
from matplotlib.figure import Figure

from annulus_pipe.report.names import BUMP_BLUE, FEATURE, INK, letter
from annulus_pipe.report.paper import DISTANCE_LABEL, DPI, SHEET_IN, png
from annulus_pipe.wall.survey import Survey

LEAST_SPAN_MM = 1.0  # of the radius in the picture: what is even looks even


def draw_course(survey: Survey) -> bytes | None:
    """The line from above and from the side, and the radius along it, as PNG; None of one straight, even pipe."""
    if survey.centreline.is_straight and survey.centreline.is_even:
        return None
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
    return png(figure)
