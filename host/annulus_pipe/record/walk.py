"""A walk through the records of an MCAP file: what is where, with no index needed, and nothing believed for its length.

Records lie one behind the other, each an opcode, its length and its content; messages lie in chunks, packed or not, and
a chunk has a checksum of its records. The walk reads heads and steps over images, and of a packed chunk unpacks what
lies before its image, so it cannot know whether a chunk is sound: whoever reads from a chunk checks it (`Chunk.read`).
Where no record can begin the walk goes on at the next chunk, and says so. Channels say whose messages are whose, so a
chunk that names channels is checked at once, and believed only if it is sound; the summary at the end of a finished
file names them again.
"""

import re
import struct
import zlib
from dataclasses import dataclass
from typing import IO, cast

import zstandard

from annulus_pipe.record.allowance import Allowance
from annulus_pipe.vocabulary import AnnulusError

MAGIC = b"\x89MCAP0\r\n"
RECORD_MAX = 1 << 30  # bytes that are read at once
ATTACHMENT_MAX = 1 << 24
DAMAGE_MAX = 1000  # places that are named
PACKED_MAX = 1 << 28  # bytes that a chunk is unpacked to: a frame of 16384x16384
WINDOW_MAX = 1 << 27  # bytes that unpacking may look back
_RECORD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, bytes, checksum, length of the compression's name
_COUNTS = struct.Struct("<QHII")  # of the summary: messages, schemas, channels, attachments
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _STATISTICS, _DATA_END = 2, 3, 4, 5, 6, 9, 11, 15
_FOOTER_BYTES = 20
_PRIVATE = 0x80  # opcodes from here on are for anybody, and passed over
_CHUNK_LIKE = re.compile(rb"\x06(?=.{5}\0\0\0.{28}(?:\0\0\0\0|\x04\0\0\0zstd))", re.DOTALL)  # below a TiB
_CODEC = b"zstd"
_LOOK_AHEAD = _RECORD.size + _CHUNK_HEAD.size + len(_CODEC) + 8
_BLOCK = 1 << 20
_SIP = 1 << 15  # of a packed chunk, to see what lies before its image
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
    """Records under one checksum. `offset`, `length`: where they lie in the file, packed or not."""

    offset: int
    length: int
    crc: int | None  # None: there is none, or the file ends before the chunk does
    messages: int
    size: int = 0  # of the records where they are packed; else 0

    def read(self, file: IO[bytes], allowed: Allowance | None = None) -> bytes:
        """The records. Raises DamagedError where they are not what was written, or more than is allowed."""
        if allowed is not None and not allowed.take(self.size, self.length):
            raise DamagedError(f"the chunk at byte {self.offset} unpacks to {self.size} bytes, one too many of such")
        data = piece(file, self.offset, self.length)
        if self.size:
            try:
                data = _unpacked(data, self.size)
            except ValueError as error:
                raise DamagedError(
                    f"the chunk at byte {self.offset} cannot be unpacked ({error}){self._lost}"
                ) from None
        if self.crc is not None and zlib.crc32(data) != self.crc:
            raise DamagedError(f"the chunk at byte {self.offset} has the wrong checksum{self._lost}")
        return data

    @property
    def _lost(self) -> str:
        return f", {self.messages} messages lost" if self.messages else ""  # none could be seen in it

    def peek(self, file: IO[bytes], offset: int, length: int) -> bytes:
        """A message of it, believed. ValueError where there is none."""
        if not self.size:
            return piece(file, offset, length)
        return _Packed(file, self).piece(offset, length)

    def within(self, data: bytes, offset: int, length: int) -> memoryview:
        """A message of it, out of what `read` gave."""
        start = offset if self.size else offset - self.offset
        return memoryview(data)[start : start + length]


@dataclass(frozen=True, slots=True)
class MessageLocation:
    """Where one message lies: in the file, or in its chunk's records where those are packed."""

    channel: int
    sequence: int
    time_ns: int
    offset: int
    length: int
    chunk: Chunk | None  # None: of a file without chunks


@dataclass(frozen=True, slots=True)
class Channel:
    """The topic that a channel's messages belong to, and how they are encoded."""

    topic: str
    encoding: str
    schema: int


_NONE = Channel("", "", 0)


class Walk:
    """`walk = Walk(file, size)`: channels, messages in the file's order, attachments, what is damaged."""

    def __init__(self, file: IO[bytes], size: int, wanted: tuple[str, ...], kept: str = "", far: bool = False) -> None:
        """`wanted`: attachments that are read. `kept`: a topic whose messages are small and will be asked for. `far`:
        all JSON will be, and going back for it costs more than keeping it."""
        self._file, self._size, self._wanted, self._kept, self._far = file, size, wanted, kept, far
        self._contents: dict[tuple[int, int], bytes] = {}  # by where chunk and message lie
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, str] = {}  # their names
        self.messages: list[MessageLocation] = []
        self.chunks: list[Chunk] = []
        self.attachments: dict[str, bytes] = {}
        self.disagreeing: dict[str, bytes] = {}  # by a name that is there twice: another that is sound, too
        self.damage: list[Damage] = []
        self._looked_at: dict[int, bool] = {}  # by a chunk's offset, whether it is sound
        self._allowed = Allowance()
        self.compression = ""
        self._counted: tuple[int, int] | None = None  # messages and attachments, by the summary
        self._attached = self._attached_with_crc = 0
        self._unchecked: dict[str, int] = {}  # attachments that say they have no checksum, and where they are
        self._without = False
        self.ended = False
        self.data_crc: tuple[int, int] | None = None  # of the bytes before the first, the second
        self.cut_messages: int | None = 0  # at most, in the record within which the file ends; None: not known
        at = len(MAGIC)
        while not self.ended and at < size:
            end = self._record(at)
            if end is None and (end := self._next_chunk(at + 1)) is not None:
                self._damaged(at, f"{end - at} bytes that are no records")
            if end is None:
                self.cut_messages = self._cut_at(at)
                break  # torn
            at = end
        if self.ended and (behind := size - at - len(MAGIC)) > 0:  # two files in one, or another's bytes
            self._damaged(at + len(MAGIC), f"{behind} bytes behind its end, which are not read")
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

    def content(self, message: MessageLocation) -> bytes:
        """A message, believed; asked for once. ValueError where there is none."""
        offset, length, chunk = message.offset, message.length, message.chunk
        known = self._contents.pop((0 if chunk is None else chunk.offset, offset), None)
        if chunk is None:
            return piece(self._file, offset, length) if known is None else known
        return chunk.peek(self._file, offset, length) if known is None else known

    def look_at(self, chunk: Chunk | None) -> bool:
        """Whether a chunk is sound, read now for once because something in it is odd; if not, that is damage."""
        if chunk is None:
            return True
        if chunk.offset not in self._looked_at:
            try:
                chunk.read(self._file, self._allowed)
                self._looked_at[chunk.offset] = True
            except DamagedError as error:
                self._damaged(chunk.offset, str(error), chunk.messages or None)
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
        if opcode == _CHUNK or self._chunk_head(start, length) is not None:
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
                number, channel = _channel(piece(self._file, start, min(length, _BLOCK)))
                self.channels.setdefault(number, channel)  # a sound chunk's word goes before the summary's
            elif opcode == _SCHEMA:
                number, name = _schema(piece(self._file, start, min(length, _BLOCK)))
                self.schemas.setdefault(number, name)
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

    def _cut_at(self, at: int) -> int | None:
        """How many messages with a picture are in the record that the file ends in, at most; None: not known."""
        if self._size - at < _LOOK_AHEAD:
            return 1  # no more than the head of one
        opcode, length = _RECORD.unpack(piece(self._file, at, _RECORD.size))
        if opcode == _CHUNK:
            return 1 if self._chunk_head(at + _RECORD.size, length) is not None else None
        return 0 if 0 < opcode <= _DATA_END and length <= ATTACHMENT_MAX else None

    def _chunk_head(self, start: int, length: int) -> tuple[int, int, int, bool] | None:
        """Of what is a chunk by its lengths, whatever its opcode has become: where its records begin, how many bytes
        they are, their checksum, whether they are packed.
        """
        data = piece(self._file, start, max(0, min(_LOOK_AHEAD - _RECORD.size, self._size - start)))
        return _chunk_head(data, start, length)

    def _chunk(self, start: int, end: int) -> int | None:
        head = self._chunk_head(start, end - start)
        if head is None:
            return self._other_codec(start, end)
        first, size, crc, packed = head
        if packed and end > self._size:
            return None
        if not self.chunks:
            self._without = crc == 0  # a writer makes checksums, or makes none
        known = crc if end <= self._size and not (crc == 0 and self._without) else None
        chunk = Chunk(first, min(end, self._size) - first, known, 0, size if packed else 0)
        messages, channels, schemas, sound = self._inside(chunk)
        if not sound and self._allowed.of(chunk.size, chunk.length) < chunk.size:
            self.look_at(chunk)  # notes that it is over what is allowed; nobody reads it again
            return end
        chunk = Chunk(chunk.offset, chunk.length, known, len(messages), chunk.size)
        if channels or schemas or not sound:
            if not self.look_at(chunk):
                channels, schemas = {}, {}
            elif not sound and end <= self._size:
                self._damaged(chunk.offset, "a chunk of records that are none")
        self.channels.update(channels)
        self.schemas.update(schemas)
        self.chunks.append(chunk)
        self.messages += (MessageLocation(*message, chunk) for message in messages)
        return end if end <= self._size else None

    def _other_codec(self, start: int, end: int) -> int | None:
        """Past a chunk that somebody packed in another way."""
        if start + _CHUNK_HEAD.size + 8 > self._size or end > self._size:
            return None
        named = _CHUNK_HEAD.unpack(piece(self._file, start, _CHUNK_HEAD.size))[-1]
        if not 0 < named <= 32 or start + _CHUNK_HEAD.size + named > self._size:
            return None
        name = piece(self._file, start + _CHUNK_HEAD.size, named)
        if not name.isalnum() or name == _CODEC:
            return None
        self.compression = name.decode("ascii", "replace")
        return end

    def _inside(self, chunk: Chunk) -> tuple[list[_Place], dict[int, Channel], dict[int, str], bool]:
        """A chunk's messages, channels and schemas, and whether its records fill it."""
        messages: list[_Place] = []
        channels: dict[int, Channel] = {}
        schemas: dict[int, str] = {}
        allowed = self._allowed.of(chunk.size, chunk.length)
        source: _Packed | _Plain = _Packed(self._file, chunk, allowed) if chunk.size else _Plain(self._file)
        at, end = (0, chunk.size) if chunk.size else (chunk.offset, chunk.offset + chunk.length)
        try:
            while at + _RECORD.size <= end:
                opcode, length = _RECORD.unpack(source.piece(at, _RECORD.size))
                start = at + _RECORD.size
                if start + length > end or opcode not in (_SCHEMA, _CHANNEL, _MESSAGE):
                    break
                if opcode == _CHANNEL:
                    number, channel = _channel(source.piece(start, min(length, _BLOCK)))
                    channels[number] = channel
                elif opcode == _SCHEMA:
                    number, name = _schema(source.piece(start, min(length, _BLOCK)))
                    schemas[number] = name
                elif length < _MESSAGE_HEAD.size:
                    break
                else:
                    place = _place(source.piece(start, _MESSAGE_HEAD.size), start, length)
                    messages.append(place)
                    known = channels.get(place[0]) or self.channels.get(place[0])
                    if length < _SIP and known is not None and self._is_kept(known, chunk):
                        self._contents[chunk.offset, place[3]] = source.piece(place[3], place[4])
                at = start + length
        except (ValueError, struct.error):
            pass
        if isinstance(source, _Packed):
            self._allowed.took(chunk.size, chunk.length, source.unpacked)
        return messages, channels, schemas, at == end

    def _message(self, start: int, length: int) -> None:
        if length < _MESSAGE_HEAD.size:
            raise ValueError("too short for a message")
        message = MessageLocation(*_place(piece(self._file, start, _MESSAGE_HEAD.size), start, length), None)
        self.messages.append(message)
        if self._far and length < _SIP and self.channels.get(message.channel, _NONE).encoding == "json":
            self._contents[0, message.offset] = piece(self._file, message.offset, message.length)

    def _is_kept(self, channel: Channel, chunk: Chunk) -> bool:
        return (self._far and channel.encoding == "json") or (chunk.size > 0 and channel.topic == self._kept)

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
        content = data[at + 8 : at + 8 + size]
        if self.attachments.get(name, content) != content:
            self.disagreeing[name] = self.attachments[name]
        self.attachments[name] = content
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
                whole = at + place + _RECORD.size + length <= self._size
                if whole and _chunk_head(block[place + _RECORD.size : place + _LOOK_AHEAD], 0, length) is not None:
                    return at + place
            at += _BLOCK
        return None


class _Plain:
    """Records as they lie in the file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def piece(self, at: int, length: int) -> bytes:
        return piece(self._file, at, length)


class _Stretch:
    """The bytes of a packed chunk, for the unpacker. (Not `_Packed` itself: the unpacker is nothing that Python's
    collector sees through, and a ring of the two was never let go.)
    """

    def __init__(self, file: IO[bytes], chunk: Chunk) -> None:
        self._file, self._at, self._end = file, chunk.offset, chunk.offset + chunk.length

    def read(self, length: int) -> bytes:
        data = piece(self._file, self._at, min(length, self._end - self._at))
        self._at += len(data)
        return data


class _Packed:
    """Records of a packed chunk from the first on, unpacked as far as somebody looks, and not kept."""

    def __init__(self, file: IO[bytes], chunk: Chunk, most: int = PACKED_MAX) -> None:
        self._most = most  # bytes that are unpacked
        source = cast(IO[bytes], _Stretch(file, chunk))
        self._stream = _unpacker().stream_reader(source, read_size=_SIP, read_across_frames=True)
        self._held, self._before = b"", 0  # bytes, and how many came before them

    @property
    def unpacked(self) -> int:
        return self._before + len(self._held)

    def piece(self, at: int, length: int) -> bytes:
        """Rising `at`. ValueError where there is no such piece, or it is too far."""
        if at + length > self._most:
            raise ValueError("more than may be unpacked")
        while self._before + len(self._held) < at + length:
            if at >= self._before + len(self._held):
                self._before, self._held = self._before + len(self._held), b""
            try:
                more = self._stream.read(min(_BLOCK, max(_SIP, at + length - self._before - len(self._held))))
            except zstandard.ZstdError as error:
                raise ValueError(str(error)) from None
            if not more:
                raise ValueError("the chunk ends before its records do")
            self._held += more
        start = at - self._before
        return self._held[start : start + length]


def _unpacker() -> zstandard.ZstdDecompressor:
    return zstandard.ZstdDecompressor(max_window_size=WINDOW_MAX)


def _unpacked(data: bytes, size: int) -> bytes:
    """All `size` bytes; never more than that is made. ValueError where they are not so many."""
    if size > PACKED_MAX:
        raise ValueError(f"{size} bytes, expected at most {PACKED_MAX}")
    try:
        with _unpacker().stream_reader(data, read_across_frames=True) as stream:
            out: bytes = stream.read(size)
            if len(out) != size or stream.read(1):
                raise ValueError(f"not the {size} bytes that it says")
            return out
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from None


def _chunk_head(data: bytes, start: int, length: int) -> tuple[int, int, int, bool] | None:
    """`data`: a record's content as far as it may be a chunk's head. See Walk._chunk_head."""
    if len(data) < _CHUNK_HEAD.size + 8:
        return None
    _, _, size, crc, named = _CHUNK_HEAD.unpack_from(data)
    packed = data[_CHUNK_HEAD.size : _CHUNK_HEAD.size + len(_CODEC)] == _CODEC
    if named != (len(_CODEC) if packed else 0) or len(data) < _CHUNK_HEAD.size + named + 8:
        return None
    (stored,) = struct.unpack_from("<Q", data, _CHUNK_HEAD.size + named)
    if length != _CHUNK_HEAD.size + named + 8 + stored or not (0 < size <= PACKED_MAX if packed else stored == size):
        return None
    return start + _CHUNK_HEAD.size + named + 8, size, crc, packed


def _place(head: bytes, start: int, length: int) -> _Place:
    channel, sequence, time_ns, _ = _MESSAGE_HEAD.unpack(head)
    return channel, sequence, time_ns, start + _MESSAGE_HEAD.size, length - _MESSAGE_HEAD.size


def _channel(data: bytes) -> tuple[int, Channel]:
    number, schema, length = struct.unpack_from("<HHI", data)
    (encoded,) = struct.unpack_from("<I", data, 8 + length)
    return number, Channel(data[8 : 8 + length].decode(), data[12 + length : 12 + length + encoded].decode(), schema)


def _schema(data: bytes) -> tuple[int, str]:
    number, length = struct.unpack_from("<HI", data)
    return number, data[6 : 6 + length].decode()


def piece(file: IO[bytes], offset: int, length: int) -> bytes:
    """Bytes of a file. ValueError where there are not so many."""
    if length > RECORD_MAX:
        raise ValueError(f"a record of {length} bytes")
    file.seek(offset)
    data = file.read(length)
    if len(data) != length:
        raise ValueError("the file ends before the record does")
    return data
