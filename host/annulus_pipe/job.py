"""The job a scan was made for: who asked, where, which pipe, who scanned it and what they marked; and where a
calibration came from.

A value that the daemon writes into a recording, and that a report, an export and a console read out of it. Whatever is
not known stays empty: nothing here is ever guessed.
"""

import contextlib
import datetime
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from annulus_pipe.untrusted import TOML_MAX, parse_toml, printable, read_file, shown
from annulus_pipe.untrusted import within as number_within
from annulus_pipe.vocabulary import AnnulusError

TEXT_MAX = 300  # characters of a line
REMARKS_MAX = 2000
CLOCK_SET = 2000  # year from which on a recorder's clock says a day: one that nobody set begins in 1970
SECTIONS_MAX, NAME_MAX = 32, 60  # of a calibration's provenance
WORDS: Mapping[str, str] = {  # of every field, in the order in which people are told
    "client": "Client",
    "site": "Site",
    "pipe": "Pipe",
    "material": "Material",
    "sdr": "SDR",
    "nominal_diameter_mm": "Nominal diameter",
    "temperature_c": "Temperature of the pipe",
    "launch": "Launched at",
    "receive": "Received at",
    "direction": "Direction of the scan",
    "operator": "Operator",
    "date": "Date of the scan",
    "head": "Head, serial number",
    "remarks": "Remarks",
}
NUMBERS: Mapping[str, tuple[float, float]] = {
    "sdr": (3.0, 100.0),
    "nominal_diameter_mm": (5.0, 10_000.0),
    "temperature_c": (-40.0, 80.0),
}
BEFORE: Mapping[str, str] = {"who": "operator", "where": "site", "what": "pipe"}  # names of recordings until 2026


@dataclass(frozen=True, slots=True)
class JobSheet:
    """Who asked for what, where; "" or None: nobody said. `date` is of the ISO form YYYY-MM-DD."""

    client: str = ""
    site: str = ""
    pipe: str = ""
    material: str = ""
    sdr: float | None = None  # outer diameter over wall thickness
    nominal_diameter_mm: float | None = None
    temperature_c: float | None = None
    launch: str = ""
    receive: str = ""
    direction: str = ""
    operator: str = ""
    date: str = ""
    head: str = ""
    remarks: str = ""

    @classmethod
    def from_dict(cls, data: object, what: str = "[job]") -> "JobSheet":
        """Of plain values, as TOML and JSON have them. Raises ValueError naming the field."""
        if not isinstance(data, Mapping):
            raise ValueError(f"{what} must be a section of names and texts")
        found: dict[str, Any] = {}
        for name, value in data.items():
            own = BEFORE.get(name, name) if isinstance(name, str) else ""
            if own not in WORDS:
                raise ValueError(f"{what} {_name(name)} is not known, expected one of {', '.join(WORDS)}")
            if own in found:
                raise ValueError(f"{what} {own} is there twice, as {name} too")
            found[own] = _checked(own, value, f"{what} {name}")
        return cls(**found)

    @classmethod
    def recorded(cls, data: object) -> "JobSheet":
        """What a recording says, whoever wrote it: what is malformed is left out."""
        found: dict[str, Any] = {}
        for name, value in data.items() if isinstance(data, Mapping) else ():
            own = BEFORE.get(name, name) if isinstance(name, str) else ""
            try:
                if own in WORDS:
                    found.setdefault(own, _checked(own, value, own))
            except ValueError:
                continue
        return cls(**found)

    def to_dict(self) -> dict[str, Any]:
        """What is known of it."""
        return {name: getattr(self, name) for name in WORDS if getattr(self, name) not in ("", None)}

    def to_whole(self) -> dict[str, Any]:
        """Every field, None where it is empty, so that writing it over another sheet empties those fields there."""
        return {name: self.to_dict().get(name) for name in WORDS}

    def under(self, other: "JobSheet") -> "JobSheet":
        """Itself with what the other says written over it."""
        return JobSheet(**{**self.to_dict(), **other.to_dict()})

    def without(self, names: Iterable[str]) -> "JobSheet":
        """Itself with these fields empty."""
        gone = {BEFORE.get(name, name) for name in names}
        return JobSheet(**{name: value for name, value in self.to_dict().items() if name not in gone})

    def over_told(self, data: object) -> "JobSheet":
        """Itself with a recording's fields written over it, those too that the recording says are empty."""
        return self.under(JobSheet.recorded(data)).without(emptied(data))


assert tuple(WORDS) == tuple(one.name for one in fields(JobSheet))


def emptied(data: object) -> frozenset[str]:
    """The fields of a sheet that it says are empty."""
    sheet = data if isinstance(data, Mapping) else {}
    return frozenset(name for name, value in sheet.items() if isinstance(name, str) and value in ("", None))


@dataclass(frozen=True, slots=True)
class Observation:
    """What an operator marked during a scan.

    z_mm : of the head at that moment, along the pipe; NaN where nobody knew. clock_deg : clockwise from 12 o'clock,
    looking forward; None: of no one place round the pipe. utc : ISO, "" where no clock was kept. picture : a JPEG, b""
    where there is none; shows : whether it is the operator's "photo" or the LED "frame" taken then, that of `camera`.
    photo_unread : there was a photo, but none that can be shown.
    """

    z_mm: float
    text: str = ""
    clock_deg: float | None = None
    utc: str = ""
    picture: bytes = b""
    shows: str = ""
    frame: int | None = None
    camera: int = 0
    photo_unread: bool = False


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a scan came from, as far as that was written down.

    utc : of its first and last moment, ISO; "" where no clock was kept. controller : what it said of itself.
    calibration : "provenance" of its calibration.json, section by section; empty where none is known. versions : of
    the program that recorded. observations : what was marked, by distance; marks_left_out : how much more was, but
    cannot be read, or is too many to show. calibration_fingerprint : of the numbers that were measured with.
    """

    job: JobSheet = field(default_factory=JobSheet)
    utc: tuple[str, str] = ("", "")
    controller: Mapping[str, str] = field(default_factory=dict)
    calibration: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    calibration_file: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    observations: tuple[Observation, ...] = ()
    marks_left_out: int = 0
    calibration_fingerprint: str = ""

    @property
    def day(self) -> datetime.date | None:
        """Of the scan, None where nobody knows."""
        return scan_day(self.job.date, self.utc[0])


def scan_day(typed: str, begun_utc: str) -> datetime.date | None:
    """The later of the day that somebody typed and that of the recorder's clock, which may have stood still while the
    head was off; None where neither is one."""
    days = []
    for stated in (typed, begun_utc[:10]):
        with contextlib.suppress(ValueError):
            days.append(datetime.date.fromisoformat(stated))
    return max((day for day in days if day.year >= CLOCK_SET), default=None)


def provenance(calibration: object) -> dict[str, dict[str, Any]]:
    """How each section of a calibration.json came about, as far as it says: its numbers and words, lists left out."""
    sections = calibration.get("provenance") if isinstance(calibration, Mapping) else None
    return _plain_sections(sections)


def recorded_provenance(configuration: object) -> dict[str, dict[str, Any]]:
    """The same, as a recording's configuration has it."""
    return _plain_sections(configuration.get("calibration_provenance") if isinstance(configuration, Mapping) else None)


def _plain_sections(sections: object) -> dict[str, dict[str, Any]]:
    out: dict[str, dict[str, Any]] = {}
    for section, made in list(sections.items())[:SECTIONS_MAX] if isinstance(sections, Mapping) else ():
        if isinstance(section, str) and isinstance(made, Mapping):
            plain = {k: v for k, v in made.items() if isinstance(k, str) and len(k) <= NAME_MAX and _is_plain(v)}
            out[printable(section)[:NAME_MAX]] = dict(list(plain.items())[:SECTIONS_MAX])
    return out


def _is_plain(value: object) -> bool:
    return isinstance(value, int | float) or (isinstance(value, str) and len(value) <= TEXT_MAX)


def job_of(given: Sequence[str]) -> JobSheet:
    """Of a command line: each is NAME=TEXT, or the path of a job.toml; later ones go over earlier ones. Raises
    AnnulusError for what is neither."""
    sheet = JobSheet()
    for one in given:
        name, sign, text = one.partition("=")
        if not sign and (name.endswith(".toml") or Path(name).is_file()):
            sheet = sheet.under(read_job(Path(one)))
            continue
        if BEFORE.get(name, name) not in WORDS or not text.strip():
            raise AnnulusError(
                f"job {shown(one)}: expected NAME=TEXT or a file .toml, a name one of {', '.join(WORDS)}"
            )
        try:
            sheet = sheet.under(JobSheet.from_dict({name: text}, "job"))
        except ValueError as error:
            raise AnnulusError(f"{error}.") from None
    return sheet


def read_job(path: Path) -> JobSheet:
    """A job.toml: the names of [job], in that section or in none. Raises AnnulusError naming file and field."""
    try:
        return parse_job(read_file(path, TOML_MAX), path)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a job.toml.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None


def parse_job(content: bytes, path: object) -> JobSheet:
    """The same of what is in the file; `path` is how an error names it."""
    try:
        data = parse_toml(content)
        return JobSheet.from_dict(data["job"] if set(data) == {"job"} else data, "[job]")
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None


def _name(value: object) -> str:
    return value if isinstance(value, str) and re.fullmatch(r"[\w-]{1,40}", value) else shown(value)


def _checked(name: str, value: object, what: str) -> str | float | None:
    """The value of a field. A number may come as a text, as a command line has it, and a date as TOML's own."""
    if name in NUMBERS:
        if isinstance(value, str):
            with contextlib.suppress(ValueError):
                value = float(value)
        return number_within(value, what, *NUMBERS[name])
    if name == "date" and isinstance(value, datetime.date):
        value = value.isoformat()[:10]
    if isinstance(value, int | float) and not isinstance(value, bool):
        value = str(value)  # a pipe may be called 7
    most = REMARKS_MAX if name == "remarks" else TEXT_MAX
    text = printable(" ".join(value.split())) if isinstance(value, str) and len(value) <= most else None
    if text is None or len(text) > most:
        raise ValueError(f"{what} must be a text of at most {most} characters")
    if name == "date" and text:
        try:
            datetime.date.fromisoformat(text)
        except ValueError:
            raise ValueError(f"{what} is {shown(text)}, expected a day, YYYY-MM-DD") from None
    return text
