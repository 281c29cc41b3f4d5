"""A frame held against the index that named it: what its own chunk says of it and of its label goes before the index.

An index is not the recording. So when a frame is read, and its chunk's records are at hand anyway, the message at its
place must be a frame of that number, camera and time, and the label beside it must be the label that was given out
with it. Where it is not, the frame is damaged: an error line, and never a wrong label.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import IO, Any

from annulus_pipe.record.frames import (
    LABEL_TOPIC,
    Labels,
    RecordedFrame,
    camera_of,
    camera_of_label,
    from_json,
    place_of,
    placed_of,
)
from annulus_pipe.record.index import Notes
from annulus_pipe.record.indexed import Indexed
from annulus_pipe.record.walk import Channel, DamagedError, MessageLocation, piece
from annulus_pipe.vocabulary import Label

_HEAD = struct.Struct("<BQHIQQ")  # of a message: opcode, length, channel, sequence, log time, publish time
_RECORD = struct.Struct("<BQ")
_MESSAGE = 5


@dataclass(frozen=True, slots=True)
class Followed:
    """What of an index is needed once a recording is open."""

    channels: Mapping[int, Channel]
    notes: Notes
    apart: Mapping[
        tuple[int, int], MessageLocation
    ]  # labels that lie in another chunk than their frame: other programs' files

    def bare(self) -> "Followed":
        """What frames are held against, without the notes."""
        return replace(self, notes=Notes({}))

    def hold(
        self, file: IO[bytes], frame: RecordedFrame, records: bytes, label: Mapping[str, Any], offset_ns: int
    ) -> None:
        """Raises DamagedError where the frame's own chunk says otherwise.

        records : of that chunk. label : what was said of the frame; empty where only the frame is at hand.
        """
        labelled = seen = False
        if frame.chunk is None:
            seen = self._is_frame(piece(file, frame.offset - _HEAD.size, _HEAD.size), frame, offset_ns)
        else:
            base, at = 0 if frame.chunk.size else frame.chunk.offset, 0
            while at + _RECORD.size <= len(records):
                opcode, length = _RECORD.unpack_from(records, at)
                if opcode == _MESSAGE and at + _HEAD.size <= len(records):
                    head = records[at : at + _HEAD.size]
                    if base + at + _HEAD.size == frame.offset:
                        seen = self._is_frame(head, frame, offset_ns)
                    else:
                        labelled |= self._is_label(head, records[at + _HEAD.size : at + 9 + length], frame, label)
                at += _RECORD.size + length
        apart = self.apart.get((frame.index, frame.camera))
        if apart is not None:
            content = (
                piece(file, apart.offset, apart.length)
                if apart.chunk is None
                else bytes(apart.chunk.within(apart.chunk.read(file), apart.offset, apart.length))
            )
            head = _HEAD.pack(_MESSAGE, _HEAD.size - 9 + apart.length, apart.channel, apart.sequence, 0, 0)
            labelled = self._is_label(head, content, frame, label)
        if not seen or not (labelled or frame.label is Label.UNKNOWN):
            raise DamagedError("the index says otherwise than the records")

    def _is_frame(self, head: bytes, frame: RecordedFrame, offset_ns: int) -> bool:
        opcode, length, number, sequence, time_ns, _ = _HEAD.unpack(head)
        channel = self.channels.get(number)
        return (
            opcode == _MESSAGE
            and length == _HEAD.size - _RECORD.size + frame.length
            and sequence == frame.index
            and time_ns - offset_ns == frame.timestamp_ns
            and channel is not None
            and camera_of(channel.topic) == frame.camera
        )

    def _is_label(self, head: bytes, content: bytes, frame: RecordedFrame, label: Mapping[str, Any]) -> bool:
        """Whether that is the frame's label. DamagedError where it is, and says otherwise."""
        _, _, number, sequence, _, _ = _HEAD.unpack(head)
        channel = self.channels.get(number)
        if channel is None or channel.topic != LABEL_TOPIC or sequence != frame.index:
            return False
        try:
            parsed = from_json(content)
            if camera_of_label(parsed) != frame.camera:
                return False
        except ValueError:
            return False
        if place_of(parsed) != placed_of(frame) or (label and parsed != label):
            raise DamagedError("the index says otherwise of its label than the records")
        return True


def followed(
    found: Indexed, frames: Sequence[RecordedFrame], labels: Labels, notes: Mapping[str, Sequence[MessageLocation]]
) -> Followed | None:
    """None where an index has more than one frame or label of a name: only a walk says which of them counts."""
    cameras = {number for number, one in found.channels.items() if camera_of(one.topic) is not None}
    if sum(message.channel in cameras for message in found.messages) != len(frames):
        return None
    messages = notes.get(LABEL_TOPIC, ())
    if len(messages) != len(labels):
        return None
    beside = {(frame.index, frame.chunk.offset) for frame in frames if frame.chunk is not None}
    apart = {
        key: message
        for message, key in zip(messages, labels, strict=True)
        if message.chunk is None or (key[0], message.chunk.offset) not in beside
    }
    return Followed(dict(found.channels), found.notes, apart)
