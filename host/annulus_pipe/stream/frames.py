"""What is said about a frame wherever it goes: to a worker, into the recording, to a viewer."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import msgpack

from annulus_pipe import untrusted
from annulus_pipe.controller import PREAMBLE_MAX
from annulus_pipe.vocabulary import CameraSequence, EdgeIndex, Label, Slot

CHANNELS = {
    "bgr8": 3,
    "bayer_rggb8": 1,
    "bayer_bggr8": 1,
    "bayer_grbg8": 1,
    "bayer_gbrg8": 1,
    "mono8": 1,
}  # encoding -> bytes a pixel, as foxglove.RawImage names them
SIDE_MAX = 16384  # pixels; a larger image is a damaged header
CAMERAS_MAX = 8
SEGMENT_MAX = 2**31 - 1
HEADER_MAX = 4096  # bytes of one packed header


@dataclass(frozen=True, slots=True)
class FrameHeader:
    """One camera frame and its label. `edge` is the edge whose flash lit it; what is not known is None."""

    index: int  # counts flashes the daemon has frames of, from 0: one camera's frames all differ, several's may share
    sequence: CameraSequence | None  # None where the driver does not count
    timestamp_ns: int  # the driver's, host monotonic clock
    label: Label
    reason: str  # why the label is unknown; empty otherwise
    edge: EdgeIndex | None
    slot: Slot | None  # place in the lamp cycle; of a preamble's frames none
    odometer: int | None  # quadrature counts since boot
    z_mm: float | None
    encoding: str
    width: int
    height: int
    roll_deg: float | None = None  # of the head, clockwise looking forward, where a sensor gives it
    camera: int = 0  # which of the head's, in the order of head.toml
    arrived_ns: int | None = None  # when the host had the frame, host monotonic clock
    z_assumed: bool = False  # z goes on from a gap in which nothing was counted: it was assumed ..
    z_bound_mm: float = 0.0  # .. and may be so far off
    segment: int = 0  # of z: begins anew with every such gap; within one, differences of z are counted

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the image array: (H, W, 3) for bgr8, (H, W) otherwise."""
        channels = CHANNELS[self.encoding]
        return (self.height, self.width, channels) if channels > 1 else (self.height, self.width)

    @property
    def size(self) -> int:
        """Bytes of the image."""
        return self.height * self.width * CHANNELS[self.encoding]

    def to_dict(self) -> dict[str, Any]:
        return {**asdict(self), "label": self.label.value}

    def pack(self) -> bytes:
        packed: bytes = msgpack.packb(self.to_dict())
        return packed

    @classmethod
    def from_dict(cls, data: object) -> "FrameHeader":
        """Check and convert. Raises ValueError naming the field that is wrong."""
        if not isinstance(data, Mapping):
            raise ValueError("frame header must be a mapping")
        label, encoding, reason = data.get("label"), data.get("encoding"), data.get("reason")
        if label not in [known.value for known in Label]:
            raise ValueError(
                f"frame header: label is {untrusted.shown(label)}, expected one of {[known.value for known in Label]}"
            )
        if not isinstance(encoding, str) or encoding not in CHANNELS:
            raise ValueError(f"frame header: encoding is {untrusted.shown(encoding)}, expected one of {list(CHANNELS)}")
        if not isinstance(reason, str) or len(reason) > 200:
            raise ValueError("frame header: reason must be a text of at most 200 characters")
        edge, slot = _whole(data, "edge", 0, 2**32 - 1), _whole(data, "slot", 0, PREAMBLE_MAX - 1)
        sequence = _whole(data, "sequence", 0, 2**63)
        return cls(
            index=_need(data, "index", 0, 2**32 - 1),
            sequence=None if sequence is None else CameraSequence(sequence),
            timestamp_ns=_need(data, "timestamp_ns", 0, 2**63),
            label=Label(label),
            reason=reason,
            edge=None if edge is None else EdgeIndex(edge),
            slot=None if slot is None else Slot(slot),
            odometer=_whole(data, "odometer", -(2**31), 2**31 - 1),
            z_mm=_length(data, "z_mm"),
            encoding=str(encoding),
            width=_need(data, "width", 1, SIDE_MAX),
            height=_need(data, "height", 1, SIDE_MAX),
            roll_deg=_length(data, "roll_deg"),
            camera=_whole(data, "camera", 0, CAMERAS_MAX - 1) or 0,  # headers from before there were several have none
            arrived_ns=_whole(data, "arrived_ns", 0, 2**63),
            z_assumed=_flag(data, "z_assumed"),
            z_bound_mm=_length(data, "z_bound_mm") or 0.0,
            segment=_whole(data, "segment", 0, SEGMENT_MAX) or 0,
        )

    @classmethod
    def unpack(cls, packed: bytes) -> "FrameHeader":
        """Raises ValueError on anything but one well-formed header."""
        return cls.from_dict(untrusted.unpack(packed, HEADER_MAX))


def _whole(data: Mapping[str, Any], key: str, low: int, high: int) -> int | None:
    value = data.get(key)
    return None if value is None else untrusted.whole(value, f"frame header: {key}", low, high)


def _need(data: Mapping[str, Any], key: str, low: int, high: int) -> int:
    return untrusted.whole(data.get(key), f"frame header: {key}", low, high)


def _flag(data: Mapping[str, Any], key: str) -> bool:
    value = data.get(key, False)
    if not isinstance(value, bool):
        raise ValueError(f"frame header: {key} is {value!r}, expected true or false")
    return value


def _length(data: Mapping[str, Any], key: str) -> float | None:
    value = data.get(key)
    return None if value is None else untrusted.number(value, f"frame header: {key}", 1e9)
