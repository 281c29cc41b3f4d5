"""report.html: one page that opens anywhere, prints, and says the result first."""

import base64
import math
from collections.abc import Mapping
from importlib import resources
from typing import Any

import jinja2

from annulus.report.figures import Pictures
from annulus.report.half_view import EXAGGERATION
from annulus.wall.defects import ALL_ROUND_DEG, Defect, Kind, clock_face
from annulus.wall.survey import Survey

TEMPLATE = "page.html.j2"
NAMES = {Kind.LOSS: "Wall loss", Kind.BUMP: "Bump into the pipe", Kind.OVALITY: "Out of round"}


def render_page(survey: Survey, summary: Mapping[str, Any], pictures: Pictures) -> str:
    """The report as one HTML document: no script, no font and no picture from anywhere else."""
    text = resources.files("annulus.report").joinpath(TEMPLATE).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(text).render(
        s=summary,
        survey=survey,
        rows=[_row(number, defect, survey) for number, defect in enumerate(survey.defects, start=1)],
        verdict=_verdict(survey),
        unwrapped=_inline(pictures.unwrapped),
        texture=_inline(pictures.texture),
        stations=_inline(pictures.stations),
        surface=[(caption, _inline(data)) for caption, data in pictures.surface],
        exaggeration=EXAGGERATION,
        length=_length(summary["scanned_mm"]["length"]),
        distance_from=f"{summary['scanned_mm']['from'] / 1000:.3f}",
        distance_to=f"{summary['scanned_mm']['to'] / 1000:.3f}",
    )


def _verdict(survey: Survey) -> str:
    worst = survey.worst
    if worst is None:
        unsure = " Not enough of it was seen to say what shape the pipe has: see below." if survey.findings else ""
        return f"No defect above the listing limits on the wall that was seen.{unsure}"
    counts = [
        (sum(d.kind is kind for d in survey.defects), one, many)
        for kind, one, many in (
            (Kind.LOSS, "wall loss", "wall losses"), (Kind.BUMP, "bump", "bumps"),
            (Kind.OVALITY, "out-of-round stretch", "out-of-round stretches"),
        )
    ]  # fmt: skip
    words = ", ".join(f"{n} {one if n == 1 else many}" for n, one, many in counts if n)
    if worst.kind is Kind.OVALITY:
        return f"{words}."
    return (
        f"{words}. Deepest: {NAMES[worst.kind].lower()} of {_measured(worst.depth_mm, worst.depth_k2_mm)} (k=2) "
        f"at {worst.z_mm / 1000:.3f} m, clock {worst.clock}."
    )


def _row(number: int, defect: Defect, survey: Survey) -> dict[str, Any]:
    first, last = defect.z_range_mm
    mean = survey.nominal_diameter_mm if math.isnan(survey.diameter_mean_mm) else survey.diameter_mean_mm
    begin, end = defect.clock_range
    if defect.kind is Kind.OVALITY:
        remark = f"long axis {defect.clock} to {clock_face(defect.clock_deg + 180)}"
        clock = "all round"
        width = "all round"
    else:
        clock = "all round" if defect.arc_deg >= ALL_ROUND_DEG else f"{begin} to {end}"
        width = f"{defect.arc_deg * math.pi / 360 * mean:.0f} mm ({defect.arc_deg:.0f}°)"
        remark = f"centre {defect.clock}" if defect.arc_deg < ALL_ROUND_DEG else ""
    if defect.shadowed_mm >= 0.5:
        seen = max(defect.length_mm - defect.shadowed_mm, 0.0)
        remark += f"{', ' if remark else ''}{defect.shadowed_mm:.0f} mm of the length hidden, {seen:.0f} mm seen"
    return {
        "number": number,
        "kind": str(defect.kind),
        "name": NAMES[defect.kind],
        "at": f"{defect.z_mm / 1000:.3f}",
        "from_to": f"{first / 1000:.3f} to {last / 1000:.3f}",
        "clock": clock,
        "length": f"{defect.length_mm:.0f} mm",
        "width": width,
        "depth": f"{'' if defect.floor_seen else '≥ '}{_measured(defect.depth_mm, defect.depth_k2_mm)}",
        "part": f"{100 * defect.depth_mm / mean:.1f} %",
        "remark": remark,
    }


def _measured(mm: float, k2_mm: float) -> str:
    """A length with its expanded uncertainty; the value alone where nobody knows how far it may be off."""
    if not math.isfinite(k2_mm):
        return f"{mm:.2f} mm"
    return f"{mm:.2f} ± {max(math.ceil(100 * k2_mm - 1e-9), 1) / 100:.2f} mm"  # rounded up, never 0.00


def _length(mm: float) -> str:
    return f"{mm / 1000:.2f} m" if mm >= 1000 else f"{mm:.0f} mm"


def _inline(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
