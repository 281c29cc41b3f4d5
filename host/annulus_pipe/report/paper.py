"""What all of the report's pictures share: size, colours, type, the axis along the pipe, what a thing is called."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from annulus_pipe.numeric import palette
from annulus_pipe.numeric.rounding import EXTENT, SHARE, digits
from annulus_pipe.wall.survey import Survey

DPI = 150
WIDTH_IN = 11.0
INK, FAINT, UNSEEN, HIDDEN = "#1c2733", "#6b7885", "#c9ced4", "#59626c"
LOSS_RED, BUMP_BLUE, FEATURE, OBSERVED = "#b3261e", "#1d5fa8", "#4b2e83", "#0b6170"
DEVIATION = LinearSegmentedColormap.from_list("deviation", palette.DEVIATION)
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.8,
    "hatch.linewidth": 0.5,
}
# A picture of the pipe along its length is as wide as A4 and Letter take beside their margins, and every one has the
# same axis at the same place, so that what lies one above the other belongs together. Inches follow from that.
PRINTED_MM, LEFT_MM, AXES_MM = 186.0, 17.0, 150.0
SHEET_IN = 9.0
IN_PER_MM = SHEET_IN / PRINTED_MM
DISTANCE_LABEL = "distance along the pipe, m"


def in_style() -> Any:
    """A context in which figures are made and saved."""
    return mpl.rc_context(STYLE)


def png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, facecolor="white")
    return buffer.getvalue()


def round_up(value: float) -> float:
    """The next round number."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-6)))
    return float(next(step * power for step in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * power >= value * 0.999))


def letter(number: int) -> str:
    """A, B .. Z, AA, AB ..: the name of the number-th feature, from 0."""
    return (letter(number // 26 - 1) if number >= 26 else "") + chr(ord("A") + number % 26)


def question(number: int) -> str:
    """?1, ?2 ..: the name of the number-th place that could not be decided, from 0."""
    return f"?{number + 1}"


def marked(number: int) -> str:
    """M1, M2 ..: the name of the number-th thing that an operator marked, from 0."""
    return f"M{number + 1}"


def badge(axes: Any, x: float, y: float, name: str, *, colour: str = INK, shape: str = "circle") -> None:
    axes.text(
        x,
        y,
        name,
        ha="center",
        va="center",
        fontsize=9.5,
        fontweight="bold",
        color="white",
        zorder=6,
        clip_on=False,
        bbox={"boxstyle": f"{shape},pad=0.28", "fc": colour, "ec": "white", "lw": 1.2},
    )


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


def stack(
    panels: Sequence[tuple[float, float]], stretch: Stretch, *, below_mm: float = 12.0
) -> tuple[Figure, list[Any]]:
    """A figure with axes one below the other, each (room above it, its height) in mm on paper, all over one stretch of
    the pipe, which is named at the last."""
    total = sum(above + height for above, height in panels) + below_mm
    figure = Figure(figsize=(SHEET_IN, total * IN_PER_MM), dpi=DPI)
    top, out = total, list[Any]()
    for above, height in panels:
        top -= above + height
        axes = figure.add_axes((LEFT_MM / PRINTED_MM, top / total, AXES_MM / PRINTED_MM, height / total))
        axes.set_xlim(stretch.first_mm / 1000, stretch.last_mm / 1000)
        axes.tick_params(labelbottom=len(out) == len(panels) - 1)
        out.append(axes)
    out[-1].set_xlabel(DISTANCE_LABEL)
    out[-1].ticklabel_format(axis="x", useOffset=False)
    return figure, out


def bar_beside(figure: Figure, axes: Any, shown: Any, label: str, **more: Any) -> None:
    """A colour bar in the margin, so that the axes keep their place."""
    box = axes.get_position()
    left = box.x1 + 3.0 / PRINTED_MM
    bar = figure.colorbar(shown, cax=figure.add_axes((left, box.y0, 3.5 / PRINTED_MM, box.height)), **more)
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=9)
    bar.outline.set_edgecolor(FAINT)


def scale_of(length_mm: float, on_paper_mm: float) -> str:
    """1 : 20; with a decimal below 10."""
    ratio = length_mm / on_paper_mm
    return f"1 : {digits(ratio, SHARE if ratio < 10 else EXTENT)}"
