"""A designed pattern as files: the slide to print, what the camera will see, the calibration to begin with."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from annulus_pipe.rings.pattern import RingPattern, preview
from annulus_pipe.storage.calibration_file import update_calibration
from annulus_pipe.vocabulary import AnnulusError

INCH_MM = 25.4
BORDER_MM = 8.0  # of paper around the black, for marks
MARK_MM = 5.0
ABOVE_MM, BELOW_MM = 3.0, 4.0  # more of it, for words and the scale
INK = {"R": "#ff0000", "G": "#00ff00", "B": "#0000ff"}


def write_design(pattern: RingPattern, focal_mm: float, folder: Path) -> list[Path]:
    """slide.svg, slide.pdf (to scale), slide.png, preview.png, calibration.json. Returns what was written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        slide = _slide(pattern, focal_mm)
        out = [folder / f"slide.{kind}" for kind in ("svg", "pdf", "png")]
        with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "annulus"}):
            for path in out:
                fixed = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(path.suffix[1:], {})
                slide.savefig(path, dpi=600, metadata=fixed)
        out.append(folder / "preview.png")
        _preview(pattern).savefig(out[-1])
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be written ({error.strerror}).") from None
    out.append(folder / "calibration.json")
    nominal = pattern.calibration().to_dict()
    nominal.pop("format")
    nominal["pattern"]["design"] = {**pattern.to_dict(), "projector_focal_mm": focal_mm}
    made = {"by": "annulus pattern design", "nominal": True}
    update_calibration(out[-1], nominal, {"rings": made})
    return out


def _slide(pattern: RingPattern, focal_mm: float) -> Figure:
    """One unit of the axes is one mm of the page."""
    stripes = pattern.radii_mm(focal_mm)
    reach = stripes[-1][2]
    half = 1.15 * reach + 1.0  # black around the pattern, or light passes beside it
    size = 2 * (half + BORDER_MM)
    figure = Figure(figsize=(size / INCH_MM, (size + BELOW_MM + ABOVE_MM) / INCH_MM))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(-size / 2, size / 2)
    axes.set_ylim(-size / 2 - BELOW_MM, size / 2 + ABOVE_MM)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.add_patch(Rectangle((-half, -half), 2 * half, 2 * half, facecolor="black", linewidth=0))
    for colour, inner, outer in reversed(stripes):
        axes.add_patch(Circle((0, 0), outer, facecolor=INK[colour], linewidth=0))
        axes.add_patch(Circle((0, 0), inner, facecolor="black", linewidth=0))
    for x, y in ((-1, 0), (1, 0), (0, -1), (0, 1)):  # their lines meet at the pattern's centre
        axes.plot([x * (half + 1), x * (half + 1 + MARK_MM)], [y * (half + 1), y * (half + 1 + MARK_MM)], **_hair())
    for x in (-1, 1):
        for y in (-1, 1):
            _cross(axes, x * (half + 3), y * (half + 3))
    bar = 10.0 if half > 6 else 5.0
    low = -half - BORDER_MM - 1.2
    axes.plot([-bar / 2, bar / 2], [low, low], **_hair())
    for x in range(-int(bar / 2), int(bar / 2) + 1):
        axes.plot([x, x], [low, low + (1.0 if abs(x) == int(bar / 2) else 0.5)], **_hair())
    axes.text(0, low - 0.5, f"{bar:g} mm", ha="center", va="top", fontsize=4)
    lines = (
        f"{pattern.colours}   n = {pattern.word}",
        f"lens f = {focal_mm:g} mm   radii {stripes[0][1]:.3f} to {reach:.3f} mm   print at 100 %",
    )
    point = (size - 2) / (0.6 * 0.353 * max(map(len, lines)))  # a letter is some 0.6 of its size wide
    axes.text(0, size / 2 + ABOVE_MM - 0.6, "\n".join(lines), ha="center", va="top", fontsize=min(4.0, point))
    return figure


def _hair() -> dict[str, Any]:
    return {"color": "black", "linewidth": 0.25, "solid_capstyle": "butt"}


def _cross(axes: Axes, x: float, y: float) -> None:
    axes.plot([x - 2, x + 2], [y, y], **_hair())
    axes.plot([x, x], [y - 2, y + 2], **_hair())
    axes.add_patch(Circle((x, y), 1.0, fill=False, edgecolor="black", linewidth=0.25))


def _preview(pattern: RingPattern) -> Figure:
    head = pattern.head
    pipes = sorted({head.least_mm, head.nominal_mm, head.most_mm})
    figure = Figure(figsize=(6.0 * len(pipes), 6.0 * head.camera.height / head.camera.width + 0.4), dpi=110)
    FigureCanvasAgg(figure)
    for at, diameter in enumerate(pipes):
        axes = figure.add_subplot(1, len(pipes), at + 1)
        axes.imshow(preview(pattern, diameter))
        low, high = (float(v) for v in (pattern.widths_px(diameter).min(), pattern.widths_px(diameter).max()))
        axes.set_title(f"pipe {diameter:g} mm: stripes {low:.1f} to {high:.1f} px", fontsize=9)
        axes.axis("off")
    figure.tight_layout()
    return figure
