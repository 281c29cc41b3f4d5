"""A recording read back: one scan in one .mcap file or in parts of it, whatever a crash or a full disk left of it.

Topics: `/frame/<camera>` (foxglove.RawImage or foxglove.CompressedImage, protobuf) and JSON `/label`, `/profile`,
`/telemetry`, `/event`, `/sensor/<name>` and whatever else is noted; other protobuf is for viewers (viewers.py), and
passed over. A frame and its label share the message sequence number, which is the frame's index; the label says which
camera it is of, and lies before its frame in one chunk. Frames of one index belong to one flash. Bytes inside JSON are
{"base64": ".."}. Attachments: `calibration.json`, `configuration.json`, `part.json` (parts.py) and `clock.json`
(clock.py): messages have times of day, and what is given here are the monotonic ones they were made of. Recordings of
before have those, and `/frame` for camera 0 where there was only one.

Opening steps over images. A chunk's checksum is looked at when something in it is read, so an image or a note that
comes out is what was written; `check` reads the whole file. What is damaged is told, and costs no more than its chunk.
"""

import base64
import json
import math
import os
import stat
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError

from annulus import untrusted
from annulus.numeric.arrays import Image
from annulus.record.clock import CLOCK_FILE, Clock
from annulus.record.codec import to_bgr
from annulus.record.parts import PART_FILE, Part, later_paths, part_of
from annulus.record.walk import ATTACHMENT_MAX, MAGIC, Chunk, Damage, DamagedError, Message, Walk, piece
from annulus.stream.frames import CHANNELS, SIDE_MAX
from annulus.vocabulary import AnnulusError, Label

FRAME_TOPIC = "/frame"  # .. of camera 0 in old recordings; now followed by the camera's id
LABEL_TOPIC = "/label"
DROPS_TOPIC = "/drops"
CAMERA_ID_MAX = 255
Z_MAX_MM = 1e8  # of a place; beyond is damage
_JSON_MAX = 1 << 24
_ATTACHED = ("calibration.json", "configuration.json", PART_FILE, CLOCK_FILE)
_JPEG = CompressedImage.DESCRIPTOR.full_name


def to_json(value: Any) -> bytes:
    """Compact JSON; bytes become {"base64": ".."}, what is not a number becomes null."""
    return json.dumps(_plain(value), separators=(",", ":"), allow_nan=False).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return {"base64": base64.b64encode(value).decode()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def from_json(data: bytes) -> Any:
    """The inverse of `to_json`. ValueError on anything else."""

    def bytes_again(item: dict[str, Any]) -> Any:
        packed = item.get("base64")
        return base64.b64decode(packed) if len(item) == 1 and isinstance(packed, str) else item

    return untrusted.parse_json(data, _JSON_MAX, bytes_again)


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One frame in a recording; `offset`, `length`: its protobuf message in the file or, of a packed chunk, in that."""

    index: int
    label: Label
    z_mm: float  # NaN where not known
    timestamp_ns: int
    offset: int
    length: int
    roll_deg: float | None = None  # of the head, clockwise looking forward, where its label says so
    camera: int = 0
    chunk: Chunk | None = None  # what its checksum is of
    part: int = 0  # which of its recording's `parts` it is in
    z_bound_mm: float = 0.0  # how far z may be off; 0: it was counted
    segment: int = 0  # of z: within one, differences of z were counted
    jpeg: bool = False


@dataclass(frozen=True, slots=True)
class Recording:
    """An opened recording. `torn`: a file ends in the middle, or is missing; everything whole is here.

    `damage`: what opening found; images are not looked at before they are read. `parts`: of a scan in several files the
    recording of each; this one joins them, and `path` is the first one's.
    """

    path: Path
    frames: tuple[RecordedFrame, ...]  # by index, then camera
    calibration: Mapping[str, Any] | None
    configuration: Mapping[str, Any] | None
    torn: bool
    _labels: Mapping[tuple[int, int], Mapping[str, Any]] = field(repr=False)  # (index, camera) -> as it was written
    _notes: Mapping[str, tuple[Message, ...]] = field(repr=False)  # by topic
    damage: tuple[Damage, ...] = ()
    _chunks: tuple[Chunk, ...] = field(default=(), repr=False)
    _data_crc: tuple[int, int] | None = field(default=None, repr=False)
    _sound: dict[int, bool] = field(default_factory=dict, repr=False)  # by a chunk's offset, of those looked at
    part: Part | None = None  # of which scan; None before there were parts
    parts: "tuple[Recording, ...]" = ()
    utc_offset_ns: int = 0  # what a message's time is later than the monotonic clock's
    cut_frames: int | None = 0  # at most, that the file ends in the middle of; None: not known

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
        with self.path.open("rb") as file:
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

    def check(self) -> tuple[Damage, ...]:
        """Everything that is damaged, by reading the whole file (1 GB/s and what the disk gives)."""
        if self.parts:
            return _named([(part, part.check()) for part in self.parts])
        found = list(self.damage)
        with self.path.open("rb") as file:
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
            with self.path.open("rb") as file:
                return _of_chunk(file, frame), where
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
        raw = RawImage()
        try:
            raw.ParseFromString(data)
        except DecodeError:
            raise DamagedError(f"{where} is damaged: not a foxglove.RawImage.") from None
        channels = CHANNELS.get(raw.encoding)
        if channels is None:
            raise AnnulusError(f"{where} is encoded as {raw.encoding!r}, expected one of {', '.join(CHANNELS)}.")
        within = 0 < raw.width <= SIDE_MAX and 0 < raw.height <= SIDE_MAX
        if not within or len(raw.data) != raw.width * raw.height * channels:
            raise DamagedError(
                f"{where} is damaged: {len(raw.data)} bytes for {raw.width}x{raw.height} pixels of {channels} bytes."
            )
        shape = (raw.height, raw.width, channels) if channels > 1 else (raw.height, raw.width)
        return np.frombuffer(raw.data, np.uint8).reshape(shape), raw.encoding

    def read(self, frame: RecordedFrame) -> Image:
        """The image as (H, W, 3) BGR, demosaiced where the camera gave a mosaic."""
        return to_bgr(*self.read_raw(frame))

    def is_sound(self, frame: RecordedFrame) -> bool:
        """Whether frame and label are what was written."""
        if self.parts:
            return self.parts[frame.part].is_sound(frame)
        try:
            with self.path.open("rb") as file:
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


def _of_chunk(file: IO[bytes], frame: RecordedFrame) -> memoryview:
    """A frame's message, out of a chunk that is what was written."""
    if frame.chunk is None:
        return memoryview(piece(file, frame.offset, frame.length))
    return frame.chunk.within(frame.chunk.read(file), frame.offset, frame.length)


def _compressed(data: memoryview, where: str) -> bytes:
    message = CompressedImage()
    try:
        message.ParseFromString(data)
    except DecodeError:
        raise DamagedError(f"{where} is damaged: not a foxglove.CompressedImage.") from None
    return bytes(message.data)


def _decoded(data: memoryview, where: str) -> Image:
    """(H, W, 3) BGR."""
    from annulus.capture.pictures import decode  # OpenCV: not by whom writes only

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


def frame_name(index: int, camera: int) -> str:
    """As messages name a frame."""
    return f"frame {index} of camera {camera}" if camera else f"frame {index}"


def open_recording(path: Path) -> Recording:
    """Index a recording by walking its records; needs no footer. Given the first part of a scan, all of them as one.

    Raises AnnulusError when it is none.
    """
    first = open_part(path)
    if first.part is None or first.part.number != 1:
        return first
    parts, torn, expected = [first], first.torn, 2
    for number, later in later_paths(path):
        known = part_of(later)
        if known is not None and known.scan != first.part.scan:
            continue  # of another scan
        torn |= number != expected
        expected = number + 1
        try:
            parts.append(open_part(later))
            torn |= parts[-1].torn
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
        parts[0], frames=tuple(frames[key] for key in sorted(frames)), torn=torn, _labels=labels, _notes={},
        damage=_named([(part, part.damage) for part in parts]), parts=tuple(parts),
    )  # fmt: skip


def _named(found: list[tuple[Recording, tuple[Damage, ...]]]) -> tuple[Damage, ...]:
    """Damage of several files, with the file's name."""
    return tuple(replace(one, text=f"of {part.path.name}: {one.text}") for part, damage in found for one in damage)


@contextmanager
def opened(path: Path) -> Iterator[tuple[IO[bytes], os.stat_result]]:
    """The file of a recording, behind its first bytes. Raises AnnulusError when it is none, or cannot be read."""
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            told = os.fstat(file.fileno())
            if not stat.S_ISREG(told.st_mode) or file.read(len(MAGIC)) != MAGIC:
                raise AnnulusError(f"{path}: not an MCAP recording.")
            yield file, told
    except ValueError as error:  # shorter than it was a moment ago
        raise AnnulusError(f"{path}: cannot be read ({error}). Is it still being written?") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a recording.") from None


def open_part(path: Path) -> Recording:
    """One file alone, whichever part it is. Raises AnnulusError when it is no recording."""
    with opened(path) as (file, told):
        walk = Walk(file, told.st_size, _ATTACHED, LABEL_TOPIC)
        frames, labels, notes = _sorted_out(walk)
    if walk.compression:
        raise AnnulusError(
            f"{path}: its chunks are compressed with {walk.compression}. "
            "Decompress it first: mcap compress --compression none."
        )
    topics = {channel.topic for channel in walk.channels.values()}
    if not any(topic == LABEL_TOPIC or _camera_of(topic) is not None for topic in topics):
        raise AnnulusError(f"{path}: no {FRAME_TOPIC}/<camera> topic. Expected a recording made by annulus.")
    calibration, configuration, part, clock = (_attached(walk, name) for name in _ATTACHED)
    known = Clock.from_dict(clock)
    offset_ns = _offset(frames, labels) if known is None else known.offset_ns
    if offset_ns:
        frames = tuple(replace(frame, timestamp_ns=frame.timestamp_ns - offset_ns) for frame in frames)
    return Recording(
        path, frames, calibration, configuration, not walk.ended, labels, notes, tuple(walk.damage),
        tuple(walk.chunks), walk.data_crc, part=Part.from_dict(part), utc_offset_ns=offset_ns,
        cut_frames=walk.cut_messages,
    )  # fmt: skip


def _offset(frames: tuple[RecordedFrame, ...], labels: "_Labels") -> int:
    """From labels, which say when their frames were, where no clock is attached any more; 0 of recordings of before."""
    for frame in frames:
        said = labels.get((frame.index, frame.camera), {}).get("timestamp_ns")
        if type(said) is int:
            return frame.timestamp_ns - said
    return 0


def _camera_of(topic: str) -> int | None:
    """Whose frames come on a topic; None for one of something else."""
    if topic == FRAME_TOPIC:
        return 0
    name = topic.removeprefix(f"{FRAME_TOPIC}/")
    known = name != topic and name.isascii() and name.isdigit() and len(name) < 4 and int(name) <= CAMERA_ID_MAX
    return int(name) if known else None


def camera_of_label(label: object) -> int:
    """Which camera's frame a label is of; 0 where none is named. Raises ValueError for what is no label."""
    return untrusted.whole(untrusted.mapping(label, "label").get("camera", 0), "label: camera", 0, CAMERA_ID_MAX)


_Labels = dict[tuple[int, int], Mapping[str, Any]]  # by index and camera


def _sorted_out(walk: Walk) -> tuple[tuple[RecordedFrame, ...], _Labels, dict[str, tuple[Message, ...]]]:
    """What was walked over as frames, their labels, and notes by topic."""
    images: dict[tuple[int, int], Message] = {}
    labels: _Labels = {}
    labelled: dict[tuple[int, int], Chunk | None] = {}
    notes: dict[str, list[Message]] = {}
    for message in walk.messages:
        channel = walk.channels.get(message.channel)
        topic = "" if channel is None else channel.topic
        camera = _camera_of(topic)
        if channel is not None and channel.encoding != "json" and camera is None:
            continue  # for viewers
        if camera is not None:
            before = images.setdefault((message.sequence, camera), message)
            if before is not message and not walk.look_at(before.chunk) and walk.look_at(message.chunk):
                images[message.sequence, camera] = message
        elif topic:
            notes.setdefault(topic, []).append(message)
            if topic == LABEL_TOPIC:
                try:
                    label = from_json(walk.content(message))
                    key = message.sequence, camera_of_label(label)
                    if key not in labels or walk.look_at(message.chunk):
                        labels[key], labelled[key] = label, message.chunk
                except ValueError:
                    walk.look_at(message.chunk)
    for key in labelled.keys() ^ images.keys():  # they are written together
        walk.look_at(labelled[key] if key in labelled else images[key].chunk)
    frames = tuple(
        _frame(index, camera, message, labels.get((index, camera), {}), _is_jpeg(walk, message))
        for (index, camera), message in sorted(images.items())
    )
    return frames, labels, {topic: tuple(messages) for topic, messages in notes.items()}


def _is_jpeg(walk: Walk, message: Message) -> bool:
    channel = walk.channels.get(message.channel)
    return channel is not None and walk.schemas.get(channel.schema) == _JPEG


def _frame(index: int, camera: int, image: Message, label: Mapping[str, Any], jpeg: bool) -> RecordedFrame:
    name, z, roll = label.get("label"), label.get("z_mm"), label.get("roll_deg")
    known = Label(name) if name in [one.value for one in Label] else Label.UNKNOWN
    z_mm = float(z) if isinstance(z, int | float) and not isinstance(z, bool) and abs(z) <= Z_MAX_MM else math.nan
    if isinstance(roll, bool) or not isinstance(roll, int | float):
        roll = None
    bound, segment = label.get("z_bound_mm"), label.get("segment")
    return RecordedFrame(
        index, known if math.isfinite(z_mm) else Label.UNKNOWN, z_mm, image.time_ns, image.offset, image.length,
        roll if roll is None else float(roll), camera, image.chunk,
        z_bound_mm=float(bound) if isinstance(bound, int | float) and 0 < bound <= Z_MAX_MM else 0.0,
        segment=segment if type(segment) is int else 0,
        jpeg=jpeg,
    )  # fmt: skip


def _attached(walk: Walk, name: str) -> Mapping[str, Any] | None:
    try:
        content = untrusted.parse_json(walk.attachments[name], ATTACHMENT_MAX)
    except (KeyError, ValueError):
        return None
    return content if isinstance(content, dict) else None
