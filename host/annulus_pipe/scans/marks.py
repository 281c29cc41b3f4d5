"""What operators marked during a scan, `/mark` of a recording, read with suspicion; with the pictures that belong to
it.

A mark is {"host_ns", "z_mm", "text", "clock_deg"} and, since there is a console, "photo" (a JPEG's bytes), "frame" and
"camera" (the newest LED frame then). Whoever wrote it, a mark that is malformed is counted and costs nothing else; a
photo is decoded within bounds and made anew, so that nothing of its file but the picture goes on.
"""

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.job import Observation
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.frames import CAMERA_ID_MAX, Z_MAX_MM
from annulus_pipe.record.recording import Recording
from annulus_pipe.scans.scan import Scan
from annulus_pipe.vocabulary import AnnulusError, Label

MARK_TOPIC = "/mark"
MARKS_MAX = 200  # of one scan; what follows is counted
TEXT_MAX = 500  # characters, as the daemon's control socket takes them
PHOTO_MAX = 1 << 16  # bytes; the daemon takes 48 KiB
PHOTO_SIDE_MAX = 4096  # pixels a side: what 64 KiB of JPEG may unpack to
INDEX_MAX = 1 << 40
SHOWN_PX = 480  # longer side of a picture on the page
EVEN_PERCENT = (1.0, 99.5)  # of a frame's grey levels: what becomes black and white
JPEG_QUALITY = 80


@dataclass(frozen=True, slots=True)
class RecordedMark:
    """One as it was written. z_mm : of the head, NaN where not known. frame : index of the LED frame beside it."""

    time_ns: int  # host monotonic
    z_mm: float
    clock_deg: float | None
    text: str
    photo: bytes | None  # b"": what was there is none
    frame: int | None
    camera: int

    @classmethod
    def from_note(cls, time_ns: int, note: object) -> "RecordedMark":
        """Raises ValueError naming what is wrong, unless it is the photo: its mark is kept."""
        body = untrusted.mapping(note, "mark")
        z, clock, frame, photo = (body.get(name) for name in ("z_mm", "clock_deg", "frame", "photo"))
        return cls(
            time_ns,
            math.nan if z is None else untrusted.number(z, "z_mm", Z_MAX_MM),
            None if clock is None else untrusted.number(clock, "clock_deg", 360.0) % 360.0,
            untrusted.printable(" ".join(untrusted.text(body.get("text", ""), "text", TEXT_MAX).split())),
            photo if isinstance(photo, bytes | None) else b"",
            None if frame is None else untrusted.whole(frame, "frame", 0, INDEX_MAX),
            untrusted.whole(body.get("camera") or 0, "camera", 0, CAMERA_ID_MAX),
        )


@dataclass(frozen=True, slots=True)
class Marks:
    """In the order they were made. unread : malformed or damaged ones; left_out : beyond MARKS_MAX, not looked at."""

    of: tuple[RecordedMark, ...] = ()
    unread: int = 0
    left_out: int = 0


def read_marks(recording: Recording) -> Marks:
    """Every mark that can be read, up to MARKS_MAX, of all parts."""
    count = recording.count(MARK_TOPIC)
    found: list[RecordedMark] = []
    malformed = 0
    for seen, (time_ns, _, note) in enumerate(recording.timed_notes(MARK_TOPIC)):
        if len(found) == MARKS_MAX:
            return Marks(tuple(found), malformed, count - seen)
        try:
            found.append(RecordedMark.from_note(time_ns, note))
        except ValueError:
            malformed += 1
    return Marks(tuple(found), count - len(found))


def observations_of(scan: Scan) -> tuple[tuple[Observation, ...], int]:
    """The marks of a scan for a report, by distance, and how many could not be read or were too many."""
    if scan.recording is None:
        return (), 0
    marks = read_marks(scan.recording)
    frames = {(one.index, one.camera): i for i, one in enumerate(scan.frames) if one.label is Label.LED}
    found = [_observed(scan, mark, frames) for mark in marks.of]
    found.sort(key=lambda one: (not math.isfinite(one.z_mm), one.z_mm if math.isfinite(one.z_mm) else 0.0))
    return tuple(found), marks.unread + marks.left_out


def _observed(scan: Scan, mark: RecordedMark, frames: Mapping[tuple[int, int], int]) -> Observation:
    assert scan.recording is not None
    beside = None if mark.frame is None else frames.get((mark.frame, mark.camera))
    z_mm = mark.z_mm if math.isfinite(mark.z_mm) or beside is None else scan.frames[beside].z_mm
    observation = Observation(z_mm, mark.text, mark.clock_deg, _utc(mark.time_ns, scan.recording))
    if photo := _photo(mark.photo):
        return replace(observation, picture=photo, shows="photo")
    observation = replace(observation, photo_unread=mark.photo is not None)
    if beside is not None:
        with contextlib.suppress(AnnulusError):  # a damaged frame shows nothing
            picture = _small(_even(scan.read(beside)))
            return replace(observation, picture=picture, shows="frame", frame=mark.frame, camera=mark.camera)
    return observation


def _utc(time_ns: int, recording: Recording) -> str:
    """To the second, "" where no clock was kept."""
    if not recording.utc_offset_ns:
        return ""
    try:
        when = datetime.fromtimestamp((time_ns + recording.utc_offset_ns) / 1e9, UTC)
        return when.isoformat(timespec="seconds")
    except (OverflowError, ValueError, OSError):
        return ""


def _photo(data: bytes | None) -> bytes:
    """An operator's photo made anew at the size it is shown at; b"" for what is none."""
    from annulus_pipe.capture.pictures import decode, size_of  # OpenCV: not by whom writes only

    if not data or not data.startswith(b"\xff\xd8") or len(data) > PHOTO_MAX:
        return b""
    try:
        size = size_of(data)
        if size is None or max(size) > PHOTO_SIDE_MAX:
            return b""
        return _small(decode(data))
    except ValueError:
        return b""


def _even(image: Image) -> Image:
    """Brightness stretched, as of the report's photographs."""
    black, white = np.percentile(image[::4, ::4].max(axis=2), EVEN_PERCENT)
    even = (image.astype(np.float32) - black) * (255.0 / max(float(white - black), 1.0))
    return np.asarray(np.clip(even, 0, 255), np.uint8)


def _small(image: Image) -> bytes:
    import cv2

    scale = min(SHOWN_PX / max(image.shape[:2]), 1.0)
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return bytes(np.asarray(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]).data)
