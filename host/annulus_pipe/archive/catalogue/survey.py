"""One survey as the catalogue keeps it: a row, its stations, defects and features, and what tells it from all others.

The identity is made of the contents: the same results are the same survey, whoever adds them, from wherever. When they
were made and added, and where they lie, is not of the contents. A scan is known by the moment at which it began and the
controller that lit it: results of one scan, made again otherwise, are versions of one survey, the last made counting.
A scan that says no moment (frames in a folder, a video) is never taken for another: names repeat.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.archive.catalogue.columns import STATIONS, TABLES
from annulus_pipe.job import JobSheet
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.qualification.applicability import Applicability
from annulus_pipe.storage.results_folder import (
    LATER_COLUMNS,
    MM_MAX,
    PLACES_MAX,
    SUMMARY,
    TEXT_MAX,
    ListedPlace,
    figures,
    places,
    read_stations,
    read_summary,
    scanned,
    text,
    texts,
    unreadable,
)
from annulus_pipe.storage.results_folder import STATIONS as STATIONS_FILE
from annulus_pipe.untrusted import mapping, printable, shown, within

ID_DIGITS = 12  # hexadecimal; of 100 000 surveys two would share them once in 50 000 catalogues, and adding says so
CLOCK_SINCE = date(2020, 1, 1)  # a computer without a battery starts in 1970: no day of a scan before this
YEARS = (1900, 2200)  # of a date that somebody typed
CALIBRATED_MAX = 20_000  # characters
KINDS_MAX = 20  # limits of a place that a verdict leaves open; kinds of defects that a study has
REASONS_MAX = 20  # why a certificate does not speak for a scan: one of each thing it is of
STATED_MAX = 20_000  # characters of what a study states of one kind
OPEN_MAX = 200  # such places that are kept
OUTSIDE = frozenset({"survey", "digest", "scan", "replaces", "results", "created_utc", "added_utc"})  # of the contents

Row = Mapping[str, Any]


@dataclass(frozen=True)
class SurveyRecord:
    """row: of the table surveys. stations: column -> (S,) NaN where empty, without survey, pipe, date. defects and
    features: rows without these three."""

    row: Row
    stations: Mapping[str, FloatArray]
    defects: Sequence[Row]
    features: Sequence[Row]

    @property
    def survey(self) -> str:
        return str(self.row["survey"])

    @property
    def key(self) -> Row:
        return {name: self.row[name] for name in ("survey", "pipe", "date")}


def read_survey(folder: Path, job: JobSheet | None = None, replaces: Row | None = None) -> SurveyRecord:
    """Of a folder of results. job: goes over what the results say. replaces: the row of the survey whose scan it is of,
    where it says no moment itself. Raises AnnulusError, one line that names the file."""
    try:
        summary = read_summary(folder)
        row, defects, features = _summary(summary, job or JobSheet())
    except (OSError, ValueError) as error:
        raise unreadable(folder / SUMMARY, error) from None
    try:
        stations = read_stations(folder, summary, LATER_COLUMNS)
    except (OSError, ValueError) as error:
        raise unreadable(folder / STATIONS_FILE, error) from None
    row["station_count"] = len(stations["z_mm"])
    row["results"] = printable(str(folder.resolve()))
    row["added_utc"] = datetime.now(UTC).replace(tzinfo=None)
    row["digest"] = digest(row, stations, defects, features)
    row["survey"] = row["digest"][:ID_DIGITS]
    row["scan"] = _scan(row) if replaces is None else replaces["scan"]
    row["replaces"] = None if replaces is None else replaces["survey"]
    return SurveyRecord({one.name: row[one.name] for one in TABLES["surveys"]}, stations, defects, features)


def digest(row: Row, stations: Mapping[str, FloatArray], defects: Sequence[Row], features: Sequence[Row]) -> str:
    """SHA-256 of the contents, hexadecimal: the same of what was read and of what the catalogue gives back."""
    found = hashlib.sha256()
    plain = {name: value for name, value in row.items() if name not in OUTSIDE and value is not None}
    known = [[{k: v for k, v in one.items() if v is not None} for one in rows] for rows in (defects, features)]
    whole = json.dumps([plain, *known], sort_keys=True, ensure_ascii=True, default=_written, allow_nan=False)
    found.update(whole.encode())
    for column in STATIONS:
        if column.kind == "number":
            values = np.ascontiguousarray(stations[column.name], "<f8")
            found.update(np.where(np.isnan(values), np.nan, values + 0.0).tobytes())  # one NaN, and no -0
    return found.hexdigest()


def _written(value: object) -> str:
    if isinstance(value, date):  # a datetime too
        return value.isoformat()
    raise TypeError(type(value).__name__)


def _scan(row: Row) -> str:
    if row["begun_utc"] is None:
        return f"alone {row['survey']}"
    began = row["begun_utc"].isoformat(timespec="milliseconds")
    return f"{began} {row['controller'] or 'no controller'}"


def _summary(summary: Mapping[str, Any], over: JobSheet) -> tuple[dict[str, Any], list[Row], list[Row]]:
    texts(summary.get("job"), "job")  # too long a text, which the sheet would cut, is refused as exports refuse it
    texts(summary.get("origin"), "origin")
    job = JobSheet.recorded(summary.get("job")).under(over)
    origin = mapping(summary.get("origin") or {}, "origin")
    who = texts(origin.get("controller"), "origin.controller")
    calibration = mapping(origin.get("calibration") or {}, "origin.calibration")
    begun, ended = (_time(origin.get(name), f"origin.{name}") for name in ("begun_utc", "ended_utc"))
    created = _time(summary.get("created"), "created")
    first, last = scanned(summary)
    known = figures(summary)
    diameter = mapping(summary.get("diameter_mm"), "diameter_mm")
    qualification = mapping(summary.get("qualification") or {}, "qualification")
    accuracy = mapping(qualification.get("accuracy") or {}, "qualification.accuracy")
    conformity = mapping(summary.get("conformity") or {}, "conformity")
    sections = {k: v for k, v in calibration.items() if k not in ("file", "fingerprint")}
    calibrated = printable(json.dumps(sections, sort_keys=True)) if sections else None
    if calibrated is not None and len(calibrated) > CALIBRATED_MAX:
        raise ValueError(f"origin.calibration has {len(calibrated)} characters, expected at most {CALIBRATED_MAX}")
    day, day_of = _date(job, begun, created)
    sure, undecided, found = (places(summary, name) for name in ("defects", "undecided", "features"))
    defects = [_defect(i, one, sure=True) for i, one in enumerate(sure, 1)]
    defects += [_defect(i, one, sure=False) for i, one in enumerate(undecided, 1)]
    firmware = " ".join(who[name] for name in ("version", "git") if name in who)
    row = {
        "pipe": job.pipe or None,
        "date": day,
        "date_of": day_of,
        **{
            name: getattr(job, name) or None
            for name in ("site", "client", "operator", "launch", "receive", "direction", "material", "remarks", "head")
        },
        "sdr": job.sdr,
        "job_diameter_mm": job.nominal_diameter_mm,
        "temperature_c": job.temperature_c,
        "nominal_diameter_mm": within(diameter.get("nominal"), "diameter_mm.nominal", 1.0, 1e5),
        "controller": who.get("serial"),
        "firmware": firmware or None,
        "calibration": _text(calibration.get("file"), "origin.calibration.file"),
        "calibrated": calibrated,
        "made_with": _version(summary.get("versions"), "versions"),
        "recorded_with": _version(origin.get("recorded_with"), "origin.recorded_with"),
        "source": _text(summary.get("source"), "source"),
        "begun_utc": begun,
        "ended_utc": ended,
        "created_utc": created,
        "scanned_from_mm": first,
        "scanned_to_mm": last,
        "points": int(within(summary.get("points"), "points", 0, 1e12)),
        **{name: known.get(name) for name in ("seen_percent", "hidden_percent", "noise_mm")},
        **{f"diameter_{name}_mm": known.get(f"diameter_mm.{name}") for name in ("mean", "min", "max", "k2")},
        "ovality_f1216_percent": known.get("ovality.max_percent"),
        "shape_ovality_f1216_percent": known.get("ovality.shape_max_percent"),
        "depth_limit_mm": known.get("limits.depth_mm"),
        "size_limit_mm": known.get("limits.size_mm"),
        "ovality_limit_percent": known.get("limits.ovality_percent"),
        "certificate": _stated(accuracy, "qualification.accuracy"),
        "accuracy_percent": None
        if accuracy.get("percent") is None
        else within(accuracy["percent"], "qualification.accuracy.percent", 0.0, 1e6),
        "detection": _detection(qualification.get("detection")),
        "limits": _text(conformity.get("title"), "conformity.title"),
        "decision": _text(conformity.get("decision"), "conformity.decision"),
        "not_established": _open_places(conformity.get("not_established")),
        "defect_count": len(sure),
        "undecided_count": len(undecided),
        "feature_count": len(found),
        "warning_count": _count(summary.get("warnings")),
    }
    return row, defects, [_feature(i, one) for i, one in enumerate(found, 1)]


def _detection(found: object) -> str | None:
    """What of each kind is stated, in one text."""
    if found is None:
        return None
    if not isinstance(found, list) or len(found) > KINDS_MAX:
        raise ValueError(f"qualification.detection must be a list of at most {KINDS_MAX}")
    where = "qualification.detection"
    rows = [mapping(one, f"{where}[{i}]") for i, one in enumerate(found)]
    return "; ".join(f"{text(one.get('of'), f'{where}.of', STATED_MAX)}: {_stated(one, where) or ''}" for one in rows)


def _stated(found: Mapping[str, Any], what: str) -> str | None:
    """A quotation, and where nobody could tell whether it applies, what would have to be so."""
    if found.get("text") is None:
        return None
    stated, reasons = text(found["text"], f"{what}.text", STATED_MAX), found.get("reasons") or []
    if not isinstance(reasons, list) or len(reasons) > REASONS_MAX:
        raise ValueError(f"{what}.reasons must be a list of at most {REASONS_MAX}")
    if found.get("standing") != Applicability.OPEN:
        return stated or None
    return f"{stated} (if it is so: {'; '.join(text(one, f'{what}.reasons', TEXT_MAX) for one in reasons)})"


def _open_places(found: object) -> str | None:
    """Those that leave a verdict open, as JSON; NULL of a verdict that has none."""
    if found is None:
        return None
    if not isinstance(found, list) or len(found) > PLACES_MAX:
        raise ValueError(f"conformity.not_established must be a list of at most {PLACES_MAX}")
    out = []
    for i, one in enumerate(found):
        what = f"conformity.not_established[{i}]"
        place = mapping(one, what)
        if place.get("usual"):
            continue
        limits = place.get("limits")
        if not isinstance(limits, list) or len(limits) > KINDS_MAX:
            raise ValueError(f"{what}.limits must be a list of at most {KINDS_MAX}")
        numbers = ("z_from_mm", "z_to_mm", "clock_deg", "arc_deg")
        out.append(
            {
                "limits": [_text(kind, f"{what}.limits") for kind in limits],
                **{name: within(place.get(name), f"{what}.{name}", -MM_MAX, MM_MAX) for name in numbers},
                "reason": _text(place.get("reason"), f"{what}.reason"),
            }
        )
    return printable(json.dumps(out[:OPEN_MAX])) if out else None


def _place(number: int, one: ListedPlace) -> dict[str, Any]:
    return {
        "number": number,
        "kind": one.kind,
        "z_mm": float(one.z_mm),
        "z_from_mm": float(one.z_from_mm),
        "z_to_mm": float(one.z_to_mm),
        "clock_deg": float(one.clock_deg),
        "arc_deg": float(one.arc_deg),
        "length_mm": float(one.length_mm),
        "severity": one.severity or None,
        "decision": one.decision or None,
    }


def _defect(number: int, one: ListedPlace, sure: bool) -> Row:
    sizes = {name: getattr(one, name) for name in ("depth_mm", "depth_k2_mm", "area_mm2", "hidden_mm")}
    floats = {name: None if value is None else float(value) for name, value in sizes.items()}
    return {**_place(number, one), **floats, "floor_seen": one.floor_seen, "sure": sure}


def _feature(number: int, one: ListedPlace) -> Row:
    measures: dict[str, float] = {}
    of_levels = [("depth_mm", one.depth_mm, one.depth_k2_mm)] if one.depth_mm is not None else []
    for name, value, k2 in [*one.measures, *of_levels]:
        stem, _, unit = name.rpartition("_")
        measures[name] = float(value)
        if k2 is not None:
            measures[f"{stem}_k2_{unit}"] = float(k2)
    return {**_place(number, one), "remark": one.remark or None, "measures": dict(sorted(measures.items()))}


def _date(job: JobSheet, begun: datetime | None, created: datetime | None) -> tuple[date | None, str | None]:
    """The day of the scan and who says it: the operator, or the recording's clock where it can have been set."""
    if job.date:
        day = date.fromisoformat(job.date)
        if not YEARS[0] <= day.year < YEARS[1]:
            raise ValueError(f"job.date is {job.date}, expected a day of {YEARS[0]}..{YEARS[1] - 1}")
        return day, "job"
    if begun is None or begun.date() < CLOCK_SINCE:
        return None, None
    if created is not None and begun > created + timedelta(days=1):
        return None, None
    return begun.date(), "recording"


def _time(value: object, what: str) -> datetime | None:
    """UTC without a zone, whole microseconds."""
    if value is None or value == "":
        return None
    try:
        found = datetime.fromisoformat(text(value, what, 60))
        return found.astimezone(UTC).replace(tzinfo=None) if found.tzinfo else found
    except (ValueError, OverflowError):
        raise ValueError(f"{what} is {shown(value)}, expected an ISO time") from None


def _text(value: object, what: str) -> str | None:
    return text(value, what, TEXT_MAX) or None if value is not None else None


def _version(found: object, what: str) -> str | None:
    return _text(mapping(found or {}, what).get("annulus"), f"{what}.annulus")


def _count(found: object) -> int:
    if found is None:
        return 0
    if not isinstance(found, list) or len(found) > PLACES_MAX:
        raise ValueError(f"warnings must be a list of at most {PLACES_MAX}")
    return len(found)
