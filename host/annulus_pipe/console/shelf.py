"""Recordings, scan folders, results and calibrations in some folders: a list that people choose from.

    shelf = Shelf([Path("scans")])
    listing = shelf.look()                  # blocks; looks again only at what has changed
    listing.by_id["3ced0ec47a28d2f58da2"].path

Whoever asks names things by their `id`, never by a path: what is not on the list is not there. Nothing is read whole
but tables, summaries and calibrations, none of them large; links are not followed, and nothing is opened but files.
One look takes a bounded time, and whatever lies there costs nothing but its own place on the list.
"""

import csv
import hashlib
import io
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from annulus_pipe import untrusted
from annulus_pipe.console.glance import glance
from annulus_pipe.job import JobSheet, provenance, read_job
from annulus_pipe.record.parts import grouped
from annulus_pipe.scans.scan import TABLE
from annulus_pipe.storage.numbers import require_cells
from annulus_pipe.vocabulary import AnnulusError

ENTRIES_MAX = 1000
CALIBRATIONS_MAX = 200
DEPTH_MAX = 3  # of folders in folders
SEEN_MAX = 20_000  # names in a folder of the list, and below it ..
COUNTED_MAX = 1_000_000  # .. and that are counted, no more than that: 0.5 s
LOOK_S = 2.0  # for what is new or has changed, in one look; a recording takes 5 ms
SMALL_MAX = 4 << 20  # bytes of a summary or calibration
TABLE_MAX = 16 << 20  # .. of a frames.csv: 300 000 frames
OPEN_S = 15.0  # a recording without an end that changed since is being made
FILES: Mapping[str, str] = {  # of a result, what is given out
    "report.html": "text/html; charset=utf-8",
    "report.pdf": "application/pdf",
    "summary.json": "application/json",
    "stations.csv": "text/csv; charset=utf-8",
    "unwrapped.png": "image/png",
    "texture.png": "image/png",
    "height.png": "image/png",
    "sigma.png": "image/png",
}
DAY_S = 86400.0


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing on the list. `kind`: recording, scan, result or calibration."""

    id: str
    kind: str
    path: Path
    changed_s: float  # Unix time
    details: Mapping[str, Any]  # what else is known, plain

    def to_dict(self) -> dict[str, Any]:
        made = {"name": untrusted.printable(self.path.name), "folder": untrusted.printable(str(self.path.parent))}
        details = dict(self.details)
        utc = details.pop("made_utc", None)
        if utc is not None:
            details["age_days"] = round((time.time() - utc) / DAY_S, 2)
        return {"id": self.id, "kind": self.kind, **made, "changed_s": self.changed_s, **details}


@dataclass(frozen=True, slots=True)
class Listing:
    """Newest first."""

    entries: Sequence[Entry] = ()
    calibrations: Sequence[Entry] = ()
    left_out: int = 0  # at least so many more: entries that were too many, names that were not looked at
    waiting: int = 0  # that there was no time for in this look
    by_id: Mapping[str, Entry] = field(default_factory=dict)

    @property
    def stamp(self) -> str:
        """Another where anything of it is."""
        contents = [(one.id, one.changed_s, sorted(one.details.items(), key=str)) for one in self.by_id.values()]
        return hashlib.sha256(f"{contents} {self.left_out} {self.waiting}".encode("utf-8", "replace")).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class _Thing:
    """What may be one entry. stamp : another when it has changed."""

    kind: str
    path: Path
    stamp: tuple[tuple[str, int, int], ...]  # its files: name, time of change in ns, bytes

    @property
    def changed_ns(self) -> int:
        return max((changed for _, changed, _ in self.stamp), default=0)


class Shelf:
    """What lies in the folders. One thread at a time calls `look`."""

    def __init__(self, folders: Sequence[Path]) -> None:
        self.folders = tuple(folder.absolute() for folder in folders)
        self.listing = Listing()
        self._known: dict[tuple[str, Path], tuple[object, Entry | None]] = {}

    def look(self) -> Listing:
        known, self._known = self._known, {}
        fresh: list[_Thing] = []
        unseen = 0
        for folder in self.folders:
            left = _Left(SEEN_MAX)
            for one in _things(folder, left):
                before = known.get((one.kind, one.path))
                if before is not None:
                    self._known[one.kind, one.path] = before
                if before is None or before[0] != one.stamp or _is_open(before[1]):
                    fresh.append(one)
            unseen += left.unseen
        waiting = self._look_at(fresh)
        found = {entry.id: entry for _, entry in self._known.values() if entry is not None}
        newest = sorted(found.values(), key=lambda one: -one.changed_s)
        entries = [one for one in newest if one.kind != "calibration"]
        calibrations = [one for one in newest if one.kind == "calibration"]
        over = max(0, len(entries) - ENTRIES_MAX) + max(0, len(calibrations) - CALIBRATIONS_MAX)
        kept = entries[:ENTRIES_MAX], calibrations[:CALIBRATIONS_MAX]
        by_id = {one.id: one for some in kept for one in some}
        self.listing = Listing(*kept, over + unseen, waiting, by_id)
        return self.listing

    def _look_at(self, fresh: Sequence[_Thing]) -> int:
        """Newest first, until the time is over; how many are left. What was known of them stays on the list."""
        end = time.monotonic() + LOOK_S
        ordered = sorted(fresh, key=lambda one: -one.changed_ns)
        for number, one in enumerate(ordered):
            if number and time.monotonic() > end:
                return len(ordered) - number
            self._known[one.kind, one.path] = one.stamp, _entry(one)
        return 0


def _is_open(entry: Entry | None) -> bool:
    """Whether it was being recorded: that may end without a change."""
    return entry is not None and entry.details.get("state") == "open"


def _entry(one: _Thing) -> Entry | None:
    try:
        changed_s, details = _TELLS[one.kind](one)
    except Exception:  # whatever a file has in it, it never takes the list of the others from everybody
        return None
    return Entry(identity(one.kind, one.path), one.kind, one.path, changed_s, details)


def identity(kind: str, path: Path) -> str:
    """The same for the same thing, and nothing that a path could be made of."""
    return hashlib.sha256(kind.encode() + b"\0" + os.fsencode(path)).hexdigest()[:20]


@dataclass(slots=True)
class _Left:
    """Names that may be looked at yet, and how many were not."""

    names: int
    unseen: int = 0


def _things(folder: Path, left: _Left, depth: int = 0) -> Iterator[_Thing]:
    """All in a folder and those below."""
    files, folders = _names(folder, left)
    if "summary.json" in files and "report.html" in files:
        yield _Thing("result", folder, _stamp([files["summary.json"], files["report.html"]]))
    if TABLE in files:
        yield _Thing("scan", folder, _stamp([files[TABLE]]))
    for first, later in grouped(files).items():
        stamp = _stamp([files[first], *(files[name] for name in later)])
        yield _Thing("recording", folder / first, stamp)
    for name, one in files.items():
        if name.endswith(".json") and name not in ("summary.json", "centreline.json"):
            yield _Thing("calibration", folder / name, _stamp([one]))
    if depth < DEPTH_MAX and TABLE not in files:
        for name in folders:
            yield from _things(folder / name, left, depth + 1)


def _names(folder: Path, left: _Left) -> "tuple[dict[str, os.DirEntry[str]], list[str]]":
    """Its files and folders. Nothing else has a place on the list: who opens a pipe waits for ever."""
    files: dict[str, os.DirEntry[str]] = {}
    folders: list[str] = []
    try:
        with os.scandir(folder) as scanned:
            for one in scanned:
                if left.names <= 0:
                    left.unseen += 1
                    if left.unseen >= COUNTED_MAX:
                        break
                    continue
                left.names -= 1
                if one.name.startswith("."):
                    continue
                if _is_folder(one):
                    folders.append(one.name)
                elif _is_file(one):
                    files[one.name] = one
    except OSError:
        pass
    return files, folders


def _is_file(one: "os.DirEntry[str]") -> bool:
    try:
        return one.is_file(follow_symlinks=False)
    except OSError:
        return False


def _is_folder(one: "os.DirEntry[str]") -> bool:
    try:
        return one.is_dir(follow_symlinks=False)
    except OSError:
        return False


def _stamp(found: "Sequence[os.DirEntry[str]]") -> tuple[tuple[str, int, int], ...]:
    out = []
    for one in found:
        try:
            status = one.stat(follow_symlinks=False)
            out.append((one.name, status.st_mtime_ns, status.st_size))
        except OSError:
            out.append((one.name, 0, 0))
    return tuple(sorted(out))


def _recording(one: _Thing) -> tuple[float, dict[str, Any]]:
    seen = glance(one.path)
    going_on = not seen.whole and time.time() - seen.changed_s < OPEN_S
    length = None if seen.from_mm is None or seen.to_mm is None else abs(seen.to_mm - seen.from_mm)
    seconds = None if seen.begun is None or seen.ended is None else (seen.ended - seen.begun).total_seconds()
    return seen.changed_s, {
        "utc": None if seen.begun is None else seen.begun.isoformat(timespec="seconds"),
        "seconds": seconds,
        "job": seen.job.to_dict(),
        "from_mm": seen.from_mm,
        "to_mm": seen.to_mm,
        "length_mm": length,
        "frames": seen.frames,
        "size": seen.size,
        "parts": len(seen.files),
        "state": "whole" if seen.whole else "open" if going_on else "torn",
        "calibrated": seen.calibrated,
        "made_utc": _made(seen.provenance),
    }


def _scan(one: _Thing) -> tuple[float, dict[str, Any]]:
    folder = one.path
    ((_, changed_ns, size),) = one.stamp
    frames, places = _rows(folder / TABLE) if size <= TABLE_MAX else (None, [])
    try:
        job = read_job(folder / "job.toml") if (folder / "job.toml").is_file() else JobSheet()
    except AnnulusError:
        job = JobSheet()
    ends = (min(places), max(places)) if places else (None, None)
    own = folder / "calibration.json"
    return changed_ns / 1e9, {
        "utc": None,
        "seconds": None,
        "job": job.to_dict(),
        "from_mm": ends[0],
        "to_mm": ends[1],
        "length_mm": max(places) - min(places) if places else None,
        "frames": frames,
        "size": None,
        "parts": 1,
        "state": "whole",
        "calibrated": own.is_file(),
        "made_utc": _made(provenance(_small(own))) if own.is_file() else None,
    }


def _rows(table: Path) -> tuple[int | None, list[float]]:
    """How many frames a table lists, and where they were; None and nothing where that cannot be read."""
    rows = csv.DictReader(io.StringIO(untrusted.read_file(table, TABLE_MAX).decode("utf-8", "replace"), newline=""))
    frames, places = 0, list[float]()
    try:
        for row in rows:
            require_cells(row, len(set(rows.fieldnames or ())))
            frames += 1
            places += _number(row.get("z_mm") or row.get("x_mm"))
    except (csv.Error, ValueError):  # a field beyond 128 KiB; a row of other cells than the heading's
        return None, []
    return frames, places


def _result(one: _Thing) -> tuple[float, dict[str, Any]]:
    folder = one.path
    summary = _small(folder / "summary.json")
    if not str(summary.get("format", "")).startswith("annulus-"):
        raise ValueError("no summary of annulus")
    origin, diameter, scanned = (_section(summary, name) for name in ("origin", "diameter_mm", "scanned_mm"))
    defects = [item for item in _list(summary, "defects") if isinstance(item, Mapping)]
    depths = [depth for item in defects for depth in _number(item.get("depth_mm"))]
    conformity = _section(summary, "conformity")
    decision = conformity.get("decision")
    begun, created = origin.get("begun_utc"), summary.get("created")
    files = [name for name in FILES if (folder / name).is_file() and not (folder / name).is_symlink()]
    return (folder / "summary.json").stat().st_mtime, {
        "utc": next((time for time in (begun, created) if _is_time(time)), None),
        "created": created if _is_time(created) else None,
        "job": JobSheet.recorded(summary.get("job")).to_dict(),
        "of": untrusted.printable(Path(str(summary.get("source", ""))).name)[:200],
        "from_mm": _one(scanned.get("from")),
        "to_mm": _one(scanned.get("to")),
        "length_mm": _one(scanned.get("length")),
        "defects": len(defects) if "defects" in summary else None,
        "worst_mm": max(depths, default=None),
        "diameter_mm": _one(diameter.get("mean")),
        "k2_mm": _one(diameter.get("k2")),
        "verdict": untrusted.printable(decision)[:60] if isinstance(decision, str) else None,
        "open": sum(isinstance(one, Mapping) and not one.get("usual") for one in _list(conformity, "not_established")),
        "warnings": len(_list(summary, "warnings")),
        "files": files,
        "size": sum((folder / name).stat().st_size for name in files),
        "state": "whole",
    }


def _calibration(one: _Thing) -> tuple[float, dict[str, Any]]:
    path = one.path
    data = _small(path)
    if not str(data.get("format", "")).startswith("annulus-calibration/"):
        raise ValueError("no calibration")
    made = provenance(data)
    radius = _one(_section(data, "pipe").get("radius_mm"))
    return path.stat().st_mtime, {
        "made_utc": _made(made),
        "sections": sorted(made),
        "nominal_diameter_mm": None if radius is None else 2 * radius,
    }


_TELLS: Mapping[str, Callable[[_Thing], tuple[float, dict[str, Any]]]] = {
    "recording": _recording,
    "scan": _scan,
    "result": _result,
    "calibration": _calibration,
}


def _made(sections: Mapping[str, Any]) -> float | None:
    """Unix time of the oldest section that says when it was made."""
    times = []
    for section in sections.values():
        try:
            at = datetime.fromisoformat(str(section.get("utc", ""))) if isinstance(section, Mapping) else None
        except ValueError:
            continue
        if at is not None:
            times.append((at if at.tzinfo is not None else at.replace(tzinfo=UTC)).timestamp())
    return min(times, default=None)


def _small(path: Path) -> Mapping[str, Any]:
    """A JSON file's object. ValueError, OSError where it is none."""
    return untrusted.mapping(untrusted.parse_json(untrusted.read_file(path, SMALL_MAX), SMALL_MAX), path.name)


def _section(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = data.get(name)
    return section if isinstance(section, Mapping) else {}


def _list(data: Mapping[str, Any], name: str) -> Sequence[Any]:
    found = data.get(name)
    return found if isinstance(found, list) else []


def _number(value: object) -> list[float]:
    """None or one."""
    try:
        number = float(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else math.nan
    except ValueError:
        return []
    return [number] if math.isfinite(number) else []


def _one(value: object) -> float | None:
    return next(iter(_number(value)), None)


def _is_time(value: object) -> bool:
    try:
        return isinstance(value, str) and bool(datetime.fromisoformat(value))
    except ValueError:
        return False
