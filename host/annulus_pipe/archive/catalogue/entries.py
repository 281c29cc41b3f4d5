"""Surveys added to a catalogue, listed, checked, and where the results of one lie."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from annulus_pipe.archive.catalogue.columns import SUPERSEDED, SURVEYS
from annulus_pipe.archive.catalogue.pieces import DamagedFile, pack, quoted
from annulus_pipe.archive.catalogue.query import open_catalogue
from annulus_pipe.archive.catalogue.store import make, put, read_back, require, survey_folder, survey_ids, sweep
from annulus_pipe.archive.catalogue.survey import Row, digest, read_survey
from annulus_pipe.extras import need
from annulus_pipe.job import WORDS, JobSheet
from annulus_pipe.untrusted import one_line, printable, shown
from annulus_pipe.vocabulary import AnnulusError

Progress = Callable[[str, int, int], None]
_ID = re.compile(r"[0-9a-f]{4,12}")
_DAY = re.compile(r"(\d{4})(-\d\d)?(-\d\d)?")
SHOWN_MAX = 5  # surveys that a message names


@dataclass(frozen=True, slots=True)
class Added:
    """row: of surveys. new: it was not there. superseded_by: another survey of its scan that counts in its place;
    supersedes: those in whose place it counts."""

    results: Path
    row: Row
    new: bool
    superseded_by: str | None = None
    supersedes: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Refused:
    """why: one line."""

    results: Path
    why: str


def add(
    archive: Path,
    results: Sequence[Path],
    job: JobSheet | None = None,
    replaces: str | None = None,
    progress: Progress = lambda what, done, total: None,
) -> list[Added | Refused]:
    """Folders of results into the catalogue, which is made where there is none; one that cannot be read does not keep
    out the others. job: goes over what each says. replaces: the survey in whose place the only one counts.

    Raises AnnulusError where the catalogue cannot be written, or is none; results until then are in it.
    """
    need("pyarrow"), need("duckdb")
    if replaces is not None and len(results) != 1:
        raise AnnulusError(f"{len(results)} results cannot replace one survey, expected one folder")
    root = require(archive) if replaces is not None else make(archive)
    old = None if replaces is None else _found(root, replaces)
    sweep(root)
    done: list[Added | Refused] = []
    for i, folder in enumerate(results):
        progress("adding", i, len(results))
        try:
            record = read_survey(folder, job, old)
        except AnnulusError as error:
            done.append(Refused(folder, str(error)))
            continue
        made, before = record.row["created_utc"], old and old["created_utc"]
        if made and before and made < before:
            raise AnnulusError(f"{folder}: was made before the survey it is to replace, expected a later one")
        done.append(Added(folder, record.row, put(root, record)))
    progress("adding", len(results), len(results))
    pack(root)
    return _versions(root, done)


def _versions(root: Path, done: Sequence[Added | Refused]) -> list[Added | Refused]:
    """The same with what counts in whose place."""
    added = {str(one.row["survey"]) for one in done if isinstance(one, Added)}
    if not added:
        return list(done)
    with open_catalogue(root) as catalogue:
        rows = catalogue.connection.execute(
            f"SELECT survey, {SUPERSEDED.name} FROM all_surveys WHERE scan IN (SELECT scan FROM all_surveys "
            f"WHERE survey IN ({', '.join(map(quoted, sorted(added)))}))"
        ).fetchall()
    above = dict(rows)
    return [
        one
        if isinstance(one, Refused)
        else Added(
            one.results,
            one.row,
            one.new,
            above.get(one.row["survey"]),
            sorted(old for old, new in above.items() if new == one.row["survey"]),
        )
        for one in done
    ]


def listed(
    archive: Path, pipe: str | None = None, since: date | None = None, superseded: bool = False
) -> tuple[Sequence[Row], int, Sequence[DamagedFile]]:
    """Rows of surveys by pipe and date, with superseded_by; how many superseded ones are not shown; what is damaged."""
    names = [one.name for one in SURVEYS] + [SUPERSEDED.name]
    where, values = ["true"], list[Any]()
    for condition, value in (("pipe = ?", None if pipe is None else printable(pipe)), ("date >= ?", since)):
        if value is not None:
            where.append(condition)
            values.append(value)
    with open_catalogue(archive) as catalogue:
        found = catalogue.connection.execute(
            f"SELECT {', '.join(names)} FROM all_surveys WHERE {' AND '.join(where)} "
            f"ORDER BY pipe NULLS LAST, date NULLS FIRST, survey",
            values,
        ).fetchall()
        rows = [dict(zip(names, row, strict=True)) for row in found]
        old = sum(row[SUPERSEDED.name] is not None for row in rows)
        if not superseded:
            rows = [row for row in rows if row[SUPERSEDED.name] is None]
        return rows, 0 if superseded else old, catalogue.damage


def checked(archive: Path, progress: Progress = lambda what, done, total: None) -> Iterator[str]:
    """What is wrong with each survey's own files, read to their ends and held against their names. One line each."""
    root = require(archive)
    ids = survey_ids(root)
    for i, survey in enumerate(ids):
        progress("checking", i, len(ids))
        try:
            read_back(survey_folder(root, survey))
        except ValueError as error:
            yield one_line(str(error))
    progress("checking", len(ids), len(ids))


def results_of(archive: Path, name: str) -> Path:
    """The folder of results of a survey: by its identity or the beginning of it, or by PIPE or PIPE@DATE, DATE being
    YYYY, YYYY-MM or YYYY-MM-DD, which is the newest of those.

    Raises AnnulusError for none, for several, and where the folder is gone or has other results by now.
    """
    row = _found(require(archive), name)
    folder = Path(str(row["results"]))
    if not folder.is_dir():
        raise AnnulusError(f"{folder}: the results of {row['survey']} are not there any more, expected their folder")
    now = read_survey(folder)
    job = {name: row[name] for name in _OF_JOB}  # a job given at adding is of the survey, not of the folder
    if digest({**now.row, **job}, now.stations, now.defects, now.features) != row["digest"]:
        raise AnnulusError(f"{folder}: has other results than those of survey {row['survey']} by now; add them again")
    return folder


_OF_JOB = frozenset(WORDS) - {"nominal_diameter_mm"} | {"date_of", "job_diameter_mm"}


def _found(root: Path, name: str) -> Row:
    """The one survey of that name."""
    columns, printed = [one.name for one in SURVEYS], shown(name)
    name = printable(name)  # as texts are kept
    with open_catalogue(root) as catalogue:
        ask = catalogue.connection.execute

        def rows(where: str, *values: Any) -> list[dict[str, Any]]:
            found = ask(f"SELECT {', '.join(columns)} FROM all_surveys WHERE {where}", list(values)).fetchall()
            return [dict(zip(columns, row, strict=True)) for row in found]

        if _ID.fullmatch(name):
            found = rows("starts_with(survey, ?)", name)
            if len(found) > 1:
                raise AnnulusError(f"{name}: begins several surveys ({_some(found)}), expected more of its digits")
            if found:
                return found[0]
        pipe, sign, day = name.rpartition("@")
        counts = f"{SUPERSEDED.name} IS NULL"
        found = rows(f"pipe = ? AND {counts}", name)
        if not found and sign and _DAY.fullmatch(day):
            found = rows(f"pipe = ? AND starts_with(date::VARCHAR, ?) AND {counts}", pipe, day)
    if not found:
        raise AnnulusError(
            f"{printed}: no such survey in {root}, expected an identity, PIPE or PIPE@DATE; "
            "`annulus archive list` has them"
        )
    newest = max(one["date"] or date.min for one in found)
    found = [one for one in found if (one["date"] or date.min) == newest]
    if len(found) > 1:
        raise AnnulusError(f"{printed}: {len(found)} surveys of that day ({_some(found)}), expected one's identity")
    return found[0]


def _some(rows: Sequence[Mapping[str, Any]]) -> str:
    names = [str(row["survey"]) for row in rows]
    return ", ".join(names[:SHOWN_MAX]) + (" .." if len(names) > SHOWN_MAX else "")
