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

from annulus_pipe.record import index
from annulus_pipe.record import walk as walked
from annulus_pipe.record.walk import ATTACHMENT_MAX, PACKED_MAX, Chunk

ZSTD = "zstd"
ZSTD_LEVEL = 1  # 3 takes twice as long for a tenth of a mosaic's bytes
# bits: of pictures with one colour a pixel. What a sensor's noise repeats it repeats by chance: to look for it in 64
# places takes 2.1 to 4.3 ms, in level 1's 16 384 4.7 to 5.8, for 2 to 6 % of the bytes. docs/decisions/0055
CELLS_HASH_LOG = 6
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_CHUNK = struct.Struct("<BQQQQII")  # opcode, length, first and last time, bytes, checksum, length of the codec's name
_U64 = struct.Struct("<Q")
_LISTED = struct.Struct("<QQIQQQI")  # of a chunk, while it waits: as `Chunk`, where offsets begin, messages asked for
_ROW = struct.Struct("<HIQQQI")  # of each: channel, sequence, time, offset, length, bytes of JSON
_BLOCK = 1 << 20
_PACKED = "application/zstd"

Piece = bytes | bytearray | memoryview


@dataclass(frozen=True, slots=True)
class ChannelForm:
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


class _Waiting:
    """What is written when the file ends, in a file without a name."""

    def __init__(self, folder: Path) -> None:
        self.failure: OSError | None = None  # no index can be written any more
        try:
            self._file: IO[bytes] | None = tempfile.TemporaryFile(dir=folder, buffering=1 << 16)  # noqa: SIM115
        except OSError as error:
            self._file, self.failure = None, error

    def append(self, data: bytes) -> None:
        self._try(lambda file: file.write(data))

    def blocks(self) -> Iterator[bytes]:
        """All of it."""
        self._try(lambda file: file.seek(0))
        while self._file is not None and (data := self._file.read(_BLOCK)):
            yield data

    def reader(self) -> Callable[[int], bytes]:
        """All of it again, so many bytes each time. Raises OSError."""
        assert self._file is not None
        self._file.seek(0)
        return self._file.read

    def pieces(self, lengths: Iterable[int]) -> Iterator[bytes]:
        """The whole content, in pieces of the lengths in which it was appended. Raises OSError."""
        read = self.reader()
        return (read(length) for length in lengths)

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


class _Contents:
    """The index of what is written. Its rows wait in a file, not in memory, and are packed at the end."""

    def __init__(self, folder: Path, labels: str, frames: str) -> None:
        self._label_topic, self._frame_topic = labels, frames
        self._waiting, self._packed = _Waiting(folder), _Waiting(folder)
        self._asked: set[int] = set()  # channels
        self._json: set[int] = set()
        self._labels: set[int] = set()
        self._at_hand: list[bytes] = []  # messages of the chunk at hand
        self._chunks = 0
        self.rows = 0

    def channel(self, number: int, topic: str, encoding: str) -> None:
        if index.is_asked_for(topic, encoding, self._frame_topic):
            self._asked.add(number)
        if encoding == "json":
            self._json.add(number)
        if topic == self._label_topic:
            self._labels.add(number)

    def message(
        self, channel: int, sequence: int, time_ns: int, offset: int, length: int, content: tuple[Piece, ...]
    ) -> None:
        """`offset`: in the records of the chunk at hand."""
        if channel in self._asked:
            body = b"".join(content) if channel in self._json else b""
            self._at_hand.append(_ROW.pack(channel, sequence, time_ns, offset, length, len(body)) + body)

    def forget(self) -> None:
        """The chunk at hand is not in the file."""
        self._at_hand.clear()

    def chunk(self, chunk: Chunk, base: int) -> None:
        """What was at hand is in the file. `base`: what its messages' offsets are from."""
        count = len(self._at_hand)
        head = _LISTED.pack(chunk.offset, chunk.length, chunk.crc or 0, chunk.messages, chunk.size, base, count)
        self._waiting.append(head + b"".join(self._at_hand))
        self.rows += count
        self._chunks += 1
        self._at_hand.clear()

    def attachments(self) -> Iterator[tuple[str, bytes]]:
        """All of it, packed, with names. Raises OSError where it could not wait."""
        lengths: list[int] = []
        for number, block in enumerate(self._blocks()):
            packed = block.packed()
            self._packed.append(packed)
            lengths.append(len(packed))
            yield f"{index.NOTES}/{number}", block.packed_notes()
        if not self._packed.complete():
            raise OSError
        for number, packed in enumerate(self._packed.pieces(lengths)):
            yield f"{index.NAME}/{number}", packed

    def _blocks(self) -> Iterator[index.Block]:
        if not self._waiting.complete():
            raise OSError
        read, block = self._waiting.reader(), index.Block()
        for number in range(self._chunks):
            offset, length, crc, messages, size, base, count = _LISTED.unpack(read(_LISTED.size))
            block.chunk(Chunk(offset, length, crc, messages, size))
            for _ in range(count):
                channel, sequence, time_ns, at, bytes_, body_bytes = _ROW.unpack(read(_ROW.size))
                block.row(number, channel, sequence, time_ns, base + at, bytes_)
                if channel in self._labels:
                    block.label(read(body_bytes))
                elif channel in self._json:
                    block.note(channel, sequence, time_ns, read(body_bytes))
            if block.full:
                yield block
                block = index.Block(number + 1)
        if block.chunks:
            yield block

    def close(self) -> None:
        self._waiting.close()
        self._packed.close()


class Container:
    """Schemas, channels and messages into chunks, chunks into the file. Raises nothing for want of room."""

    def __init__(self, file: IO[bytes], folder: Path, indexed: tuple[str, str] | None = None) -> None:
        """`file`: unbuffered, empty. `folder`: where indexes may wait. `indexed`: the topics of labels and, with what
        follows them, of frames: where they are named, the file ends with an index of ours (`record/index.py`).
        """
        self._whole = _Whole(file)
        self._indexes = _Waiting(folder)
        self._contents = None if indexed is None else _Contents(folder, *indexed)
        cells = zstandard.ZstdCompressionParameters.from_level(ZSTD_LEVEL, hash_log=CELLS_HASH_LOG)
        self._compressors = {  # by whether it is of cells
            False: zstandard.ZstdCompressor(level=ZSTD_LEVEL),
            True: zstandard.ZstdCompressor(compression_params=cells),
        }
        self._schemas: dict[str, Schema] = {}  # by name, those on disk or about to be; so with channels
        self._channels: dict[tuple[str, str], Channel] = {}  # by topic and schema
        self._issued = 0, 0  # numbers that were given out: none is given twice
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

    def channel(self, topic: str, encoding: str, form: ChannelForm) -> int:
        """The number of a topic's channel, said before its first message."""
        key = topic, form.name
        if key not in self._channels:
            schemas, channels = self._issued
            if form.name not in self._schemas:
                schemas += 1
                self._tell(
                    self._schemas, form.name, Schema(id=schemas, data=form.data, encoding=form.encoding, name=form.name)
                )
            channels += 1
            self._issued = schemas, channels
            self._tell(self._channels, key, self._said_of(channels, topic, encoding, form))
            if self._contents is not None:
                self._contents.channel(channels, topic, encoding)
        number: int = self._channels[key].id
        return number

    def message(self, channel: int, time_ns: int, sequence: int, *content: Piece) -> None:
        """Into the chunk at hand. `content`, bytes, must not change before the chunk is ended."""
        length = sum(len(piece) for piece in content)
        head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - 9 + length, channel, sequence, time_ns, time_ns)
        self._places.setdefault(channel, []).append((time_ns, self._size))
        if self._contents is not None:
            self._contents.message(channel, sequence, time_ns, self._size + len(head), length, content)
        self._pieces += (head, *content)
        self._size += len(head) + length

    def attach(self, time_ns: int, name: str, content: bytes, media_type: str = "application/json") -> bool:
        attachment = Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=content)
        data = _record(attachment)
        listed = AttachmentIndex(
            offset=self._whole.end,
            length=len(data),
            log_time=time_ns,
            create_time=time_ns,
            data_size=len(content),
            name=name,
            media_type=media_type,
        )
        if done := self._whole.write([data]):
            self._attachments.append(listed)
        return done

    def end_chunk(self, compressed: bool = False, cells: bool = False) -> bool:
        """What is at hand to the disk, as one chunk; False, and gone, where that is not to be. cells : most of it is a
        picture with one colour a pixel."""
        if not self._places:
            return True
        times = [time_ns for places in self._places.values() for time_ns, _ in places]
        first, last = min(times), max(times)
        crc = 0
        for piece in self._pieces:
            crc = zlib.crc32(piece, crc)
        codec, packed, length = self._packed(compressed, cells)
        inside = _CHUNK.size - 9 + len(codec) + 8 + length
        head = _CHUNK.pack(Opcode.CHUNK, inside, first, last, self._size, crc, len(codec))
        indexes: list[bytes] = []
        offsets: dict[int, int] = {}
        begin, after = self._whole.end, self._whole.end + 9 + inside
        for channel, places in self._places.items():
            offsets[channel] = after + sum(map(len, indexes))
            indexes.append(_record(MessageIndex(channel, places)))
        listed = ChunkIndex(
            chunk_start_offset=begin,
            chunk_length=9 + inside,
            compression=codec,
            compressed_size=length,
            uncompressed_size=self._size,
            message_start_time=first,
            message_end_time=last,
            message_index_offsets=offsets,
            message_index_length=sum(map(len, indexes)),
        )
        if done := self._whole.write([head + codec.encode() + _U64.pack(length), *packed, *indexes]):
            self._indexes.append(_record(listed))
            if self._contents is not None:
                first_byte = after - length
                messages = sum(map(len, self._places.values()))
                self._contents.chunk(
                    Chunk(first_byte, length, crc, messages, self._size if codec else 0), 0 if codec else first_byte
                )
            self._counts.update({channel: len(places) for channel, places in self._places.items()})
            self._chunks += 1
            before = self._times or (first, last)
            self._times = min(before[0], first), max(before[1], last)
        else:
            for known, key in self._new:  # what says whose messages they are was lost with them: to be said again
                del known[key]
            if self._contents is not None:
                self._contents.forget()
        self._new.clear()
        self._pieces, self._size, self._places = [], 0, {}
        return done

    def finish(self) -> bool:
        """Index and end; an end alone where an index is not to be had. Readers of ours do without."""
        if self._indexes.complete():
            self._attach_contents()
        done = self._indexes.complete() and self._whole.write(self._ending())
        return done or self._whole.write([_record(DataEnd(0)), _record(Footer(0, 0, 0)), MCAP0_MAGIC])

    def close(self) -> None:
        self._indexes.close()
        if self._contents is not None:
            self._contents.close()

    def _attach_contents(self) -> None:
        """The index of ours, or some of it, which is none: readers then walk."""
        if self._contents is None:
            return
        time_ns, begin = (self._times or (0, 0))[1], self._whole.end
        before = [[one.name, one.offset, one.length] for one in self._attachments]
        channels = {
            one.id: walked.Channel(one.topic, one.message_encoding, one.schema_id) for one in self._channels.values()
        }
        schemas = {one.id: one.name for one in self._schemas.values()}
        try:
            for name, block in self._contents.attachments():
                if len(block) > ATTACHMENT_MAX // 2 or not self.attach(time_ns, name, block, _PACKED):
                    return  # the first: notes of megabytes each
        except (OSError, struct.error):
            return
        head = index.head_of(
            channels,
            schemas,
            self._chunks,
            self._contents.rows,
            begin=begin,
            at=self._whole.end,
            loose=False,
            attached=before,
        )
        self.attach(time_ns, index.NAME, index.pack(head), _PACKED)

    def _said_of(self, number: int, topic: str, encoding: str, form: ChannelForm) -> Channel:
        schema = self._schemas[form.name].id
        return Channel(id=number, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema)

    def _tell(self, known: dict[Any, Any], key: Any, record: Schema | Channel) -> None:
        known[key] = record
        self._new.append((known, key))
        self._pieces.append(_record(record))
        self._size += len(self._pieces[-1])

    def _packed(self, compressed: bool, cells: bool) -> tuple[str, list[Piece], int]:
        """The chunk's codec, its bytes as they are stored, how many."""
        if compressed and self._size <= PACKED_MAX:
            # in one piece: piece by piece the packed bytes are moved a dozen times as they grow, which takes longer
            packed = self._compressors[cells].compress(b"".join(self._pieces))
            if len(packed) < self._size:
                return ZSTD, [packed], len(packed)
        return "", self._pieces, self._size

    def _ending(self) -> Iterator[bytes]:
        """What follows the last chunk, a block at a time."""
        data_end = _record(DataEnd(0))
        yield data_end
        start = at = self._whole.end + len(data_end)
        crc = 0
        first, last = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=self._counts.total(),
            message_start_time=first,
            message_end_time=last,
            metadata_count=0,
            schema_count=len(self._schemas),
        )
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
