"""A closed recording's contents by the index at its end (`record/index.py`), checked before it is believed."""

import struct
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import IO, Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.record.allowance import Allowance
from annulus_pipe.record.index import (
    CHUNK_COLUMNS,
    NAME,
    NOTES,
    ROW_COLUMNS,
    U64,
    Notes,
    Numbers,
    attached,
    columns,
    count_of,
    numbers,
    plan,
    rows_of,
    unpack,
)
from annulus_pipe.record.walk import (
    ATTACHMENT_MAX,
    DAMAGE_MAX,
    MAGIC,
    PACKED_MAX,
    Channel,
    Chunk,
    Damage,
    DamagedError,
    MessageLocation,
    piece,
)

BYTES_A_MESSAGE = 4  # of a file, at least: of JSON and its head, packed as well as can be
HEAD = 64 << 10  # bytes of a file's beginning that are read at once: attachments
TAIL = 64 << 10  # bytes that are read first: footer, where the summary's parts are, attachments
_FOOTER = struct.Struct("<BQQQI")
_RECORD = struct.Struct("<BQ")
_SUMMARY_OFFSET = struct.Struct("<BQBQQ")
_ATTACHMENT_INDEX, _SUMMARY = 10, 14
_DATA_END_BYTES = _RECORD.size + 4


class Indexed:
    """`Contents` by an index. ValueError where it cannot be true of a file of `size` bytes up to `end`."""

    def __init__(
        self,
        file: IO[bytes],
        end: int,
        head: Mapping[str, Any],
        blocks: Iterable[bytes],
        attachments: dict[str, bytes],
        label_topic: str,
        notes: tuple[tuple[int, int], ...] | tuple[bytes, ...] = (),
    ) -> None:
        """`notes`: blocks, or where they lie."""
        self.file, self.attachments = file, attachments
        self.channels = {count_of(one[0], 1 << 16): _channel(one) for one in rows_of(head, "channels", 4)}
        self.schemas = {
            count_of(one[0], 1 << 16): untrusted.text(one[1], "schema", 256) for one in rows_of(head, "schemas", 2)
        }
        self.compression, self.ended = "", True
        self.data_crc: tuple[int, int] | None = None
        self.cut_messages: int | None = 0
        self.damage: list[Damage] = []
        self.chunks: list[Chunk] = []
        self.messages: list[MessageLocation] = []
        self._contents: dict[tuple[int, int], bytes] = {}
        self._looked_at: dict[int, bool] = {}
        self._allowed = Allowance()
        self._labels = [number for number, one in self.channels.items() if one.topic == label_topic]
        self._end = end
        self._loose = head.get("loose") is True  # a file without chunks
        for block in blocks:
            self._take(unpack(block))
        topics = {number: one.topic for number, one in self.channels.items()}
        here = tuple(one for one in notes if isinstance(one, bytes))
        self.notes = Notes(topics, here, tuple(one for one in notes if not isinstance(one, bytes)))
        if len(self.chunks) != head.get("chunks") or len(self.messages) != head.get("rows"):
            raise ValueError("index: other counts than its blocks")

    def _take(self, block: Mapping[str, Any]) -> None:
        count, rows = count_of(block.get("chunks"), 1 << 24), count_of(block.get("rows"), 1 << 24)
        if block.get("first") != len(self.chunks):
            raise ValueError("index: a block is missing")
        if (len(self.messages) + rows) * BYTES_A_MESSAGE > self._end:
            raise ValueError("index: more messages than the file has room for")
        chunk = [numbers(one, count) for one in columns(block, "chunk", CHUNK_COLUMNS)]
        offset, length, crc, _, messages, size = chunk
        last = self.chunks[-1].offset + self.chunks[-1].length if self.chunks else len(MAGIC)
        ends = np.concatenate([[np.uint64(last)], offset + length]).astype(U64)
        if count and not (
            np.all(length <= self._end)
            and np.all(offset <= self._end)
            and np.all(offset >= ends[:-1])
            and ends[-1] <= self._end
            and np.all(size <= PACKED_MAX)
            and max(crc.max(), messages.max()) < 1 << 32
        ):
            raise ValueError("index: chunks that lie outside the file")
        fresh = [
            Chunk(one[0], one[1], one[2] if one[3] else None, one[4], one[5])
            for one in zip(*(column.tolist() for column in chunk), strict=True)
        ]
        self.chunks += fresh
        row = [numbers(one, rows) for one in columns(block, "row", ROW_COLUMNS)]
        which, channel, sequence, _, at, bytes_ = row
        if rows:
            self._check_rows(which, at, bytes_, offset, length, size, len(self.chunks) - count)
            if channel.max() >= 1 << 16 or sequence.max() >= 1 << 32:
                raise ValueError("index: a message with numbers that none has")
        first = len(self.chunks) - count
        found = [
            MessageLocation(one[1], one[2], one[3], one[4], one[5], None if self._loose else fresh[one[0] - first])
            for one in zip(*(column.tolist() for column in row), strict=True)
        ]
        self.messages += found
        self._take_labels(block, found)

    def _check_rows(
        self, which: Numbers, at: Numbers, bytes_: Numbers, offset: Numbers, length: Numbers, size: Numbers, first: int
    ) -> None:
        if self._loose:
            ok = len(offset) == 0 and np.all(at <= self._end) and np.all(bytes_ <= self._end)
            if not (ok and np.all(at + bytes_ <= self._end)):
                raise ValueError("index: messages that lie outside the file")
            return
        if which.min() < first or which.max() >= first + len(offset) or np.any(which[1:] < which[:-1]):
            raise ValueError("index: messages of chunks that are not there")
        number = (which - np.uint64(first)).astype(np.int64)
        start = np.where(size[number] > 0, 0, offset[number]).astype(U64)
        end = start + np.where(size[number] > 0, size[number], length[number]).astype(U64)
        same = which[1:] == which[:-1]
        if not (
            np.all(bytes_ <= end)
            and np.all(at >= start)
            and np.all(at <= end)
            and np.all(at + bytes_ <= end)
            and np.all(at[1:][same] >= (at + bytes_)[:-1][same])
        ):
            raise ValueError("index: messages that lie outside their chunks")

    def _take_labels(self, block: Mapping[str, Any], found: Sequence[MessageLocation]) -> None:
        labels = [one for one in found if one.channel in self._labels]
        lengths = numbers(block.get("said"), len(labels)).tolist()
        content = block.get("labels")
        if not isinstance(content, bytes) or sum(lengths) != len(content):
            raise ValueError("index: labels of another length")
        at = 0
        for message, length in zip(labels, lengths, strict=True):
            key = -1 if message.chunk is None else message.chunk.offset, message.offset
            self._contents[key] = content[at : at + length]
            at += length

    def content(self, message: MessageLocation) -> bytes:
        chunk = message.chunk
        known = self._contents.pop((-1 if chunk is None else chunk.offset, message.offset), None)
        if known is not None:
            return known
        if chunk is None:
            return piece(self.file, message.offset, message.length)
        return chunk.peek(self.file, message.offset, message.length)

    def look_at(self, chunk: Chunk | None) -> bool:
        if chunk is None:
            return True
        if chunk.offset not in self._looked_at:
            try:
                chunk.read(self.file, self._allowed)
                self._looked_at[chunk.offset] = True
            except DamagedError as error:
                self._looked_at[chunk.offset] = False
                if len(self.damage) < DAMAGE_MAX:
                    self.damage.append(Damage(chunk.offset, str(error), chunk.messages or None))
        return self._looked_at[chunk.offset]


def _channel(one: list[Any]) -> Channel:
    topic, encoding = (untrusted.text(text, "index: channel", 1 << 16) for text in one[1:3])
    return Channel(topic, encoding, count_of(one[3], 1 << 16))


def read_index(file: IO[bytes], size: int, wanted: Sequence[str], label_topic: str) -> Indexed | None:
    """A closed file's contents by the index at its end; None where there is none that can be of this file.

    wanted : names of the attachments that are read.
    """
    try:
        return _read(file, size, wanted, label_topic)
    except (ValueError, struct.error, IndexError, OverflowError):
        return None


def _read(file: IO[bytes], size: int, wanted: Sequence[str], label_topic: str) -> Indexed | None:
    start = max(0, size - TAIL)
    tail = piece(file, start, size - start)
    at = len(tail) - len(MAGIC) - _FOOTER.size
    if at < 0 or not tail.endswith(MAGIC):
        return None
    opcode, length, summary, offsets, _ = _FOOTER.unpack_from(tail, at)
    if opcode != 2 or length != _FOOTER.size - _RECORD.size or not start <= offsets <= start + at:
        return None
    group = _group(tail[offsets - start : at])
    if group is None or not start <= group[0] <= group[0] + group[1] <= offsets:
        return None
    listed = _listed(tail[group[0] - start : group[0] - start + group[1]])
    places = listed.pop(NAME, None)
    blocks = {int(name[len(NAME) + 1 :]): place for name, place in listed.items() if name.startswith(f"{NAME}/")}
    if places is None or sorted(blocks) != list(range(len(blocks))):
        return None
    noted = {int(name[len(NOTES) + 1 :]): place for name, place in listed.items() if name.startswith(f"{NOTES}/")}
    if sorted(noted) != list(range(len(blocks))):
        return None
    notes = [noted[number] for number in range(len(blocks))]
    inside = [blocks[number] for number in range(len(blocks))] + [places]
    begin, end = inside[0][0], sum(places)
    if any(sum(a) != b[0] for a, b in pairwise(inside)) or end + _DATA_END_BYTES != summary:
        return None
    first = notes[0][0] if notes else begin
    if any(sum(a) != b[0] for a, b in pairwise([*notes, inside[0]])) or not len(MAGIC) < first <= begin < end <= size:
        return None
    if begin < start:
        plan(file, [(begin, min(end, start))])
    data = piece(file, begin, min(end, start) - begin) if begin < start else b""
    data += tail[max(0, begin - start) : max(0, end - start)]
    contents = (attached(data[one[0] - begin : sum(one) - begin]) for one in inside[:-1])
    head = unpack(attached(data[places[0] - begin :])[1])
    if head.get("begin") != first or head.get("at") != places[0]:
        return None
    attached_at = [(name, (offset, length)) for name, offset, length in rows_of(head, "attached", 3)]
    kept = {name: place for name, place in attached_at if name in wanted}
    if any(listed.get(name) != place for name, place in kept.items()):  # the list has no checksum
        return None
    if any(sum(place) > first or place[1] > ATTACHMENT_MAX for place in kept.values()):
        return None
    plan(file, [(offset, offset + length) for offset, length in kept.values()])
    attachments = {name: attached(piece(file, *place), name)[1] for name, place in kept.items()}
    return Indexed(file, first, head, (one for _, one in contents), attachments, label_topic, tuple(notes))


def _group(offsets: bytes) -> tuple[int, int] | None:
    """Where the summary lists attachments: offset, length. None also where there is anything else: of two files in one
    the second's footer points into the first, and all between the two would be passed over."""
    found = None
    for opcode, _, group, start, length in _SUMMARY_OFFSET.iter_unpack(offsets):
        if opcode != _SUMMARY:
            return None
        if group == _ATTACHMENT_INDEX and found is None:
            found = start, length
    return found


def _listed(data: bytes) -> dict[str, tuple[int, int]]:
    """Where attachments lie, by name: offset and length. ValueError where one name is there twice."""
    out: dict[str, tuple[int, int]] = {}
    at = 0
    while at < len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if opcode != _ATTACHMENT_INDEX or at + length > len(data):
            raise ValueError("the summary lists what is no attachment")
        offset, whole, _, _, _, named = struct.unpack_from("<QQQQQI", data, at)
        name = data[at + 44 : at + 44 + named].decode()
        if name in out:
            raise ValueError("two attachments of one name")
        out[name] = offset, whole
        at += length
    return out
