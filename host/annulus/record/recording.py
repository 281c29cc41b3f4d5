"""A recording read back: one scan in one .mcap file, whatever a crash or a full disk left of it.

Topics: `/frame/<camera>` (foxglove.RawImage, protobuf) and JSON `/label`, `/profile`, `/telemetry`, `/event`,
`/sensor/<name>` and whatever else is noted. A frame and its label share the message sequence number, which is the
frame's index; the label says which camera it is of, and lies before its frame in one uncompressed chunk. Frames of one
index belong to one flash. Bytes inside JSON are {"base64": ".."}. Attachments: `calibration.json`,
`configuration.json`. Recordings of before there was more than one camera have `/frame`: camera 0.
"""

import base64
import contextlib
import json
import math
import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError

from annulus import untrusted
from annulus.numeric.arrays import Image
from annulus.stream.frames import CHANNELS
from annulus.vocabulary import AnnulusError, Label

FRAME_TOPIC = "/frame"  # .. of camera 0 in old recordings; now followed by the camera's id
LABEL_TOPIC = "/label"
CAMERA_ID_MAX = 255
_MAGIC = b"\x89MCAP0\r\n"
_JSON_MAX = 1 << 24
_RECORD_MAX = 1 << 30
_RECORD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT = 0x02, 0x04, 0x05, 0x06, 0x09


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
        return base64.b64decode(item["base64"]) if item.keys() == {"base64"} else item

    if len(data) > _JSON_MAX:
        raise ValueError(f"{len(data)} bytes of JSON")
    return json.loads(data, object_hook=bytes_again)


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One frame in a recording; `offset`, `length`: its protobuf message in the file."""

    index: int
    label: Label
    z_mm: float  # NaN where not known
    timestamp_ns: int
    offset: int
    length: int
    roll_deg: float | None = None  # of the head, clockwise looking forward, where its label says so
    camera: int = 0


@dataclass(frozen=True, slots=True)
class Recording:
    """An opened recording. `torn`: the file ends in the middle; everything whole before that is here."""

    path: Path
    frames: tuple[RecordedFrame, ...]  # by index, then camera
    calibration: Mapping[str, Any] | None
    configuration: Mapping[str, Any] | None
    torn: bool
    _labels: Mapping[tuple[int, int], Mapping[str, Any]] = field(repr=False)  # (index, camera) -> as it was written
    _notes: Mapping[str, tuple[tuple[int, int], ...]] = field(repr=False)  # topic -> (offset, length)

    @property
    def cameras(self) -> tuple[int, ...]:
        """Ids of the cameras that have a frame here, rising."""
        return tuple(sorted({frame.camera for frame in self.frames}))

    def label(self, frame: RecordedFrame) -> Mapping[str, Any]:
        """What was written of a frame with its label; empty where the label was lost."""
        return self._labels.get((frame.index, frame.camera), {})

    def notes(self, topic: str) -> Iterator[Any]:
        """The records of one JSON topic, like "/event" or "/sensor/imu", in order; malformed ones are left out."""
        with self.path.open("rb") as file:
            for offset, length in self._notes.get(topic, ()):
                try:
                    yield from_json(_slice(file, offset, length))
                except ValueError:
                    continue

    def read_raw(self, frame: RecordedFrame) -> tuple[Image, str]:
        """The image as the camera gave it, and its encoding. Raises AnnulusError when the bytes are damaged."""
        where = f"{self.path}: {frame_name(frame.index, frame.camera)}"
        with self.path.open("rb") as file:
            data = _slice(file, frame.offset, frame.length)
        raw = RawImage()
        try:
            raw.ParseFromString(data)
        except DecodeError:
            raise AnnulusError(f"{where} is damaged: not a foxglove.RawImage.") from None
        channels = CHANNELS.get(raw.encoding)
        if channels is None:
            raise AnnulusError(f"{where} is encoded as {raw.encoding!r}, expected one of {', '.join(CHANNELS)}.")
        if not raw.width or not raw.height or len(raw.data) != raw.width * raw.height * channels:
            raise AnnulusError(
                f"{where} is damaged: {len(raw.data)} bytes for {raw.width}x{raw.height} pixels of {channels} bytes."
            )
        shape = (raw.height, raw.width, channels) if channels > 1 else (raw.height, raw.width)
        return np.frombuffer(raw.data, np.uint8).reshape(shape), raw.encoding

    def read(self, frame: RecordedFrame) -> Image:
        """The image as (H, W, 3) BGR, demosaiced where the camera gave a mosaic."""
        return to_bgr(*self.read_raw(frame))


def frame_name(index: int, camera: int) -> str:
    """As messages name a frame."""
    return f"frame {index} of camera {camera}" if camera else f"frame {index}"


def to_bgr(image: Image, encoding: str) -> Image:
    """(H, W, 3) BGR from any encoding of CHANNELS. bayer_rggb8 has R at (0, 0)."""
    import cv2  # not by whom writes only: a recorder has to be up at once

    if encoding == "bayer_rggb8":
        return cast(Image, cv2.cvtColor(image, cv2.COLOR_BayerRGGB2BGR))
    if encoding == "mono8":
        return cast(Image, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    return image


def open_recording(path: Path) -> Recording:
    """Index a recording by walking its records; needs no footer. Raises AnnulusError when it is none."""
    walk = _Walk()
    try:
        with path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise AnnulusError(f"{path}: not an MCAP recording.")
            with contextlib.suppress(struct.error, EOFError, ValueError):  # damaged from there on, whole before
                walk.records(file, len(_MAGIC), os.fstat(file.fileno()).st_size)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a recording.") from None
    if walk.compression:
        raise AnnulusError(
            f"{path}: its chunks are compressed with {walk.compression}. "
            "Decompress it first: mcap compress --compression none."
        )
    if not any(topic == LABEL_TOPIC or _camera_of(topic) is not None for topic in walk.channels.values()):
        raise AnnulusError(f"{path}: no {FRAME_TOPIC}/<camera> topic. Expected a recording made by annulus.")
    return Recording(
        path, tuple(walk.frames()), walk.attached("calibration.json"), walk.attached("configuration.json"),
        not walk.ended, walk.labels, {topic: tuple(places) for topic, places in walk.notes.items()},
    )  # fmt: skip


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


class _Walk:
    """Goes through a file record by record, remembering where things are. Images are stepped over."""

    def __init__(self) -> None:
        self.channels: dict[int, str] = {}
        self.notes: dict[str, list[tuple[int, int]]] = {}
        self.labels: dict[tuple[int, int], Mapping[str, Any]] = {}  # by index and camera
        self.images: dict[tuple[int, int], tuple[int, int, int]] = {}  # the same -> time, offset, length
        self.attachments: dict[str, bytes] = {}
        self.compression = ""
        self.ended = False

    def records(self, file: IO[bytes], start: int, end: int) -> None:
        at = start
        while at + _RECORD.size <= end and not self.ended:
            opcode, length = _RECORD.unpack(_slice(file, at, _RECORD.size))
            at += _RECORD.size
            if opcode == _CHUNK:
                self._chunk(file, at, min(at + length, end))  # of a torn chunk, the messages that are whole
            elif at + length > end:
                return
            elif opcode == _MESSAGE and length >= _MESSAGE_HEAD.size:
                self._message(file, at, length)
            elif opcode == _CHANNEL:
                self._channel(_slice(file, at, length))
            elif opcode == _ATTACHMENT:
                self._attachment(_slice(file, at, length))
            elif opcode == _FOOTER:
                self.ended = True
            at += length

    def _chunk(self, file: IO[bytes], at: int, end: int) -> None:
        (name_length,) = struct.unpack("<I", _slice(file, at + _CHUNK_HEAD.size, 4))
        compression = _slice(file, at + _CHUNK_HEAD.size + 4, min(name_length, 64)).decode()
        if compression:
            self.compression = compression
            return
        self.records(file, at + _CHUNK_HEAD.size + 4 + name_length + 8, end)

    def _channel(self, data: bytes) -> None:
        number, _schema, length = struct.unpack_from("<HHI", data)
        self.channels[number] = data[8 : 8 + length].decode()

    def _message(self, file: IO[bytes], at: int, length: int) -> None:
        number, sequence, time_ns, _ = _MESSAGE_HEAD.unpack(_slice(file, at, _MESSAGE_HEAD.size))
        topic = self.channels.get(number, "")
        offset, size = at + _MESSAGE_HEAD.size, length - _MESSAGE_HEAD.size
        camera = _camera_of(topic)
        if camera is not None:
            self.images[sequence, camera] = time_ns, offset, size
        elif topic:
            self.notes.setdefault(topic, []).append((offset, size))
            if topic == LABEL_TOPIC:
                try:
                    label = from_json(_slice(file, offset, size))
                    self.labels[sequence, camera_of_label(label)] = label
                except ValueError:
                    return

    def _attachment(self, data: bytes) -> None:
        (name_length,) = struct.unpack_from("<I", data, 16)
        name = data[20 : 20 + name_length].decode()
        at = 20 + name_length
        (media_length,) = struct.unpack_from("<I", data, at)
        at += 4 + media_length
        (size,) = struct.unpack_from("<Q", data, at)
        self.attachments[name] = data[at + 8 : at + 8 + size]

    def frames(self) -> Iterator[RecordedFrame]:
        for (index, camera), (time_ns, offset, length) in sorted(self.images.items()):
            label = self.labels.get((index, camera), {})
            name, z, roll = label.get("label"), label.get("z_mm"), label.get("roll_deg")
            known = Label(name) if name in {one.value for one in Label} else Label.UNKNOWN
            z_mm = float(z) if isinstance(z, int | float) and not isinstance(z, bool) else math.nan
            if isinstance(roll, bool) or not isinstance(roll, int | float) or not math.isfinite(roll):
                roll = None
            yield RecordedFrame(
                index, known if math.isfinite(z_mm) else Label.UNKNOWN, z_mm, time_ns, offset, length,
                roll if roll is None else float(roll), camera,
            )  # fmt: skip

    def attached(self, name: str) -> Mapping[str, Any] | None:
        try:
            content = json.loads(self.attachments[name])
        except (KeyError, ValueError):
            return None
        return content if isinstance(content, dict) else None


def _slice(file: IO[bytes], offset: int, length: int) -> bytes:
    if length > _RECORD_MAX:
        raise ValueError(f"a record of {length} bytes")
    file.seek(offset)
    data = file.read(length)
    if len(data) != length:
        raise EOFError
    return data
