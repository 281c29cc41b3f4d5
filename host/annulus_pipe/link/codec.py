"""Frames of the wire: COBS, CRC, identity and length. Bytes in any chunks go in, checked messages come out.

A frame is COBS(body) and a zero; a body is id, sequence (u8 for a command and its reply, u16 and the boot byte for an
event, none for a notice), payload, CRC-16. The rules are protocol/README.md's.
"""

import binascii
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from annulus_pipe.link.fields import Message
from annulus_pipe.link.messages import COMMANDS, EVENTS, MAX_WIRE, NOTICES, REPLIES, REPLY_BIT, Event, Notice

TO_CONTROLLER: Mapping[int, type[Message]] = COMMANDS
TO_HOST: Mapping[int, type[Message]] = {**REPLIES, **EVENTS, **NOTICES}
_CRC_BYTES = 2
EVENTS_FROM, _NOTICES_FROM = 0x80, 0xF0  # ids
_EVENT_HEADER = 4  # bytes: id and what follows it before the payload
_HEADER = {  # .. by id
    **dict.fromkeys((*COMMANDS, *REPLIES), 2),
    **dict.fromkeys(EVENTS, _EVENT_HEADER),
    **dict.fromkeys(NOTICES, 1),
}
_BYTES = tuple(bytes((value,)) for value in range(256))


class CorruptReason(StrEnum):
    """What was wrong with bytes that came."""

    COBS = "cobs"  # a code byte points past the frame
    TOO_LONG = "too_long"  # longer than any frame may be
    LENGTH = "length"  # not the length its id has
    CRC = "crc"
    ID = "id"  # nobody has this id, or not in this direction
    VALUE = "value"  # CRC right, but a field holds what the schema does not define


@dataclass(frozen=True, slots=True)
class Frame:
    """One message that passed every check."""

    message: Message
    sequence: int  # 0..255, an event's 0..65535, a notice's 0
    boot: int = 0  # events only


@dataclass(frozen=True, slots=True)
class Corrupt:
    """Bytes up to a delimiter that were no message."""

    why: CorruptReason
    size: int  # bytes without the delimiter


@dataclass(frozen=True, slots=True)
class Unknown:
    """A message of a newer controller: whole, by its CRC, but of an id or with a value this host does not know."""

    identity: int
    sequence: int | None  # of an event or a reply
    boot: int  # of an event


def crc16(body: bytes, schema_byte: int) -> int:
    """CRC-16, polynomial 0x1021, init 0xFFFF, xorout 0xFFFF, over the body and one schema byte.

    The xorout is not decoration: without it one dropped zero byte can go unseen.
    """
    return binascii.crc_hqx(_BYTES[schema_byte], binascii.crc_hqx(body, 0xFFFF)) ^ 0xFFFF


def encode(frame: Frame) -> bytes:
    """The frame as it crosses the wire, delimiter included."""
    message = frame.message
    if isinstance(message, Event):
        header = bytes((message.ID, frame.sequence & 0xFF, frame.sequence >> 8, frame.boot))
    elif isinstance(message, Notice):
        header = bytes((message.ID,))
    else:
        header = bytes((message.ID, frame.sequence))
    body = header + message.pack()
    return _stuff(body + crc16(body, message.SCHEMA_BYTE).to_bytes(2, "little")) + b"\0"


def decode(stuffed: bytes, accepted: Mapping[int, type[Message]] = TO_HOST) -> Frame | Corrupt | Unknown:
    """One frame without its delimiter. Never raises: whatever comes, it is a Frame, Unknown or Corrupt."""
    if len(stuffed) >= MAX_WIRE:
        return Corrupt(CorruptReason.TOO_LONG, len(stuffed))
    body = _unstuff(stuffed)
    if body is None:
        return Corrupt(CorruptReason.COBS, len(stuffed))
    if len(body) < 2 + _CRC_BYTES:
        return Corrupt(CorruptReason.LENGTH, len(stuffed))
    kind = accepted.get(body[0])
    if kind is None:
        newer = body[0] >= REPLY_BIT and accepted is TO_HOST and _is_whole(body)
        return _unknown(body) if newer else Corrupt(CorruptReason.ID, len(stuffed))
    header = _HEADER[body[0]]
    if len(body) != header + kind.LENGTH + _CRC_BYTES:
        return Corrupt(CorruptReason.LENGTH, len(stuffed))
    content, crc = body[:-_CRC_BYTES], int.from_bytes(body[-_CRC_BYTES:], "little")
    if crc16(content, kind.SCHEMA_BYTE) != crc:
        return Corrupt(CorruptReason.CRC, len(stuffed))
    try:
        message = kind.unpack(content[header:])
    except ValueError:
        return _unknown(body) if accepted is TO_HOST else Corrupt(CorruptReason.VALUE, len(stuffed))
    sequence = int.from_bytes(content[1:3], "little") if header == 4 else content[1] if header == 2 else 0
    return Frame(message, sequence, content[3] if header == 4 else 0)


class Decoder:
    """Cuts a byte stream at its delimiters. Holds at most one frame; what is longer is thrown away to the next zero."""

    def __init__(self, accepted: Mapping[int, type[Message]] = TO_HOST) -> None:
        self._accepted = accepted
        self._held = bytearray()
        self._dropped = 0  # bytes thrown away of a frame that is too long

    def feed(self, data: bytes) -> list[Frame | Corrupt | Unknown]:
        """Everything that `data` completes, in order. Two zeros in a row are no frame and no error."""
        found: list[Frame | Corrupt | Unknown] = []
        if not data:
            return found
        *complete, rest = data.split(b"\0")
        for part in complete:
            if not self._held and not self._dropped and len(part) <= MAX_WIRE:  # whole: nothing to be held
                if part:
                    found.append(decode(bytes(part), self._accepted))
                continue
            self._hold(part)
            if self._dropped:
                found.append(Corrupt(CorruptReason.TOO_LONG, self._dropped + len(self._held)))
            elif self._held:
                found.append(decode(bytes(self._held), self._accepted))
            self._held.clear()
            self._dropped = 0
        self._hold(rest)
        return found

    def _hold(self, part: bytes) -> None:
        room = MAX_WIRE - len(self._held)
        self._held += part[:room]
        self._dropped += len(part) - min(room, len(part))


def _is_whole(body: bytes) -> bool:
    """Whether some schema byte makes the CRC right: of damaged frames one in 256 has one."""
    content, crc = body[:-_CRC_BYTES], int.from_bytes(body[-_CRC_BYTES:], "little")
    return any(crc16(content, schema_byte) == crc for schema_byte in range(256))


def _unknown(body: bytes) -> Unknown:
    if body[0] >= EVENTS_FROM:
        has_sequence = len(body) >= _EVENT_HEADER + _CRC_BYTES and body[0] < _NOTICES_FROM
        return Unknown(body[0], int.from_bytes(body[1:3], "little") if has_sequence else None, body[3])
    return Unknown(body[0], body[1], 0)


def _stuff(body: bytes) -> bytes:
    """COBS: every zero replaced by the distance to the next. No body reaches 254 bytes: one code byte more."""
    return b"".join(bytes((len(run) + 1,)) + run for run in body.split(b"\0"))


def _unstuff(stuffed: bytes) -> bytes | None:
    """The body, or None where a code byte points past the end. `stuffed` holds no zero."""
    runs, at, size = [], 0, len(stuffed)
    while at < size:
        end = at + stuffed[at]
        if end == at or end > size:
            return None
        runs.append(stuffed[at + 1 : end])
        at = end
    return b"\0".join(runs)
