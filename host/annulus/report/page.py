"""report.html: one page that opens anywhere, prints, and says the result first."""

import base64
import math
from collections.abc import Mapping
from importlib import resources
from typing import Any

import jinja2

from annulus.numeric.rounding import clock_face
from annulus.report.figures import Pictures
from annulus.report.half_view import EXAGGERATION
from annulus.report.paper import letter, question
from annulus.wall.defects import ALL_ROUND_DEG, UNSURE, Defect, Kind
from annulus.wall.features import Feature, FeatureKind, Measure
from annulus.wall.lost import RING_LOST
from annulus.wall.stations import NOT_ENOUGH
from annulus.wall.survey import Survey

TEMPLATE = "page.html.j2"
NAMES = {Kind.LOSS: "Wall loss", Kind.BUMP: "Bump into the pipe", Kind.OVALITY: "Out of round"}
ALL_ROUND = {Kind.LOSS: "Groove all round", Kind.BUMP: "Ridge all round"}
UNDECIDED = {Kind.LOSS: "Stands outwards", Kind.BUMP: "Stands inwards", Kind.OVALITY: "May be out of round"}
COUNTED: Mapping[Kind | FeatureKind, tuple[str, str]] = {  # one of them, and many
    Kind.LOSS: ("wall loss", "wall losses"), Kind.BUMP: ("bump", "bumps"),
    Kind.OVALITY: ("out-of-round stretch", "out-of-round stretches"),
    FeatureKind.JOINT: ("joint", "joints"), FeatureKind.GAP: ("gap", "gaps"),
    FeatureKind.BRANCH: ("opening", "openings"), FeatureKind.TEE: ("tee", "tees"),
    FeatureKind.WATER: ("stretch under water", "stretches under water"),
    FeatureKind.DEPOSIT: ("deposit", "deposits"), FeatureKind.REDUCER: ("reducer", "reducers"),
    FeatureKind.TAPER: ("taper", "tapers"), FeatureKind.BEND: ("bend", "bends"),
    FeatureKind.CROSS_BORE: ("cross bore", "cross bores"),
}  # fmt: skip
FEATURES = {
    FeatureKind.JOINT: "Joint", FeatureKind.GAP: "Gap in a coupling", FeatureKind.BRANCH: "Opening, branch",
    FeatureKind.TEE: "Opening, rim stands in", FeatureKind.WATER: "Water", FeatureKind.DEPOSIT: "Deposit",
    FeatureKind.REDUCER: "Reducer", FeatureKind.TAPER: "Taper", FeatureKind.BEND: "Bend",
    FeatureKind.CROSS_BORE: "Cross bore",
}  # fmt: skip
UNITS = {"deg": "°", "percent": "%", "ff": "fF"}
WORDS = {
    "hilo": "hi-lo",
    "hilo clock": "hi-lo towards",
    "angle clock": "turns towards",
    "inner d": "inner diameter",
}  # where the name says too little


def render_page(survey: Survey, summary: Mapping[str, Any], pictures: Pictures, **more: Any) -> str:
    """The report as one HTML document: no script, no font and no picture from anywhere else. more : what further parts
    of the page ask for, by name."""
    features = [_feature(letter(i), feature) for i, feature in enumerate(survey.features)]
    undecided = [
        {**_row(question(i), place, survey), "name": UNDECIDED[place.kind]}
        for i, place in enumerate(survey.detection.undecided)
    ]
    captions = {one["number"]: f"{one['number']}: {one['name'].lower()}" for one in (*features, *undecided)}
    text = resources.files("annulus.report").joinpath(TEMPLATE).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=jinja2.PackageLoader("annulus", "report"),
    )  # fmt: skip
    return environment.from_string(text).render(
        s=summary,
        survey=survey,
        rows=[_row(str(number), defect, survey) for number, defect in enumerate(survey.defects, start=1)],
        features=features,
        undecided=undecided,
        pictures=[(captions[name], _inline(data)) for name, data in pictures.features],
        verdict=_verdict(survey),
        look=_look(survey),
        unsure=UNSURE,
        unwrapped=_inline(pictures.unwrapped),
        texture=_inline(pictures.texture),
        cameras=None if pictures.cameras is None else _inline(pictures.cameras),
        stations=_inline(pictures.stations),
        lane=None if pictures.lane is None else _inline(pictures.lane),
        course=None if pictures.course is None else _inline(pictures.course),
        surface=[(caption, _inline(data)) for caption, data in pictures.surface],
        exaggeration=EXAGGERATION,
        length=_length(summary["scanned_mm"]["length"]),
        distance_from=f"{summary['scanned_mm']['from'] / 1000:.3f}",
        distance_to=f"{summary['scanned_mm']['to'] / 1000:.3f}",
        **more,
    )


def _verdict(survey: Survey) -> str:
    """The result in words: what is damaged, what there is besides, and what could not be said."""
    worst, undecided = survey.worst, len(survey.detection.undecided)
    kinds = [defect.kind for defect in survey.defects]
    damage = ", ".join(_count(kinds.count(kind), *COUNTED[kind]) for kind in Kind if kind in kinds)
    if worst is None:
        sure = "sure " if undecided else ""
        damage = f"No {sure}defect above the listing limits on the wall that was seen."
    elif worst.kind is Kind.OVALITY:
        damage = f"{damage}."
    else:
        damage = (
            f"{damage}. Deepest: {_name(worst).lower()} of {_depth(worst)} (k=2) "
            f"at {worst.z_mm / 1000:.3f} m, clock {worst.clock}."
        )
    said = [damage]
    named = [feature.kind for feature in survey.features]
    if named:
        counts = (_count(named.count(kind), *COUNTED[kind]) for kind in FeatureKind if kind in named)
        said.append(f"Also in the pipe: {', '.join(counts)}.")
    if undecided:
        said.append(
            f"{_count(undecided, 'place stands', 'places stand')} out and could not be decided: see below, look there."
        )
    missed = {finding.kind for finding in survey.findings}
    if NOT_ENOUGH in missed:
        said.append("Not enough of it was seen to say what shape the pipe has: see below.")
    if RING_LOST in missed:
        said.append("A ring of the pattern was lost: see below.")
    return " ".join(said)


def _look(survey: Survey) -> str:
    """Class of the first sentence: sound (green) only where nothing at all is listed; look where no damage is."""
    if survey.defects:
        return ""
    return "look" if survey.features or survey.detection.undecided or survey.findings else "sound"


def _name(defect: Defect) -> str:
    return (ALL_ROUND if defect.is_all_round else NAMES)[defect.kind]


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


def _row(number: str, defect: Defect, survey: Survey) -> dict[str, Any]:
    first, last = defect.z_range_mm
    mean = survey.nominal_diameter_mm if math.isnan(survey.diameter_mean_mm) else survey.diameter_mean_mm
    begin, end = defect.clock_range
    clock = width = "all round"
    remark = ""
    if defect.kind is Kind.OVALITY:
        remark = f"long axis {defect.clock} to {clock_face(defect.clock_deg + 180)}"
    elif not defect.is_all_round:
        clock = f"{begin} to {end}"
        width = f"{defect.arc_deg * math.pi / 360 * mean:.0f} mm ({defect.arc_deg:.0f}°)"
        remark = f"centre {defect.clock}"
    if defect.shadowed_mm >= 0.5:
        seen = max(defect.length_mm - defect.shadowed_mm, 0.0)
        remark += f"{', ' if remark else ''}{defect.shadowed_mm:.0f} mm of the length hidden, {seen:.0f} mm seen"
    return {
        "number": number,
        "kind": str(defect.kind),
        "name": _name(defect),
        "at": f"{defect.z_mm / 1000:.3f}",
        "from_to": f"{first / 1000:.3f} to {last / 1000:.3f}",
        "clock": clock,
        "length": f"{defect.length_mm:.0f} mm",
        "width": width,
        "depth": _depth(defect),
        "part": f"{100 * defect.depth_mm / mean:.1f} %",
        "remark": remark,
    }


def _feature(name: str, feature: Feature) -> dict[str, Any]:
    first, last = feature.z_range_mm
    begin, end = (clock_face(feature.clock_deg + side * feature.arc_deg / 2) for side in (-1, 1))
    return {
        "number": name,
        "name": FEATURES[feature.kind],
        "at": f"{feature.z_mm / 1000:.3f}",
        "from_to": f"{first / 1000:.3f} to {last / 1000:.3f}",
        "clock": "all round" if feature.arc_deg >= ALL_ROUND_DEG else f"{begin} to {end}",
        "length": f"{feature.length_mm:.0f} mm",
        "measures": [_words(one) for one in feature.measures],
        "remark": feature.remark,
    }


def _words(one: Measure) -> tuple[str, str]:
    """What was measured, and its value with its expanded uncertainty and unit."""
    stem = one.name.removesuffix("_" + one.unit).replace("_", " ")
    unit = UNITS.get(one.unit, one.unit)
    if not math.isfinite(one.value):
        text = "not measured"
    elif stem.endswith("clock"):
        text = clock_face(one.value)
    elif math.isfinite(one.k2):
        text = f"{one.value:.2f} ± {_up(one.k2)} {unit}"
    else:
        text = f"{one.value:.2f} {unit}"
    return WORDS.get(stem, stem), text


def _up(k2: float) -> str:
    """An uncertainty is rounded up, never 0.00."""
    return f"{max(math.ceil(100 * k2 - 1e-9), 1) / 100:.2f}"


def _depth(defect: Defect) -> str:
    return f"{'' if defect.floor_seen else '≥ '}{_measured(defect.depth_mm, defect.depth_k2_mm)}"


def _measured(mm: float, k2_mm: float) -> str:
    """A length with its expanded uncertainty; the value alone where nobody knows how far it may be off."""
    if not math.isfinite(k2_mm):
        return f"{mm:.2f} mm"
    return f"{mm:.2f} ± {_up(k2_mm)} mm"


def _length(mm: float) -> str:
    return f"{mm / 1000:.2f} m" if mm >= 1000 else f"{mm:.0f} mm"


def _inline(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
