"""What a walk through a recording would find, kept: at the end of the file by who writes it, or beside the file.

An MCAP's own summary says where chunks are, not which frame a message is or what its label says; that would be read out
of every chunk. So a recording has its index in attachments before its summary, which names them: `annulus.index`, and
before it blocks `annulus.index/0`, .. of whole chunks each, and before those `annulus.notes/0`, .. with all other JSON.
A closed recording is opened by its last bytes, its index and its first bytes, however long it is, and its notes are one
stretch; every other program passes over them.

A block is MessagePack in zstd: columns of chunks (offset, length, checksum, messages, size) and of those messages that
a recording's reader asks for (JSON and frames: chunk, channel, sequence, time, offset, length), and what labels say. A
column is 64-bit numbers, each less the one before, their first bytes first: so they pack to a tenth.

Nothing of it is believed: it is of this file if it says where in it it lies, to the byte, as a program that copies
attachments into another file does not mend it; places lie in the file, rising; a frame that is read is held against its
index in its own chunk (`Recording`). What does not hold is no index, and the file is walked.
"""

import struct
import zlib
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any, Protocol

import msgpack
import numpy as np
import zstandard

from annulus_pipe import untrusted
from annulus_pipe.record.walk import Channel, Chunk, Damage, MessageLocation, piece

NAME = "annulus.index"
NOTES = "annulus.notes"
VERSION = 1
ROWS = 1 << 13  # messages of a block, or chunks: 0.8 MB that a writer keeps ..
SAID_MAX = 2 << 20  # .. and bytes of its labels, or of its notes
UNPACKED_MAX = 64 << 20  # bytes of a block: ROWS of both, SAID_MAX, and what one more chunk brings
_LEVEL = 3
_RECORD = struct.Struct("<BQ")
_ATTACHMENT = 9
U64 = np.dtype("<u8")
CHUNK_COLUMNS = ("offset", "length", "crc", "sound", "messages", "size")
ROW_COLUMNS = ("chunk", "channel", "sequence", "time", "offset", "length")
_NOTE_COLUMNS = ("channel", "sequence", "time", "length")
Numbers = np.ndarray[Any, np.dtype[np.uint64]]


class Contents(Protocol):
    """What is in a file, by a walk or its index."""

    channels: dict[int, Channel]
    schemas: dict[int, str]
    messages: list[MessageLocation]
    chunks: list[Chunk]
    attachments: dict[str, bytes]
    damage: list[Damage]
    compression: str
    ended: bool
    data_crc: tuple[int, int] | None
    cut_messages: int | None

    def content(self, message: MessageLocation) -> bytes:
        """A message, believed; asked for once. ValueError where there is none."""

    def look_at(self, chunk: Chunk | None) -> bool:
        """Whether a chunk is sound; if not, that is damage."""


class Block:
    """Whole chunks, and of their messages those that are asked for, in the file's order."""

    def __init__(self, first: int = 0) -> None:
        """`first`: number of its first chunk."""
        self.first = first
        self._chunks, self._rows, self._label_lengths = array("Q"), array("Q"), array("Q")
        self._labels = bytearray()
        self._notes, self._noted = array("Q"), bytearray()

    @property
    def chunks(self) -> int:
        return len(self._chunks) // len(CHUNK_COLUMNS)

    @property
    def rows(self) -> int:
        return len(self._rows) // len(ROW_COLUMNS)

    @property
    def full(self) -> bool:
        return max(self.rows, self.chunks) >= ROWS or max(len(self._labels), len(self._noted)) >= SAID_MAX

    def chunk(self, chunk: Chunk) -> None:
        crc = chunk.crc
        self._chunks.extend((chunk.offset, chunk.length, crc or 0, crc is not None, chunk.messages, chunk.size))

    def row(self, chunk: int, channel: int, sequence: int, time_ns: int, offset: int, length: int) -> None:
        """A message of the chunk of that number."""
        self._rows.extend((chunk, channel, sequence, time_ns, offset, length))

    def label(self, content: bytes) -> None:
        """Of the last row, which is one of the labels' topic."""
        self._label_lengths.append(len(content))
        self._labels += content

    def note(self, channel: int, sequence: int, time_ns: int, content: bytes) -> None:
        """The same of a row of another topic."""
        self._notes.extend((channel, sequence, time_ns, len(content)))
        self._noted += content

    def packed_notes(self) -> bytes:
        rows = np.frombuffer(self._notes, U64).reshape(-1, len(_NOTE_COLUMNS))
        found = [_column(rows[:, i]) for i in range(len(_NOTE_COLUMNS))]
        return pack({"version": VERSION, "rows": len(rows), "row": found, "said": bytes(self._noted)})

    def packed(self) -> bytes:
        chunks = np.frombuffer(self._chunks, U64).reshape(-1, len(CHUNK_COLUMNS))
        rows = np.frombuffer(self._rows, U64).reshape(-1, len(ROW_COLUMNS))
        return pack(
            {
                "version": VERSION,
                "first": self.first,
                "chunks": len(chunks),
                "rows": len(rows),
                "chunk": [_column(chunks[:, i]) for i in range(len(CHUNK_COLUMNS))],
                "row": [_column(rows[:, i]) for i in range(len(ROW_COLUMNS))],
                "said": _column(np.frombuffer(self._label_lengths, U64)),
                "labels": bytes(self._labels),
            }
        )


def head_of(
    channels: Mapping[int, Channel], schemas: Mapping[int, str], chunks: int, rows: int, **more: Any
) -> dict[str, Any]:
    """What stands behind the blocks."""
    return {
        "version": VERSION,
        "chunks": chunks,
        "rows": rows,
        "channels": [[number, one.topic, one.encoding, one.schema] for number, one in channels.items()],
        "schemas": [[number, name] for number, name in schemas.items()],
        **more,
    }


def pack(value: Mapping[str, Any]) -> bytes:
    content: bytes = msgpack.packb(value)
    return bytes(zstandard.ZstdCompressor(level=_LEVEL).compress(content))


def unpack(data: bytes) -> Mapping[str, Any]:
    """ValueError for anything else."""
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(data) as stream:
            content = stream.read(UNPACKED_MAX + 1)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from None
    value = untrusted.mapping(untrusted.unpack(content, UNPACKED_MAX), "index")
    untrusted.whole(value.get("version"), "index: version", VERSION, VERSION)
    return value


def _column(values: Numbers) -> bytes:
    step = np.diff(values, prepend=np.zeros(1, U64)).astype(U64)  # modulo 2^64, as the sum is
    return step.view(np.uint8).reshape(-1, 8).T.tobytes()


def numbers(data: object, count: int) -> Numbers:
    if not isinstance(data, bytes) or len(data) != 8 * count:
        raise ValueError("a column of another length")
    step = np.frombuffer(data, np.uint8).reshape(8, count).T.copy().view(U64).ravel()
    return np.cumsum(step, dtype=np.uint64)


def notes_of(block: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """Channel, sequence, time and content of each note in a block. ValueError where it is none."""
    fields = unpack(block)
    count = count_of(fields.get("rows"), 1 << 24)
    found = [numbers(one, count).tolist() for one in columns(fields, "row", _NOTE_COLUMNS)]
    content = fields.get("said")
    if not isinstance(content, bytes) or sum(found[-1]) != len(content):
        raise ValueError("index: notes of another length")
    at = 0
    for channel, sequence, time_ns, length in zip(*found, strict=True):
        yield channel, sequence, time_ns, content[at : at + length]
        at += length


@dataclass(frozen=True, slots=True)
class Notes:
    """Where all JSON but labels is once more: blocks as they are, or where they lie in the file as attachments."""

    topics: Mapping[int, str]
    blocks: tuple[bytes, ...] = ()
    places: tuple[tuple[int, int], ...] = ()

    def of(self, topic: str, file: IO[bytes]) -> Iterator[tuple[int, int, bytes]]:
        """Sequence, time as it is written and content, in the file's order. ValueError, at once, where they are not
        what was written."""
        wanted = {number for number, name in self.topics.items() if name == topic}
        plan(file, [(offset, offset + length) for offset, length in self.places])
        blocks = self.blocks or tuple(attached(piece(file, *place))[1] for place in self.places)
        return (
            (sequence, time_ns, content)
            for block in blocks
            for channel, sequence, time_ns, content in notes_of(block)
            if channel in wanted
        )


def count_of(value: object, below: int) -> int:
    return untrusted.whole(value, "index: a count", 0, below - 1)


def rows_of(fields: Mapping[str, Any], name: str, width: int) -> Iterator[list[Any]]:
    rows = fields.get(name)
    if not isinstance(rows, list) or any(not isinstance(one, list) or len(one) != width for one in rows):
        raise ValueError(f"index: {name} are none")
    return iter(rows)


def columns(fields: Mapping[str, Any], name: str, names: Sequence[str]) -> list[object]:
    found = fields.get(name)
    if not isinstance(found, list) or len(found) != len(names):
        raise ValueError(f"index: {name} has other columns")
    return found


def is_asked_for(topic: str, encoding: str, frames: str) -> bool:
    """Whether a reader asks for a channel's messages; others are for viewers."""
    return encoding == "json" or topic == frames or topic.startswith(f"{frames}/")


def plan(file: IO[bytes], ranges: list[tuple[int, int]]) -> None:
    """Told to a file that is far."""
    plan = getattr(file, "plan", None)
    if plan is not None:
        plan(ranges)


def attached(record: bytes, expected: str = "") -> tuple[str, bytes]:
    """An attachment's name and content. ValueError where its checksum is not that of what is there."""
    opcode, length = _RECORD.unpack_from(record)
    data = record[_RECORD.size :]
    (crc,) = struct.unpack("<I", data[-4:])
    if opcode != _ATTACHMENT or length != len(data) or zlib.crc32(data[:-4]) != crc:
        raise ValueError("an attachment with the wrong checksum")
    (named,) = struct.unpack_from("<I", data, 16)
    name = data[20 : 20 + named].decode()
    (media,) = struct.unpack_from("<I", data, 20 + named)
    at = 24 + named + media
    (size,) = struct.unpack_from("<Q", data, at)
    if at + 8 + size + 4 != len(data) or (expected and name != expected):
        raise ValueError("an attachment of another length")
    return name, data[at + 8 : at + 8 + size]


def blocks_of(contents: Contents, label_topic: str, frames: str) -> tuple[dict[str, Any], list[bytes], list[bytes]]:
    """What a walk found, as an index keeps it: the head without its places, blocks, and blocks of notes."""
    numbers = {chunk.offset: number for number, chunk in enumerate(contents.chunks)}
    labels = {number for number, one in contents.channels.items() if one.topic == label_topic}
    asked = {n for n, one in contents.channels.items() if is_asked_for(one.topic, one.encoding, frames)}
    rows: dict[int, list[MessageLocation]] = {}
    loose = not contents.chunks and bool(contents.messages)
    count = 0
    for message in contents.messages:
        if message.channel in asked:
            rows.setdefault(-1 if message.chunk is None else numbers[message.chunk.offset], []).append(message)
            count += 1
    blocks: list[bytes] = []
    notes: list[bytes] = []
    block = Block()

    def end(first: int) -> None:
        nonlocal block
        blocks.append(block.packed())
        notes.append(block.packed_notes())
        block = Block(first)

    def take(number: int) -> None:
        for one in rows.pop(number, ()):
            block.row(max(0, number), one.channel, one.sequence, one.time_ns, one.offset, one.length)
            if contents.channels[one.channel].encoding == "json":
                try:
                    content = contents.content(one)
                except ValueError:
                    content = b""
                if one.channel in labels:
                    block.label(content)
                else:
                    block.note(one.channel, one.sequence, one.time_ns, content)
            elif one.channel in labels:
                block.label(b"")
            if loose and block.full:
                end(0)

    for number, chunk in enumerate(contents.chunks):
        block.chunk(chunk)
        take(number)
        if block.full:
            end(number + 1)
    take(-1)
    if block.chunks or block.rows:
        end(0)
    return head_of(contents.channels, contents.schemas, len(contents.chunks), count, loose=loose), blocks, notes
