"""A recording read back: one scan in one .mcap file or in parts of it, whatever a crash or a full disk left of it.

Topics: `/frame/<camera>` (foxglove.RawImage or foxglove.CompressedImage, protobuf) and JSON `/label`, `/profile`,
`/telemetry`, `/event`, `/sensor/<name>` and whatever else is noted; other protobuf is for viewers (viewers.py), and
passed over. A frame and its label share the message sequence number, which is the frame's index; the label says which
camera it is of, and lies before its frame in one chunk. Frames of one index belong to one flash. Bytes inside JSON are
{"base64": ".."}. Attachments: `calibration.json`, `configuration.json`, `part.json` (parts.py) and `clock.json`
(clock.py): messages have times of day, and what is given here are the monotonic ones they were made of. Recordings of
before have those, and `/frame` for camera 0 where there was only one.

A closed recording is opened by the index at its end (index.py); what was made before has none, and a torn one neither:
it is walked over, stepping over images, and where that takes long the walk is kept beside it (kept.py). A chunk's
checksum is looked at when something in it is read, so an image that comes out is what was written, and its label what
its own chunk says; `check` reads the whole file. What is damaged is told, and costs no more than its chunk.

A recording may lie in a store (storage/place.py): its path is a URL then. It is a plain value, and opens its file
itself.
"""

import contextlib
import os
import stat
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.numeric.mosaic import Picture, bgr_of
from annulus_pipe.record import protobuf
from annulus_pipe.record.clock import CLOCK_FILE, Clock
from annulus_pipe.record.codec import to_picture
from annulus_pipe.record.followed import Followed, followed
from annulus_pipe.record.frames import (
    FRAME_TOPIC,
    LABEL_TOPIC,
    RecordedFrame,
    TwoScansError,
    camera_of,
    frame_name,
    from_json,
    offset_of,
    sorted_out,
)
from annulus_pipe.record.indexed import HEAD, Indexed, read_index
from annulus_pipe.record.kept import is_kept, keep, kept_walk, stamp_of
from annulus_pipe.record.one_scan import check_clock, check_one_scan
from annulus_pipe.record.parts import PART_FILE, Part, later_parts, part_of
from annulus_pipe.record.walk import ATTACHMENT_MAX, MAGIC, Chunk, Damage, DamagedError, MessageLocation, Walk, piece
from annulus_pipe.storage.place import Where, opened_file, where
from annulus_pipe.storage.remote import RemoteFile, StoreEntry, UnreachableError, Url, remote_file
from annulus_pipe.stream.frames import CHANNELS, SIDE_MAX
from annulus_pipe.vocabulary import AnnulusError

WALKED = 8 << 20  # bytes of one request of a walk over a store: all are moved, in the time that they take
_WIDTH, _HEIGHT, _ENCODING, _PIXELS = 2, 3, 4, 6  # fields of a foxglove.RawImage
_COMPRESSED = 2  # .. and the bytes of a .CompressedImage
_ATTACHED = ("calibration.json", "configuration.json", PART_FILE, CLOCK_FILE)


@dataclass(frozen=True, slots=True)
class Recording:
    """An opened recording. `torn`: a file ends in the middle, or is missing; everything whole is here.

    `damage`: what opening found; images are not looked at before they are read. `parts`: of a scan in several files the
    recording of each; this one joins them, and `path` is the first one's.
    """

    path: Where
    frames: tuple[RecordedFrame, ...]  # by index, then camera
    calibration: Mapping[str, Any] | None
    configuration: Mapping[str, Any] | None
    torn: bool
    _labels: Mapping[tuple[int, int], Mapping[str, Any]] = field(repr=False)  # (index, camera) -> as it was written
    _notes: Mapping[str, tuple[MessageLocation, ...]] = field(repr=False)  # by topic
    damage: tuple[Damage, ...] = ()
    _chunks: tuple[Chunk, ...] = field(default=(), repr=False)
    _data_crc: tuple[int, int] | None = field(default=None, repr=False)
    _sound: dict[int, bool] = field(default_factory=dict, repr=False)  # by a chunk's offset, of those looked at
    part: Part | None = None  # of which scan; None before there were parts
    parts: "tuple[Recording, ...]" = ()
    utc_offset_ns: int = 0  # what a message's time is later than the monotonic clock's
    cut_frames: int | None = 0  # at most, that the file ends in the middle of; None: not known
    known: StoreEntry | None = None  # what a store said of the file
    index: Followed | None = field(default=None, repr=False)  # None: walked over

    @property
    def cameras(self) -> tuple[int, ...]:
        """Ids of the cameras that have a frame here, rising."""
        return tuple(sorted({frame.camera for frame in self.frames}))

    def label(self, frame: RecordedFrame) -> Mapping[str, Any]:
        """What was written of a frame with its label; empty where the label was lost. Sound where the frame is."""
        return self._labels.get((frame.index, frame.camera), {})

    def notes(self, topic: str) -> Iterator[Any]:
        """The records of one JSON topic, like "/event" or "/sensor/imu", in order.

        What is malformed, or lies in a chunk with the wrong checksum, is left out.
        """
        return (body for _, _, body in self.timed_notes(topic))

    @property
    def topics(self) -> tuple[str, ...]:
        """That have JSON records."""
        return tuple(dict.fromkeys([*self._notes, *(topic for part in self.parts for topic in part.topics)]))

    def count(self, topic: str) -> int:
        """How many records a JSON topic has, readable or not."""
        return len(self._notes.get(topic, ())) + sum(part.count(topic) for part in self.parts)

    def timed_notes(self, topic: str) -> Iterator[tuple[int, int, Any]]:
        """The same with host time, ns, and sequence number."""
        for part in self.parts:
            yield from part.timed_notes(topic)
        if self.parts:
            return
        held, data = None, b""  # the chunk that is unpacked, its records
        with self._open() as file:
            if self.index is not None and topic != LABEL_TOPIC:
                try:
                    kept = self.index.notes.of(topic, file)
                except ValueError:
                    kept = None  # they are in their chunks, too
                if kept is not None:
                    for sequence, time_ns, content in kept:
                        with contextlib.suppress(ValueError):
                            yield time_ns - self.utc_offset_ns, sequence, from_json(content)
                    return
            for message in self._notes.get(topic, ()):
                chunk = message.chunk
                try:
                    if chunk is not None and chunk.size:
                        if held != chunk.offset:
                            held, data = chunk.offset, b""
                            data = chunk.read(file)
                        if not data:
                            continue
                        content = bytes(chunk.within(data, message.offset, message.length))
                    elif self._is_sound(chunk, file):
                        content = piece(file, message.offset, message.length)
                    else:
                        continue
                    yield message.time_ns - self.utc_offset_ns, message.sequence, from_json(content)
                except (ValueError, DamagedError):
                    continue

    @property
    def size(self) -> int:
        """Bytes of all its files. OSError where one is gone."""
        if self.parts:
            return sum(part.size for part in self.parts)
        if isinstance(self.path, Path):
            return self.path.stat().st_size
        return 0 if self.known is None else self.known.size

    def _open(self) -> IO[bytes]:
        return opened_file(self.path, self.known)

    def plan(self, which: Iterable[RecordedFrame]) -> None:
        """These frames will be read: of what lies in a store their chunks are fetched together, each once."""
        ranges: dict[int, list[tuple[int, int]]] = {}
        for frame in which:
            chunk = frame.chunk
            place = (frame.offset, frame.length) if chunk is None else (chunk.offset, chunk.length)
            ranges.setdefault(frame.part, []).append(place)
        for number, places in ranges.items():
            part = self.parts[number] if self.parts else self
            if isinstance(part.path, Url):
                remote_file(part.path, part.known).plan((offset, offset + length) for offset, length in places)

    def check(self) -> tuple[Damage, ...]:
        """Everything that is damaged, by reading the whole file (1 GB/s and what the disk gives)."""
        if self.parts:
            return _named([(part, part.check()) for part in self.parts])
        if self.index is not None:
            try:
                walked = _walked(self.path, self.known, self)
            except AnnulusError as error:  # a chunk whose compression's name is another now, or nothing to walk
                return (*self.damage, Damage(0, str(error).removeprefix(f"{self.path}: ").rstrip(".")))
            return walked.check()
        found = list(self.damage)
        with self._open() as file:
            for chunk in self._chunks:
                try:
                    if not self._is_sound(chunk, file) and all(one.offset != chunk.offset for one in self.damage):
                        found.append(Damage(chunk.offset, "a chunk with the wrong checksum", chunk.messages))
                except ValueError:
                    found.append(Damage(chunk.offset, "a chunk that is no longer there", chunk.messages))
            if self._data_crc is not None and _crc_before(file, self._data_crc[0]) != self._data_crc[1]:
                found.append(Damage(0, "the checksum of all records is wrong"))
        return tuple(found)

    def read_jpeg(self, frame: RecordedFrame) -> bytes:
        """The picture of a frame that is `jpeg`, as it lies there. Raises as `read_raw` does."""
        if self.parts:
            return self.parts[frame.part].read_jpeg(frame)
        data, where = self._message(frame)
        return _compressed(data, where)

    def _message(self, frame: RecordedFrame) -> tuple[memoryview, str]:
        """A frame's message, and what the frame is called."""
        where = f"{self.path}: {frame_name(frame.index, frame.camera)}"
        try:
            with self._open() as file:
                if frame.chunk is None:
                    records, data = b"", memoryview(piece(file, frame.offset, frame.length))
                else:
                    records = frame.chunk.read(file)
                    self._sound[frame.chunk.offset] = True
                    data = frame.chunk.within(records, frame.offset, frame.length)
                if self.index is not None:
                    self.index.hold(file, frame, records, self.label(frame), self.utc_offset_ns)
                return data, where
        except DamagedError as error:
            raise DamagedError(f"{where} is damaged: {error}.") from None
        except ValueError as error:
            raise DamagedError(f"{where} is damaged: {error}.") from None
        except OSError as error:
            raise AnnulusError(f"{where} cannot be read ({error.strerror}).") from None

    def read_raw(self, frame: RecordedFrame) -> tuple[Image, str]:
        """The image as the camera gave it, and its encoding.

        Raises DamagedError where the bytes are not what was written, AnnulusError for what is no image.
        """
        if self.parts:
            return self.parts[frame.part].read_raw(frame)
        data, where = self._message(frame)
        if frame.jpeg:
            return _decoded(data, where), "bgr8"
        try:
            raw = protobuf.fields(data)
            encoding = protobuf.text(raw, _ENCODING)
        except ValueError:
            raise DamagedError(f"{where} is damaged: not a foxglove.RawImage.") from None
        width, height = (protobuf.number(raw, of, protobuf.FIXED32) for of in (_WIDTH, _HEIGHT))
        pixels = protobuf.content(raw, _PIXELS)
        channels = CHANNELS.get(encoding)
        if channels is None:
            raise AnnulusError(f"{where} is encoded as {encoding!r}, expected one of {', '.join(CHANNELS)}.")
        within = 0 < width <= SIDE_MAX and 0 < height <= SIDE_MAX
        if not within or len(pixels) != width * height * channels:
            raise DamagedError(
                f"{where} is damaged: {len(pixels)} bytes for {width}x{height} pixels of {channels} bytes."
            )
        shape = (height, width, channels) if channels > 1 else (height, width)
        return np.frombuffer(pixels, np.uint8).reshape(shape), encoding

    def picture(self, frame: RecordedFrame) -> Picture:
        """The image, a mosaic as the camera gave it: nothing of it is copied, and it may not be written to."""
        return to_picture(*self.read_raw(frame))

    def read(self, frame: RecordedFrame) -> Image:
        """The image as (H, W, 3) BGR, demosaiced where the camera gave a mosaic."""
        return bgr_of(self.picture(frame))

    def is_sound(self, frame: RecordedFrame) -> bool:
        """Whether frame and label are what was written."""
        if self.parts:
            return self.parts[frame.part].is_sound(frame)
        try:
            with self._open() as file:
                return self._is_sound(frame.chunk, file)
        except (OSError, ValueError):
            return False

    def _is_sound(self, chunk: Chunk | None, file: IO[bytes]) -> bool:
        if chunk is None:
            return True
        if chunk.offset not in self._sound:
            try:
                chunk.read(file)
                self._sound[chunk.offset] = True
            except DamagedError:
                self._sound[chunk.offset] = False
        return self._sound[chunk.offset]


def _compressed(data: memoryview, where: str) -> bytes:
    try:
        return bytes(protobuf.content(protobuf.fields(data), _COMPRESSED))
    except ValueError:
        raise DamagedError(f"{where} is damaged: not a foxglove.CompressedImage.") from None


def _decoded(data: memoryview, where: str) -> Image:
    """(H, W, 3) BGR."""
    from annulus_pipe.capture.pictures import decode  # OpenCV: not by whom writes only

    try:
        return decode(_compressed(data, where))
    except ValueError as error:
        raise DamagedError(f"{where} is damaged: {error}.") from None


def _crc_before(file: IO[bytes], end: int) -> int:
    file.seek(0)
    crc, left = 0, end
    while left and (data := file.read(min(left, 1 << 20))):
        crc, left = zlib.crc32(data, crc), left - len(data)
    return crc


def open_recording(place: Where | str) -> Recording:
    """Open a recording, whole or torn. Given the first part of a scan, all of them as one.

    Raises AnnulusError when it is none.
    """
    path = where(place)
    later = later_parts(path)
    first = open_part(path, later.first)
    if first.part is None or first.part.number != 1:
        return first
    parts, torn, expected = [first], first.torn, 2
    for number, other, known in later.others:
        part = part_of(other, known)
        if part is not None and part.scan != first.part.scan:
            continue  # of another scan
        torn |= number != expected
        expected = number + 1
        try:
            parts.append(open_part(other, known))
            torn |= parts[-1].torn
        except (UnreachableError, TwoScansError):
            raise
        except AnnulusError:  # cut off before anything was in it
            torn = True
    return first if len(parts) == 1 and torn == first.torn else _joined(parts, torn)


def _joined(parts: list[Recording], torn: bool) -> Recording:
    frames: dict[tuple[int, int], RecordedFrame] = {}
    labels: dict[tuple[int, int], Mapping[str, Any]] = {}
    for number, part in enumerate(parts):
        for frame in part.frames:
            frames.setdefault((frame.index, frame.camera), replace(frame, part=number))
        labels = {**part._labels, **labels}
    return replace(
        parts[0],
        frames=tuple(frames[key] for key in sorted(frames)),
        torn=torn,
        _labels=labels,
        _notes={},
        damage=_named([(part, part.damage) for part in parts]),
        parts=tuple(parts),
    )


def _named(found: list[tuple[Recording, tuple[Damage, ...]]]) -> tuple[Damage, ...]:
    """Damage of several files, with the file's name."""
    return tuple(replace(one, text=f"of {part.path.name}: {one.text}") for part, damage in found for one in damage)


@contextmanager
def opened_place(
    path: Where, known: StoreEntry | None, ahead: int = 0
) -> Iterator[tuple[IO[bytes], int, StoreEntry | None]]:
    """The file of a recording here or in a store, its bytes, and what the store says of it. Raises as `opened` does.

    ahead : bytes of a file that is far which are fetched at once, in place of those that are asked for.
    """
    if isinstance(path, Path):
        with opened(path) as (file, status):
            yield file, status.st_size, None
        return
    try:
        far = RemoteFile(path, known, ahead) if ahead else remote_file(path, known)
        far.plan([(0, HEAD)])
        far.seek(0)
        if far.read(len(MAGIC)) != MAGIC:
            raise AnnulusError(f"{path}: not an MCAP recording.")
        yield cast(IO[bytes], far), far.size, far.known
    except ValueError as error:
        raise AnnulusError(f"{path}: cannot be read ({error}).") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a recording.") from None


@contextmanager
def opened(path: Path) -> Iterator[tuple[IO[bytes], os.stat_result]]:
    """The file of a recording, behind its first bytes. Raises AnnulusError when it is none, or cannot be read."""
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode) or file.read(len(MAGIC)) != MAGIC:
                raise AnnulusError(f"{path}: not an MCAP recording.")
            yield file, status
    except ValueError as error:  # shorter than it was a moment ago
        raise AnnulusError(f"{path}: cannot be read ({error}). Is it still being written?") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a recording.") from None


def open_part(place: Where | str, known: StoreEntry | None = None) -> Recording:
    """One file alone, whichever part it is. `known`: what a store said of it a moment ago.

    Raises AnnulusError when it is no recording.
    """
    path = where(place)
    with opened_place(path, known) as (file, size, known):
        found = read_index(file, size, _ATTACHED, LABEL_TOPIC)
        if found is not None and (recording := _recorded(path, found, known)) is not None:
            return recording
    return _walked(path, known)


def _walked(path: Where, known: StoreEntry | None, opened_by_index: Recording | None = None) -> Recording:
    """By a walk, as it was kept or anew. `opened_by_index`: the same, which is damaged where it is another."""
    begun = time.monotonic()
    with opened_place(path, known) as (file, size, known):
        stamp = stamp_of(path, file, size, known)
        found = kept_walk(path, file, stamp) if opened_by_index is None else None
        if found is not None and (recording := _recorded(path, found, known)) is not None:
            return recording
    with opened_place(path, known, WALKED) as (file, size, known):
        walk = Walk(file, size, _ATTACHED, LABEL_TOPIC, isinstance(path, Url))
        lasting = opened_by_index is None and not walk.compression and not walk.disagreeing
        if lasting and is_kept(path, time.monotonic() - begun):
            found = keep(path, file, stamp, walk)
            if found is not None and (recording := _recorded(path, found, known)) is not None:
                return recording
        recording = _recorded(path, walk, known)
    assert recording is not None
    if opened_by_index is not None and not _same(recording, opened_by_index):
        damage = (*recording.damage, Damage(0, "the index at the end says otherwise than the records"))
        return replace(recording, damage=damage)
    return recording


def _same(one: Recording, other: Recording) -> bool:
    return one.frames == other.frames and one._labels == other._labels and one._notes == other._notes


def _recorded(path: Where, found: Walk | Indexed, known: StoreEntry | None) -> Recording | None:
    """Out of a file's contents. None where an index has more than one frame or label of a name, or of two scans: only
    a walk says what counts. Raises AnnulusError for what is no recording, TwoScansError for what is two.
    """
    try:
        frames, labels, notes = sorted_out(found)
        clock = Clock.from_dict(_attached(found, CLOCK_FILE))
        check_one_scan(found)
        if clock is not None:
            check_clock(found, frames, labels, clock)
    except TwoScansError as error:
        if isinstance(found, Indexed):
            return None
        raise TwoScansError(
            f"{path}: holds more than one scan ({error}). Expected one: open the files that it was joined from, or "
            "part it by time (mcap filter)."
        ) from None
    if found.compression:
        raise AnnulusError(
            f"{path}: its chunks are compressed with {found.compression}. "
            "Decompress it first: mcap compress --compression none."
        )
    topics = {channel.topic for channel in found.channels.values()}
    if not any(topic == LABEL_TOPIC or camera_of(topic) is not None for topic in topics):
        raise AnnulusError(f"{path}: no {FRAME_TOPIC}/<camera> topic. Expected a recording made by annulus.")
    index = None
    if isinstance(found, Indexed):
        index = followed(found, frames, labels, notes)
        if index is None:
            return None
    calibration, configuration, part = (_attached(found, name) for name in _ATTACHED if name != CLOCK_FILE)
    offset_ns = offset_of(frames, labels) if clock is None else clock.offset_ns
    if offset_ns:
        frames = tuple(replace(frame, timestamp_ns=frame.timestamp_ns - offset_ns) for frame in frames)
    return Recording(
        path,
        frames,
        calibration,
        configuration,
        not found.ended,
        labels,
        notes,
        tuple(found.damage),
        tuple(found.chunks),
        found.data_crc,
        part=Part.from_dict(part),
        utc_offset_ns=offset_ns,
        cut_frames=found.cut_messages,
        known=known,
        index=index,
    )


def _attached(walk: Walk | Indexed, name: str) -> Mapping[str, Any] | None:
    try:
        content = untrusted.parse_json(walk.attachments[name], ATTACHMENT_MAX)
    except (KeyError, ValueError):
        return None
    return content if isinstance(content, dict) else None
