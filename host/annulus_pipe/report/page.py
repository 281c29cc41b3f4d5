"""report.html: one page that opens anywhere, prints, and says the result first."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from annulus_pipe.numeric.rounding import (
    ANGLE,
    ARC,
    DISTANCE,
    EXTENT,
    MEASURE,
    NOT_MEASURED,
    PERCENT,
    SHARE,
    Quantity,
    clock_face,
    digits,
    quoted,
    span,
)
from annulus_pipe.report.figures import ReportPictures
from annulus_pipe.report.names import EXAGGERATION, letter, question
from annulus_pipe.report.sheet import inline, minute, sheet
from annulus_pipe.wall.defects import ALL_ROUND_DEG, UNSURE, Defect, Kind
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.lost import RING_LOST
from annulus_pipe.wall.stations import NOT_ENOUGH
from annulus_pipe.wall.survey import Survey

TEMPLATE = "page.html.j2"
NAMES = {Kind.LOSS: "Wall loss", Kind.BUMP: "Bump into the pipe", Kind.OVALITY: "Out of round"}
ALL_ROUND = {Kind.LOSS: "Groove all round", Kind.BUMP: "Ridge all round"}
UNDECIDED = {Kind.LOSS: "Stands outwards", Kind.BUMP: "Stands inwards", Kind.OVALITY: "May be out of round"}
COUNTED: Mapping[Kind | FeatureKind, tuple[str, str]] = {  # one of them, and many
    Kind.LOSS: ("wall loss", "wall losses"),
    Kind.BUMP: ("bump", "bumps"),
    Kind.OVALITY: ("out-of-round stretch", "out-of-round stretches"),
    FeatureKind.JOINT: ("joint", "joints"),
    FeatureKind.GAP: ("gap", "gaps"),
    FeatureKind.BRANCH: ("opening", "openings"),
    FeatureKind.TEE: ("tee", "tees"),
    FeatureKind.WATER: ("stretch under water", "stretches under water"),
    FeatureKind.DEPOSIT: ("deposit", "deposits"),
    FeatureKind.REDUCER: ("reducer", "reducers"),
    FeatureKind.TAPER: ("taper", "tapers"),
    FeatureKind.BEND: ("bend", "bends"),
    FeatureKind.CROSS_BORE: ("cross bore", "cross bores"),
    FeatureKind.NAMELESS: ("place without a name", "places without a name"),
}
FEATURES = {
    FeatureKind.JOINT: "Joint",
    FeatureKind.GAP: "Gap in a coupling",
    FeatureKind.BRANCH: "Opening, branch",
    FeatureKind.TEE: "Opening, rim stands in",
    FeatureKind.WATER: "Water",
    FeatureKind.DEPOSIT: "Deposit",
    FeatureKind.REDUCER: "Reducer",
    FeatureKind.TAPER: "Taper",
    FeatureKind.BEND: "Bend",
    FeatureKind.CROSS_BORE: "Cross bore",
    FeatureKind.NAMELESS: "Not established",
}
UNITS = {"mm": MEASURE, "deg": ANGLE, "percent": PERCENT, "ff": Quantity("fF", 2)}
WORDS = {
    "hilo": "hi-lo",
    "hilo clock": "hi-lo towards",
    "angle clock": "turns towards",
    "inner d": "inner diameter",
}  # where the name says too little


PICTURES_TAKEN = {
    "projector": "pictures under the rings, for the shape",
    "led": "pictures under plain light, for the colour",
    "unknown": "pictures whose lamp is unknown, not used",
}
LOST = {  # in the client's words, by the account's kinds; several kinds that read the same are counted together
    "profiles_without_pose": "pictures whose place in the pipe is unknown, not used",
    "frames_damaged": "damaged pictures, not used",
    "recording_incomplete": "places where the recording lacks what was written",
    "recording_torn": "recordings that end in the middle of a picture",
} | dict.fromkeys(
    (
        "camera",
        "camera_away",
        "no_slot",
        "recorder_busy",
        "recorder_absent",
        "disk",
        "recorder_failed",
        "recorder_died",
        "recording_gone",
    ),
    "pictures lost before they were kept",
)
OTHERWISE = "other incidents of the instrument, see summary.json"
SAID_ABOVE = ("frames_unknown", "reconstructed_after_the_scan")


def render_page(survey: Survey, summary: Mapping[str, Any], pictures: ReportPictures, **more: Any) -> str:
    """The report as one HTML document: no script, no font and no picture from anywhere else. more : what further parts
    of the page ask for, by name."""
    features = [_feature(letter(i), feature) for i, feature in enumerate(survey.features)]
    undecided = [
        {**_row(question(i), place, survey), "name": UNDECIDED[place.kind], "why": place.why}
        for i, place in enumerate(survey.detection.undecided)
    ]
    captions = {one["number"]: f"{one['number']}: {one['name'].lower()}" for one in (*features, *undecided)}
    inlined = {
        name: None if data is None else inline(data)
        for name in ("unwrapped", "texture", "cameras", "stations", "course")
        for data in (getattr(pictures, name),)
    }
    values = {
        "s": summary,
        "source": summary["source"],
        "created": minute(summary["created"]),
        "version": summary["versions"]["annulus"],
        "running": f"Pipe wall inspection: {summary['source']}",
        "rows": [_row(str(number), defect, survey) for number, defect in enumerate(survey.defects, start=1)],
        "features": features,
        "undecided": undecided,
        "beside": [(one.title, inline(one.picture), one.shows, one.note) for one in pictures.beside],
        "pictures": [(captions[name], inline(data)) for name, data in pictures.features],
        "verdict": _verdict(survey),
        "look": _look(survey),
        "unsure": quoted(100 * UNSURE, Quantity("%", 0)),
        "surface": [(caption, inline(data)) for caption, data in pictures.surface],
        "stretch": "" if pictures.stretch_mm is None else span(*pictures.stretch_mm, DISTANCE),
        "exaggeration": f"{EXAGGERATION:g}",
        "sheets": [(caption, inline(data)) for caption, data in pictures.sheets],
        "sheet_length": quoted(pictures.sheet_mm, Quantity("m", 0, thousands=True)),
        "sheet_scale": pictures.sheet_scale,
        "overview_scale": pictures.scale,
        "frames": _taken(summary["frames"]),
        "lost": list(_lost(summary["drops"])),
        "truth": list(_truth(summary.get("truth", {}))),
    }
    return sheet(TEMPLATE, {}, **(values | inlined | more))


def _taken(frames: Mapping[str, int]) -> list[tuple[str, int]]:
    return [(PICTURES_TAKEN.get(label, f"pictures under {label}"), n) for label, n in frames.items()]


def _lost(drops: Mapping[str, int]) -> Iterator[tuple[str, int]]:
    """What was lost, in words for one who was not there, and how often."""
    counts: dict[str, int] = {}
    for kind, n in drops.items():
        if n and kind not in SAID_ABOVE:
            counts[LOST.get(kind, OTHERWISE)] = counts.get(LOST.get(kind, OTHERWISE), 0) + n
    yield from counts.items()


def _truth(truth: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for name, value in truth.items():
        stem, _, unit = name.rpartition("_")
        if isinstance(value, float) and unit in UNITS:
            yield stem.replace("_", " "), quoted(value, UNITS[unit])
        elif isinstance(value, int | float | str):
            yield name.replace("_", " "), str(value)


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
            f"at {quoted(worst.z_mm, DISTANCE)}, clock {worst.clock}."
        )
    sentences = [damage]
    named = [feature.kind for feature in survey.features]
    if named:
        counts = (_count(named.count(kind), *COUNTED[kind]) for kind in FeatureKind if kind in named)
        sentences.append(f"Also in the pipe: {', '.join(counts)}.")
    if undecided:
        sentences.append(
            f"{_count(undecided, 'place stands', 'places stand')} out and could not be decided: see below, look there."
        )
    if holes := sum(one.is_hole and not one.usual for one in survey.unjudged):
        sentences.append(
            f"{_count(holes, 'place of the wall was', 'places of the wall were')} not seen: see below, where and why."
        )
    if survey.views is not None:
        alone, both = (quoted(100.0 * part, PERCENT) for part in (survey.views.not_seen_alone, survey.views.not_seen))
        sentences.append(
            f"Two heads looked, one forward and one back: {both} of the wall was not seen, by the forward one alone "
            f"{alone}."
        )
    missed = {finding.kind for finding in survey.findings}
    if NOT_ENOUGH in missed:
        sentences.append("Not enough of it was seen to say what shape the pipe has: see below.")
    if RING_LOST in missed:
        sentences.append("A ring of the pattern was lost: see below.")
    return " ".join(sentences)


def _look(survey: Survey) -> str:
    """Class of the first sentence: sound (green) only where nothing at all is listed; look where no damage is."""
    if survey.defects:
        return ""
    unseen = any(one.is_hole and not one.usual for one in survey.unjudged)
    return "look" if survey.features or survey.detection.undecided or survey.findings or unseen else "sound"


def _name(defect: Defect) -> str:
    return (ALL_ROUND if defect.is_all_round else NAMES)[defect.kind]


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


def _row(number: str, defect: Defect, survey: Survey) -> dict[str, Any]:
    mean = survey.nominal_diameter_mm if math.isnan(survey.diameter_mean_mm) else survey.diameter_mean_mm
    begin, end = defect.clock_range
    clock = width = "all round"
    remark = ""
    if defect.kind is Kind.OVALITY:
        remark = f"long axis {defect.clock} to {clock_face(defect.clock_deg + 180)}"
    elif not defect.is_all_round:
        clock = f"{begin} to {end}"
        width = f"{quoted(defect.arc_deg * math.pi / 360 * mean, EXTENT)} ({quoted(defect.arc_deg, ARC)})"
        remark = f"centre {defect.clock}"
    if defect.shadowed_mm >= 0.5:
        seen = max(defect.length_mm - defect.shadowed_mm, 0.0)
        hidden = f"{quoted(defect.shadowed_mm, EXTENT)} of the length hidden, {quoted(seen, EXTENT)} seen"
        remark += f"{', ' if remark else ''}{hidden}"
    return {
        "number": number,
        "kind": str(defect.kind),
        "name": _name(defect),
        "at": digits(defect.z_mm, DISTANCE),
        "from_to": span(*defect.z_range_mm, DISTANCE, unit=False),
        "clock": clock,
        "length": quoted(defect.length_mm, EXTENT),
        "width": width,
        "depth": _depth(defect),
        "part": quoted(100 * defect.depth_mm / mean, SHARE),
        "remark": remark,
    }


def _feature(name: str, feature: Feature) -> dict[str, Any]:
    begin, end = (clock_face(feature.clock_deg + side * feature.arc_deg / 2) for side in (-1, 1))
    return {
        "number": name,
        "name": FEATURES[feature.kind],
        "at": digits(feature.z_mm, DISTANCE),
        "from_to": span(*feature.z_range_mm, DISTANCE, unit=False),
        "clock": "all round" if feature.arc_deg >= ALL_ROUND_DEG else f"{begin} to {end}",
        "length": quoted(feature.length_mm, EXTENT),
        "measures": [_words(one) for one in feature.measures],
        "remark": feature.remark,
    }


def _words(one: FeatureMeasure) -> tuple[str, str]:
    """What was measured, and its value with its expanded uncertainty and unit."""
    stem = one.name.removesuffix("_" + one.unit).replace("_", " ")
    if stem.endswith("clock"):
        text = clock_face(one.value) if math.isfinite(one.value) else NOT_MEASURED
    else:
        along = stem == "start"  # where it begins: a place along the pipe, unlike what else is in mm
        text = quoted(one.value, DISTANCE if along else UNITS.get(one.unit, Quantity(one.unit, 2)), one.k2)
    return WORDS.get(stem, stem), text


def _depth(defect: Defect) -> str:
    return quoted(defect.depth_mm, MEASURE, defect.depth_k2_mm, at_least=not defect.floor_seen)
