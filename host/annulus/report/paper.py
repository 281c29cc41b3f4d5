"""What all of the report's pictures share: size, colours, type, and how a thing on the wall is marked."""

import io
from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from annulus.wall.defects import ALL_ROUND_DEG
from annulus.wall.survey import Survey

DPI = 150
WIDTH_IN = 11.0
INK, FAINT, UNSEEN, HIDDEN = "#1c2733", "#6b7885", "#c9ced4", "#59626c"
LOSS_RED, BUMP_BLUE, FEATURE = "#b3261e", "#1d5fa8", "#4b2e83"
# Outwards red, sound wall near white, inwards blue; readable in every common colour vision, and grey means not seen.
DEVIATION = LinearSegmentedColormap.from_list(
    "deviation", ["#0b3c7d", "#2f79c4", "#a9cdea", "#f7f7f5", "#f6c3a4", "#d9583b", "#86101b"]
)
STYLE = {
    "font.family": "DejaVu Sans", "font.size": 10, "axes.edgecolor": FAINT, "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.linewidth": 0.8, "hatch.linewidth": 0.5,
}  # fmt: skip
NEAR = 0.035  # part of a picture's width: marks closer than this share a place


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


def badge(axes: Any, x: float, y: float, name: str, *, colour: str = INK, shape: str = "circle") -> None:
    axes.text(
        x, y, name, ha="center", va="center", fontsize=9.5, fontweight="bold", color="white", zorder=6, clip_on=False,
        bbox={"boxstyle": f"{shape},pad=0.28", "fc": colour, "ec": "white", "lw": 1.2},
    )  # fmt: skip


def mark(axes: Any, survey: Survey, per_mm: float) -> None:
    """Features by letter and what could not be decided by question mark, on a map of clock against distance."""
    low, high = axes.get_xlim()
    taken: list[float] = []
    for name, (z0, z1), clock, arc in _marks(survey):
        first, last = np.clip([z0 * per_mm, z1 * per_mm], low, high)
        feature = not name.startswith("?")
        style: dict[str, Any] = {"ec": FEATURE if feature else INK, "ls": "-" if feature else (0, (3, 2)), "lw": 1.3}
        kind: dict[str, str] = {"colour": FEATURE, "shape": "round"} if feature else {}
        x = float(np.clip((first + last) / 2, low + 0.015 * (high - low), high - 0.015 * (high - low)))
        if arc >= ALL_ROUND_DEG:
            for at in (first, last):
                axes.axvline(at, color=style["ec"], lw=1.0, ls=style["ls"], zorder=4)
            axes.annotate(
                "", (first, 366), (last, 366), annotation_clip=False,
                arrowprops={"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "lw": 1.2, "color": style["ec"]},
            )  # fmt: skip
            row = sum(abs(x - other) < NEAR * (high - low) for other in taken)
            taken.append(x)
            badge(axes, x, 349 - 22 * row, name, **kind)
            continue
        top = (clock - arc / 2) % 360
        for turn in (0, -360):  # what reaches over 12 o'clock comes in again from the other edge
            axes.add_patch(Rectangle((first, top + turn), last - first, arc, fill=False, zorder=4, **style))
        badge(
            axes, x, float(np.clip(top + 12 if last - first > 0.06 * (high - low) else top - 11, 11, 349)), name, **kind
        )


def _marks(survey: Survey) -> Iterator[tuple[str, tuple[float, float], float, float]]:
    """Name, stretch (mm), clock and arc (deg)."""
    for i, one in enumerate(survey.features):
        yield letter(i), one.z_range_mm, one.clock_deg, one.arc_deg
    for i, place in enumerate(survey.detection.undecided):
        yield question(i), place.z_range_mm, place.clock_deg, place.arc_deg
