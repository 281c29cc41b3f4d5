"""Truths, reports and trials as files: what people write by hand or a program wrote, bounded and checked.

Every number stands under a name that has its unit. A file that lacks a column, names one without a unit, or in another
unit, is refused with what was expected: a depth in inches that is read as millimetres is no error anybody would notice.
"""

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

from annulus_pipe.qualification.trials import (
    KINDS,
    Pull,
    Reported,
    Trial,
    Trials,
    TrialState,
    TrueDefect,
    require_one_unit,
)
from annulus_pipe.untrusted import mapping, parse_json, printable, read_file, shown, whole, within
from annulus_pipe.untrusted import text as checked_text
from annulus_pipe.vocabulary import AnnulusError

FORMAT = "annulus-trials/1"
FILE_MAX = 1 << 26  # bytes: a million rows
ROWS_MAX = 100_000
PULLS_MAX = 1000
NAME_MAX = 200
MM_MAX = 1e7  # of a place: 10 km
SIZE_MAX = 1e5  # of a depth, length or width
TRUTH_COLUMNS = (
    "name",
    "kind",
    "z_mm",
    "clock_deg",
    "depth_mm",
    "length_mm",
    "width_mm",
    "beside_joint",
    "pipe",
    "laid",
    "depth_u_mm",
)
TRUTH_NEEDED = ("kind", "z_mm", "clock_deg", "depth_mm")
REPORT_COLUMNS = ("kind", "z_mm", "clock_deg", "depth_mm", "depth_k2_mm", "length_mm", "arc_deg", "at_least", "state")
REPORT_NEEDED = ("kind", "z_mm", "clock_deg")
HIT_MISS_COLUMNS = ("kind", "depth_mm", "length_mm", "width_mm", "beside_joint", "detected", "reported_depth_mm")
HIT_MISS_NEEDED = ("kind", "depth_mm", "detected")
DIG = "dig"  # a column that makes a file a dig sheet: what was dug up because it was reported ..
REPORTED_AS = re.compile(r"(D|\?)[0-9]+")  # .. and so do the names that a report gives to what it lists
QUANTITIES = ("z", "clock", "depth", "length", "width", "arc", "reported", "distance", "chainage", "size")
YES, NO = ("yes", "true", "1", "hit"), ("no", "false", "0", "miss")
LISTED = ("listed", "undecided")

Row = Mapping[str, Any]
T = TypeVar("T")


def read_truths(path: Path) -> tuple[TrueDefect, ...]:
    """A CSV or JSON file of defects that are known: TRUTH_COLUMNS, of which TRUTH_NEEDED. AnnulusError, one line."""
    return _read(path, "defects", lambda rows: tuple(_truths(rows)))


def read_reports(path: Path) -> tuple[Reported, ...]:
    """A CSV or JSON file of a survey's list: REPORT_COLUMNS, of which REPORT_NEEDED. AnnulusError, one line."""
    return _read(path, "defects", lambda rows: tuple(_reports(rows)))


def read_trials(path: Path) -> Trials:
    """Of `annulus pod match`, or a CSV file of hits and misses as others have them. AnnulusError, one line."""
    if path.suffix.lower() == ".csv":
        listed = _read(path, "trials", lambda rows: Trials(tuple(_hit_miss(rows, path.name))))
        require_one_unit(listed.trials, str(path))
        return listed
    try:
        found = mapping(parse_json(read_file(path, FILE_MAX), FILE_MAX), "trials")
        if found.get("format") != FORMAT:
            raise ValueError(
                f"its format is {shown(found.get('format'))}, expected {FORMAT}, or a .csv of hits and misses"
            )
        return trials_from(found)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None


def pull_of_list(name: str, scanned_mm: tuple[float, float], diameter_mm: float, limit_mm: float) -> Pull:
    """The pull of a list that says nothing of it; what people name, looked at as `read_trials` does. AnnulusError."""
    try:
        first, last = (within(one, "scanned, mm,", -MM_MAX, MM_MAX) for one in scanned_mm)
        if not first < last:
            raise ValueError(f"scanned from {first:g} to {last:g} mm, expected from before to")
        radius = within(diameter_mm, "its diameter, mm,", 2.0, 2 * SIZE_MAX) / 2
        return Pull(
            name,
            "",
            first,
            last,
            radius,
            limit_mm if math.isnan(limit_mm) else within(limit_mm, "its depth limit, mm,", 0.0, SIZE_MAX),
        )
    except ValueError as error:
        raise AnnulusError(f"{name}: {error}") from None


def truths_csv(truths: Sequence[TrueDefect]) -> str:
    """As `read_truths` and `annulus twin scan` read it."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(TRUTH_COLUMNS)
    for one in truths:
        numbers = [_cell(value) for value in (one.z_mm, one.clock_deg, one.depth_mm, one.length_mm, one.width_mm)]
        joint = {None: "", True: "yes", False: "no"}[one.beside_joint]
        writer.writerow(
            [one.name, one.kind, *numbers, joint, one.pipe, "yes" if one.laid else "no", _cell(one.depth_u_mm)]
        )
    return out.getvalue()


def trials_json(trials: Trials) -> str:
    """All but what the surveys did not see, which has done its work."""

    def plain(one: Any) -> Any:
        if isinstance(one, Mapping):
            return {name: plain(value) for name, value in one.items()}
        if isinstance(one, list | tuple):
            return [plain(value) for value in one]
        return None if isinstance(one, float) and not math.isfinite(one) else one

    found = {
        "format": FORMAT,
        "pulls": [asdict(replace(one, holes=(), seen=None)) for one in trials.pulls],
        "trials": [asdict(one) for one in trials.trials],
        "false_calls": [asdict(one) | {"pull": pull} for pull, one in trials.false_calls],
        "undecided_elsewhere": trials.undecided_elsewhere,
        "of_other_kinds": trials.of_other_kinds,
    }
    return json.dumps(plain(found), indent=1, allow_nan=False) + "\n"


def trials_from(found: Mapping[str, Any]) -> Trials:
    """Of what `trials_json` wrote, parsed. Raises ValueError naming the entry."""
    pulls = tuple(_pull(one, f"pulls[{i}]") for i, one in enumerate(_list(found, "pulls", PULLS_MAX)))
    trials = tuple(_trial(one, f"trials[{i}]") for i, one in enumerate(_list(found, "trials", ROWS_MAX)))
    false_calls = tuple(
        (_text(one, "pull", f"false_calls[{i}]"), _report(one, f"false_calls[{i}]"))
        for i, one in enumerate(_list(found, "false_calls", ROWS_MAX))
    )
    undecided, others = (
        whole(found.get(name), name, 0, ROWS_MAX) for name in ("undecided_elsewhere", "of_other_kinds")
    )
    return Trials(trials, pulls, false_calls, undecided, others)


def _read(path: Path, listed_as: str, parsed: Callable[[Sequence[Row]], T]) -> T:
    """Rows of a CSV file, or of a JSON one: a list of objects, or an object that has it under a name."""
    try:
        data = read_file(path, FILE_MAX)
        if path.suffix.lower() == ".json":
            found = parse_json(data, FILE_MAX)
            rows = found.get(listed_as) if isinstance(found, Mapping) else found
            if not isinstance(rows, list) or len(rows) > ROWS_MAX:
                raise ValueError(f"expected a list of at most {ROWS_MAX} objects, or an object with one as {listed_as}")
            return parsed([mapping(one, f"entry {i + 1}") for i, one in enumerate(rows)])
        return parsed(_csv_rows(data.decode("utf-8-sig")))
    except UnicodeDecodeError:
        raise AnnulusError(f"{path}: not a text file") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror or error})") from None
    except csv.Error as error:
        raise AnnulusError(f"{path}: not a table: {error}") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None


def _csv_rows(content: str) -> list[Row]:
    rows = csv.reader(io.StringIO(content, newline=""), strict=True)
    head = [name.strip() for name in next(rows, [])]
    if len(head) == 1 and ";" in head[0]:
        raise ValueError("line 1: its cells are parted by semicolons, expected commas and decimal points")
    if len(set(head)) < len(head):
        raise ValueError("line 1: a column is there twice")
    out: list[Row] = []
    for row in rows:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(head):
            raise ValueError(f"line {rows.line_num}: {len(row)} cells, expected {len(head)} as line 1 has")
        if len(out) == ROWS_MAX:
            raise ValueError(f"more than {ROWS_MAX} rows")
        out.append({name: cell.strip() for name, cell in zip(head, row, strict=True)} | {"": f"line {rows.line_num}"})
    return out or [dict.fromkeys(head, "") | {"": ""}]  # for its columns


def _rows(rows: Sequence[Row], columns: Sequence[str], needed: Sequence[str]) -> Iterator[tuple[Row, str]]:
    """Each row with where it stands. ValueError for columns that lack, or that have another unit or none."""
    names = {name for one in rows for name in one}
    for name in sorted(names - {*columns, DIG, ""}):
        stem = name.lower().partition("_")[0].partition(" ")[0]
        alike = [one for one in columns if one.startswith(stem)]
        if stem in QUANTITIES and alike:
            raise ValueError(f"{shown(name)} is no column of it: expected {' or '.join(alike)}")
    missing = [name for name in needed if name not in names]
    if missing:
        raise ValueError(f"no column {missing[0]}, expected {','.join(columns)} (needed: {', '.join(needed)})")
    for i, one in enumerate(rows):
        where = one.get("", f"entry {i + 1}")
        if where:
            yield one, str(where)


def _truths(rows: Sequence[Row]) -> Iterator[TrueDefect]:
    named = [str(one.get("name", "")) for one in rows]
    dug = any(DIG in one for one in rows) or all(REPORTED_AS.fullmatch(one) for one in named)
    names: set[tuple[str, str]] = set()
    laid_at: dict[tuple[str, str, float, float], str] = {}
    for number, (row, where) in enumerate(_rows(rows, TRUTH_COLUMNS, TRUTH_NEEDED), start=1):
        one = _truth(row, where, str(number))
        if (one.pipe, one.name) in names:
            raise ValueError(f"{where}: {shown(one.name)} is there twice, expected a name for each")
        names.add((one.pipe, one.name))
        before = laid_at.setdefault((one.pipe, one.kind, one.z_mm, one.clock_deg), one.name)
        if before != one.name:  # matched one to one, the second of them would be missed however good the head is
            raise ValueError(f"{where}: {shown(one.name)} lies where {shown(before)} does, expected one row a defect")
        yield replace(one, laid=False) if dug else one


def _truth(row: Row, where: str, name: str = "") -> TrueDefect:
    return TrueDefect(
        _text(row, "name", where) or name,
        _kind(row, "kind", where),
        _number(row, "z_mm", where, -MM_MAX, MM_MAX),
        _number(row, "clock_deg", where, -360.0, 360.0) % 360.0,
        _number(row, "depth_mm", where, 1e-3, SIZE_MAX),
        _maybe(row, "length_mm", where, 1e-3, SIZE_MAX),
        _maybe(row, "width_mm", where, 1e-3, SIZE_MAX),
        _yes(row, "beside_joint", where),
        _text(row, "pipe", where),
        _yes(row, "laid", where) is not False,
        _maybe(row, "depth_u_mm", where, 0.0, SIZE_MAX),
    )


def _reports(rows: Sequence[Row]) -> Iterator[Reported]:
    for row, where in _rows(rows, REPORT_COLUMNS, REPORT_NEEDED):
        yield _report(row, where)


def _report(row: Row, where: str) -> Reported:
    state = _text(row, "state", where)
    listed = row.get("listed", state != LISTED[1])
    if state not in ("", *LISTED):
        raise ValueError(f"{where}: state is {shown(state)}, expected {' or '.join(LISTED)}")
    return Reported(
        _text(row, "kind", where),
        _number(row, "z_mm", where, -MM_MAX, MM_MAX),
        _number(row, "clock_deg", where, -360.0, 360.0) % 360.0,
        _maybe(row, "depth_mm", where, 0.0, SIZE_MAX),
        _maybe(row, "depth_k2_mm", where, 0.0, SIZE_MAX),
        _maybe(row, "length_mm", where, 0.0, MM_MAX),
        _maybe(row, "arc_deg", where, 0.0, 360.0),
        _yes(row, "at_least", where) is True,
        listed is not False,
    )


def _hit_miss(rows: Sequence[Row], name: str) -> Iterator[Trial]:
    for number, (row, where) in enumerate(_rows(rows, HIT_MISS_COLUMNS, HIT_MISS_NEEDED), start=1):
        hit = _yes(row, "detected", where)
        if hit is None:
            raise ValueError(f"{where}: detected is empty, expected yes or no")
        truth = TrueDefect(
            str(number),
            _kind(row, "kind", where),
            math.nan,
            math.nan,
            _number(row, "depth_mm", where, 1e-3, SIZE_MAX),
            _maybe(row, "length_mm", where, 1e-3, SIZE_MAX),
            _maybe(row, "width_mm", where, 1e-3, SIZE_MAX),
            _yes(row, "beside_joint", where),
        )
        depth = _maybe(row, "reported_depth_mm", where, 0.0, SIZE_MAX)
        yield Trial(truth, name, TrialState.DETECTED if hit else TrialState.MISSED, reported_depth_mm=depth)


def _pull(found: Any, what: str) -> Pull:
    row = mapping(found, what)
    first, last = (_number(row, name, what, -MM_MAX, MM_MAX) for name in ("from_mm", "to_mm"))
    if last < first:
        raise ValueError(f"{what} ends at {last:g} mm, before it begins at {first:g}")
    name, pipe, head, version, date = (_text(row, one, what) for one in ("name", "pipe", "head", "version", "date"))
    radius, limit = (
        _number(row, "bore_radius_mm", what, 1.0, SIZE_MAX),
        _maybe(row, "depth_limit_mm", what, 0.0, SIZE_MAX),
    )
    return Pull(name, pipe, first, last, radius, limit, head, version, date)


def _trial(found: Any, what: str) -> Trial:
    row = mapping(found, what)
    truth = mapping(row.get("truth"), f"{what}.truth")
    state = _text(row, "state", what)
    if state not in list(TrialState):
        raise ValueError(f"{what}.state is {shown(state)}, expected {', '.join(TrialState)}")
    return Trial(
        _truth(truth, f"{what}.truth"),
        _text(row, "pull", what),
        TrialState(state),
        _text(row, "reported", what),
        _maybe(row, "reported_depth_mm", what, 0.0, SIZE_MAX),
        _maybe(row, "reported_k2_mm", what, 0.0, SIZE_MAX),
        row.get("at_least") is True,
        _maybe(row, "depth_limit_mm", what, 0.0, SIZE_MAX),
    )


def _list(found: Mapping[str, Any], name: str, most: int) -> list[Any]:
    value = found.get(name)
    if not isinstance(value, list) or len(value) > most:
        raise ValueError(f"{name} must be a list of at most {most}")
    return value


def _text(row: Row, name: str, where: str) -> str:
    value = row.get(name)
    return "" if value is None else printable(checked_text(value, f"{where}: {name}", NAME_MAX))


def _kind(row: Row, name: str, where: str) -> str:
    value = _text(row, name, where)
    if value not in KINDS:
        raise ValueError(f"{where}: {name} is {shown(value)}, expected {' or '.join(KINDS)}")
    return value


def _number(row: Row, name: str, where: str, low: float, high: float) -> float:
    value = row.get(name)
    if isinstance(value, str):  # of a CSV file; digits of other scripts and 1_000 are none
        with contextlib.suppress(ValueError):
            value = float(value) if value.isascii() and "_" not in value else value
    return within(value, f"{where}: {name}", low, high)


def _maybe(row: Row, name: str, where: str, low: float, high: float) -> float:
    """NaN where it is empty, null or not there."""
    return math.nan if row.get(name) in (None, "") else _number(row, name, where, low, high)


def _yes(row: Row, name: str, where: str) -> bool | None:
    value = row.get(name)
    word = str(value).lower() if isinstance(value, bool | str) or value in (0, 1) else shown(value)
    if value is None or word == "":
        return None
    if word not in YES + NO:
        raise ValueError(f"{where}: {name} is {shown(value)}, expected yes or no")
    return word in YES


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6g}"
