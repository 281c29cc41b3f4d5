"""Which files of a catalogue say what: packs that do not overlap, and the surveys that are in none of them.

Everything is looked at before it is used, by its ends at first; a file that breaks when it is read is left out the next
time (`without`). A damaged pack costs nothing, its surveys' own files say the same. A damaged file of a survey costs
that survey's rows of that table, and is told.

A pack has the rows of many surveys in one file a table, so that a question opens a few files and not thousands. Each
is made (`pack`) of the surveys that are in none yet and of all smaller packs, so that a row is written again only when
the pack it is in has doubled: adding stays cheap, and there are never many. What a new pack has taken in stays for an
hour, for those who are reading it. Rows stand by date: most questions are of the newest seasons.
"""

import contextlib
import fcntl
import hashlib
import os
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from annulus_pipe.archive.catalogue.columns import TABLES, CatalogueColumn
from annulus_pipe.archive.catalogue.store import (
    LEFT_S,
    PACKS,
    file_of,
    folder_whole,
    pack_folders,
    survey_folder,
    survey_ids,
    why_cut,
)
from annulus_pipe.archive.catalogue.survey import ID_DIGITS
from annulus_pipe.extras import need
from annulus_pipe.untrusted import one_line

MEMORY_MB = 1024
PACK_AT = 64  # surveys in no pack; read alone each costs 2 ms
LOT = 500  # surveys packed at once; DuckDB keeps what it knows of every file it reads
ROWS_OF_GROUP = 61_440  # what DuckDB reads, or passes over, at once: 30 surveys of 10 m
_SQL_OF = {
    "text": "VARCHAR",
    "number": "DOUBLE",
    "whole": "BIGINT",
    "yes": "BOOLEAN",
    "date": "DATE",
    "time": "TIMESTAMP",
    "measures": "MAP(VARCHAR, DOUBLE)",
}


@dataclass(frozen=True, slots=True)
class Pack:
    """members: surveys that are in it and still have a folder; gone: those that have none any more."""

    folder: Path
    members: frozenset[str]
    gone: frozenset[str]


@dataclass(frozen=True, slots=True)
class DamagedFile:
    """A file that is not whole. lost: whether rows are missing, for no other file has them."""

    path: Path
    why: str
    lost: bool


@dataclass(frozen=True, slots=True)
class Pieces:
    """loose: surveys read from their own folders, whose row of the table surveys can be read."""

    root: Path
    packs: Sequence[Pack]
    loose: Sequence[str]
    damage: Sequence[DamagedFile]
    left_out: frozenset[Path] = field(default_factory=frozenset)

    def files(self, table: str) -> list[Path]:
        """Of the table, all that are whole."""
        own = (file_of(survey_folder(self.root, one), table) for one in self.loose)
        packed = (file_of(pack.folder, table) for pack in self.packs)
        return [*packed, *(path for path in own if path not in self.left_out)]

    def relation(self, table: str, without: Iterable[str] = ()) -> str:
        """SQL of the table's rows, less those of the surveys `without`. Only packs that have some of these are
        filtered; their own files are not named at all."""
        gone = frozenset(without)
        whole, mixed = list[Path](), list[Path]()
        for pack in self.packs:
            (mixed if pack.gone or pack.members & gone else whole).append(file_of(pack.folder, table))
        own = (file_of(survey_folder(self.root, one), table) for one in self.loose if one not in gone)
        whole += [path for path in own if path not in self.left_out]
        names = ", ".join(one.name for one in TABLES[table])
        parts = [f"SELECT {names} FROM {reading(whole)}"] if whole else []
        if mixed:
            out = sorted(gone.union(*(pack.gone for pack in self.packs)))
            parts.append(f"SELECT {names} FROM {reading(mixed)} WHERE survey NOT IN ({', '.join(map(quoted, out))})")
        return " UNION ALL ".join(parts) or nothing(TABLES[table])


def session(memory_mb: int = MEMORY_MB) -> Any:
    """DuckDB in memory: it loads nothing, looks nothing up, and spills nowhere."""
    duckdb = need("duckdb")
    return duckdb.connect(
        ":memory:",
        config={
            "memory_limit": f"{memory_mb}MB",
            "temp_directory": "",
            "autoinstall_known_extensions": "false",
            "autoload_known_extensions": "false",
            "allow_community_extensions": "false",
            "allow_persistent_secrets": "false",
            "python_enable_replacements": "false",
            "preserve_insertion_order": "true",
        },
    )


def find(connection: Any, root: Path, without: frozenset[Path] = frozenset()) -> Pieces:
    """What there is, each survey once. without: files that broke before."""
    ids = frozenset(survey_ids(root))
    damage: list[DamagedFile] = []
    packs: list[Pack] = []
    covered: set[str] = set()
    for count, folder in pack_folders(root):
        if packs and count > len(ids) - len(covered):
            continue  # what a larger one has taken in
        found = _pack(connection, folder, count, ids, without, damage)
        if found is not None and found.members and not found.members & covered:
            packs.append(found)
            covered |= found.members
    loose, left_out = [], set(without)
    for survey in sorted(ids - covered):
        rows_lost = False
        for table in TABLES:
            path = file_of(survey_folder(root, survey), table)
            why = "cannot be read" if path in without else why_cut(path)
            if why is not None:
                damage.append(DamagedFile(path, why, lost=True))
                left_out.add(path)
                rows_lost |= table == "surveys"
        if not rows_lost:
            loose.append(survey)
    return Pieces(root, packs, loose, damage, frozenset(left_out))


def _pack(
    connection: Any, folder: Path, count: int, ids: frozenset[str], without: frozenset[Path], damage: list[DamagedFile]
) -> Pack | None:
    for table in TABLES:
        path = file_of(folder, table)
        why = "cannot be read" if path in without else why_cut(path)
        if why is not None:
            damage.append(DamagedFile(path, why, lost=False))
            return None
    path = file_of(folder, "surveys")
    try:
        found = connection.execute(f"SELECT survey FROM {reading([path])}").fetchall()
    except need("duckdb").Error as error:
        damage.append(DamagedFile(path, one_line(str(error).partition("\n")[0]), lost=False))
        return None
    surveys = frozenset(str(row[0]) for row in found)
    if len(surveys) != count or len(found) != count:
        damage.append(DamagedFile(path, f"has {len(surveys)} surveys, expected {count}", lost=False))
        return None
    return Pack(folder, surveys & ids, surveys - ids)


def broken(connection: Any, pieces: Pieces, tables: Iterable[str] = TABLES) -> dict[Path, str]:
    """Every file that cannot be read to its end, and why: reads all of them."""
    found = {}
    for table in tables:
        wanted = ", ".join(f"max({one.name}::VARCHAR)" for one in TABLES[table])
        for path in pieces.files(table):
            try:
                connection.execute(f"SELECT {wanted} FROM {reading([path])}").fetchall()
            except need("duckdb").Error as error:
                found[path] = one_line(str(error).partition("\n")[0])
    return found


def reading(paths: Sequence[Path]) -> str:
    return f"read_parquet([{', '.join(quoted(str(path)) for path in paths)}])"


def quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def nothing(columns: Sequence[CatalogueColumn]) -> str:
    """SQL of a table without a row."""
    return f"SELECT {', '.join(f'NULL::{_SQL_OF[one.kind]} AS {one.name}' for one in columns)} WHERE false"


def pack(root: Path, at: int = PACK_AT) -> Path | None:
    """Makes a pack if `at` surveys or more are in none, and takes away those nobody reads. None: nothing to do, or
    another is at it, or the folder cannot be written: a pack is a convenience."""
    try:
        (root / PACKS).mkdir(exist_ok=True)
        with _alone(root / PACKS) as first, session() as connection:
            if not first:
                return None
            made = None
            pieces = find(connection, root)
            connection.execute("SET threads = 1")  # several keep whole files in memory to have their rows in order
            while len(pieces.loose) >= at and (one := _make(connection, root, pieces)) is not None:
                made = one
                pieces = find(connection, root)
            _take_away(root, {one.folder for one in pieces.packs})
            return made
    except OSError:
        return None


def _make(connection: Any, root: Path, pieces: Pieces) -> Path | None:
    bad: frozenset[Path] = frozenset()
    for _ in range(2):
        chosen = _chosen(pieces, root)
        if chosen is None:
            return None
        try:
            return _written(connection, root, chosen)
        except need("duckdb").Error:
            bad = frozenset(broken(connection, chosen))
            if not bad:
                return None
            pieces = find(connection, root, bad)
    return None


def _chosen(pieces: Pieces, root: Path) -> Pieces | None:
    """The loose ones that are whole, and the packs they outgrow."""
    hurt = {path.parent.name for path in pieces.left_out}
    loose = [one for one in pieces.loose if one not in hurt][:LOT]
    count, packs = len(loose), list[Pack]()
    for one in reversed(pieces.packs):  # the smallest first
        if len(one.members) > count:
            break
        packs.append(one)
        count += len(one.members)
    return Pieces(root, packs, loose, ()) if loose else None


def _written(connection: Any, root: Path, pieces: Pieces) -> Path:
    surveys = connection.execute(f"SELECT survey FROM ({pieces.relation('surveys')}) ORDER BY date, pipe, survey")
    order = [str(row[0]) for row in surveys.fetchall()]
    own = frozenset(pieces.loose)
    sorted_pieces = Pieces(root, pieces.packs, [one for one in order if one in own], ())
    name = hashlib.sha256("".join(sorted(order)).encode()).hexdigest()[:ID_DIGITS]
    place = root / PACKS / f"{name}-{len(order)}"
    with folder_whole(place) as folder:
        for table in TABLES:
            connection.execute(
                f"COPY ({sorted_pieces.relation(table)}) TO {quoted(str(file_of(folder, table)))} "
                f"(FORMAT parquet, COMPRESSION zstd, ROW_GROUP_SIZE {ROWS_OF_GROUP})"
            )
    return place


def _take_away(root: Path, used: set[Path]) -> None:
    youngest = max((_age_s(one) for one in used), default=0.0, key=lambda age: -age)
    for _, folder in pack_folders(root):
        if folder not in used and youngest > LEFT_S:
            with contextlib.suppress(OSError):
                aside = folder.with_name(f".gone-{secrets.token_hex(8)}")
                folder.rename(aside)
                shutil.rmtree(aside, ignore_errors=True)


def _age_s(path: Path) -> float:
    with contextlib.suppress(OSError):
        return time.time() - path.stat().st_mtime
    return 0.0


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[bool]:
    """Whether nobody else is packing. On a disk that knows no locks all may: two packs of the same are one."""
    opened = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        except OSError:
            pass
        yield True
    finally:
        os.close(opened)
