"""Recordings, scan folders, results and calibrations in some folders: a list that people choose from.

    shelf = Shelf([Path("scans")])
    listing = shelf.look()                  # blocks; looks again only at what has changed
    listing.by_id["3ced0ec47a28d2f58da2"].path

Whoever asks names things by their `id`, never by a path: what is not on the list is not there. Nothing is read whole
but tables, summaries and calibrations, none of them large; links are not followed.
"""

import csv
import hashlib
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from annulus import untrusted
from annulus.job import JobSheet, provenance, read_job
from annulus.record.glance import glance
from annulus.record.parts import first_paths
from annulus.record.scan import TABLE
from annulus.vocabulary import AnnulusError

ENTRIES_MAX = 1000
CALIBRATIONS_MAX = 200
DEPTH_MAX = 3  # of folders in folders
SEEN_MAX = 20_000  # names in all folders
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
    told: Mapping[str, Any]  # what else is known, plain

    def to_dict(self) -> dict[str, Any]:
        made = {"name": untrusted.printable(self.path.name), "folder": untrusted.printable(str(self.path.parent))}
        told = dict(self.told)
        utc = told.pop("made_utc", None)
        if utc is not None:
            told["age_days"] = round((time.time() - utc) / DAY_S, 2)
        return {"id": self.id, "kind": self.kind, **made, "changed_s": self.changed_s, **told}


@dataclass(frozen=True, slots=True)
class Listing:
    """Newest first."""

    entries: Sequence[Entry] = ()
    calibrations: Sequence[Entry] = ()
    left_out: int = 0  # that were too many
    by_id: Mapping[str, Entry] = field(default_factory=dict)

    @property
    def stamp(self) -> str:
        """Another where anything of it is."""
        told = [(one.id, one.changed_s, sorted(one.told.items(), key=str)) for one in self.by_id.values()]
        return hashlib.sha256(f"{told} {self.left_out}".encode("utf-8", "replace")).hexdigest()[:16]


class Shelf:
    """What lies in the folders. One thread at a time calls `look`."""

    def __init__(self, folders: Sequence[Path]) -> None:
        self.folders = tuple(folder.absolute() for folder in folders)
        self.listing = Listing()
        self._known: dict[tuple[str, Path], tuple[object, Entry | None]] = {}

    def look(self) -> Listing:
        found: dict[str, Entry] = {}
        left = [SEEN_MAX]
        known, self._known = self._known, {}
        for folder in self.folders:
            for kind, path, stamp in _things(folder, left):
                before = known.get((kind, path))
                if before is None or before[0] != stamp or _is_open(before[1]):
                    before = stamp, _entry(kind, path)
                self._known[kind, path] = before
                if before[1] is not None:
                    found[before[1].id] = before[1]
        newest = sorted(found.values(), key=lambda one: -one.changed_s)
        entries = [one for one in newest if one.kind != "calibration"]
        calibrations = [one for one in newest if one.kind == "calibration"][:CALIBRATIONS_MAX]
        kept = entries[:ENTRIES_MAX]
        by_id = {one.id: one for one in (*kept, *calibrations)}
        self.listing = Listing(kept, calibrations, len(entries) - len(kept), by_id)
        return self.listing


def _is_open(entry: Entry | None) -> bool:
    """Whether it was being recorded: that may end without a change."""
    return entry is not None and entry.told.get("state") == "open"


def _entry(kind: str, path: Path) -> Entry | None:
    try:
        changed_s, told = _TELLS[kind](path)
    except (AnnulusError, OSError, ValueError):
        return None
    return Entry(identity(kind, path), kind, path, changed_s, told)


def identity(kind: str, path: Path) -> str:
    """The same for the same thing, and nothing that a path could be made of."""
    return hashlib.sha256(kind.encode() + b"\0" + os.fsencode(path)).hexdigest()[:20]


def _things(folder: Path, left: list[int], depth: int = 0) -> Iterator[tuple[str, Path, object]]:
    """(kind, path, what changes when it does) of all in a folder and those below. `left`: names that may be looked
    at."""
    names: dict[str, os.DirEntry[str]] = {}
    try:
        with os.scandir(folder) as scanned:
            for one in scanned:
                if left[0] <= 0:
                    break
                left[0] -= 1
                if not one.name.startswith(".") and not one.is_symlink():
                    names[one.name] = one
    except OSError:
        return
    if "summary.json" in names and "report.html" in names:
        yield "result", folder, _stamp([names["summary.json"], names["report.html"]])
    if TABLE in names:
        yield "scan", folder, _stamp([names[TABLE]])
    recordings = [name for name in names if name.endswith(".mcap")]
    for first in first_paths(folder) if recordings else ():
        if first.name in names:
            parts = [names[name] for name in recordings if name.startswith(f"{first.stem}-") or name == first.name]
            yield "recording", first, _stamp(parts)
    for name, one in names.items():
        if name.endswith(".json") and name not in ("summary.json", "centreline.json"):
            yield "calibration", folder / name, _stamp([one])
        elif depth < DEPTH_MAX and TABLE not in names and _is_folder(one):
            yield from _things(folder / name, left, depth + 1)


def _is_folder(one: "os.DirEntry[str]") -> bool:
    try:
        return one.is_dir(follow_symlinks=False)
    except OSError:
        return False


def _stamp(found: "Sequence[os.DirEntry[str]]") -> object:
    out = []
    for one in found:
        try:
            told = one.stat(follow_symlinks=False)
            out.append((one.name, told.st_mtime_ns, told.st_size))
        except OSError:
            out.append((one.name, 0, 0))
    return tuple(sorted(out))


def _recording(path: Path) -> tuple[float, dict[str, Any]]:
    seen = glance(path)
    going_on = not seen.whole and time.time() - seen.changed_s < OPEN_S
    length = None if seen.from_mm is None or seen.to_mm is None else abs(seen.to_mm - seen.from_mm)
    seconds = None if seen.begun is None or seen.ended is None else (seen.ended - seen.begun).total_seconds()
    return seen.changed_s, {
        "utc": None if seen.begun is None else seen.begun.isoformat(timespec="seconds"),
        "seconds": seconds, "job": seen.job.to_dict(), "from_mm": seen.from_mm, "to_mm": seen.to_mm,
        "length_mm": length, "frames": seen.frames, "size": seen.size, "parts": len(seen.files),
        "state": "whole" if seen.whole else "open" if going_on else "torn", "calibrated": seen.calibrated,
        "made_utc": _made(seen.provenance),
    }  # fmt: skip


def _scan(folder: Path) -> tuple[float, dict[str, Any]]:
    table = folder / TABLE
    told = table.stat()
    frames, places = None, []
    if told.st_size <= TABLE_MAX:
        with table.open(newline="", encoding="utf-8", errors="replace") as file:
            rows = csv.DictReader(file)
            frames = 0
            for row in rows:
                frames += 1
                places += _number(row.get("z_mm") or row.get("x_mm"))
    try:
        job = read_job(folder / "job.toml") if (folder / "job.toml").is_file() else JobSheet()
    except AnnulusError:
        job = JobSheet()
    ends = (min(places), max(places)) if places else (None, None)
    own = folder / "calibration.json"
    return told.st_mtime, {
        "utc": None, "seconds": None, "job": job.to_dict(), "from_mm": ends[0], "to_mm": ends[1],
        "length_mm": max(places) - min(places) if places else None, "frames": frames, "size": None, "parts": 1,
        "state": "whole", "calibrated": own.is_file(),
        "made_utc": _made(provenance(_small(own))) if own.is_file() else None,
    }  # fmt: skip


def _result(folder: Path) -> tuple[float, dict[str, Any]]:
    summary = _small(folder / "summary.json")
    if not str(summary.get("format", "")).startswith("annulus-"):
        raise ValueError("no summary of annulus")
    origin, diameter, scanned = (_section(summary, name) for name in ("origin", "diameter_mm", "scanned_mm"))
    defects = [one for one in _list(summary, "defects") if isinstance(one, Mapping)]
    depths = [depth for one in defects for depth in _number(one.get("depth_mm"))]
    decision = _section(summary, "conformity").get("decision")
    begun, created = origin.get("begun_utc"), summary.get("created")
    files = [name for name in FILES if (folder / name).is_file() and not (folder / name).is_symlink()]
    return (folder / "summary.json").stat().st_mtime, {
        "utc": next((one for one in (begun, created) if _is_time(one)), None),
        "created": created if _is_time(created) else None,
        "job": JobSheet.recorded(summary.get("job")).to_dict(),
        "of": untrusted.printable(Path(str(summary.get("source", ""))).name)[:200],
        "from_mm": _one(scanned.get("from")), "to_mm": _one(scanned.get("to")),
        "length_mm": _one(scanned.get("length")),
        "defects": len(defects) if "defects" in summary else None, "worst_mm": max(depths, default=None),
        "diameter_mm": _one(diameter.get("mean")), "k2_mm": _one(diameter.get("k2")),
        "verdict": untrusted.printable(decision)[:60] if isinstance(decision, str) else None,
        "warnings": len(_list(summary, "warnings")), "files": files,
        "size": sum((folder / name).stat().st_size for name in files), "state": "whole",
    }  # fmt: skip


def _calibration(path: Path) -> tuple[float, dict[str, Any]]:
    data = _small(path)
    if not str(data.get("format", "")).startswith("annulus-calibration/"):
        raise ValueError("no calibration")
    made = provenance(data)
    radius = _one(_section(data, "pipe").get("radius_mm"))
    return path.stat().st_mtime, {
        "made_utc": _made(made), "sections": sorted(made),
        "nominal_diameter_mm": None if radius is None else 2 * radius,
    }  # fmt: skip


_TELLS: Mapping[str, Callable[[Path], tuple[float, dict[str, Any]]]] = {
    "recording": _recording, "scan": _scan, "result": _result, "calibration": _calibration,
}  # fmt: skip


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
