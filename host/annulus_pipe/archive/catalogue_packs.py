"""Packs: the rows of many surveys in one file a table, so that a question opens a few files and not thousands.

Each is made of the surveys that are in none yet and of all smaller packs, so that a row is written again only when the
pack it is in has doubled: adding stays cheap, and there are never many. What a new pack has taken in stays for an hour,
for those who are reading it. Rows stand by date: most questions are of the newest seasons.
"""

import contextlib
import fcntl
import hashlib
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from annulus_pipe.archive.catalogue_columns import TABLES
from annulus_pipe.archive.catalogue_pieces import Pack, Pieces, broken, find, quoted, session
from annulus_pipe.archive.catalogue_store import LEFT_S, PACKS, file_of, folder_whole, pack_folders
from annulus_pipe.archive.catalogue_survey import ID_DIGITS
from annulus_pipe.extras import need

PACK_AT = 64  # surveys in no pack; read alone each costs 2 ms
LOT = 500  # surveys packed at once; DuckDB keeps what it knows of every file it reads
ROWS_OF_GROUP = 61_440  # what DuckDB reads, or passes over, at once: 30 surveys of 10 m


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
