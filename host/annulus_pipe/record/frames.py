"""Frames, labels and notes of a recording, out of the messages of its file, whoever says what those are.

What the topics hold: recording.py.

Frames go by index and camera. Two scans that somebody joined in one file (`mcap merge`) have the same, and would give
each other their labels while every chunk is as it was written. So what lies there twice in sound chunks, or was
measured on two clocks, is no recording of one scan. Parts of one scan may be joined: they share numbers and clock.
"""

import base64
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from annulus_pipe import untrusted
from annulus_pipe.record.index import Contents
from annulus_pipe.record.walk import Chunk, MessageLocation
from annulus_pipe.vocabulary import AnnulusError, Label

FRAME_TOPIC = "/frame"  # .. of camera 0 in old recordings; now followed by the camera's id
LABEL_TOPIC = "/label"
DROPS_TOPIC = "/drops"
IDENTITY, EVIDENCE = "/identity", "/evidence"
CAMERA_ID_MAX = 255
Z_MAX_MM = 1e8  # of a place; beyond is damage
_JSON_MAX = 1 << 24
_JPEG = "foxglove.CompressedImage"
Labels = dict[tuple[int, int], Mapping[str, Any]]  # by index and camera


CLOCKS_APART_NS = 1_000_000  # cameras of one scan stamp closer together than clocks that were read twice


class TwoScansError(AnnulusError):
    """A file holds more than one scan; the text says by what that is seen."""


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


def frame_name(index: int, camera: int) -> str:
    """As messages name a frame."""
    return f"frame {index} of camera {camera}" if camera else f"frame {index}"


def offset_of(frames: tuple[RecordedFrame, ...], labels: Labels) -> int:
    """From labels, which say when their frames were, where no clock is attached any more; 0 of recordings of before."""
    for frame in frames:
        stated_ns = labels.get((frame.index, frame.camera), {}).get("timestamp_ns")
        if type(stated_ns) is int:
            return frame.timestamp_ns - stated_ns
    return 0


def camera_of(topic: str) -> int | None:
    """Whose frames come on a topic; None for one of something else."""
    if topic == FRAME_TOPIC:
        return 0
    name = topic.removeprefix(f"{FRAME_TOPIC}/")
    known = name != topic and name.isascii() and name.isdigit() and len(name) < 4 and int(name) <= CAMERA_ID_MAX
    return int(name) if known else None


def camera_of_label(label: object) -> int:
    """Which camera's frame a label is of; 0 where none is named. Raises ValueError for what is no label."""
    return untrusted.whole(untrusted.mapping(label, "label").get("camera", 0), "label: camera", 0, CAMERA_ID_MAX)


def sorted_out(walk: Contents) -> tuple[tuple[RecordedFrame, ...], Labels, dict[str, tuple[MessageLocation, ...]]]:
    """What was walked over as frames, their labels, and notes by topic. Raises TwoScansError."""
    images: dict[tuple[int, int], MessageLocation] = {}
    labels: Labels = {}
    labelled: dict[tuple[int, int], Chunk | None] = {}
    notes: dict[str, list[MessageLocation]] = {}
    for message in walk.messages:
        channel = walk.channels.get(message.channel)
        topic = "" if channel is None else channel.topic
        camera = camera_of(topic)
        if channel is not None and channel.encoding != "json" and camera is None:
            continue  # for viewers
        if camera is not None:
            before = images.setdefault((message.sequence, camera), message)
            if before is not message and walk.look_at(message.chunk):
                if walk.look_at(before.chunk):
                    raise TwoScansError(f"{frame_name(message.sequence, camera)} is there twice")
                images[message.sequence, camera] = message
        elif topic:
            notes.setdefault(topic, []).append(message)
            if topic == LABEL_TOPIC:
                try:
                    label = from_json(walk.content(message))
                    key = message.sequence, camera_of_label(label)
                    other = key in labels and label != labels[key] and _is_label(label) and _is_label(labels[key])
                    if other and _both_sound(walk, labelled[key], message.chunk):
                        raise TwoScansError(f"{frame_name(*key)} has two labels")
                    if key not in labels or walk.look_at(message.chunk):
                        labels[key], labelled[key] = label, message.chunk
                except ValueError:
                    walk.look_at(message.chunk)
    for key in labelled.keys() ^ images.keys():  # they are written together
        walk.look_at(labelled[key] if key in labelled else images[key].chunk)
    shared = [key for key in images if key in labels]
    cameras = [[key for key in shared if key[1] == camera] for camera in {key[1] for key in shared}]
    for keys, apart_ns in (*((keys, 0) for keys in cameras), ([keys[0] for keys in cameras], CLOCKS_APART_NS)):
        _check_one(walk, _later, "their labels are of two clocks", keys, images, labels, labelled, apart_ns)
    _check_one(walk, _shift, "labels name other frames", shared, images, labels, labelled)
    frames = tuple(
        _frame(index, camera, message, labels.get((index, camera), {}), _is_jpeg(walk, message))
        for (index, camera), message in sorted(images.items())
    )
    return frames, labels, {topic: tuple(messages) for topic, messages in notes.items()}


def _is_label(label: Mapping[str, Any]) -> bool:
    """Whether a scan's writer made it, and not somebody who put anything there."""
    return type(label.get("timestamp_ns")) is int


def _both_sound(walk: Contents, one: Chunk | None, other: Chunk | None) -> bool:
    return walk.look_at(one) and walk.look_at(other)


def _later(message: MessageLocation, label: Mapping[str, Any]) -> int | None:
    """What a frame's message is later than its label says, ns: of one camera's frames always the same. None: not
    known.
    """
    stamp_ns = label.get("timestamp_ns")
    return message.time_ns - stamp_ns if type(stamp_ns) is int and message.time_ns else None  # 0: before 1970, cut off


def _shift(message: MessageLocation, label: Mapping[str, Any]) -> int | None:
    labelled = label.get("index")
    return message.sequence - labelled if type(labelled) is int else None


def _check_one(
    walk: Contents,
    witness: Callable[[MessageLocation, Mapping[str, Any]], int | None],
    what: str,
    keys: list[tuple[int, int]],
    images: Mapping[tuple[int, int], MessageLocation],
    labels: Labels,
    labelled: Mapping[tuple[int, int], Chunk | None],
    apart: int = 0,
) -> None:
    """Raises TwoScansError where sound frames say more than one thing, `apart` or more, of what one scan has one of."""
    differences = {key: value for key in keys if (value := witness(images[key], labels[key])) is not None}
    if not differences or max(differences.values()) - min(differences.values()) <= apart:
        return
    sound: dict[int, tuple[int, int]] = {}
    for key, value in differences.items():
        if value not in sound and _both_sound(walk, images[key].chunk, labelled[key]):
            sound[value] = key
    if len(sound) > 1:
        names = [frame_name(*key) for key in sound.values()]
        raise TwoScansError(f"{names[0]} and {names[1]}: {what}")


def _is_jpeg(walk: Contents, message: MessageLocation) -> bool:
    channel = walk.channels.get(message.channel)
    return channel is not None and walk.schemas.get(channel.schema) == _JPEG


def _frame(index: int, camera: int, image: MessageLocation, label: Mapping[str, Any], jpeg: bool) -> RecordedFrame:
    known, z_mm, roll_deg, bound_mm, segment = place_of(label)
    return RecordedFrame(
        index,
        known,
        math.nan if z_mm is None else z_mm,
        image.time_ns,
        image.offset,
        image.length,
        roll_deg,
        camera,
        image.chunk,
        z_bound_mm=bound_mm,
        segment=segment,
        jpeg=jpeg,
    )


_Place = tuple[Label, float | None, float | None, float, int]


def place_of(label: Mapping[str, Any]) -> _Place:
    """What a label says of a frame: what lit it, z (mm) and roll (degrees) where they are known, z's bound, segment."""
    name, z, roll = label.get("label"), label.get("z_mm"), label.get("roll_deg")
    known = Label(name) if name in [one.value for one in Label] else Label.UNKNOWN
    placed = isinstance(z, int | float) and not isinstance(z, bool) and abs(z) <= Z_MAX_MM
    if isinstance(roll, bool) or not isinstance(roll, int | float):
        roll = None
    segment = label.get("segment")
    return (
        known if placed else Label.UNKNOWN,
        float(z) if placed else None,  # type: ignore[arg-type]
        roll if roll is None else float(roll),
        _bound(label.get("z_bound_mm"), label.get("z_assumed") is True),
        segment if type(segment) is int else 0,
    )


def _bound(bound_mm: object, assumed: bool) -> float:
    """0 where it was counted. A bound that is none, of an assumed place, is as far as any pipe: not 0."""
    if isinstance(bound_mm, int | float) and not isinstance(bound_mm, bool) and bound_mm > 0:
        return float(min(bound_mm, Z_MAX_MM))
    return Z_MAX_MM if assumed else 0.0


def placed_of(frame: RecordedFrame) -> _Place:
    """The same of a frame."""
    z_mm = frame.z_mm if math.isfinite(frame.z_mm) else None
    return frame.label, z_mm, frame.roll_deg, frame.z_bound_mm, frame.segment
