"""What a recording says of itself: who, where, when, with what, how its pictures are kept, and what it lacks."""

import math
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from annulus_pipe.record.clock import clock_of
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.frames import EVIDENCE, IDENTITY, RecordedFrame
from annulus_pipe.record.missing import missing_told
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.scans.marks import read_marks
from annulus_pipe.scans.origin import job_told
from annulus_pipe.vocabulary import Label


def identity(path: Path) -> dict[str, Any]:
    """What a recording says of itself, for people and programs."""
    recording = open_recording(path)
    who = [one for one in recording.notes(IDENTITY) if isinstance(one, dict)]
    first: Mapping[str, Any] = who[0] if who else {}
    last: Mapping[str, Any] = who[-1] if who else {}
    counted = Counter(frame.label.value for frame in recording.frames)
    kept = Counter(_codec(frame).value for frame in recording.frames)
    assumed = [frame for frame in recording.frames if frame.z_bound_mm > 0.0]
    parts = recording.parts or (recording,)
    size = recording.size
    times = [frame.timestamp_ns for frame in recording.frames]
    marks = read_marks(recording)
    return {
        "recording": str(path),
        "parts": len(parts),
        "bytes": size,
        "torn": recording.torn,
        "cut_frames_at_most": recording.cut_frames,
        "power_cut_frames_at_most": _at_risk(recording),
        "damage_seen": len(recording.damage),
        "frames": dict(counted),
        "codecs": dict(kept),
        "first_frame": _of_day(recording, min(times, default=None)),
        "last_frame": _of_day(recording, max(times, default=None)),
        "seconds": round((max(times) - min(times)) / 1e9, 3) if times else 0.0,
        "from": first.get("utc"),
        "to": last.get("utc"),
        "job": job_told(recording).to_dict() or None,
        "controller": last.get("controller"),
        "cameras": last.get("cameras"),
        "versions": first.get("versions"),
        "segments": len({frame.segment for frame in recording.frames if frame.label is not Label.UNKNOWN}),
        "frames_of_assumed_place": len(assumed),
        "z_bound_mm": max((frame.z_bound_mm for frame in assumed), default=0.0),
        "evidence": EVIDENCE in recording.topics,
        "marks": len(marks.of) + marks.left_out,
        "marks_unread": marks.unread,
        "missing": missing_told(recording),
    }


def _codec(frame: RecordedFrame) -> Codec:
    if frame.jpeg:
        return Codec.JPEG
    return Codec.ZSTD if frame.chunk is not None and frame.chunk.size else Codec.RAW


def _at_risk(recording: Recording) -> int | None:
    """Of a torn one, how many frames at most had not been told to be on the disk itself, were it the power that went;
    None where it was not torn, or that is not known. See [record] sync_s.
    """
    if not recording.torn or recording.configuration is None:
        return None
    try:
        cameras = recording.configuration["cameras"]
        sync_s, fps = float(recording.configuration["record"]["sync_s"]), float(cameras[0]["timing"]["fps"])
    except (KeyError, IndexError, TypeError, ValueError):
        return None
    return math.ceil(2 * sync_s * fps) * len(cameras) if sync_s > 0 else None


def _of_day(recording: Recording, time_ns: int | None) -> str | None:
    """UTC; None where that is not known."""
    clock = clock_of(recording.utc_offset_ns, recording.notes(IDENTITY))
    if time_ns is None or not clock.offset_ns:
        return None
    try:
        return datetime.fromtimestamp(clock.utc(time_ns) / 1e9, UTC).isoformat(timespec="milliseconds")
    except (OverflowError, ValueError, OSError):
        return None
