"""A catalogue's folder: Parquet files that are written once and never again.

    catalogue.json            {"format": "annulus-catalogue/1"}
    surveys/ID/NAME.parquet   of one survey: surveys (one row), stations, defects, features
    packs/ID-N/NAME.parquet   the same rows of N surveys in one file each, so that thousands are read in a moment

A survey is a folder that is made beside its place, brought to the disk and renamed: it is there whole or not at all,
and of two who add at once both succeed, the same survey being one folder. Packs follow from the surveys' folders and
may be deleted at any time; adding makes them, a damaged one is read from its surveys' own files. A survey is taken out
by deleting its folder.
"""

import contextlib
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.archive.catalogue.columns import TABLES, CatalogueColumn
from annulus_pipe.archive.catalogue.survey import Row, SurveyRecord, digest
from annulus_pipe.extras import need
from annulus_pipe.storage.results_folder import STATIONS_MAX
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.untrusted import mapping, one_line, parse_json, read_file, shown
from annulus_pipe.vocabulary import AnnulusError

FORMAT, HEAD = "annulus-catalogue/1", "catalogue.json"
HEAD_MAX = 10_000  # bytes
SURVEYS, PACKS = "surveys", "packs"
ID = re.compile(r"[0-9a-f]{12}")
PACK = re.compile(r"[0-9a-f]{12}-(\d{1,9})")
URL = re.compile(r"[a-z][a-z0-9+.-]+:/")  # as a path has it, which makes one of two slashes
MAGIC = b"PAR1"  # a Parquet file's first and last bytes
PLACES_MAX = 1_000_000  # rows of one survey's defects
LEFT_S = 3600.0  # after which what was begun and never renamed is of somebody who died, and an old pack has no reader


def require(root: Path) -> Path:
    """The absolute path of a catalogue's folder. AnnulusError for what is none, or is of a newer annulus."""
    if URL.match(str(root)):
        raise AnnulusError(f"{root}: a catalogue lies in a folder of this computer, expected a path")
    root = root.absolute()
    try:
        str(root).encode()
        head = mapping(parse_json(read_file(root / HEAD, HEAD_MAX), HEAD_MAX), "catalogue")
        if head.get("format") != FORMAT:
            raise ValueError(f"its format is {shown(head.get('format'))}, expected {FORMAT}; is it of a newer annulus?")
    except FileNotFoundError:
        raise AnnulusError(f"{root}: is no catalogue: it has no {HEAD}. `annulus archive add` makes one.") from None
    except UnicodeEncodeError:
        raise AnnulusError(f"{root}: its name is not UTF-8, expected a folder whose name is") from None
    except (OSError, ValueError) as error:
        raise AnnulusError(f"{root / HEAD}: {_why(error)}") from None
    return root


def make(root: Path) -> Path:
    """The same, made where there is nothing or an empty folder."""
    if (root / HEAD).exists() or URL.match(str(root)):
        return require(root)
    try:
        root.mkdir(parents=True, exist_ok=True)
        if any(one.name not in (SURVEYS, PACKS) and not one.name.startswith(f".{HEAD}") for one in root.iterdir()):
            if (root / HEAD).exists():  # another has just made it
                return require(root)
            raise AnnulusError(f"{root}: has other things in it, expected a catalogue or an empty folder")
        with written_whole(root / HEAD) as file:
            file.write(json.dumps({"format": FORMAT}).encode() + b"\n")
    except OSError as error:
        raise AnnulusError(f"{root}: cannot be written to ({error.strerror}). Expected a folder.") from None
    return require(root)


def survey_ids(root: Path) -> list[str]:
    """Of all that are there whole."""
    return sorted(name for name in _names(root / SURVEYS) if ID.fullmatch(name))


def pack_folders(root: Path) -> list[tuple[int, Path]]:
    """(surveys, folder), the largest first."""
    found = [
        (int(match[1]), root / PACKS / match[0]) for name in _names(root / PACKS) if (match := PACK.fullmatch(name))
    ]
    return sorted(found, key=lambda one: (-one[0], one[1]))


def survey_folder(root: Path, survey: str) -> Path:
    return root / SURVEYS / survey


def file_of(folder: Path, table: str) -> Path:
    return folder / f"{table}.parquet"


def why_cut(path: Path) -> str | None:
    """What is wrong with a file at first sight: gone, or not whole. None: nothing."""
    try:
        with open(path, "rb") as file:
            head = file.read(len(MAGIC))
            size = file.seek(0, os.SEEK_END)
            file.seek(-min(size, len(MAGIC)), os.SEEK_END)
            return None if head == file.read() == MAGIC and size > 2 * len(MAGIC) else "not whole"
    except OSError as error:
        return error.strerror or type(error).__name__


def put(root: Path, record: SurveyRecord) -> bool:
    """A survey into the catalogue: True where it was not there. One that is there and is damaged is made anew. Raises
    AnnulusError where the folder cannot be written."""
    place = survey_folder(root, record.survey)
    try:
        place.parent.mkdir(exist_ok=True)
        if place.is_dir() and _same(place, record):
            return False
        with folder_whole(place) as folder:
            for table, columns in TABLES.items():
                _write(file_of(folder, table), columns, record, table)
        return True
    except OSError as error:
        if place.is_dir() and _same(place, record):
            return False
        raise AnnulusError(f"{root}: cannot be written to ({error.strerror or error})") from None


def _same(place: Path, record: SurveyRecord) -> bool:
    """Whether the survey of this name is this one; False: it is damaged, and now out of the way."""
    try:
        found = read_back(place)
    except ValueError:
        with contextlib.suppress(FileNotFoundError):  # another was quicker
            place.rename(place.with_name(f".damaged-{place.name}-{secrets.token_hex(4)}"))
        return False
    if found.row["digest"] != record.row["digest"]:
        raise AnnulusError(f"{place}: another survey has the same {len(record.survey)} digits, expected its own")
    return True


@contextlib.contextmanager
def folder_whole(place: Path) -> Iterator[Path]:
    """A folder to be filled, which is `place` when the block ends well and is on the disk; else nothing is left.
    OSError where there is such a folder already."""
    staging = place.with_name(f".new-{os.getpid()}-{secrets.token_hex(8)}")
    staging.mkdir()
    try:
        yield staging
        for one in (*staging.iterdir(), staging):
            _to_disk(one)
        staging.rename(place)
        _to_disk(place.parent)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def sweep(root: Path) -> None:
    """Takes away what adders that died have begun."""
    for folder in (root / SURVEYS, root / PACKS):
        for name in _names(folder):
            if name.startswith((".new-", ".gone-")):
                with contextlib.suppress(OSError):
                    if time.time() - (folder / name).stat().st_mtime > LEFT_S:
                        shutil.rmtree(folder / name, ignore_errors=True)


def read_back(folder: Path) -> SurveyRecord:
    """A survey as its own files have it. ValueError, one line, where they are damaged or are not those that were
    added."""
    pq, arrow = need("pyarrow.parquet"), need("pyarrow")
    rows: dict[str, Any] = {}
    for table, columns in TABLES.items():
        path = file_of(folder, table)
        try:
            file = pq.ParquetFile(path)
            if file.metadata.num_rows > (STATIONS_MAX if table == "stations" else PLACES_MAX):
                raise ValueError(f"{file.metadata.num_rows} rows")
            rows[table] = file.read([one.name for one in columns], use_threads=False)
        except (OSError, ValueError, KeyError, arrow.ArrowException) as error:
            raise ValueError(f"{path}: {_why(error)}") from None
    try:
        (row,) = rows["surveys"].to_pylist()
        stations = {
            one.name: rows["stations"][one.name].to_numpy().astype(np.float64)
            for one in TABLES["stations"]
            if one.kind == "number"
        }
        places = {name: [_own(one) for one in rows[name].to_pylist()] for name in ("defects", "features")}
        same = digest(row, stations, places["defects"], places["features"]) == row["digest"]
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{folder}: {_why(error)}") from None
    if not same or not str(row["digest"]).startswith(folder.name):
        raise ValueError(f"{folder}: its contents are not those that were added")
    return SurveyRecord(row, stations, places["defects"], places["features"])


def _own(row: dict[str, Any]) -> dict[str, Any]:
    own = {name: value for name, value in row.items() if name not in ("survey", "pipe", "date")}
    if own.get("measures") is not None:
        own["measures"] = dict(own["measures"])
    return own


def _write(path: Path, columns: Sequence[CatalogueColumn], record: SurveyRecord, table: str) -> None:
    pa, pq = need("pyarrow"), need("pyarrow.parquet")
    kinds = {
        "text": pa.string(),
        "number": pa.float64(),
        "whole": pa.int64(),
        "yes": pa.bool_(),
        "date": pa.date32(),
        "time": pa.timestamp("us"),
        "measures": pa.map_(pa.string(), pa.float64()),
    }
    key = record.key
    if table == "stations":
        count = len(record.stations["z_mm"])
        arrays = [
            pa.repeat(pa.scalar(key[one.name], kinds[one.kind]), count)
            if one.name in key
            else pa.array(record.stations[one.name], kinds[one.kind], mask=np.isnan(record.stations[one.name]))  # NULL
            for one in columns
        ]
    else:
        rows: Sequence[Row] = {"surveys": [record.row], "defects": record.defects, "features": record.features}[table]
        whole = [{**row, **key} for row in rows]
        arrays = [pa.array([_arrow(row[one.name], one) for row in whole], kinds[one.kind]) for one in columns]
    texts = [one.name for one in columns if one.kind == "text"]
    schema = pa.schema([pa.field(one.name, kinds[one.kind]) for one in columns])
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path, compression="zstd", use_dictionary=texts)


def _arrow(value: Any, column: CatalogueColumn) -> Any:
    return list(value.items()) if column.kind == "measures" else value


def _to_disk(path: Path) -> None:
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be read ({error.strerror})") from None


def _why(error: Exception) -> str:
    why = error.strerror if isinstance(error, OSError) and error.strerror else one_line(str(error))
    return why or type(error).__name__
