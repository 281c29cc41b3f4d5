"""pod.html: what a study of detection showed, and its pictures, which other pages take."""

import importlib.metadata
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from annulus_pipe.numeric.rounding import MEASURE, digits, digits_k2
from annulus_pipe.qualification.hit_miss import CONFIDENCE, HIT_MISS, POD, TARGETS_ASKED, PodFit, SizeAxis
from annulus_pipe.qualification.pod import CALLED, DIMENSIONS, Detectability, PodRow
from annulus_pipe.qualification.sizing import Basis
from annulus_pipe.qualification.trials import JUDGED, Trial, Trials, TrialState
from annulus_pipe.report.names import BUMP_BLUE, FAINT, INK, LOSS_RED
from annulus_pipe.report.paper import DPI, SHEET_IN, in_style, png
from annulus_pipe.report.sheet import minute, sheet

TEMPLATE = "pod.html.j2"
PANEL_IN = 3.3  # height of a picture
ROOM = 0.7  # of the largest size laid: left of it a90/95's own name has room beside its line
SCATTER = 0.025  # of POD: marks of hits and misses are spread by it, or many would be one
COLOUR = {"loss": LOSS_RED, "bump": BUMP_BLUE}


def pictures(found: Detectability, trials: Trials) -> dict[str, bytes]:
    """By name: pod-KIND, POD against each dimension with its data; depth-KIND, reported depth against true one."""
    out = {}
    judged = [one for one in trials.trials if one.state in JUDGED and one.truth.laid]
    with in_style():
        for kind in found.kinds:
            its = [one for one in judged if one.truth.kind == kind]
            out[f"pod-{kind}"] = _pod(found, kind, its)
            if any(one.state is TrialState.DETECTED and one.reported_depth_mm > 0 for one in its):
                out[f"depth-{kind}"] = _depth(found, kind, its)
    return out


def pod_page(found: Detectability, drawn: dict[str, bytes]) -> str:
    """One HTML document, from the value and its pictures."""
    return sheet(
        TEMPLATE,
        drawn,
        source=", ".join(found.pulls[:6]) + (f" and {len(found.pulls) - 6} more" if len(found.pulls) > 6 else ""),
        created=minute(found.created),
        version=importlib.metadata.version("annulus-pipe"),
        running="Probability of detection",
        of=list(_of(found)),
        kinds=[(kind, CALLED.get(kind, kind), found.statement(kind)) for kind in found.kinds],
        calls=found.false_calls.statement(),
        rows=[cells for one in found.rows for cells in _cells(one)],
        asked=TARGETS_ASKED,
        confidence=f"{100 * CONFIDENCE:.0f} %",
        pictures=list(drawn),
    )


def _of(found: Detectability) -> Iterator[tuple[str, str]]:
    yield "Heads, serial numbers", ", ".join(one or "not stated" for one in found.heads) or "not stated"
    yield "Software", ", ".join(f"annulus {one}" if one else "not stated" for one in found.versions) or "not stated"
    least, most = found.bore_mm
    if not math.isnan(least):
        wide = digits(least, MEASURE) if least == most else f"{digits(least, MEASURE)} to {digits(most, MEASURE)}"
        yield "Inner diameter of the pipes", f"{wide} mm"
    out = found.left_out
    yield "Undecided", f"{out.undecided}: reported as places that may be nothing, counted as missed"
    yield (
        "Left out",
        (
            f"{out.not_seen} in holes of the survey, {out.outside} outside of what was scanned,"
            f" {out.dug} dug up because they were reported"
        ),
    )


def _cells(row: PodRow) -> Iterator[tuple[str, ...]]:
    yield row.kind, row.dimension, row.where, *_numbers(row.fit)
    if row.response is not None:
        yield row.kind, "reported depth", row.where, *_numbers(row.response)


def _numbers(fit: PodFit) -> tuple[str, ...]:
    sizes = [_mm(one) for one in (fit.a50_mm, fit.a90_mm)]
    bound = "" if fit.a9095_mm is None else digits_k2(fit.a9095_mm, MEASURE)
    laid = f"{digits(fit.from_mm, MEASURE)} to {digits(fit.to_mm, MEASURE)}" if fit.laid else ""
    more = fit.why if fit.why else f"in {fit.axis}"
    if fit.laid < TARGETS_ASKED and fit.a9095_mm is not None and fit.method == HIT_MISS:
        more += f"; {TARGETS_ASKED} are asked for"
    return str(fit.laid), laid, str(fit.detected), *sizes, bound, more


def _mm(value: float | None) -> str:
    return "" if value is None else digits(value, MEASURE)


def _pod(found: Detectability, kind: str, its: Sequence[Trial]) -> bytes:
    rows = [row for row in (found.row(kind, one) for one in DIMENSIONS) if row is not None]
    figure = Figure(figsize=(SHEET_IN, PANEL_IN), dpi=DPI)
    wide = 0.94 / len(rows)
    for i, row in enumerate(rows):
        axes = figure.add_axes((0.065 + i * wide, 0.155, wide - 0.065, 0.70))
        _draw_pod(axes, row.fit, [_sized(one, row.dimension) for one in its], COLOUR.get(kind, INK))
        axes.set_xlabel(f"{row.dimension}, mm")
        if not i:
            axes.set_ylabel("probability of detection")
            handles, names = axes.get_legend_handles_labels()
            figure.legend(
                handles, names, loc="upper left", bbox_to_anchor=(0.06, 0.99), ncols=4, frameon=False, fontsize=8.5
            )
    return png(figure)


def _draw_pod(axes: Any, fit: PodFit, trials: Sequence[tuple[float, bool]], colour: str) -> None:
    spread = np.random.default_rng(0).uniform(0, SCATTER, len(trials))
    for hit, name, mark in ((True, "detected", "o"), (False, "missed", "x")):
        at = [
            (size, hit + (-off if hit else off)) for (size, was), off in zip(trials, spread, strict=True) if was is hit
        ]
        if at:
            shown = {"mfc": "none"} if mark == "o" else {}
            axes.plot(*zip(*at, strict=True), mark, ms=4, mec=FAINT, label=name, clip_on=False, **shown)
    if fit.curve is not None:
        axes.plot(fit.curve.size_mm, fit.curve.pod, color=colour, lw=1.8, label="POD")
        name = f"lower bound, {100 * CONFIDENCE:.0f} % confidence"
        axes.plot(fit.curve.size_mm, fit.curve.lower, color=colour, lw=1.2, ls=(0, (4, 3)), label=name)
    axes.axhline(POD, color=FAINT, lw=0.6, alpha=0.5)
    if fit.a9095_mm is not None:
        axes.plot([fit.a9095_mm] * 2, [0, POD], color=INK, lw=0.9)
        text = f"a90/95 {digits_k2(fit.a9095_mm, MEASURE)}"
        right = fit.a9095_mm < ROOM * fit.to_mm  # of the line no curve is so low, and no miss so high
        height, side = (0.45, "left") if right else (0.06, "right")
        axes.text(fit.a9095_mm, height, f" {text} ", fontsize=8.5, ha=side)
    else:
        axes.text(0.5, 0.5, "a90/95\nnot established", transform=axes.transAxes, fontsize=8.5, color=FAINT, ha="center")
    axes.set_ylim(-0.04, 1.04)
    axes.set_xlim(0, 1.04 * max([fit.to_mm, *(size for size, _ in trials if math.isfinite(size))]))
    axes.grid(color=INK, alpha=0.10, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _sized(one: Trial, dimension: str) -> tuple[float, bool]:
    truth = one.truth
    size = {"depth": truth.depth_mm, "length": truth.length_mm, "width": truth.width_mm}[dimension]
    return size, one.state is TrialState.DETECTED


def _depth(found: Detectability, kind: str, its: Sequence[Trial]) -> bytes:
    figure = Figure(figsize=(SHEET_IN, PANEL_IN), dpi=DPI)
    left, right = (figure.add_axes((x, 0.155, 0.40, 0.70)) for x in (0.065, 0.58))
    row = found.row(kind)
    sized = [one for one in its if one.state is TrialState.DETECTED and one.reported_depth_mm >= 0]
    most = 1.06 * max(max(one.truth.depth_mm for one in its), max(one.reported_depth_mm for one in sized))
    colour = COLOUR.get(kind, INK)
    left.plot([0, most], [0, most], color=FAINT, lw=0.7, label="as deep as it is")
    if row is not None and row.line is not None:
        size = np.linspace(max(row.fit.from_mm, 1e-3), row.fit.to_mm, 100)
        at = {SizeAxis.LINEAR: size, SizeAxis.LOG: np.log(size)}[SizeAxis(row.line.true_axis)]
        line = row.line.intercept + row.line.slope * at
        back = np.exp if SizeAxis(row.line.reported_axis) is SizeAxis.LOG else np.asarray
        left.plot(size, back(line), color=colour, lw=1.6, label="fitted")
        low, high = (back(line + side * 1.645 * row.line.sigma) for side in (-1, 1))
        left.fill_between(size, low, high, color=colour, alpha=0.12, lw=0, label="90 % of reports")
        left.axhline(row.line.decision_mm, color=INK, lw=0.9, ls=(0, (4, 3)), label="listed from here on")
    _scatter(left, [(one.truth.depth_mm, one.reported_depth_mm, one.at_least) for one in sized])
    missed = [one.truth.depth_mm for one in its if one.state is not TrialState.DETECTED]
    left.plot(missed, [0.0] * len(missed), "x", ms=4, color=FAINT, clip_on=False, label="missed")
    left.set(xlim=(0, most), ylim=(0, most), xlabel="true depth, mm", ylabel="reported depth, mm")
    errors = [(one.truth.depth_mm, one.reported_depth_mm - one.truth.depth_mm, one.at_least) for one in sized]
    right.axhline(0, color=FAINT, lw=0.7)
    for name, sizing in found.sizing:
        for one in sizing.tolerances if name == kind else ():
            if one.basis is not Basis.NONE:
                words = f"{100 * one.certainty:.0f} % within ± {digits_k2(one.tolerance_mm, MEASURE)} mm"
                style = "-" if one.certainty < POD else (0, (4, 3))
                for side in (-1, 1):
                    right.axhline(
                        side * one.tolerance_mm, color=colour, lw=1.0, ls=style, label=words if side > 0 else None
                    )
    _scatter(right, errors)
    right.set(xlim=(0, most), xlabel="true depth, mm", ylabel="reported less true, mm")
    for axes in (left, right):
        axes.grid(color=INK, alpha=0.10, lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        corner = {"loc": "lower left", "bbox_to_anchor": (0, 1.0), "borderaxespad": 0.1}
        if axes.get_legend_handles_labels()[1]:  # errors have no limits where too few were sized
            axes.legend(**corner, ncols=3 if axes is left else 2, frameon=False, fontsize=7.5)
    return png(figure)


def _scatter(axes: Any, points: Sequence[tuple[float, float, bool]]) -> None:
    for at_least, mark, name in ((False, "o", None), (True, "^", "at least")):
        its = [(x, y) for x, y, flag in points if flag is at_least]
        if its:
            axes.plot(*zip(*its, strict=True), mark, ms=4, mfc="none", mec=INK, mew=0.8, label=name)
