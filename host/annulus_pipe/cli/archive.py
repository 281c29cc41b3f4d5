"""`annulus archive`: surveys of many pipes over the years."""

import csv
import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, date, datetime
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from annulus_pipe.cli.compare import EXAMPLE as COMPARE_EXAMPLE
from annulus_pipe.cli.compare import compare
from annulus_pipe.cli.show import Json, progress, tell, verbs
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.archive.catalogue import Added
    from annulus_pipe.archive.catalogue.pieces import DamagedFile
    from annulus_pipe.archive.catalogue.query import QueryResult

app = verbs()
app.command(epilog=COMPARE_EXAMPLE)(compare)

Archive = Annotated[Path, typer.Option("--archive", "-a", help="Folder of the catalogue.")]
HERE = Path("archive")
CELL_MAX, ROWS_MAX = 36, 200  # characters of a cell, rows of a table, for people


@app.command("add", epilog="Example: annulus archive add season/*/results --archive archive")
def add_command(
    results: Annotated[list[Path], typer.Argument(help="Folders that `annulus reconstruct` wrote.")],
    archive: Archive = HERE,
    job: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=TEXT|FILE", help="Over what the results say, as of reconstruct: --job pipe=P-17."),
    ] = None,
    replaces: Annotated[
        str | None, typer.Option(metavar="SURVEY", help="The survey in whose place these results count.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Add folders of results to a catalogue, which is made where there is none.

    The same results are one survey, however often they are added. Results of one scan that were made anew are a new
    version: the one made last counts, the others stay and are said to be superseded.
    """
    from annulus_pipe.archive.catalogue import Added, add
    from annulus_pipe.job import job_of

    with progress() as bars:
        done = add(archive, results, job_of(job or ()), replaces, bars)
    refused = [one for one in done if not isinstance(one, Added)]
    added = [one for one in done if isinstance(one, Added)]
    if as_json:
        surveys = [
            {
                "survey": one.row["survey"],
                "new": one.new,
                "superseded_by": one.superseded_by,
                "supersedes": list(one.supersedes),
                "pipe": one.row["pipe"],
                "date": _plain(one.row["date"]),
                "results": str(one.results),
            }
            for one in added
        ]
        print(json.dumps({"added": surveys, "refused": [{"results": str(o.results), "why": o.why} for o in refused]}))
    else:
        for one in added:
            _print_added(one)
    for out in refused:
        print(f"annulus: {out.why}", file=sys.stderr)
    if refused:
        raise typer.Exit(1)


def _print_added(one: "Added") -> None:
    row = one.row
    pipe, day = row["pipe"] or "no pipe named", row["date"] or "no date known"
    print(f"{'added' if one.new else 'was there':<10} {row['survey']}  {pipe}, {day}, {_count(row)}")
    for old in one.supersedes if one.new else ():
        print(f"{'':<10} in place of {old}, which stays")
    if one.superseded_by:
        print(f"{'':<10} superseded by {one.superseded_by}, which was made later from the same scan")
    if row["begun_utc"] is None:
        print(f"{'':<10} the scan says no time: results of it made anew are to be added with --replaces")


def _count(row: Mapping[str, Any]) -> str:
    return f"{row['station_count']} stations, {row['defect_count']} defects"


@app.command("list", epilog="Example: annulus archive list --pipe P-17 --since 2025-01-01")
def list_command(
    archive: Archive = HERE,
    pipe: Annotated[str | None, typer.Option(help="Only of this pipe.")] = None,
    since: Annotated[str | None, typer.Option(metavar="DATE", help="Only scans of that day and later.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Superseded ones, too.")] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Read all files to their ends and hold them against what was added.")
    ] = False,
    as_json: Json = False,
) -> None:
    """The surveys of a catalogue, by pipe and date."""
    from annulus_pipe.archive.catalogue import checked, listed
    from annulus_pipe.numeric.rounding import DISTANCE, MEASURE, PERCENT, quoted

    rows, hidden, damage = listed(archive, pipe, _day(since), every)
    wrong = []
    if check:
        with progress() as bars:
            wrong = list(checked(archive, bars))
    if as_json:
        surveys = [{name: _plain(value) for name, value in row.items()} for row in rows]
        print(json.dumps({"surveys": surveys, "superseded": hidden, "damaged": [*_damaged(damage), *wrong]}))
    else:

        def known(value: Any, quantity: Any) -> str:
            return "" if value is None else quoted(value, quantity)

        head = ("survey", "pipe", "date", "site", "scanned", "diameter", "ovality", "defects", "joints and more", "")
        table = [
            (
                row["survey"],
                row["pipe"] or "-",
                str(row["date"] or "-"),
                row["site"] or "-",
                known(row["scanned_to_mm"] - row["scanned_from_mm"], DISTANCE),
                known(row["diameter_mean_mm"], MEASURE),
                known(row["shape_ovality_f1216_percent"], PERCENT),
                str(row["defect_count"]),
                str(row["feature_count"]),
                f"superseded by {row['superseded_by']}" if row["superseded_by"] else row["decision"] or "",
            )
            for row in rows
        ]
        print("\n".join(_aligned(head, table)))
        print(
            f"{len(rows)} survey{'s' * (len(rows) != 1)}"
            + (f", and {hidden} superseded: --all shows them" if hidden else "")
        )
        for line in wrong:
            print(f"damaged    {line}")
    _tell_damage(damage)
    if wrong or (check and damage):
        raise typer.Exit(1)


@app.command(
    "query", epilog='Example: annulus archive query "SELECT pipe, max(depth_mm) FROM defects GROUP BY pipe" --csv'
)
def query_command(
    sql: Annotated[
        str | None, typer.Argument(help="One SELECT over surveys, stations, defects, joints; DuckDB's SQL.")
    ] = None,
    archive: Archive = HERE,
    named: Annotated[
        str | None, typer.Option(help="A question that is kept: worst-ovality, year-on-year; --named list has all.")
    ] = None,
    show: Annotated[bool, typer.Option("--show", help="Print the SQL of --named and ask nothing.")] = False,
    as_json: Json = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV.")] = False,
    parquet: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the answer as Parquet.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, max=86_400, help="How long it may take.")] = 60.0,
    memory: Annotated[int, typer.Option(metavar="MB", min=64, max=1 << 20, help="How much memory, MB.")] = 1024,
) -> None:
    """Ask a catalogue in SQL. It only reads, and only the catalogue.

    Views: surveys, stations, defects, joints; undecided, features; all_surveys and so on with what is superseded.
    DESCRIBE stations names the columns, each with its unit.
    """
    from annulus_pipe.archive.catalogue import open_catalogue

    if sum((as_json, as_csv, parquet is not None)) > 1:
        raise AnnulusError("--json, --csv and --parquet do not go together, expected one of them")
    if show and named is None:
        raise AnnulusError("--show does not go without --named")
    if (sql is None) == (named is None):
        raise AnnulusError("expected SQL or --named, one of them")
    if named is not None:
        sql = _named(named, show)
        if sql is None:
            return
    assert sql is not None
    with open_catalogue(archive, memory) as catalogue:
        with catalogue.asked(sql, seconds) as answer:
            if parquet is not None:
                _write_parquet(answer, parquet)
            elif as_csv:
                _print_csv(answer)
            elif as_json:
                _print_json(answer)
            else:
                _print_table(answer)
        _tell_damage(catalogue.damage)


def _named(name: str, show: bool) -> str | None:
    """The SQL of a question; None: it, or the list of them, has been printed."""
    from annulus_pipe.archive.catalogue.questions import QUESTIONS

    if name == "list":
        for known, question in QUESTIONS.items():
            print(f"{known:<20} {question.asks}")
        return None
    if name not in QUESTIONS:
        raise AnnulusError(f"--named {name}: expected one of {', '.join(QUESTIONS)}, or list")
    question = QUESTIONS[name]
    if show:
        print(f"/* {question.asks} */\n{question.sql.strip()}")  # -- would be an option, given back
        return None
    return question.sql


def _print_json(answer: "QueryResult") -> None:
    """A list of objects, a row a line."""
    print("[", end="")
    for i, row in enumerate(answer.rows()):
        one = {name: _plain(value) for name, value in zip(answer.columns, row, strict=True)}
        print(",\n " if i else "\n ", json.dumps(one, ensure_ascii=False), sep="", end="")
    print("\n]")


def _print_csv(answer: "QueryResult") -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(answer.columns)
    for row in answer.rows():
        writer.writerow([_cell(value) for value in row])


def _cell(value: Any) -> Any:
    """A text that begins as a formula does stays one, by an apostrophe."""
    plain = _plain(value)
    if isinstance(plain, str):
        return f"'{plain}" if isinstance(value, str) and plain.startswith(("=", "+", "-", "@")) else plain
    return json.dumps(plain) if isinstance(plain, dict | list) else plain


def _print_table(answer: "QueryResult") -> None:
    rows, more = list[list[str]](), False
    for row in answer.rows():
        if len(rows) == ROWS_MAX:
            more = True
            break
        rows.append([_shown(value) for value in row])
    print("\n".join(_aligned(answer.columns, rows)))
    print(f"the first {ROWS_MAX} rows; --csv prints all" if more else f"{len(rows)} row{'s' * (len(rows) != 1)}")


def _write_parquet(answer: "QueryResult", path: Path) -> None:
    from annulus_pipe.extras import need
    from annulus_pipe.storage.whole import written_whole

    pq, rows = need("pyarrow.parquet"), 0
    try:
        with written_whole(path) as file, pq.ParquetWriter(file, answer.schema, compression="zstd") as writer:
            for batch in answer.batches():
                writer.write_batch(batch)
                rows += batch.num_rows
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror or error})") from None
    tell(f"{rows} rows in {path}")


def _plain(value: Any) -> Any:
    """As JSON has it; null for what it has no number for."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, datetime):
        zoned = value if value.tzinfo else value.replace(tzinfo=UTC)
        return zoned.isoformat()
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value if value is None or isinstance(value, str | int | bool) else str(value)


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.10g}"
    plain = _plain(value)
    text = plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False)
    return text.replace("\n", " ").replace("\t", " ")


def _aligned(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table; what is too long for its cell is cut."""
    cut = [[one if len(one) <= CELL_MAX else f"{one[: CELL_MAX - 2]}.." for one in row] for row in (head, *rows)]
    widths = [max(map(len, column)) for column in zip(*cut, strict=True)]
    return ["  ".join(one.ljust(width) for one, width in zip(row, widths, strict=True)).rstrip() for row in cut]


def _day(text: str | None) -> date | None:
    if text is None:
        return None
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise AnnulusError(f"--since {text}: expected a day, YYYY-MM-DD") from None


def _damaged(damage: "Sequence[DamagedFile]") -> list[str]:
    return [f"{one.path}: {one.why}" for one in damage]


def _tell_damage(damage: "Sequence[DamagedFile]") -> None:
    for one in damage:
        then = "its rows are missing: add the results again" if one.lost else "the surveys' own files are read instead"
        tell(f"annulus: {one.path}: damaged ({one.why}); {then}")
