"""Where scans and results lie: a path of this machine, or a URL of a store.

    place = StoragePath("s3://results/season")            # or a folder
    place.write("ranges/0007.parquet", content)     # appears whole or not at all
    place.names("ranges/"), place.read("ranges/0007.parquet"), place.remove("ranges/0007.parquet")

Local files stay pathlib.Path and are opened as ever; a URL is a `remote.Url`, which has of a Path what is used here.
Both are plain values: a worker that is handed one opens the file itself.
"""

import contextlib
import errno
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, TypeAlias, cast

from annulus_pipe import untrusted
from annulus_pipe.storage.remote import (
    StoreEntry,
    Url,
    found_below,
    listed,
    read_remote,
    remote_file,
    remove_remote,
    stat_remote,
    write_remote,
)
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.vocabulary import AnnulusError

Where: TypeAlias = Path | Url

RESULT_MAX = 1 << 32  # bytes of a file that is read whole
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
_FILE = "file://"


def where(place: "Path | str | Url") -> Where:
    """A path, or what a URL names. Raises AnnulusError for a URL of a kind that is not known."""
    if not isinstance(place, str):
        return place
    if place.startswith(_FILE):
        path = place[len(_FILE) :]
        if not path.startswith("/"):
            raise AnnulusError(f"{place}: names a host. Expected {_FILE}/ and a path of this machine.")
        return Path(path)
    return Url(place) if _SCHEME.match(place) else Path(place)


def read_whole(place: Where, limit: int) -> bytes:
    """All bytes of a file, at most `limit`. ValueError for a larger one, or what is no file; OSError as it comes."""
    return untrusted.read_file(place, limit) if isinstance(place, Path) else read_remote(place, limit)


def is_file(place: Where) -> bool:
    if isinstance(place, Path):
        return place.is_file()
    try:
        stat_remote(place)
    except (FileNotFoundError, IsADirectoryError):
        return False
    return True


def opened_file(place: Where, known: StoreEntry | None = None) -> IO[bytes]:
    """For reading; `known`: what a store said of it when somebody opened it. OSError as it comes, and for what is no
    file: a pipe would keep us waiting for ever."""
    if not isinstance(place, Path):
        return cast(IO[bytes], remote_file(place, known))
    file = open(place, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))  # noqa: SIM115 given out
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "not a file", str(place))
    return file


@dataclass(frozen=True)
class StoragePath:
    """A folder that results are written to, here or in a store. Raises AnnulusError, one line, and nothing else."""

    place: "Path | str | Url"
    _where: Where = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_where", where(self.place))

    def __str__(self) -> str:
        return str(self._where)

    @property
    def local(self) -> Path | None:
        """The folder where it is one of this machine's."""
        return self._where if isinstance(self._where, Path) else None

    def __truediv__(self, name: str) -> "StoragePath":
        """A folder in it."""
        return StoragePath(self._of(name))

    def read(self, name: str) -> bytes | None:
        """A file's content; None where there is no such file."""
        file = self._of(name)
        with _errors_named(file, "read"):
            try:
                return read_whole(file, RESULT_MAX)
            except FileNotFoundError:
                return None

    def write(self, name: str, content: bytes) -> None:
        """A file that appears whole or not at all, in place of one that was there."""
        file = self._of(name)
        with _errors_named(file, "written"):
            if isinstance(file, Url):
                write_remote(file, content)
                return
            file.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(file) as out:
                out.write(content)

    def write_folder(self, folder: Path, *, last: str, leave_out: str = "") -> None:
        """All files of a folder of this machine, those named `last` after the others, so that whoever finds one finds
        what it speaks of too. leave_out : a folder in it."""
        files = [file for file in folder.rglob("*") if file.is_file()]
        for file in sorted(files, key=lambda file: (file.name == last, file)):
            name = file.relative_to(folder).as_posix()
            if not (leave_out and name.startswith(f"{leave_out}/")):
                self.write(name, file.read_bytes())

    def names(self, prefix: str = "") -> list[str]:
        """Names of its files, also of those in folders ("ranges/0007.parquet"), that begin so; sorted."""
        within = prefix.rpartition("/")[0]
        folder = self._of(within) if within else self._where
        before = f"{within}/" if within else ""
        with _errors_named(folder, "listed"):
            if isinstance(folder, Url):
                found = [before + name for name in found_below(folder)]
            else:
                files = (Path(top) / name for top, _, names in os.walk(folder) for name in names)
                found = [before + file.relative_to(folder).as_posix() for file in files]
        return sorted(name for name in found if name.startswith(prefix) and not _is_unfinished(name))

    def remove(self, name: str) -> None:
        """What is not there is removed."""
        file = self._of(name)
        with _errors_named(file, "removed"):
            if isinstance(file, Url):
                remove_remote(file)
            else:
                file.unlink(missing_ok=True)

    def _of(self, name: str) -> Where:
        parts = PurePosixPath(name)
        if not name or parts.is_absolute() or ".." in parts.parts or "\\" in name or "\0" in name:
            raise AnnulusError(f"{self}: {untrusted.shown(name)} names no file in it.")
        return self._where / name


@contextlib.contextmanager
def writer(place: "StoragePath | Path | str | Url", name: str) -> Iterator[IO[bytes]]:
    """A file to be written and sought in, which is `name` in the place when the block ends well; else nothing changes.

    What goes to a store waits in a file of this machine (TMPDIR), and is read from there as it is put.
    """
    target = place if isinstance(place, StoragePath) else StoragePath(place)
    file = target._of(name)
    if isinstance(file, Path):
        with _errors_named(file, "written"):
            file.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(file) as out:
                yield out
        return
    with _errors_named(file, "written"), tempfile.NamedTemporaryFile(prefix="annulus-") as spool:
        yield spool
        spool.flush()
        write_remote(file, Path(spool.name))


def _is_unfinished(name: str) -> bool:
    last = name.rpartition("/")[2]
    return last.endswith(".part")


@contextlib.contextmanager
def _errors_named(file: Where, what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise AnnulusError(f"{file}: cannot be {what} ({error.strerror or error}).") from None
    except ValueError as error:
        raise AnnulusError(f"{file}: cannot be {what}: {error}.") from None


__all__ = [
    "StoragePath",
    "StoreEntry",
    "Url",
    "Where",
    "is_file",
    "listed",
    "opened_file",
    "read_whole",
    "where",
    "writer",
]
