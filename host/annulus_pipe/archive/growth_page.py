"""A comparison for people: the growth map as a picture, and one page with it and the table, that opens anywhere."""

import base64
import io
import math
from datetime import UTC, datetime
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from annulus_pipe.archive.comparison import Comparison
from annulus_pipe.archive.growth import CHANGED, Change
from annulus_pipe.archive.ovality import Ovality
from annulus_pipe.numeric import palette
from annulus_pipe.numeric.rounding import (
    ARC,
    DISTANCE,
    EXTENT,
    MEASURE,
    SHARE,
    clock_face,
    digits_k2,
    off,
    quoted,
    span,
)
from annulus_pipe.numeric.thinning import farthest
from annulus_pipe.untrusted import printable
from annulus_pipe.vocabulary import AnnulusError

TEMPLATE = "growth.html.j2"
INK, FAINT, UNSEEN = "#1c2733", "#6b7885", "#c9ced4"
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
SIZE_IN = (9.0, 3.9)  # of the map: as wide as a page takes
OVALITY_IN = (9.0, 2.2)  # of the curve below it
DPI = 150  # sharp in print, and 1350 dots on a screen
ROWS_MAX = 2400  # of the picture: two a dot
SCALE_LEAST_MM = 0.25  # ends of the colours where nothing grew
BLUR = 1.0  # cells, so that noise does not hide what grew


def draw(comparison: Comparison) -> bytes:
    """The growth map as PNG: distance against clock, outwards red, grey where one of the two did not see."""
    difference, changed = comparison.difference, comparison.changed
    scale = max([SCALE_LEAST_MM, *(abs(one.growth_mm) for one in changed)])
    field = farthest(difference.grown, ROWS_MAX)
    z = difference.z_mm / 1000
    half = difference.step_mm / 2000
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE_IN, dpi=DPI)
        axes = figure.add_axes((0.085, 0.14, 0.79, 0.70))
        axes.set_facecolor(UNSEEN)
        shown = axes.imshow(
            np.ma.masked_invalid(field.T),
            cmap=LinearSegmentedColormap.from_list("deviation", palette.DEVIATION),
            vmin=-scale,
            vmax=scale,
            extent=(z[0] - half, z[-1] + half, 360.0, 0.0),
            aspect="auto",
            interpolation="nearest",
            zorder=2,
        )
        for number, one in enumerate(changed, start=1):
            _mark(axes, one, number)
        axes.set_xlim(z[0] - half, z[-1] + half)
        axes.set_ylim(360, 0)
        axes.set_yticks(range(0, 361, 30), labels=[f"{h % 12 or 12}:00" if h % 3 == 0 else "" for h in range(13)])
        axes.set_ylabel("clock, looking forward")
        axes.set_xlabel("distance along the pipe in the first scan, m")
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.grid(axis="y", color=INK, alpha=0.10, lw=0.6)
        axes.text(0, 1.12, "Growth from the first scan to the second", transform=axes.transAxes, fontweight="bold")
        axes.legend(
            handles=[Patch(label="not seen by both", fc=UNSEEN, ec="#aab1b9", lw=0.5)],
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            frameon=False,
            fontsize=8.5,
            borderaxespad=0.1,
        )
        box = axes.get_position()
        bar = figure.colorbar(shown, cax=figure.add_axes((box.x1 + 0.016, box.y0, 0.018, box.height)))
        bar.set_label("growth, mm\n− inwards    outwards +", fontsize=9)
        bar.ax.tick_params(labelsize=9)
        out = io.BytesIO()
        figure.savefig(out, format="png", facecolor="white")
    return out.getvalue()


def draw_ovality(oval: Ovality) -> bytes:
    """Ovality of both along the pipe, as PNG."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=OVALITY_IN, dpi=DPI)
        axes = figure.add_axes((0.085, 0.22, 0.79, 0.70))
        z = oval.z_mm / 1000
        axes.fill_between(
            z, oval.second - oval.change_k2, oval.second + oval.change_k2, color=palette.DEVIATION[4], lw=0
        )
        axes.plot(z, oval.first, color=palette.DEVIATION[1], lw=1.4, label="first scan")
        axes.plot(z, oval.second, color=palette.DEVIATION[6], lw=1.4, label="second scan")
        axes.set_ylim(bottom=0)
        axes.set_ylabel("ovality, %")
        axes.set_xlabel("distance along the pipe in the first scan, m")
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.legend(frameon=False, fontsize=8.5, loc="upper left", ncols=2)
        out = io.BytesIO()
        figure.savefig(out, format="png", facecolor="white")
    return out.getvalue()


def _mark(axes: Any, one: Change, number: int) -> None:
    length, arc = one.length_mm / 1000, min(one.arc_deg, 360.0)
    for turn in (-360.0, 0.0, 360.0):
        corner = (one.z_mm / 1000 - 0.75 * length, one.clock_deg + turn - 0.75 * arc)
        axes.add_patch(Rectangle(corner, 1.5 * length, 1.5 * arc, fill=False, ec=INK, lw=0.8, zorder=3))
    axes.text(
        one.z_mm / 1000,
        max(one.clock_deg - 0.75 * arc - 3, 12),
        str(number),
        ha="center",
        va="bottom",
        fontsize=8,
        fontweight="bold",
        zorder=4,
        clip_on=True,
    )


def render(comparison: Comparison) -> str:
    """One HTML document: no script, no font and no picture from anywhere else."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    text = resources.files("annulus_pipe.archive").joinpath(TEMPLATE).read_text(encoding="utf-8")
    aligned, size = comparison.alignment, comparison.growth
    changed = comparison.changed
    numbers = {id(one): number for number, one in enumerate(changed, start=1)}
    first, last = comparison.overlap_mm
    return environment.from_string(text).render(
        first=printable(comparison.first.name),
        second=printable(comparison.second.name),
        says=comparison.sentence(),
        remarks=comparison.remarks(),
        picture=base64.b64encode(draw(comparison)).decode(),
        changed=len(changed),
        rows=[_row(one, numbers.get(id(one))) for one in size.changes],
        listed=any(one.called for one in size.changes),
        ovality=comparison.ovality_sentence(),
        diameter=comparison.diameter_sentence(),
        ovality_picture=base64.b64encode(draw_ovality(comparison.ovality)).decode(),
        z_k2=f"± {_typical(2 * aligned.sigma_z_mm):.1f} mm",
        roll_k2=f"± {_typical(2 * aligned.sigma_roll_deg):.2f}°",
        z_worst=f"{_worst(2 * aligned.sigma_z_mm):.1f} mm",
        roll_worst=f"{_worst(2 * aligned.sigma_roll_deg):.2f}°",
        scale=f"{aligned.scale:.4f}",
        slips=len(aligned.slips),
        sure=f"{aligned.sure:.0f}",
        overlap=span(first, last, DISTANCE),
        seen=quoted(100 * size.seen_fraction, SHARE),
        least=off(size.least_median_mm, MEASURE),
        least_worst=off(size.least_p95_mm, MEASURE),
        created=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        version=metadata.version("annulus-pipe"),
    )


def _row(one: Change, number: int | None) -> dict[str, object]:
    growth = quoted(one.growth_mm, MEASURE, one.growth_k2_mm)
    if one.verdict not in CHANGED and math.isfinite(one.growth_k2_mm):
        growth = f"within ± {digits_k2(one.growth_k2_mm, MEASURE)} mm"
    return {
        "number": number or "",
        "z": quoted(one.z_mm, DISTANCE),
        "clock": clock_face(one.clock_deg),
        "growth": growth,
        "then": quoted(one.depth_first_mm, MEASURE),
        "now": quoted(one.depth_second_mm, MEASURE),
        "size": f"{quoted(one.length_mm, EXTENT)} × {quoted(one.arc_deg, ARC)}",
        "verdict": str(one.verdict),
        "changed": one.verdict in CHANGED,
        "first": one.first,
        "second": one.second,
    }


def _typical(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def _worst(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, 95)) if len(known) else math.nan


def write_page(comparison: Comparison, out: Path) -> None:
    """The page. AnnulusError where it cannot be written."""
    page = render(comparison)
    try:
        out.write_text(page, encoding="utf-8")
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written ({error.strerror or error})") from None
