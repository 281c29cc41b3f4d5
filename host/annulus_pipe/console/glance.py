"""What a recording is, without reading it: its beginning, its end and what the end counts; a few MB of however many.

    for first in first_paths(folder):
        print(glance(first))            # a scan in parts is one

Nothing here is checked against its checksum but what `Walk` checks: it is for a list that people choose from.
"""

import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Statistics

from annulus_pipe import untrusted
from annulus_pipe.job import JobSheet
from annulus_pipe.record.clock import CLOCK_FILE, Clock
from annulus_pipe.record.frames import FRAME_TOPIC, IDENTITY, LABEL_TOPIC, Z_MAX_MM, from_json
from annulus_pipe.record.parts import PART_FILE, later_paths, part_of
from annulus_pipe.record.recording import opened
from annulus_pipe.record.walk import ATTACHMENT_MAX, MAGIC, Channel, DamagedError, Walk, piece
from annulus_pipe.scans.origin import JOB_TOPIC
from annulus_pipe.vocabulary import AnnulusError

HEAD = 64 << 20  # bytes, stepped over: attachments, what was said at the start, the first label with a place
TAIL = 8 << 20  # bytes before the index: four frames as they are, and the identity that ends a recording
NAMES = 1 << 16  # bytes of the index that name channels and count messages
CONFIGURATION_FILE = "configuration.json"
CALIBRATION_FILE = "calibration.json"
_FOOTER = struct.Struct("<BQQQI")
_RECORD = struct.Struct("<BQ")
_STATISTICS = 0x0B


@dataclass(frozen=True, slots=True)
class Glance:
    """Of one scan. None, "" or empty: not known without reading it."""

    files: tuple[Path, ...]
    size: int  # bytes of all of them
    whole: bool  # every file was ended as it should be
    changed_s: float  # Unix time
    begun: datetime | None = None  # UTC
    ended: datetime | None = None
    from_mm: float | None = None
    to_mm: float | None = None
    frames: int | None = None
    job: JobSheet = field(default_factory=JobSheet)
    provenance: Mapping[str, Any] = field(default_factory=dict)  # of the calibration it carries
    calibrated: bool = False


@dataclass(frozen=True, slots=True)
class _ScanFile:
    """One file of a scan."""

    size: int
    changed_s: float
    whole: bool
    times_ns: tuple[int, int] | None  # of messages, as they are written
    clock: Clock | None
    labels: tuple[float | None, float | None]  # mm: of the first frame seen, of the last
    frames: int | None
    job: JobSheet
    calibration: Mapping[str, Any] | None


def glance(first: Path) -> Glance:
    """Of a scan, given its only or first file. Raises AnnulusError when it is no recording."""
    files, seen = [first], [_look(first)]
    known = part_of(first)
    missing, number = False, 1
    for place, later in later_paths(first) if known is not None else ():
        if (part := part_of(later)) is not None and part.scan == known.scan:  # type: ignore[union-attr]
            missing |= place != number + 1
            number = place
            files.append(later)
            try:
                seen.append(_look(later))
            except AnnulusError:  # cut off before anything was in it
                missing = True
    begun = next((_utc(one, 0) for one in seen if one.times_ns), None)
    ended = next((_utc(one, 1) for one in reversed(seen) if one.times_ns), None)
    return Glance(
        tuple(files),
        sum(one.size for one in seen),
        all(one.whole for one in seen) and not missing,
        max(one.changed_s for one in seen),
        begun,
        ended,
        next((one.labels[0] for one in seen if one.labels[0] is not None), None),
        next((one.labels[1] for one in reversed(seen) if one.labels[1] is not None), None),
        None if any(one.frames is None for one in seen) else sum(one.frames or 0 for one in seen),
        seen[0].job.under(seen[-1].job),
        _section(seen[0].calibration, "provenance"),
        seen[0].calibration is not None,
    )


def _look(path: Path) -> _ScanFile:
    with opened(path) as (file, status):
        return _seen(file, status.st_size, status.st_mtime)


def _seen(file: IO[bytes], size: int, changed_s: float) -> _ScanFile:
    wanted = (PART_FILE, CLOCK_FILE, CALIBRATION_FILE, CONFIGURATION_FILE)
    head = Walk(file, min(size, HEAD), wanted)
    index = _index(file, size)
    names, end = (b"", size) if index is None else (piece(file, index, min(NAMES, size - index)), index)
    start = max(len(MAGIC), end - TAIL)
    tail_file = io.BytesIO(MAGIC + piece(file, start, end - start) + names)
    tail = Walk(tail_file, len(tail_file.getbuffer()), wanted)
    statistics = _statistics(names)
    channels: dict[int, Channel] = {**tail.channels, **head.channels}
    frames = None
    if statistics is not None:
        frames = sum(
            count
            for number, count in statistics.channel_message_counts.items()
            if number in channels and channels[number].topic.startswith(FRAME_TOPIC)
        )
    first = [_label(head, one, channels) for one in head.messages]
    last = [_label(tail, one, channels) for one in reversed(tail.messages)]
    times = [one.time_ns for one in (*head.messages, *tail.messages)]
    configuration, calibration = (_attached(head, name) for name in (CONFIGURATION_FILE, CALIBRATION_FILE))
    who = _last(tail, channels, IDENTITY) or _last(head, channels, IDENTITY)
    job = _last(tail, channels, JOB_TOPIC) or _last(head, channels, JOB_TOPIC)
    return _ScanFile(
        size,
        changed_s,
        index is not None,
        (min(times), max(times)) if times else None,
        Clock.from_dict(_attached(head, CLOCK_FILE)),
        (next((z for z in first if z is not None), None), next((z for z in last if z is not None), None)),
        frames,
        JobSheet.recorded(_section(configuration, "job")).under(JobSheet.recorded(who.get("job"))).over_told(job),
        calibration,
    )


def _index(file: IO[bytes], size: int) -> int | None:
    """Where the index begins; None where the file has no end."""
    at = size - len(MAGIC) - _FOOTER.size
    if at < len(MAGIC):
        return None
    end = piece(file, at, _FOOTER.size + len(MAGIC))
    opcode, length, start, _, _ = _FOOTER.unpack_from(end)
    if not end.endswith(MAGIC) or opcode != 2 or length != _FOOTER.size - _RECORD.size:
        return None
    return start if len(MAGIC) <= start <= at else at


def _statistics(index: bytes) -> Statistics | None:
    at = 0
    while at + _RECORD.size <= len(index):
        opcode, length = _RECORD.unpack_from(index, at)
        at += _RECORD.size
        if opcode == _STATISTICS and at + length <= len(index):
            try:
                return Statistics.read(ReadDataStream(io.BytesIO(index[at : at + length])))
            except (McapError, struct.error, ValueError):
                return None
        at += length
    return None


def _label(walk: Walk, message: Any, channels: Mapping[int, Channel]) -> float | None:
    """Where a label says that its frame was, mm."""
    body = _body(walk, message, channels, LABEL_TOPIC)
    z = body.get("z_mm")
    known = isinstance(z, int | float) and not isinstance(z, bool) and abs(z) <= Z_MAX_MM
    return float(z) if known else None  # type: ignore[arg-type]


def _last(walk: Walk, channels: Mapping[int, Channel], topic: str) -> Mapping[str, Any]:
    found = (_body(walk, one, channels, topic) for one in reversed(walk.messages))
    return next((one for one in found if one), {})


def _body(walk: Walk, message: Any, channels: Mapping[int, Channel], topic: str) -> Mapping[str, Any]:
    """A message of that topic; empty where it is another, or none that can be read."""
    channel = channels.get(message.channel)
    if channel is None or channel.topic != topic:
        return {}
    try:
        body = from_json(walk.content(message))
    except (ValueError, DamagedError):
        return {}
    return body if isinstance(body, dict) else {}


def _attached(walk: Walk, name: str) -> Mapping[str, Any] | None:
    try:
        content = untrusted.parse_json(walk.attachments[name], ATTACHMENT_MAX)
    except (KeyError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _section(data: Mapping[str, Any] | None, name: str) -> Mapping[str, Any]:
    section = (data or {}).get(name)
    return section if isinstance(section, dict) else {}


def _utc(one: _ScanFile, which: int) -> datetime | None:
    """Of the first or last message; None of recordings whose messages have no time of day."""
    assert one.times_ns is not None
    if one.clock is None:
        return None
    try:
        return datetime.fromtimestamp(one.times_ns[which] / 1e9, UTC)
    except (OverflowError, OSError, ValueError):
        return None
