"""What all of the report's pictures share: size, type, the axis along the pipe. It imports matplotlib, so late."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from PIL import Image

from annulus_pipe.numeric import palette
from annulus_pipe.numeric.rounding import EXTENT, SHARE, digits
from annulus_pipe.report.names import FAINT, INK
from annulus_pipe.wall.survey import Survey

DPI = 150
WIDTH_IN = 11.0
PNG_LEVEL = 4  # of packing: 6 takes twice as long, for a twentieth of the bytes
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
    """Three channels: savefig's fourth is the same everywhere, and its packing took longer than drawing."""
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(DPI)
    canvas.draw()
    buffer = io.BytesIO()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    picture.save(buffer, "png", dpi=(DPI, DPI), compress_level=PNG_LEVEL)
    return buffer.getvalue()


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
