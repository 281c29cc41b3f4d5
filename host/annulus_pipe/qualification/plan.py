"""The plan of a gauge study (plan.toml) and its runs (runs.csv): which pieces, operators, repeats, temperatures."""

import csv
import io
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from annulus_pipe.untrusted import TOML_MAX, mapping, parse_toml, printable, read_file, shown, text, whole, within
from annulus_pipe.vocabulary import AnnulusError

PIECES_MAX, OPERATORS_MAX, REPEATS_MAX = 32, 32, 100
CSV_MAX = 1 << 20  # bytes of runs.csv: thousands of runs
NAME_MAX = 60  # characters of a piece's or operator's name
DIAMETER_MM = (5.0, 10_000.0)
CELSIUS = (-40.0, 80.0)
K2_PART = 0.02  # of its diameter: what is known no better is no reference for half a percent
SPAN_LEAST_MM = 5.0  # of a piece within a scan: shorter, no station lies in it
MONTHS_MAX = 60  # no head is as it was for longer; a certificate that states more was not made by `certify issue`
MONTHS = 12  # a certificate holds unless the plan says otherwise: what calibration laboratories give a gauge
ALL = "all"  # in runs.csv, in place of a piece: one pull through all of them
COLUMNS = ("run", "operator", "piece", "repeat", "temperature_c", "results")
PLAN_KEYS = ("title", "head", "laboratory", "operators", "repeats", "months", "one_pull", "seed", "piece")
PIECE_KEYS = ("name", "diameter_mm", "u_mm", "from_mm", "to_mm", "measured_by")


@dataclass(frozen=True, slots=True)
class ReferencePiece:
    """A piece of pipe whose inner diameter somebody measured. k2_mm : expanded uncertainty (k = 2) of that. span_mm :
    where it lies in a scan, by the odometer; None: all of the scan shows it."""

    name: str
    diameter_mm: float
    k2_mm: float
    span_mm: tuple[float, float] | None = None
    measured_by: str = ""


@dataclass(frozen=True, slots=True)
class StudyPlan:
    """one_pull : a scan shows all pieces, one after the other. repeats : of each operator with each piece."""

    title: str
    head: str
    laboratory: str
    operators: tuple[str, ...]
    repeats: int
    pieces: tuple[ReferencePiece, ...]
    months: int = MONTHS
    one_pull: bool = False
    seed: int = 1


@dataclass(frozen=True, slots=True)
class StudyRun:
    """A row of runs.csv. piece : its name, or ALL. temperature_c : NaN where nobody measured it. results : the folder
    that `annulus reconstruct` wrote, as the file names it."""

    number: int
    operator: str
    piece: str
    repeat: int
    temperature_c: float = math.nan
    results: str = ""


def read_plan(path: Path) -> StudyPlan:
    """Raises AnnulusError, one line that names file and key."""
    try:
        return plan_from(parse_toml(read_file(path, TOML_MAX)))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a plan.toml.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None


def plan_from(data: Mapping[str, Any]) -> StudyPlan:
    """Of plain values, as TOML has them. Raises ValueError naming the key."""
    _require_known(data, PLAN_KEYS, "the plan")
    operators = data.get("operators")
    if not isinstance(operators, list) or not 2 <= len(operators) <= OPERATORS_MAX:
        raise ValueError(
            f"operators: expected a list of 2 to {OPERATORS_MAX} names. One operator alone says nothing of what others "
            "would read"
        )
    names = tuple(_name(one, f"operators[{i}]") for i, one in enumerate(operators))
    rows = data.get("piece")
    if not isinstance(rows, list) or not 1 <= len(rows) <= PIECES_MAX:
        raise ValueError(f"piece: expected 1 to {PIECES_MAX} sections [[piece]], each a reference piece")
    pieces = tuple(_piece(mapping(one, f"piece {i + 1}"), f"piece {i + 1}") for i, one in enumerate(rows))
    for what, listed in (("operators", names), ("pieces", tuple(piece.name for piece in pieces))):
        if len(set(listed)) < len(listed):
            raise ValueError(f"{what}: two have one name, {shown(max(listed, key=listed.count))}")
    one_pull = data.get("one_pull", False)
    if not isinstance(one_pull, bool):
        raise ValueError(f"one_pull is {shown(one_pull)}, expected true or false")
    if one_pull:
        _require_apart(pieces)
    return StudyPlan(
        _text(data, "title"),
        _name(data.get("head"), "head"),
        _text(data, "laboratory"),
        names,
        whole(data.get("repeats"), "repeats", 2, REPEATS_MAX),
        pieces,
        whole(data.get("months", MONTHS), "months", 1, MONTHS_MAX),
        one_pull,
        whole(data.get("seed", 1), "seed", 0, 1 << 31),
    )


def _piece(row: Mapping[str, Any], what: str) -> ReferencePiece:
    _require_known(row, PIECE_KEYS, what)
    diameter = within(row.get("diameter_mm"), f"{what} diameter_mm", *DIAMETER_MM)
    k2 = within(row.get("u_mm"), f"{what} u_mm (k = 2)", 1e-4, K2_PART * diameter)
    span = None
    if "from_mm" in row or "to_mm" in row:
        first, last = (within(row.get(key), f"{what} {key}", -1e7, 1e7) for key in ("from_mm", "to_mm"))
        if last - first < SPAN_LEAST_MM:
            raise ValueError(f"{what}: {first:g} to {last:g} mm, expected from_mm before to_mm by {SPAN_LEAST_MM:g} mm")
        span = (first, last)
    return ReferencePiece(_name(row.get("name"), f"{what} name"), diameter, k2, span, _text(row, "measured_by"))


def _require_apart(pieces: Sequence[ReferencePiece]) -> None:
    """In one pull each piece has a place of its own."""
    for piece in pieces:
        if piece.span_mm is None:
            raise ValueError(f"piece {shown(piece.name)}: one_pull = true, and from_mm and to_mm are missing")
    spans = sorted((piece.span_mm, piece.name) for piece in pieces if piece.span_mm is not None)
    for (before, name), (after, other) in pairwise(spans):
        if before[1] > after[0]:
            raise ValueError(f"pieces {shown(name)} and {shown(other)} overlap in one pull")


def _require_known(data: Mapping[str, Any], keys: Sequence[str], what: str) -> None:
    for key in data:
        if key not in keys:
            raise ValueError(f"{shown(key)} is not known in {what}, expected {', '.join(keys)}")


def _name(value: object, what: str) -> str:
    """A name that stands in a cell and a folder's name."""
    name = printable(" ".join(text(value, what, NAME_MAX).split()))
    if not name or name == ALL or name[0] in "=+-@":
        raise ValueError(f"{what} is {shown(value)}, expected a name")
    return name


def _text(data: Mapping[str, Any], key: str) -> str:
    return printable(" ".join(text(data.get(key, ""), key, 300).split()))


def planned(plan: StudyPlan) -> tuple[StudyRun, ...]:
    """All runs, in an order drawn from the plan's seed: what drifts over a day shall not look like an operator."""
    pieces = (ALL,) if plan.one_pull else tuple(piece.name for piece in plan.pieces)
    rows = [(o, p, r) for r in range(1, plan.repeats + 1) for o in plan.operators for p in pieces]
    random.Random(plan.seed).shuffle(rows)
    return tuple(
        StudyRun(i, operator, piece, repeat, results=f"results/{i:03d}")
        for i, (operator, piece, repeat) in enumerate(rows, start=1)
    )


def runs_csv(runs: Sequence[StudyRun]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for run in runs:
        warm = "" if math.isnan(run.temperature_c) else f"{run.temperature_c:g}"
        writer.writerow([run.number, run.operator, run.piece, run.repeat, warm, run.results])
    return out.getvalue()


def read_runs(path: Path, plan: StudyPlan) -> tuple[StudyRun, ...]:
    """The runs that were made: every one of the plan's, once. Raises AnnulusError, one line."""
    try:
        content = read_file(path, CSV_MAX).decode("utf-8-sig")
        runs = tuple(_runs(csv.reader(io.StringIO(content, newline=""), strict=True)))
        _require_planned(runs, plan)
        return runs
    except OSError as error:
        raise AnnulusError(
            f"{path}: cannot be read ({error.strerror}). Expected the runs.csv of `annulus certify plan`."
        ) from None
    except UnicodeDecodeError:
        raise AnnulusError(f"{path}: not a text file. Expected the runs.csv of `annulus certify plan`.") from None
    except (ValueError, csv.Error) as error:
        raise AnnulusError(f"{path}: {error}.") from None


def _runs(rows: Any) -> Iterator[StudyRun]:
    head: list[str] = next(rows, [])
    if tuple(head) != COLUMNS:
        raise ValueError(f"its columns are {shown(','.join(head))}, expected {','.join(COLUMNS)}")
    for row in rows:
        if not row:
            continue
        where = f"line {rows.line_num}"
        if len(row) != len(COLUMNS):
            raise ValueError(f"{where}: {len(row)} cells, expected {len(COLUMNS)}")
        number, repeat = (_whole_cell(row[i], f"{where}: {COLUMNS[i]}") for i in (0, 3))
        yield StudyRun(
            number,
            _name(row[1], f"{where}: operator"),
            ALL if row[2] == ALL else _name(row[2], f"{where}: piece"),
            repeat,
            _celsius(row[4], f"{where}: temperature_c"),
            row[5].strip(),
        )


def _whole_cell(cell: str, what: str) -> int:
    if not cell.strip().isdecimal() or len(cell) > 6:
        raise ValueError(f"{what} is {shown(cell)}, expected a whole number")
    return int(cell)


def _celsius(cell: str, what: str) -> float:
    if not cell.strip():
        return math.nan
    try:
        return within(float(cell), what, *CELSIUS)
    except ValueError:
        low, high = CELSIUS
        raise ValueError(
            f"{what} is {shown(cell)}, expected degrees Celsius, {low:g} to {high:g}, or nothing where nobody measured"
        ) from None


def _require_planned(runs: Sequence[StudyRun], plan: StudyPlan) -> None:
    """Each run of the plan once, each with results: cells of unequal size would need another analysis, and runs that
    somebody left out another name."""
    expected = {(run.operator, run.piece, run.repeat) for run in planned(plan)}
    made: set[tuple[str, str, int]] = set()
    folders: dict[str, int] = {}
    for run in runs:
        key = (run.operator, run.piece, run.repeat)
        named = f"run {run.number} ({run.operator}, {run.piece}, repeat {run.repeat})"
        if key not in expected:
            raise ValueError(f"{named} is not in the plan: its operators, pieces or repeats are others")
        if key in made:
            raise ValueError(f"{named} is there twice")
        if not run.results:
            raise ValueError(f"{named} has no results")
        if run.results in folders:
            raise ValueError(f"{named} has the results of run {folders[run.results]}: {shown(run.results)}")
        made.add(key)
        folders[run.results] = run.number
    if missing := sorted(expected - made):
        operator, piece, repeat = missing[0]
        raise ValueError(
            f"{len(made)} of {len(expected)} runs; of {operator}, {piece}, repeat {repeat} there is none. A run that "
            "failed is made again"
        )
