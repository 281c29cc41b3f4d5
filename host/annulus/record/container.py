"""An MCAP file as it is written: a chunk is in it whole or not at all, and what ends the file names those that are.

    container.message(container.channel("/event", "json", RECORD), time_ns, 0, b"{..}")
    container.end_chunk()            # False: the disk did not take it; the file is as it was
    container.finish()

The library's own writer copies a picture three times, keeps 0.6 kB of index a frame in memory, and is left in the
middle of a chunk when a write fails. Here a picture is written, or compressed, from where it lies; indexes wait in a
file without a name; a write that fails half-way is taken back.
"""

import contextlib
import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from annulus.record.walk import PACKED_MAX

ZSTD = "zstd"
ZSTD_LEVEL = 1  # of a mosaic: 60 % of the bytes for 4.5 ms; 3 is 10 ms for 5 % less
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_CHUNK = struct.Struct("<BQQQQII")  # opcode, length, first and last time, bytes, checksum, length of the codec's name
_U64 = struct.Struct("<Q")
_BLOCK = 1 << 20

Piece = bytes | bytearray | memoryview


@dataclass(frozen=True, slots=True)
class Form:
    """What the messages of a channel are."""

    name: str
    encoding: str  # of the description
    data: bytes


class _Whole:
    """A file that holds whole writes only."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.end = 0
        self.failure: OSError | None = None  # of the last write

    def write(self, pieces: Iterable[Piece]) -> bool:
        """All of it, or none."""
        self.failure = None
        written = self.end
        try:
            for piece in pieces:
                rest = memoryview(piece)
                while rest:
                    took = self._file.write(rest)
                    rest, written = rest[took:], written + took
        except OSError as error:
            self.failure = error
            with contextlib.suppress(OSError):
                self._file.seek(self.end)
                self._file.truncate()
            return False
        self.end = written
        return True


class _ChunkIndexes:
    """What the end of the file says of each chunk, in a file without a name."""

    def __init__(self, folder: Path) -> None:
        self.failure: OSError | None = None  # no index can be written any more
        try:
            self._file: IO[bytes] | None = tempfile.TemporaryFile(dir=folder, buffering=1 << 16)  # noqa: SIM115
        except OSError as error:
            self._file, self.failure = None, error

    def append(self, index: ChunkIndex) -> None:
        data = _record(index)
        self._try(lambda file: file.write(data))

    def blocks(self) -> Iterator[bytes]:
        """All of them, as records."""
        self._try(lambda file: file.seek(0))
        while self._file is not None and (data := self._file.read(_BLOCK)):
            yield data

    def complete(self) -> bool:
        """Whether every index is there."""
        self._try(lambda file: file.flush())
        return self.failure is None

    def close(self) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def _try(self, do: Callable[[IO[bytes]], object]) -> None:
        try:
            if self._file is not None and self.failure is None:
                do(self._file)
        except OSError as error:
            self.failure = error


class Container:
    """Schemas, channels and messages into chunks, chunks into the file. Raises nothing for want of room."""

    def __init__(self, file: IO[bytes], folder: Path) -> None:
        """`file`: unbuffered, empty. `folder`: where indexes may wait."""
        self._whole = _Whole(file)
        self._indexes = _ChunkIndexes(folder)
        self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
        self._schemas: dict[str, Schema] = {}  # by name, those on disk or about to be; so with channels
        self._channels: dict[tuple[str, str], Channel] = {}  # by topic and schema
        self._said = 0, 0  # numbers that were given out: none is given twice
        self._new: list[tuple[dict[Any, Any], Any]] = []  # of both, those that are not on disk yet
        self._pieces: list[Piece] = []
        self._size = 0
        self._places: dict[int, list[tuple[int, int]]] = {}  # of the chunk at hand: times and offsets by channel
        self._attachments: list[AttachmentIndex] = []
        self._counts: Counter[int] = Counter()  # messages by channel
        self._chunks = 0
        self._times: tuple[int, int] | None = None  # of all messages
        self.begun = self._whole.write([MCAP0_MAGIC, _record(Header(profile="annulus", library="annulus"))])

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._whole.end

    @property
    def failure(self) -> OSError | None:
        """Why the last write did not succeed."""
        return self._whole.failure

    def channel(self, topic: str, encoding: str, form: Form) -> int:
        """The number of a topic's channel, said before its first message."""
        key = topic, form.name
        if key not in self._channels:
            schemas, channels = self._said
            if form.name not in self._schemas:
                schemas += 1
                self._tell(
                    self._schemas, form.name, Schema(id=schemas, data=form.data, encoding=form.encoding, name=form.name)
                )
            channels += 1
            self._said = schemas, channels
            self._tell(self._channels, key, self._said_of(channels, topic, encoding, form))
        number: int = self._channels[key].id
        return number

    def message(self, channel: int, time_ns: int, sequence: int, *content: Piece) -> None:
        """Into the chunk at hand. `content`, bytes, must not change before the chunk is ended."""
        length = sum(len(piece) for piece in content)
        head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - 9 + length, channel, sequence, time_ns, time_ns)
        self._places.setdefault(channel, []).append((time_ns, self._size))
        self._pieces += (head, *content)
        self._size += len(head) + length

    def attach(self, time_ns: int, name: str, content: bytes) -> bool:
        attachment = Attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type="application/json", data=content
        )
        data = _record(attachment)
        index = AttachmentIndex(
            offset=self._whole.end, length=len(data), log_time=time_ns, create_time=time_ns, data_size=len(content),
            name=name, media_type="application/json",
        )  # fmt: skip
        if done := self._whole.write([data]):
            self._attachments.append(index)
        return done

    def end_chunk(self, compressed: bool = False) -> bool:
        """What is at hand to the disk, as one chunk; False, and gone, where that is not to be."""
        if not self._places:
            return True
        times = [time_ns for places in self._places.values() for time_ns, _ in places]
        first, last = min(times), max(times)
        crc = 0
        for piece in self._pieces:
            crc = zlib.crc32(piece, crc)
        codec, packed, length = self._packed(compressed)
        inside = _CHUNK.size - 9 + len(codec) + 8 + length
        head = _CHUNK.pack(Opcode.CHUNK, inside, first, last, self._size, crc, len(codec))
        indexes: list[bytes] = []
        offsets: dict[int, int] = {}
        begin, after = self._whole.end, self._whole.end + 9 + inside
        for channel, places in self._places.items():
            offsets[channel] = after + sum(map(len, indexes))
            indexes.append(_record(MessageIndex(channel, places)))
        index = ChunkIndex(
            chunk_start_offset=begin, chunk_length=9 + inside, compression=codec, compressed_size=length,
            uncompressed_size=self._size, message_start_time=first, message_end_time=last,
            message_index_offsets=offsets, message_index_length=sum(map(len, indexes)),
        )  # fmt: skip
        if done := self._whole.write([head + codec.encode() + _U64.pack(length), *packed, *indexes]):
            self._indexes.append(index)
            self._counts.update({channel: len(places) for channel, places in self._places.items()})
            self._chunks += 1
            before = self._times or (first, last)
            self._times = min(before[0], first), max(before[1], last)
        else:
            for known, key in self._new:  # what says whose messages they are was lost with them: to be said again
                del known[key]
        self._new.clear()
        self._pieces, self._size, self._places = [], 0, {}
        return done

    def finish(self) -> bool:
        """Index and end; an end alone where an index is not to be had. Readers of ours do without."""
        done = self._indexes.complete() and self._whole.write(self._ending())
        return done or self._whole.write([_record(DataEnd(0)), _record(Footer(0, 0, 0)), MCAP0_MAGIC])

    def close(self) -> None:
        self._indexes.close()

    def _said_of(self, number: int, topic: str, encoding: str, form: Form) -> Channel:
        schema = self._schemas[form.name].id
        return Channel(id=number, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema)

    def _tell(self, known: dict[Any, Any], key: Any, record: Schema | Channel) -> None:
        known[key] = record
        self._new.append((known, key))
        self._pieces.append(_record(record))
        self._size += len(self._pieces[-1])

    def _packed(self, compressed: bool) -> tuple[str, list[Piece], int]:
        """The chunk's codec, its bytes as they are stored, how many."""
        if compressed and self._size <= PACKED_MAX:
            packer = self._compressor.compressobj(size=self._size)
            packed: list[Piece] = [packer.compress(piece) for piece in self._pieces]
            packed.append(packer.flush())
            length = sum(map(len, packed))
            if length < self._size:
                return ZSTD, packed, length
        return "", self._pieces, self._size

    def _ending(self) -> Iterator[bytes]:
        """What follows the last chunk, a block at a time."""
        data_end = _record(DataEnd(0))
        yield data_end
        start = at = self._whole.end + len(data_end)
        crc = 0
        first, last = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=dict(self._counts), chunk_count=self._chunks, message_count=self._counts.total(),
            message_start_time=first, message_end_time=last, metadata_count=0, schema_count=len(self._schemas),
        )  # fmt: skip
        groups: list[tuple[Opcode, Iterable[bytes]]] = [
            (Opcode.SCHEMA, map(_record, self._schemas.values())),
            (Opcode.CHANNEL, map(_record, self._channels.values())),
            (Opcode.STATISTICS, [_record(statistics)]),
            (Opcode.CHUNK_INDEX, self._indexes.blocks()),
            (Opcode.ATTACHMENT_INDEX, map(_record, self._attachments)),
        ]
        offsets = []
        for opcode, blocks in groups:
            began = at
            for block in blocks:
                crc, at = zlib.crc32(block, crc), at + len(block)
                yield block
            if at > began:
                offsets.append(_record(SummaryOffset(opcode, began, at - began)))
        for block in offsets:
            crc = zlib.crc32(block, crc)
            yield block
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, at), crc)
        yield _record(Footer(start, at, crc))
        yield MCAP0_MAGIC


def _record(content: Any) -> bytes:
    builder = RecordBuilder()
    content.write(builder)
    return bytes(builder.end())
