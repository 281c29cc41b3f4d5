"""Files in a store that others keep (S3, Google Cloud Storage, SFTP), by fsspec: asked for in ranges, answers checked.

    file = RemoteFile(url, known=told(url))
    file.seek(4096)
    file.read(100)                      # one request; `plan` says which bytes will be wanted, and joins neighbours

A store may fail, be slow, stop in the middle of an answer, or be handed another object of that name meanwhile. Every
request has a bound in time and is asked again a few times, later each time; what is still not there then is one line.
Nothing here is believed for its length: an answer of other than the bytes asked for is no answer. Where a store can,
it is asked for the object as it was when it was opened (ETag); else that is looked at when a process opens it.

Who may read is between the store's own package and the environment (AWS_*, GOOGLE_APPLICATION_CREDENTIALS, ~/.ssh); a
password in a URL is never shown.
"""

import contextlib
import errno
import random
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from io import SEEK_CUR, SEEK_END, SEEK_SET
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from annulus_pipe.extras import need
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

PACKAGES = {"s3": "s3fs", "s3a": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "sftp": "paramiko", "ssh": "paramiko"}
"""By a URL's scheme, what knows it."""

JOINED_MAX = 16 << 20  # bytes of one request: at 1 Gbit/s 0.13 s, against 0.02 to 0.1 s until the first comes
GAP_SHARE = 20  # neighbours are joined where what lies between is at most this part of them: 1/20 too much is read
FILES_MAX = 8  # opened files that a thread keeps ..
ANSWERS_MAX = 4  # .. each with as many answers ..
HELD_MAX = 2 * JOINED_MAX  # .. or bytes of them

_Answer = TypeVar("_Answer")


@dataclass(frozen=True, slots=True)
class Patience:
    """How long a store is waited for. Guarded by tests/unit/storage/test_remote.py."""

    attempts: int = 6
    answer_s: float = 20.0  # for an answer to begin and be whole ..
    slowest: float = 250e3  # .. and for its length, bytes/s
    wait_s: float = 0.2  # after the first attempt; twice as long after each
    connect_s: float = 10.0


PATIENCE = Patience()


class UnreachableError(AnnulusError):
    """A store did not give what it has, whatever that is: nothing is known of the file."""


class ChangedError(AnnulusError):
    """A file is not what it was when it was opened."""


@dataclass(frozen=True, slots=True)
class StoreEntry:
    """What a store says of a file: its bytes, and a word that changes with its content; empty where it has none."""

    size: int
    tag: str


@dataclass(frozen=True, slots=True)
class Url:
    """A file or folder in a store. Has what a recording asks of a pathlib.Path, and is written without its password."""

    text: str = ""

    def __post_init__(self) -> None:
        parts = urlsplit(self.text)
        if parts.scheme not in PACKAGES or not parts.netloc or "::" in self.text:
            raise AnnulusError(f"{self}: not a place. Expected a path, or a URL: file, {', '.join(PACKAGES)}.")

    def __str__(self) -> str:
        scheme, _, rest = self.text.partition("://")
        who, at, where = rest.partition("/")[0].rpartition("@")
        return f"{scheme}://{who.partition(':')[0]}{at}{where}{rest[len(who + at + where) :]}" if at else self.text

    def __repr__(self) -> str:
        return f"Url({str(self)!r})"

    @property
    def scheme(self) -> str:
        return self.text.partition("://")[0]

    @property
    def name(self) -> str:
        return self.text.rstrip("/").partition("://")[2].rpartition("/")[2]

    @property
    def stem(self) -> str:
        stem, dot, _ = self.name.rpartition(".")
        return stem if dot and stem else self.name

    @property
    def suffix(self) -> str:
        return self.name[len(self.stem) :]

    @property
    def parent(self) -> "Url":
        scheme, _, rest = self.text.rstrip("/").partition("://")
        folder = rest.rpartition("/")[0]
        return Url(f"{scheme}://{folder}") if folder else self

    def resolve(self) -> "Url":
        return self

    def with_name(self, name: str) -> "Url":
        return self.parent / name

    def __truediv__(self, name: object) -> "Url":
        return Url(f"{self.text.rstrip('/')}/{name}")


def stat_remote(url: Url) -> StoreEntry:
    """What the store says of a file now. FileNotFoundError, PermissionError; AnnulusError where it does not answer."""
    return _parsed(_asked(url, "info", lambda store, path: _in_time(store, store.info, path)), url)


def _parsed(info: Any, url: Url) -> StoreEntry:
    if info.get("type") == "directory":
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(url))
    tag = next(
        (info[key] for key in ("ETag", "etag", "generation", "md5Hash", "mtime", "LastModified") if info.get(key)), ""
    )
    if isinstance(tag, datetime):
        tag = tag.isoformat()
    return StoreEntry(int(info["size"] or 0), str(tag))


def listed(folder: Url, prefix: str = "") -> dict[str, StoreEntry]:
    """The files of a folder (not of those in it) whose names begin so, by name. Empty where there is none."""

    def ask(store: Any, path: str) -> Any:
        if prefix and folder.scheme in ("s3", "s3a"):  # a bucket's folder may have a season's scans
            from fsspec.asyn import sync

            return sync(store.loop, store._lsdir, path, prefix=prefix, timeout=_bound_s(0))
        return _in_time(store, store.ls, path, detail=True)

    try:
        found = _asked(folder, "list", ask)
    except FileNotFoundError:
        return {}
    out = {}
    for info in found:
        name = str(info["name"]).rstrip("/").rpartition("/")[2]
        if info.get("type") != "directory" and name.startswith(prefix):
            out[name] = _parsed(info, folder)
    return out


def found_below(folder: Url) -> list[str]:
    """Names of all files in a folder and its folders, with slashes, sorted."""
    try:
        found = _asked(folder, "list", lambda store, path: (path, _in_time(store, store.find, path, pages=1000)))
    except FileNotFoundError:
        return []
    path, names = found
    begin = path.rstrip("/") + "/"
    return sorted(name[len(begin) :] for name in names if name.startswith(begin))


def read_remote(url: Url, limit: int) -> bytes:
    """All bytes of a file. ValueError where there are more than `limit`; else as `stat_remote` raises."""
    known = stat_remote(url)
    if known.size > limit:
        raise ValueError(f"larger than {limit >> 20} MiB" if limit >> 20 else f"larger than {limit >> 10} KiB")
    return fetched(url, 0, known.size, known)


def write_remote(url: Url, content: "bytes | Path") -> None:
    """A file that appears whole or not at all, in place of what was there; a Path: of what is in that file.

    Raises as `stat_remote` does.
    """

    def put(store: Any, path: str) -> None:
        if url.scheme not in ("sftp", "ssh"):
            _put(store, path, content)  # one object, by one request or joined at its end
            return
        beside = f"{path}.{random.randrange(1 << 40):010x}.part"
        try:
            store.makedirs(path.rpartition("/")[0], exist_ok=True)
            _put(store, beside, content)
            store.ftp.posix_rename(beside, path)
        except BaseException:
            with contextlib.suppress(Exception):
                store.rm_file(beside)
            raise

    _asked(url, "write", put)


def _put(store: Any, path: str, content: "bytes | Path") -> None:
    if isinstance(content, bytes):
        _in_time(store, store.pipe_file, path, content, length=len(content))
    else:
        _in_time(store, store.put_file, str(content), path, length=content.stat().st_size)


def remove_remote(url: Url) -> None:
    """What is not there is removed."""
    with contextlib.suppress(FileNotFoundError):
        _asked(url, "remove", lambda store, path: _in_time(store, store.rm_file, path))


def fetched(url: Url, start: int, end: int, known: StoreEntry) -> bytes:
    """Bytes of a file that was `known` so. ChangedError where it is not that any more."""
    if end <= start:
        return b""

    def ask(store: Any, path: str) -> bytes:
        data: bytes = _ranged(store, url, path, start, end, known.tag)
        if len(data) != end - start:
            raise OSError(errno.EIO, f"{len(data)} bytes came of {end - start}")
        return data

    return _asked(url, "read", ask)


def _ranged(store: Any, url: Url, path: str, start: int, end: int, tag: str) -> Any:
    if url.scheme not in ("s3", "s3a"):
        return _in_time(store, store.cat_file, path, start=start, end=end, length=end - start)
    from fsspec.asyn import sync

    bucket, key, _ = store.split_path(path)

    async def get() -> Any:
        match = {"IfMatch": tag} if tag else {}
        answer = await store._call_s3("get_object", Bucket=bucket, Key=key, Range=f"bytes={start}-{end - 1}", **match)
        try:
            return await answer["Body"].read()
        finally:
            answer["Body"].close()

    return sync(store.loop, get, timeout=_bound_s(end - start))


def _in_time(store: Any, ask: Callable[..., Any], *args: Any, length: int = 0, pages: int = 1, **more: Any) -> Any:
    """What a store answers within the bound for so many bytes, or pages of a list."""
    if getattr(store, "async_impl", False):
        more["timeout"] = _bound_s(length) + (pages - 1)
    return ask(*args, **more)


def _bound_s(length: int) -> float:
    return PATIENCE.answer_s + length / PATIENCE.slowest


def _store(url: Url) -> tuple[Any, str]:
    """fsspec's own for a URL, which it keeps, and the path there."""
    need(PACKAGES[url.scheme])
    fsspec = need("fsspec")
    options: dict[str, Any] = {"use_listings_cache": False}
    if url.scheme in ("s3", "s3a"):
        options["config_kwargs"] = {
            "connect_timeout": PATIENCE.connect_s,
            "read_timeout": PATIENCE.answer_s,
            "retries": {"total_max_attempts": 1, "mode": "standard"},
        }
    elif url.scheme in ("sftp", "ssh"):
        parts = urlsplit(url.text)
        login = {"username": parts.username, "password": parts.password, "port": parts.port}
        options = {key: value for key, value in login.items() if value is not None}
        options |= {"host": parts.hostname, "timeout": PATIENCE.connect_s}
    store = fsspec.filesystem(url.scheme, **options)
    if url.scheme in ("s3", "s3a"):
        store.retries = 1  # asked again here, and nowhere else
    elif url.scheme in ("sftp", "ssh"):
        store.ftp.get_channel().settimeout(PATIENCE.answer_s)
        return store, urlsplit(url.text).path
    return store, store._strip_protocol(url.text)


def _asked(url: Url, what: str, ask: Callable[[Any, str], _Answer]) -> _Answer:
    """What a store answers. FileNotFoundError and PermissionError as they are, with a word; else AnnulusError."""
    begun, wait_s = time.monotonic(), PATIENCE.wait_s
    for attempt in range(PATIENCE.attempts):
        if attempt:
            time.sleep(wait_s * random.uniform(0.5, 1.5))  # many workers do not come back at once
            wait_s *= 2
        try:
            store, path = _store(url)
            return ask(store, path)
        except AnnulusError:
            raise
        except FileNotFoundError as error:
            gone = "no such bucket" if "bucket" in str(error).lower() else "no such file there"
            raise FileNotFoundError(errno.ENOENT, gone, str(url)) from None
        except PermissionError as error:
            why = f"no permission: {_short(error, url)}"
            raise PermissionError(errno.EACCES, why, str(url)) from None
        except IsADirectoryError:
            raise
        except Exception as error:  # of a dozen packages, few of them OSError
            last = error
            if isinstance(error, OSError) and error.errno == errno.EINVAL:  # 412, 416
                raise ChangedError(f"{url}: is not what it was when it was opened. Open it again.") from None
            if isinstance(error, TypeError | AttributeError | NotImplementedError | KeyError | IndexError):
                raise
            if _is_for_ever(error):
                raise PermissionError(errno.EACCES, f"no permission: {_short(error, url)}", str(url)) from None
            _forget(url, error)
    raise UnreachableError(
        f"{url}: {what} failed {PATIENCE.attempts} times in {time.monotonic() - begun:.0f} s, the last time with "
        f"{type(last).__name__}: {_short(last, url)}"
    ) from None


_FOR_EVER = {
    "NoCredentialsError",
    "PartialCredentialsError",
    "ProfileNotFound",
    "ParamValidationError",
    "NoRegionError",
    "InvalidEndpointURLError",
    "TokenRetrievalError",
    "UnauthorizedSSOTokenError",
    "AuthenticationException",
    "BadHostKeyException",
    "PasswordRequiredException",
    "DefaultCredentialsError",
    "RefreshError",
}


def _is_for_ever(error: Exception) -> bool:
    """Whether asking again is of no use, of what is no PermissionError by its class."""
    code = getattr(error, "code", None)
    named = {one.__name__ for one in type(error).__mro__}
    return bool(named & _FOR_EVER) or code in (400, 401, 403) or "known_hosts" in str(error)


def _short(error: BaseException, url: Url) -> str:
    text = one_line(str(error)) or type(error).__name__
    try:
        secret = urlsplit(url.text).password
    except ValueError:
        secret = None
    return text.replace(secret, "..") if secret else text


def _forget(url: Url, error: Exception) -> None:
    """A line to a host that broke is made anew."""
    if url.scheme in ("sftp", "ssh"):
        with contextlib.suppress(Exception):
            need("fsspec").get_filesystem_class(url.scheme).clear_instance_cache()


class RemoteFile:
    """A file in a store, for reading, with what a binary file has that a recording's readers use.

    Holds its last few answers. What is asked for is fetched as it is asked for, unless `plan` was told more, or `ahead`
    bytes are to be fetched at least: of a walk, which looks at little pieces one behind the other.
    """

    def __init__(self, url: Url, known: StoreEntry | None = None, ahead: int = 0) -> None:
        """`known`: what it was when somebody opened it. Raises as `stat_remote`, ChangedError where it is
        that no more."""
        if known is None or not known.tag or url.scheme not in ("s3", "s3a"):
            now = stat_remote(url)
            if known is not None and now != known:
                raise ChangedError(f"{url}: is not what it was when it was opened. Open it again.")
            known = now
        self.url, self.known, self.ahead = url, known, ahead
        self._at = 0
        self._held: list[tuple[int, bytes]] = []  # from where on, the last one last
        self._planned: list[tuple[int, int]] = []

    @property
    def size(self) -> int:
        return self.known.size

    def plan(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Which bytes, from and to, will be asked for; each is fetched once, neighbours in one request."""
        self._planned = joined(ranges)

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        self._at = {SEEK_SET: 0, SEEK_CUR: self._at, SEEK_END: self.size}[whence] + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, length: int = -1) -> bytes:
        end = self.size if length < 0 else min(self.size, self._at + length)
        start = self._at
        if start >= end:
            return b""
        self._at = end
        for begin, data in reversed(self._held):
            if begin <= start and end <= begin + len(data):
                return data[start - begin : end - begin]
        return self._fetched(start, end)[: end - start]

    def _fetched(self, start: int, end: int) -> bytes:
        last = max(end, min(self.size, start + self.ahead))
        for begin, stop in self._planned:
            if begin <= start < stop:
                last = max(last, stop)
        kept = b""
        for begin, data in reversed(self._held):
            if begin <= start < begin + len(data):  # its beginning is here
                kept = data[start - begin :]
                break
        data = kept + fetched(self.url, start + len(kept), last, self.known)
        self._held.append((start, data))
        while len(self._held) > ANSWERS_MAX or (
            len(self._held) > 1 and sum(len(one) for _, one in self._held) > HELD_MAX
        ):
            del self._held[0]
        return data

    def __enter__(self) -> "RemoteFile":
        return self

    def __exit__(self, *error: object) -> None:
        """It stays open: what it holds may be asked for again."""


def joined(ranges: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Neighbours in one, up to JOINED_MAX bytes, where little lies between."""
    out: list[tuple[int, int]] = []
    needed = 0
    for start, end in sorted(set(ranges)):
        if out:
            first, last = out[-1]
            between = max(0, start - last)
            more = max(0, end - max(start, last))
            if between * GAP_SHARE <= needed + more and end - first <= JOINED_MAX:
                out[-1] = first, max(last, end)
                needed += more
                continue
        out.append((start, end))
        needed = end - start
    return out


class _Kept(threading.local):
    def __init__(self) -> None:
        self.files: OrderedDict[tuple[Url, StoreEntry | None], RemoteFile] = OrderedDict()


_KEPT = _Kept()


def remote_file(url: Url, known: StoreEntry | None) -> RemoteFile:
    """An opened file, kept by this thread: the next one who asks has it with what it holds."""
    files = _KEPT.files
    key = url, known
    if key not in files:
        files[key] = RemoteFile(url, known)
        while len(files) > FILES_MAX:
            files.popitem(last=False)
    files.move_to_end(key)
    return files[key]
