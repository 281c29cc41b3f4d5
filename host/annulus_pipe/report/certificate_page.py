"""certificate.html: what a gauge study showed of a head, for whom its numbers are quoted to, on paper too."""

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from annulus_pipe.numeric.rounding import MEASURE, quoted, two_digits_up
from annulus_pipe.qualification.certificate import DIAMETER_MARGIN, KELVIN_MARGIN, Certificate
from annulus_pipe.qualification.precision import LIMIT, Interval
from annulus_pipe.report.paper import DPI, SHEET_IN, in_style, png
from annulus_pipe.report.sheet import sheet

TEMPLATE = "certificate.html.j2"
ACCURACY_ASKED, REPEATABILITY_ASKED = 0.5, 0.12  # percent: what certified profilers state, and owners ask for
RADII_ASKED = 1080  # a picture: ASTM F3080
MARKS = "osD^vPX*<>"  # of operators
HEIGHT_IN = 3.4
DECIMALS_MOST = 6  # of a percentage: a nanometre of a 4-inch pipe
INKS = ("#1f5fa8", "#c2611f", "#3b7d3a", "#7b4aa0", "#8a6d1d", "#a02c4a", "#2b7f86", "#555f6b")


def certificate_page(certificate: Certificate) -> str:
    """One HTML document; `report.pdf.to_pdf` makes paper of it."""
    accuracy, scope, form = certificate.accuracy, certificate.scope, certificate.form
    signature = certificate.signature
    return sheet(
        TEMPLATE,
        {"errors": _errors(certificate)},
        source=certificate.title or "Gauge study on reference pieces of pipe",
        created=f"issued {scope.issued}",
        version="",
        running=f"Certificate {certificate.number}",
        number=certificate.number,
        valid=list(_valid(certificate)),
        states=list(_states(certificate)),
        profiler=[
            (
                "accuracy: largest error of a run's mean diameter",
                _percent_up(accuracy.worst),
                f"{ACCURACY_ASKED:g} %",
                _met(accuracy.worst <= ACCURACY_ASKED),
            ),
            (
                "repeatability: limit r of one operator and piece",
                _percent_up(LIMIT * accuracy.s_r.value),
                f"{REPEATABILITY_ASKED:g} %",
                _met(LIMIT * accuracy.s_r.value <= REPEATABILITY_ASKED),
            ),
            (
                "points of the wall in a picture under rings",
                f"{form.points_per_picture:,.0f}",
                f"{RADII_ASKED:,}",
                _met(form.points_per_picture >= RADII_ASKED) if form.points_per_picture else "not recorded",
            ),
            ("diameter in any direction, largest error of a station", _percent_up(accuracy.worst_direction), "", ""),
            ("a round piece reads out of round by at most (ASTM F1216)", _percent_up(form.ovality_percent), "", ""),
            ("lens chart", form.lens or "not recorded", "", ""),
        ],
        budget=[
            (
                row.name,
                row.kind,
                two_digits_up(row.u),
                "∞" if row.dof is None else f"{row.dof:.3g}",
                f"{100 * row.share:.0f}",
                row.source,
            )
            for row in certificate.budget
        ],
        dominant=max(certificate.budget, key=lambda row: row.u).name,
        combined=(
            two_digits_up(accuracy.u),
            "∞" if accuracy.dof is None else f"{accuracy.dof:.3g}",
            f"{accuracy.k:.3g}",
            two_digits_up(accuracy.U),
        ),
        pieces=[
            (
                one.name,
                quoted(one.diameter_mm, MEASURE, one.k2_mm),
                one.measured_by or "not stated",
                f"{one.mean_mm:.3f}",
                f"{100 * (one.mean_mm / one.diameter_mm - 1):+.3f}",
                f"{one.s_r_mm:.4f}",
                f"{one.s_R_mm:.4f}",
                f"{LIMIT * one.s_r_mm:.4f}",
                f"{LIMIT * one.s_R_mm:.4f}",
                ", ".join(f"{k:.2f}" for k in one.k),
            )
            for one in certificate.pieces
        ],
        operators=", ".join(certificate.operators),
        laboratory=certificate.laboratory or "not stated",
        runs=[
            (
                one.number,
                one.operator,
                one.piece,
                one.repeat,
                "" if one.temperature_c is None else f"{one.temperature_c:g}",
                f"{one.diameter_mm:.3f}",
                f"{one.error:+.3f}",
                one.results,
            )
            for one in certificate.runs
        ],
        open=certificate.left_open,
        signature=None if signature is None else (signature.fingerprint, signature.public_key, signature.value),
    )


def _valid(certificate: Certificate) -> Iterator[tuple[str, str]]:
    scope = certificate.scope
    yield "Head, serial number", scope.head
    yield "Calibration, fingerprint", scope.calibration or "not stated by the runs"
    yield "Firmware", scope.firmware or "not stated by the runs"
    yield "Software", f"annulus {scope.software}" if scope.software else "not stated by the runs"
    low, high = scope.diameter_mm
    margin = DIAMETER_MARGIN * high
    yield "Inner diameters", f"{low:g} to {high:g} mm, and {margin:.1f} mm beyond"
    warm = scope.temperature_c
    yield (
        "Temperature of the pipe",
        "not certified: not every run has one"
        if warm is None
        else f"{warm[0]:g} to {warm[1]:g} °C, and {KELVIN_MARGIN:g} K beyond",
    )
    yield "Valid", f"{scope.issued} to {scope.until}"


def _states(certificate: Certificate) -> Iterator[tuple[str, str, str]]:
    accuracy = certificate.accuracy
    yield "a diameter keeps, in 19 of 20, bias included", f"± {two_digits_up(accuracy.U)} %", ""
    yield ".. in a scan without a reference section, its optics drifting", f"± {two_digits_up(accuracy.U_drift)} %", ""
    yield "bias: mean error of these pieces and operators", f"{accuracy.bias.value:+.3f} %", _bounds(accuracy.bias)
    yield "standard deviation of repeatability s_r (E691)", _percent(accuracy.s_r.value), _bounds(accuracy.s_r)
    yield "standard deviation of reproducibility s_R (E691)", _percent(accuracy.s_R.value), _bounds(accuracy.s_R)
    yield (
        f"limits of repeatability and reproducibility, {LIMIT:g} s (E177)",
        ", ".join(f"{two_digits_up(LIMIT * one.value)} %" for one in (accuracy.s_r, accuracy.s_R)),
        "",
    )
    if accuracy.per_kelvin is not None:
        slope, sigma = accuracy.per_kelvin
        yield "temperature changes an error by, a kelvin", f"{slope:+.4f} %", f"± {2 * sigma:.4f}"


def _bounds(interval: Interval) -> str:
    places = max(_places(interval.low), _places(interval.high))
    return f"{interval.low:.{places}f} to {interval.high:.{places}f}"


def _percent(value: float) -> str:
    return f"{value:.{_places(value)}f} %"


def _percent_up(value: float) -> str:
    """What is held against a limit: it never shows as within one that it is beyond."""
    places = _places(value)
    return f"{math.ceil(round(value * 10**places, DECIMALS_MOST)) / 10**places:.{places}f} %"


def _places(value: float) -> int:
    """Three decimals, and of what would show as 0 so many that it does not."""
    small = 0.0 < abs(value) < 0.005
    return min(DECIMALS_MOST, 1 - math.floor(math.log10(abs(value)))) if small else 3


def _met(is_met: bool) -> str:
    return "met" if is_met else "NOT MET"


def _errors(certificate: Certificate) -> bytes:
    """Every reading's error in the order of the runs, a panel a piece: what repeats, what differs, and the limits."""
    names = [piece.name for piece in certificate.pieces]
    accuracy = certificate.accuracy
    with in_style():
        figure = Figure(figsize=(SHEET_IN, HEIGHT_IN), dpi=DPI, layout="constrained")
        panels = np.atleast_1d(np.array(figure.subplots(1, len(names), sharey=True)))
        for panel, name in zip(panels, names, strict=True):
            panel.axhspan(-accuracy.U, accuracy.U, color="#e8eef5", lw=0)
            panel.axhline(0.0, color="#6b7885", lw=0.8)
            for i, operator in enumerate(certificate.operators):
                mine = [run for run in certificate.runs if run.piece == name and run.operator == operator]
                panel.plot(
                    [run.number for run in mine],
                    [run.error for run in mine],
                    MARKS[i % len(MARKS)],
                    color=INKS[i % len(INKS)],
                    ms=5,
                    label=operator,
                )
            panel.set_title(name)
            panel.set_xlabel("run")
            panel.spines[["top", "right"]].set_visible(False)
        panels[0].set_ylabel("error, % of the diameter")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=4, frameon=False)
        return png(figure)
