"""A walk through the records of an MCAP file: what is where, with no index needed, and nothing believed for its length.

Records lie one behind the other, each an opcode, its length and its content; messages lie in chunks, and a chunk has a
checksum. The walk reads heads and steps over images, so it cannot know whether a chunk is sound: whoever reads from a
chunk checks it (`Chunk.read`). Where no record can begin the walk goes on at the next chunk, and says so. Channels say
whose messages are whose, so a chunk that names channels is checked at once, and believed only if it is sound; the
summary at the end of a finished file names them again.
"""

import re
import struct
import zlib
from dataclasses import dataclass
from typing import IO

from annulus.vocabulary import AnnulusError

MAGIC = b"\x89MCAP0\r\n"
RECORD_MAX = 1 << 30  # bytes that are read at once
ATTACHMENT_MAX = 1 << 24
DAMAGE_MAX = 1000  # places that are named
_RECORD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, bytes, checksum, length of the compression's name
_COUNTS = struct.Struct("<QHII")  # of the summary: messages, schemas, channels, attachments
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _STATISTICS, _DATA_END = 2, 3, 4, 5, 6, 9, 11, 15
_FOOTER_BYTES = 20
_PRIVATE = 0x80  # opcodes from here on are for anybody, and passed over
_CHUNK_LIKE = re.compile(rb"\x06(?=.{5}\0\0\0.{28}\0\0\0\0)", re.DOTALL)  # below a TiB, uncompressed
_LOOK_AHEAD = _RECORD.size + _CHUNK_HEAD.size + 8
_BLOCK = 1 << 20
_Place = tuple[int, int, int, int, int]  # of a message: channel, sequence, time, offset, length


class DamagedError(AnnulusError):
    """What was written cannot be read back. The rest of the file can."""


@dataclass(frozen=True, slots=True)
class Damage:
    """A place in a file that does not hold what was written."""

    offset: int
    text: str
    messages: int | None = None  # lost with it, where that is known


@dataclass(frozen=True, slots=True)
class Chunk:
    """Records under one checksum. `offset`, `length`: where they lie in the file."""

    offset: int
    length: int
    crc: int | None  # None: there is none, or the file ends before the chunk does
    messages: int

    def read(self, file: IO[bytes]) -> bytes:
        """The records. Raises DamagedError where they are not what was written."""
        data = piece(file, self.offset, self.length)
        if self.crc is not None and zlib.crc32(data) != self.crc:
            raise DamagedError(f"the chunk at byte {self.offset} has the wrong checksum, {self.messages} messages lost")
        return data


@dataclass(frozen=True, slots=True)
class Message:
    """Where one message lies. `channel` is a number until the walk is over."""

    channel: int
    sequence: int
    time_ns: int
    offset: int
    length: int
    chunk: Chunk | None  # None: of a file without chunks


class Walk:
    """`walk = Walk(file, size)`: channels, messages in the file's order, attachments, what is damaged."""

    def __init__(self, file: IO[bytes], size: int, wanted: tuple[str, ...]) -> None:
        """`wanted`: attachments that are read."""
        self._file, self._size, self._wanted = file, size, wanted
        self.channels: dict[int, str] = {}
        self.messages: list[Message] = []
        self.chunks: list[Chunk] = []
        self.attachments: dict[str, bytes] = {}
        self.damage: list[Damage] = []
        self._looked_at: dict[int, bool] = {}  # by a chunk's offset, whether it is sound
        self.compression = ""
        self._counted: tuple[int, int] | None = None  # messages and attachments, by the summary
        self._attached = self._attached_with_crc = 0
        self._unchecked: dict[str, int] = {}  # attachments that say they have no checksum, and where they are
        self._without = False
        self.ended = False
        self.data_crc: tuple[int, int] | None = None  # of the bytes before the first, the second
        at = len(MAGIC)
        while not self.ended and at < size:
            end = self._record(at)
            if end is None and (end := self._next_chunk(at + 1)) is not None:
                self._damaged(at, f"{end - at} bytes that are no records")
            if end is None:
                break  # torn
            at = end
        loose = sum(message.chunk is None for message in self.messages)
        if self.chunks and loose:
            self.messages = [message for message in self.messages if message.chunk is not None]
            self._damaged(0, "messages outside the chunks", loose)
        if self._attached_with_crc or any(chunk.crc is not None for chunk in self.chunks):
            for name, offset in self._unchecked.items():  # a writer makes checksums, or makes none
                del self.attachments[name]
                self._damaged(offset, "an attachment with the wrong checksum")
        self._compare()
        nameless = [message.chunk for message in self.messages if message.channel not in self.channels]
        if nameless and all([self.look_at(chunk) for chunk in nameless]):
            self._damaged(0, "messages of which no record says what they are", len(nameless))

    def _compare(self) -> None:
        """What is here with what the summary counted."""
        here = len(self.messages), self._attached
        for what, written, found in zip(("messages", "attachments"), self._counted or here, here, strict=True):
            if written != found:
                self._damaged(0, f"{written} {what} were written, {found} are here")

    def look_at(self, chunk: Chunk | None) -> bool:
        """Whether a chunk is sound, read now for once because something in it is odd; if not, that is damage."""
        if chunk is None:
            return True
        if chunk.offset not in self._looked_at:
            try:
                chunk.read(self._file)
                self._looked_at[chunk.offset] = True
            except DamagedError as error:
                self._damaged(chunk.offset, str(error), chunk.messages)
                self._looked_at[chunk.offset] = False
        return self._looked_at[chunk.offset]

    def _damaged(self, offset: int, text: str, messages: int | None = None) -> None:
        if len(self.damage) < DAMAGE_MAX:
            self.damage.append(Damage(offset, text, messages))

    def _record(self, at: int) -> int | None:
        """Take the record at `at`; where the next one begins, None where this is none."""
        if at + _RECORD.size > self._size:
            return None
        opcode, length = _RECORD.unpack(piece(self._file, at, _RECORD.size))
        start = at + _RECORD.size
        end: int = start + length
        if opcode == _CHUNK or self._like_chunk(start, length):
            return self._chunk(start, end)
        if end > self._size or opcode == 0 or _DATA_END < opcode < _PRIVATE:
            return None
        if opcode == _FOOTER and not (
            length == _FOOTER_BYTES and MAGIC.startswith(piece(self._file, end, min(len(MAGIC), self._size - end)))
        ):
            return None  # bytes that look like one: the walk would end here, and nobody miss the rest
        try:
            if opcode == _MESSAGE:
                self._message(start, length)
            elif opcode == _CHANNEL:
                number, topic = _channel(piece(self._file, start, min(length, _BLOCK)))
                self.channels.setdefault(number, topic)  # a sound chunk's word goes before the summary's
            elif opcode == _ATTACHMENT:
                self._attachment(start, length)
            elif opcode == _DATA_END and length >= 4:
                (crc,) = struct.unpack("<I", piece(self._file, start, 4))
                self.data_crc = (at, crc) if crc else None
            elif opcode == _STATISTICS:
                messages, _, _, attachments = _COUNTS.unpack(piece(self._file, start, _COUNTS.size))
                self._counted = messages, attachments
            elif opcode == _FOOTER:
                self.ended = True
        except (ValueError, struct.error):
            self._damaged(at, "a record that is none")
        return end

    def _like_chunk(self, start: int, length: int) -> bool:
        """Whether a record is a chunk by its lengths, whatever its opcode has become."""
        if length < _CHUNK_HEAD.size + 8 or start + _CHUNK_HEAD.size + 8 > self._size:
            return False
        head = piece(self._file, start, _CHUNK_HEAD.size + 8)
        _, _, size, _, named = _CHUNK_HEAD.unpack_from(head)
        return not named and head[-8:] == struct.pack("<Q", size) and length == _CHUNK_HEAD.size + 8 + size

    def _chunk(self, start: int, end: int) -> int | None:
        if start + _CHUNK_HEAD.size + 8 > self._size:
            return None
        _, _, size, crc, named = _CHUNK_HEAD.unpack(piece(self._file, start, _CHUNK_HEAD.size))
        if 0 < named <= 32 and end <= self._size:
            name = piece(self._file, start + _CHUNK_HEAD.size, named)
            if name.isalnum():
                self.compression = name.decode("ascii", "replace")
                return end
        first = start + _CHUNK_HEAD.size + 8
        if named or piece(self._file, first - 8, 8) != struct.pack("<Q", size) or end != first + size:
            return None
        if not self.chunks:
            self._without = crc == 0  # a writer makes checksums, or makes none
        chunk, messages, channels, sound = self._inside(first, min(end, self._size), crc if end <= self._size else None)
        if channels or not sound:
            if not self.look_at(chunk):
                channels = {}
            elif not sound and end <= self._size:
                self._damaged(chunk.offset, "a chunk of records that are none")
        self.channels.update(channels)
        self.chunks.append(chunk)
        self.messages += (Message(*message, chunk) for message in messages)
        return end if end <= self._size else None

    def _inside(self, at: int, end: int, crc: int | None) -> tuple[Chunk, list[_Place], dict[int, str], bool]:
        """The chunk, its messages and channels, and whether its records fill it."""
        first = at
        messages: list[_Place] = []
        channels: dict[int, str] = {}
        while at + _RECORD.size <= end:
            opcode, length = _RECORD.unpack(piece(self._file, at, _RECORD.size))
            start = at + _RECORD.size
            if start + length > end or opcode not in (_SCHEMA, _CHANNEL, _MESSAGE):
                break
            if opcode == _CHANNEL:
                try:
                    number, topic = _channel(piece(self._file, start, min(length, _BLOCK)))
                except (ValueError, struct.error):
                    break
                channels[number] = topic
            elif opcode == _MESSAGE:
                if length < _MESSAGE_HEAD.size:
                    break
                messages.append(self._head(start, length))
            at = start + length
        return (
            Chunk(first, end - first, None if crc == 0 and self._without else crc, len(messages)),
            messages,
            channels,
            at == end,
        )

    def _head(self, start: int, length: int) -> _Place:
        channel, sequence, time_ns, _ = _MESSAGE_HEAD.unpack(piece(self._file, start, _MESSAGE_HEAD.size))
        return channel, sequence, time_ns, start + _MESSAGE_HEAD.size, length - _MESSAGE_HEAD.size

    def _message(self, start: int, length: int) -> None:
        if length < _MESSAGE_HEAD.size:
            raise ValueError("too short for a message")
        self.messages.append(Message(*self._head(start, length), None))

    def _attachment(self, start: int, length: int) -> None:
        self._attached += 1
        if length > ATTACHMENT_MAX:
            self._damaged(start, f"an attachment of {length} bytes, which is not read")
            return
        data = piece(self._file, start, length)
        (crc,) = struct.unpack("<I", data[-4:])
        if crc and zlib.crc32(data[:-4]) != crc:
            self._damaged(start, "an attachment with the wrong checksum")
            return
        self._attached_with_crc += crc != 0
        (name_length,) = struct.unpack_from("<I", data, 16)
        name = data[20 : 20 + name_length].decode()
        if name not in self._wanted:
            return
        at = 20 + name_length
        (media_length,) = struct.unpack_from("<I", data, at)
        at += 4 + media_length
        (size,) = struct.unpack_from("<Q", data, at)
        self.attachments[name] = data[at + 8 : at + 8 + size]
        if not crc:
            self._unchecked[name] = start

    def _next_chunk(self, at: int) -> int | None:
        """Where a chunk begins whose lengths agree with each other, from `at` on."""
        while at + _LOOK_AHEAD <= self._size:
            block = piece(self._file, at, min(_BLOCK + _LOOK_AHEAD, self._size - at))
            for found in _CHUNK_LIKE.finditer(block):
                place = found.start()
                if place + _LOOK_AHEAD > len(block):
                    break
                _, length = _RECORD.unpack_from(block, place)
                _, _, size, _, _ = _CHUNK_HEAD.unpack_from(block, place + _RECORD.size)
                (again,) = struct.unpack_from("<Q", block, place + _LOOK_AHEAD - 8)
                whole = at + place + _RECORD.size + length <= self._size
                if whole and size == again and length == _CHUNK_HEAD.size + 8 + size:
                    return at + place
            at += _BLOCK
        return None


def _channel(data: bytes) -> tuple[int, str]:
    number, _schema, length = struct.unpack_from("<HHI", data)
    return number, data[8 : 8 + length].decode()


def piece(file: IO[bytes], offset: int, length: int) -> bytes:
    """Bytes of a file. ValueError where there are not so many."""
    if length > RECORD_MAX:
        raise ValueError(f"a record of {length} bytes")
    file.seek(offset)
    data = file.read(length)
    if len(data) != length:
        raise ValueError("the file ends before the record does")
    return data
