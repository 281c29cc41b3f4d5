"""unity.html: what excavations say of a survey, with the unity plot: reported depths over dug ones."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from annulus_pipe.numeric.rounding import ARC, DISTANCE, MEASURE, clock_face, digits_k2, quoted
from annulus_pipe.qualification.unity import CHOSEN, Dug, DugPlace, NextDig, Unity
from annulus_pipe.qualification.validation import Outcome, Proportion
from annulus_pipe.report.names import BUMP_BLUE, FAINT, INK, LOSS_RED
from annulus_pipe.report.paper import DPI, in_style, png
from annulus_pipe.report.sheet import minute, sheet

TEMPLATE = "unity.html.j2"
SIZE_IN = (9.0, 4.5)
BOUNDS: dict[str, Any] = {"color": FAINT, "lw": 1.0, "ls": (0, (5, 4)), "zorder": 1}
FITTED = "#c2611f"
LOOKS = {Outcome.ACCEPTED: "sound", Outcome.REJECTED: "", Outcome.OPEN: "look"}
HEADINGS = {
    Outcome.ACCEPTED: "The specification is accepted",
    Outcome.REJECTED: "The specification is rejected",
    Outcome.OPEN: "The specification is open: these digs say neither",
}
COLOURS = {"loss": LOSS_RED, "bump": BUMP_BLUE}
LEAST_MM = 1.0  # of the plot's axes


def draw_unity(unity: Unity) -> bytes:
    """As PNG: reported over dug depths with both tools' bars (k = 2), the claim's bounds and the fitted line; beside it
    the errors alone, by name."""
    drawn = [(row, both) for row in unity.rows if row.outcome is Dug.FOUND and (both := _depths(row)) is not None]
    bound = _bound(unity)
    with in_style():
        figure = Figure(figsize=SIZE_IN, dpi=DPI)
        axes = figure.add_axes((0.065, 0.115, 0.43, 0.86))
        end = 1.12 * max([LEAST_MM, *(max(both) + _most_off(row) for row, both in drawn)])
        axes.plot((0, end), (0, end), color=INK, lw=1.2, zorder=2)
        handles = [Line2D([], [], color=INK, lw=1.2, label="unity: reported as dug")]
        errors = figure.add_axes((0.59, 0.115, 0.395, 0.86))
        errors.axhline(0.0, color=INK, lw=1.2, zorder=2)
        if math.isfinite(bound):
            for side in (-bound, bound):
                axes.plot((0, end), (side, end + side), **BOUNDS)
                errors.axhline(side, **BOUNDS)
            label = f"claim with the digs' own: ± {digits_k2(bound, MEASURE)} mm"
            handles.append(Line2D([], [], **BOUNDS, label=label))
        if unity.line is not None:
            x = np.array((0.0, end))
            fitted = unity.line.intercept_mm + unity.line.slope * x
            axes.plot(x, fitted, color=FITTED, lw=1.0, zorder=2)
            errors.plot(x, fitted - x, color=FITTED, lw=1.0, zorder=2)
            handles.append(Line2D([], [], color=FITTED, lw=1.0, label="fitted line"))
        for row, (dug, reported) in drawn:
            _draw_row(
                axes, row, dug, reported, _bar(row.dig.depth_u_mm), _bar(row.place.depth_k2_mm if row.place else 0.0)
            )
            _draw_row(errors, row, dug, reported - dug, 0.0, _most_off(row))
        handles += list(_marks([row for row, _ in drawn]))
        axes.set_ylim(0, end)
        axes.set_ylabel("depth as reported, mm")
        errors.set_ylabel("error, reported less dug, mm")
        most = 1.25 * max(
            [bound if math.isfinite(bound) else 0.1, *(abs(y - x) + _most_off(row) for row, (x, y) in drawn)]
        )
        errors.set_ylim(-most, most)
        _name(errors, drawn, 0.05 * end, 0.08 * most)
        for one in (axes, errors):
            one.set_xlim(0, end)
            one.set_xlabel("depth as dug, mm")
            one.grid(color=INK, alpha=0.08, lw=0.6)
        axes.legend(handles=handles, frameon=False, fontsize=8.5, loc="upper left")
        if not drawn:
            axes.text(
                0.5, 0.3, "no depth was both dug and reported", transform=axes.transAxes, ha="center", color=FAINT
            )
        return png(figure)


def unity_page(unity: Unity, picture: bytes, created: str) -> str:
    """One HTML document; `report.pdf.to_pdf` makes paper of it. created : ISO time."""
    judged = unity.judgement
    return sheet(
        TEMPLATE,
        {"unity": picture},
        source=unity.source,
        created=minute(created),
        version="",
        running="Survey against excavations",
        look=LOOKS[judged.outcome],
        heading=HEADINGS[judged.outcome],
        judged=judged.statement(),
        claim=unity.claim.statement(),
        remarks=unity.remarks,
        digs=unity.digs,
        facts=list(_facts(unity)),
        line=unity.line_statement,
        sizing=unity.sizing.statement(),
        rows=[_cells(row) for row in unity.rows],
        next_digs=[_next_cells(one) for one in unity.next_digs],
        shift=_shift(unity),
        chosen=CHOSEN,
        levels=judged.level,
    )


def _draw_row(axes: Any, row: DugPlace, x: float, y: float, x_bar: float, y_bar: float) -> None:
    assert row.place is not None
    colour = COLOURS.get(row.place.kind, INK)
    fill = colour if row.within is not False else "white"
    marker = "^" if row.place.at_least else "o"
    axes.errorbar(
        x,
        y,
        xerr=x_bar or None,
        yerr=y_bar or None,
        fmt=marker,
        ms=5.5,
        color=colour,
        mfc=fill,
        mec=colour,
        elinewidth=0.9,
        capsize=2.0,
        zorder=4,
    )


def _name(axes: Any, drawn: Sequence[tuple[DugPlace, tuple[float, float]]], near_x: float, near_y: float) -> None:
    """Names beside the points, of those that crowd the first alone."""
    named: list[tuple[float, float]] = []
    for row, (dug, reported) in drawn:
        x, y = dug, reported - dug
        if row.place is None or any(abs(x - a) < near_x and abs(y - b) < near_y for a, b in named):
            continue
        named.append((x, y))
        style = {"textcoords": "offset points", "fontsize": 8.5, "color": FAINT}
        axes.annotate(row.place.name, (x, y), xytext=(6, 3), **style)


def _marks(rows: Sequence[DugPlace]) -> Iterator[Line2D]:
    """Of what is drawn, one each."""
    for kind, colour in COLOURS.items():
        if any(row.place and row.place.kind == kind for row in rows):
            yield Line2D([], [], ls="", marker="o", color=colour, label=f"{kind}, bars k = 2")
    if any(row.within is False for row in rows):
        yield Line2D([], [], ls="", marker="o", color=INK, mfc="white", label="outside of the tolerance")
    if any(row.place and row.place.at_least for row in rows):
        yield Line2D([], [], ls="", marker="^", color=INK, label="reported as a lower limit")


def _bound(unity: Unity) -> float:
    """Half the width between the bounds: the claim with a typical dig's own; NaN where either differs by place."""
    if math.isnan(unity.claim.single_mm):
        return math.nan
    stated = [unity.claim.of_dig(row.dig.depth_u_mm) for row in unity.rows if math.isfinite(row.dig.depth_u_mm)]
    return math.hypot(unity.claim.single_mm, float(np.median(stated)) if stated else 0.0)


def _depths(row: DugPlace) -> tuple[float, float] | None:
    """(dug, reported) mm where both are known and of one kind."""
    if row.place is None or row.same_kind is False:
        return None
    both = row.dig.depth_mm, row.place.depth_mm
    return both if all(math.isfinite(one) for one in both) else None


def _most_off(row: DugPlace) -> float:
    """Both bars of an error together."""
    return math.hypot(_bar(row.dig.depth_u_mm), _bar(row.place.depth_k2_mm if row.place else 0.0))


def _bar(k2_mm: float) -> float:
    return k2_mm if math.isfinite(k2_mm) else 0.0


def _facts(unity: Unity) -> Iterator[tuple[str, str, str]]:
    judged = unity.judgement
    yield "Digs", str(len(unity.rows)), f"{sum(row.is_sized for row in unity.rows)} with a depth to compare"
    yield "Within tolerance", f"{judged.within} of {judged.n}", _interval(judged.proportion)
    missed = unity.count(Dug.MISSED)
    yield "Not listed", f"{missed} of {missed + unity.count(Dug.FOUND)}", "dug defects; no measure of what is missed"
    there = unity.confirmed
    yield "Confirmed", f"{there.hits} of {there.n}", f"of the listed places that were dug; {_interval(there)}"
    yield "To accept", "-" if not judged.needed else str(judged.needed), "more digs, all within"


def _interval(found: Proportion) -> str:
    if not found.n:
        return "none tried"
    lower, upper, confidence = (100 * one for one in (found.lower, found.upper, found.confidence))
    return f"{lower:.0f} % to {upper:.0f} % with {confidence:.0f} % confidence"


def _cells(row: DugPlace) -> dict[str, str]:
    place = row.place
    within = {True: "within", False: "outside", None: ""}[row.within]
    return {
        "dig": row.dig.called,
        "kind": row.dig.kind.value,
        "at": quoted(row.dig.z_mm, DISTANCE),
        "clock": clock_face(row.dig.clock_deg),
        "dug": quoted(row.dig.depth_mm, MEASURE, row.dig.depth_u_mm) if math.isfinite(row.dig.depth_mm) else "",
        "listed": "" if place is None else f"{place.name}, {place.kind}",
        "reported": ""
        if place is None
        else quoted(place.depth_mm, MEASURE, place.depth_k2_mm, at_least=place.at_least),
        "error": quoted(row.error_mm, MEASURE) if row.is_sized else "",
        "tolerance": f"± {digits_k2(row.tolerance_mm, MEASURE)} mm" if math.isfinite(row.tolerance_mm) else "",
        "outcome": ", ".join(
            one for one in (row.outcome.value, "another kind" * (row.same_kind is False), within) if one
        ),
    }


def _next_cells(one: NextDig) -> dict[str, str]:
    place = one.place
    return {
        "name": place.name,
        "kind": place.kind,
        "at": quoted(place.z_mm, DISTANCE),
        "clock": "all round"
        if place.arc_deg >= 360.0
        else f"{clock_face(place.clock_deg)}, {quoted(place.arc_deg, ARC)}",
        "depth": quoted(place.depth_mm, MEASURE, place.depth_k2_mm, at_least=place.at_least),
        "remains": f"{100 * one.remains:.0f} %",
        "why": f"no {place.kind} was verified yet" if one.new_kind else "",
    }


def _shift(unity: Unity) -> str:
    if unity.shift_basis == "none":
        return "Dug and listed places were matched on one zero of the chainage."
    by = "names" if unity.shift_basis == "names" else "places"
    return f"{unity.shift_mm:+.0f} mm were added to the digs' distances, by the {by} of what was dug."
