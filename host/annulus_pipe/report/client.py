"""What makes a client sign a report: whose job it was, the verdict, each defect from close by, how sure all of it is.

Values for job.html.j2, verdict.html.j2, details.html.j2 and accuracy.html.j2; numbers as `numeric.rounding` says them.
"""

import base64
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from annulus_pipe.job import NUMBERS, WORDS, Observation, Origin
from annulus_pipe.numeric.rounding import (
    ANGLE,
    ARC,
    AREA,
    DISTANCE,
    EXTENT,
    MEASURE,
    PERCENT,
    SHARE,
    Quantity,
    clock_face,
    digits,
    digits_k2,
    off,
    quoted,
    span,
)
from annulus_pipe.report.account import ScanAccount
from annulus_pipe.report.cuts import across, along
from annulus_pipe.report.names import letter, marked, question
from annulus_pipe.report.photographs import part_of_map, photograph
from annulus_pipe.wall.accuracy import tolerances
from annulus_pipe.wall.conformity import QUANTITIES, RULE, Decision, Judged, Verdict
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.scale import anchor
from annulus_pipe.wall.sections import MOST, cut, worth_showing
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wall.unjudged import Unjudged

NOT_RECORDED = "not recorded"
STATIONS_MAX = 24  # rows of the table, the worst ones beside
HOLE_OF_SIZE = 3.0  # times the smallest size listed, both ways: smaller holes of one cause share one row
CLOCKS_MAX = 8  # named in such a row
PLACES_MAX = 60  # of the table of what is not established; summary.json has all
UNITS = {"mm": MEASURE, "%": PERCENT, "°": ANGLE}
TOLERANCES = {"mm": MEASURE, "mm²": AREA}
OVERALL = {
    Decision.CONFORMS: ("Conforms", "sound"),
    Decision.SEEN: ("Conforms where seen", "sound"),
    Decision.UNDECIDED: ("Undecided", "look"),
    Decision.FAILS: ("Does not conform", ""),
}
SHEET_UNITS = {"nominal_diameter_mm": " mm", "sdr": "", "temperature_c": " °C"}
assert SHEET_UNITS.keys() == NUMBERS.keys()


def values(survey: Survey, account: ScanAccount) -> dict[str, Any]:
    """Everything the four parts ask for, by name."""
    verdict = account.verdict
    return {
        "job": list(_job(account.origin)),
        "calibrated": [
            *_calibrated(account.origin),
            ("Check against a reference section", anchor(survey.scale, survey.diameter_mean_mm)),
        ],
        "conformity": None if verdict is None else _conformity(verdict, survey.seen_fraction),
        "holes": list(_holes(survey)),
        "least_hole": quoted(survey.size_limit_mm, EXTENT),
        "details": _details(survey, account),
        "observations": [_observed(i, one) for i, one in enumerate(account.origin.observations)],
        "marks_left_out": account.origin.marks_left_out,
        "station_rows": list(_stations(survey)),
        "accuracy": _accuracy(survey, account),
    }


def _job(origin: Origin) -> Iterator[tuple[str, str]]:
    """Every field, whether somebody said it or not."""
    sheet = origin.job.to_dict()
    for name, words in WORDS.items():
        value = sheet.get(name)
        if name in SHEET_UNITS and value is not None:
            yield words, f"{value:g}{SHEET_UNITS[name]}"
        elif name == "date" and value is None and origin.utc[0]:
            yield words, f"{origin.utc[0][:10]} (UTC, by the recorder's clock)"
        elif name != "remarks" or value:
            yield words, str(value) if value else NOT_RECORDED
    if origin.utc[0]:
        yield "Recorded", f"{_moment(origin.utc[0])} to {_moment(origin.utc[1])} UTC"
    if serial := origin.controller.get("serial"):
        yield "Controller board", f"{serial}, firmware {origin.controller.get('version', NOT_RECORDED)}"


def _moment(utc: str) -> str:
    return utc[:16].replace("T", " ")


def _calibrated(origin: Origin) -> Iterator[tuple[str, str]]:
    """How the head was calibrated, as far as that was written down."""
    yield "Calibration", origin.calibration_file or NOT_RECORDED
    for section, made in sorted(origin.calibration.items()):
        parts = [str(made.get("by", "by what, not recorded"))]
        parts.append(str(made["utc"])[:10] if made.get("utc") else "date not recorded")
        for key, unit in (("held_out_mm", "mm"), ("residual_px", "px"), ("rms_px", "px"), ("rms_rad", "rad")):
            value = made.get(key)
            if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
                parts.append(f"{key.rsplit('_', 1)[0].replace('_', ' ')} {value:.3g} {unit}")
        yield f"Calibrated: {section}", ", ".join(parts)
    if not origin.calibration:
        yield "Calibrated when, and how", NOT_RECORDED


def _observed(index: int, one: Observation) -> dict[str, str]:
    """What an operator marked, as it was said; a picture says whose it is."""
    name = marked(index)
    camera = f" of camera {one.camera}" if one.camera else ""
    captions = {
        "photo": f"{name}: photo by the operator.",
        "frame": f"{name}: LED frame {one.frame}{camera}, taken there, looking forward; brightness stretched.",
    }
    return {
        "number": name,
        "at": digits(one.z_mm, DISTANCE) if math.isfinite(one.z_mm) else "not known",
        "clock": "" if one.clock_deg is None else clock_face(one.clock_deg),
        "text": one.text,
        "when": _second(one.utc),
        "caption": captions.get(one.shows, ""),
        "picture": f"data:image/jpeg;base64,{base64.b64encode(one.picture).decode()}" if one.picture else "",
        "remark": "its photo cannot be read" if one.photo_unread else "",
    }


def _second(utc: str) -> str:
    return utc[:19].replace("T", " ")


def _conformity(verdict: Verdict, seen: float) -> dict[str, Any]:
    overall, look = OVERALL[verdict.decision]
    if verdict.decision is Decision.SEEN:
        overall += f" ({quoted(math.floor(1000.0 * seen) / 10.0, SHARE)} of the wall)"
    still_open = [one for one in verdict.not_established if not one.usual and not one.is_hole]
    return {
        "title": verdict.criteria.title,
        "overall": overall,
        "look": look,
        "rule": RULE,
        "accepted": verdict.criteria.accepted,
        "rows": [_judged(one) for one in _governing(verdict)],
        "remarks": list(verdict.remarks),
        "limits": list(_limits(verdict)),
        "places": [*map(_place, still_open[:PLACES_MAX]), *_folded(verdict.not_established)],
        "places_left_out": max(len(still_open) - PLACES_MAX, 0),
    }


def _place(one: Unjudged) -> dict[str, str]:
    return {
        "at": span(one.z_from_mm, one.z_to_mm, DISTANCE, unit=False),
        "clock": "all round" if one.arc_deg >= 360.0 else " to ".join(one.clock_range),
        "limits": ", ".join(one.kinds),
        "why": one.reason,
        "open": "no" if one.usual else "yes",
    }


def _holes(survey: Survey) -> Iterator[dict[str, str]]:
    """Holes in the map, the larger ones a row each; of the small ones of a cause, and of those that every scan has, one
    row that says at which clocks."""
    radius = survey.wall.mean_radius_mm
    large = HOLE_OF_SIZE * survey.size_limit_mm
    sorts: dict[tuple[bool, bool, str], list[Unjudged]] = {}
    for one in survey.unjudged:
        if one.is_hole:
            wide = one.usual or min(one.z_to_mm - one.z_from_mm, math.radians(one.arc_deg) * radius) >= large
            sorts.setdefault((one.usual, not wide, one.reason), []).append(one)
    for (usual, small, _), many in sorted(sorts.items(), key=lambda sort: sort[0][:2]):
        many.sort(key=lambda one: one.z_from_mm)
        each = [[one] for one in many[:PLACES_MAX]] if not usual and not small else [many]
        for some in each:
            first, last = min(one.z_from_mm for one in some), max(one.z_to_mm for one in some)
            row = {**_place(some[0]), "at": span(first, last, DISTANCE, unit=False)}
            if len(some) > 1:
                clocks = sorted({round(one.clock_deg / 5.0) * 5.0 for one in some})
                near = ", ".join(clock_face(clock) for clock in clocks) if len(clocks) <= CLOCKS_MAX else "all about"
                row["clock"] = f"{len(some)} places: {near}"
            length = max(one.z_to_mm - one.z_from_mm for one in some)
            arc = max(one.arc_deg for one in some)
            size = f"{quoted(length, EXTENT)}, {quoted(arc, ARC)}"
            yield row | {"size": size if len(some) == 1 else f"up to {size}"}


def _folded(places: Sequence[Unjudged]) -> Iterator[dict[str, str]]:
    """Holes, which have a table of their own, and what every scan has, one row a sort; summary.json has each."""
    sorts: dict[tuple[tuple[str, ...], str, bool], list[Unjudged]] = {}
    for one in sorted(places, key=lambda one: one.usual):
        if one.usual or one.is_hole:
            sorts.setdefault((one.kinds, one.reason, one.usual), []).append(one)
    for many in sorts.values():
        row = _place(many[0])
        if len(many) > 1:
            first, last = min(one.z_from_mm for one in many), max(one.z_to_mm for one in many)
            row |= {"at": span(first, last, DISTANCE, unit=False), "clock": f"{len(many)} places"}
        yield row


def _governing(verdict: Verdict) -> Iterator[Judged]:
    """Of each thing the quantity that decides; of the pipe as a whole every one."""
    for one in verdict.items:
        if one.group == "pipe" or one is verdict.worst_of(one.group, one.index):
            yield one


def _name(one: Judged) -> str:
    if one.group == "defect":
        return str(one.index + 1)
    return {"undecided": question(one.index), "feature": letter(one.index), "pipe": "pipe"}[one.group]


def _judged(one: Judged) -> dict[str, str]:
    unit = UNITS[one.of.unit]
    least, most = min(one.severities), max(one.severities)
    severity = str(one.severity) if one.severity else "none"
    if least != most:
        severity += f" ({least or 'none'} to {most})"
    return {
        "number": _name(one),
        "kind": one.kind,
        "what": one.of.words,
        "at": _cell(one.z_mm, DISTANCE),
        "measured": quoted(one.value, unit, one.k2, at_least=one.at_least),
        "limit": "none"
        if math.isnan(one.limit)
        else f"{'above' if one.of.lower else 'below'} {quoted(one.limit, unit)}",
        "severity": severity,
        "decision": str(one.decision),
        "group": one.group,
    }


def _limits(verdict: Verdict) -> Iterator[dict[str, str]]:
    for kind, grades in verdict.criteria.grades.items():
        for one in sorted(grades, key=lambda one: (one.quantity, one.severity)):
            quantity = QUANTITIES[kind][one.quantity]
            side = "or less" if quantity.lower else "or more"
            yield {
                "kind": kind,
                "what": quantity.words,
                "severity": str(one.severity),
                "from": f"{quoted(one.start, UNITS[quantity.unit])} {side}",
                "accepted": "accepted" if one.severity <= verdict.criteria.accepted else "not accepted",
            }


def _details(survey: Survey, account: ScanAccount) -> dict[str, Any]:
    chosen = worth_showing(survey.defects, MOST, account.verdict.foremost if account.verdict else ())
    taken = {one.view.index: one for one in account.photographs}
    shown = []
    for one in cut(survey, chosen):
        defect = survey.defects[one.index]
        drawn, ring = across(one, survey.wall.clock_deg, defect)
        picture, caption = None, "No photograph: no LED frame shows it, and it is not on the map of colour."
        if one.index in taken:
            view = taken[one.index].view
            picture = photograph(taken[one.index])
            camera = f" of camera {view.shot.camera}" if len(survey.cameras) > 1 else ""
            caption = (
                f"LED frame {view.shot.index}{camera}, taken {quoted(view.ahead_mm, EXTENT)} before it, "
                f"{digits(view.oblique_deg, Quantity('°', 0))}° off the wall's normal. Looking forward; brightness "
                "stretched, outline as measured."
            )
        elif defect.kind is Kind.OVALITY:
            caption = "No photograph: a stretch is out of round, there is no one place to look at."
        elif (part := part_of_map(survey, one.index)) is not None:
            picture = part
            caption = (
                f"From the unrolled map ({survey.light}), not a photograph: distance to the right, clock downwards."
            )
        judged = None if account.verdict is None else account.verdict.worst_of("defect", one.index)
        apart = abs(abs(one.departs) - defect.depth_mm)
        finer = defect.kind is not Kind.OVALITY and apart > max(defect.depth_k2_mm, 0.0)
        shown.append(
            {
                "number": str(one.index + 1),
                "kind": str(defect.kind),
                "across": drawn,
                "along": along(one, defect),
                "across_caption": f"Across, at {quoted(one.z_mm, DISTANCE)}, looking forward. Rings: "
                f"{quoted(ring, MEASURE)} outwards and inwards of the mean circle, Ø "
                f"{quoted(2 * one.mean_radius_mm, MEASURE)}.",
                "along_caption": f"Along, at clock {clock_face(one.clock_deg)}. Grey: the extent "
                f"{span(*defect.z_range_mm, DISTANCE)}; dashed: the depth of the list.",
                "depth": quoted(defect.depth_mm, MEASURE, defect.depth_k2_mm, at_least=not defect.floor_seen),
                "judged": None if judged is None else _judged(judged),
                "picture": picture,
                "caption": caption,
                "alt": f"Defect {one.index + 1}, {'photograph' if one.index in taken else 'part of the map of colour'}",
                "finer": finer,
            }
        )
    return {"shown": shown, "left_out": len(survey.defects) - len(shown)}


def _stations(survey: Survey) -> Iterator[dict[str, str]]:
    """Rows at even steps, and the worst stations, marked."""
    s, any_k2 = survey.stations, survey.stations.any_diameter_k2_mm
    n = len(s.z_mm)
    step = max(1, math.ceil(n / STATIONS_MAX))
    worst: dict[int, list[str]] = {}
    for words, column, pick in (
        ("smallest diameter", s.diameter_min_mm, np.argmin),
        ("largest diameter", s.diameter_max_mm, np.argmax),
        ("most out of round", s.shape_ovality_percent, np.argmax),
        ("least area", s.area_mm2, np.argmin),
    ):
        known = np.flatnonzero(np.isfinite(column))
        if len(known):
            worst.setdefault(int(known[int(pick(column[known]))]), []).append(words)
    for i in sorted({*range(0, n, step), *worst}):
        yield {
            "at": digits(s.z_mm[i], DISTANCE),
            "worst": ", ".join(worst.get(i, ())),
            "x": _cell(s.diameter_x_mm[i], MEASURE),
            "y": _cell(s.diameter_y_mm[i], MEASURE),
            "min": _cell(s.diameter_min_mm[i], MEASURE),
            "mean": _cell(s.diameter_mean_mm[i], MEASURE),
            "max": _cell(s.diameter_max_mm[i], MEASURE),
            "k2": digits_k2(any_k2[i], MEASURE) if math.isfinite(any_k2[i]) else "",
            "ovality": _cell(s.shape_ovality_percent[i], PERCENT),
            "around": _cell(s.circumference_mm[i], MEASURE),
            "around_k2": digits_k2(s.circumference_k2_mm[i], MEASURE)
            if math.isfinite(s.circumference_k2_mm[i])
            else "",
            "area": _cell(s.area_mm2[i], AREA),
            "area_k2": digits_k2(s.area_k2_mm2[i], AREA) if math.isfinite(s.area_k2_mm2[i]) else "",
            "seen": digits(100 * s.valid_fraction[i], SHARE),
        }


def _cell(value: float, quantity: Quantity) -> str:
    return digits(value, quantity) if math.isfinite(value) else ""


def _accuracy(survey: Survey, account: ScanAccount) -> dict[str, Any]:
    """The statement of accuracy: what this scan says of itself, and what a reference section says of this head. No
    number of the benchmarks: theirs are of simulated heads, most with their exact calibration."""
    rows = [
        {
            "what": one.what,
            "usual": _within(one.usual, one.unit),
            "most": _within(one.most, one.unit),
            "n": f"{one.n:,}",
        }
        for one in tolerances(survey)
    ]
    return {
        "rows": rows,
        "reference": anchor(survey.scale, survey.diameter_mean_mm),
        "least_depth": quoted(survey.depth_limit_mm, MEASURE),
        "least_size": quoted(survey.size_limit_mm, EXTENT),
        "quoted": account.stated.rows,
        "open": list(_not_covered(survey, account)),
    }


def _within(k2: float, unit: str) -> str:
    return "not known" if math.isnan(k2) else f"± {off(k2, TOLERANCES[unit])}"


def _not_covered(survey: Survey, account: ScanAccount) -> Iterator[str]:
    if not account.covariance_stated:
        yield (
            "the calibration's own uncertainty: calibration.json states no covariance, and an error of the head's "
            "calibration is in none of this scan's tolerances"
            + (": of diameters the certificate has it" if account.stated.percent is not None else "")
        )
    if survey.scale is None:
        yield "what the head's optics may have drifted by since its calibration"
    yield "a wall that light enters farther than the calibration's did, where no section of known diameter was seen"
    yield "distance along the pipe: what the odometer's wheel or cable is off"
    yield f"what nobody saw: {quoted(100 * (1 - survey.seen_fraction), SHARE)} of the wall"
    yield "the wall's thickness, its outside and the ground behind it: they are not measured from inside"
