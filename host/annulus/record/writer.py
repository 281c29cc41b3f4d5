"""A recording written: a kill costs the last moments, a full disk the frames that did not fit, neither the file.

What is in the file: recording.py.
"""

import contextlib
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex, DataEnd, Footer
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from mcap_protobuf.schema import register_schema

from annulus.numeric.arrays import Image
from annulus.record.parts import PART_FILE, Part
from annulus.record.recording import FRAME_TOPIC, LABEL_TOPIC, camera_of_label, to_json
from annulus.stream.frames import CHANNELS
from annulus.vocabulary import AnnulusError

_NOTES_MAX = 1 << 18  # bytes of small records that may wait for the next frame's chunk


class _Whole:
    """A file that holds whole records only: a write that fails half-way is taken back, remembered, and not raised.

    The MCAP writer must not see the error: it would be left in the middle of a chunk, unable to write the next one.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._end = 0
        self.failure: OSError | None = None  # nothing is written until `retry`

    def write(self, data: bytes) -> int:
        if self.failure is None:
            rest = memoryview(data)
            try:
                while rest:
                    rest = rest[self._file.write(rest) :]
                self._end += len(data)
            except OSError as error:
                self.failure = error
                self._file.seek(self._end)
                self._file.truncate()
        return len(data)

    def retry(self) -> None:
        self.failure = None

    def tell(self) -> int:
        return self._end

    def flush(self) -> None:
        pass


class _ChunkIndexes:
    """What the end of the file says of each chunk, in a file without a name. In memory it was 0.6 kB a frame: 50 MB an
    hour.
    """

    def __init__(self, folder: Path) -> None:
        self.failure: OSError | None = None  # no index can be written any more
        try:
            self._file: IO[bytes] | None = tempfile.TemporaryFile(dir=folder, buffering=1 << 16)  # noqa: SIM115
        except OSError as error:
            self._file, self.failure = None, error

    def append(self, index: ChunkIndex) -> None:
        builder = RecordBuilder()
        index.write(builder)
        self._try(lambda file: file.write(builder.end()))

    def write(self, builder: RecordBuilder) -> None:
        """All of them, as records."""
        self._try(lambda file: file.seek(0))
        while self._file is not None and (data := self._file.read(1 << 20)):
            builder.write(data)

    def __iter__(self) -> "Iterator[_ChunkIndexes]":
        """The MCAP writer asks each of its indexes to `write` itself: this one writes all."""
        yield self

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


class RecordingWriter:
    """Writes one recording. What the disk does not take is counted in `lost`, by what it was, and never raised."""

    def __init__(
        self,
        path: Path,
        *,
        calibration: Mapping[str, Any] | None,
        configuration: Mapping[str, Any],
        now_ns: int,
        file: IO[bytes] | None = None,
        part: Part | None = None,
    ) -> None:
        """Creates `path`, which must not exist (`file`, an unbuffered binary file, is written instead when given).

        Raises AnnulusError when the file cannot be begun.
        """
        self.lost: Counter[str] = Counter()  # by topic, frames of all cameras as "/frame"
        self.written: Counter[str] = Counter()
        self.problem = ""  # the last reason for a loss
        self._pending: Counter[str] = Counter()
        self._pending_bytes = 0
        self._pending_since = 0.0
        try:
            self._file = path.open("xb", buffering=0) if file is None else file
        except OSError as error:
            raise AnnulusError(f"{path}: cannot be written ({error.strerror}). Choose another folder.") from None
        self._whole = _Whole(self._file)
        self._writer = Writer(
            cast(IO[Any], self._whole),
            chunk_size=1 << 62,  # chunks end where we say
            compression=CompressionType.NONE,
        )
        self._indexes = _ChunkIndexes(path.parent)
        setattr(self._writer, "_Writer__chunk_indices", self._indexes)  # noqa: B010 - a name of its own making
        self._writer.start(profile="annulus")
        self._channels: dict[str, int] = {}  # by topic, those that are on disk or about to be
        self._new: list[str] = []  # of them, those that are not on disk yet
        # On disk before anything else: without these records nothing that follows could be read.
        self._image = register_schema(self._writer, RawImage)
        self._record = self._writer.register_schema("annulus.record", "jsonschema", b'{"type":"object"}')
        self._channel(LABEL_TOPIC)
        self.note("/event", {"kind": "recording_started", "text": "recording started"}, now_ns)
        self._flush()
        attached = {
            PART_FILE: None if part is None else part.to_dict(),  # first: it is looked for at the beginning of the file
            "calibration.json": calibration,
            "configuration.json": configuration,
        }
        for name, content in attached.items():
            if content is not None:
                self._writer.add_attachment(now_ns, now_ns, name, "application/json", to_json(content))
        if self.lost or self._whole.failure is not None:
            self.abandon()
            path.unlink(missing_ok=True)
            raise AnnulusError(f"{path}: cannot be written ({self.problem or self._whole.failure}). Is the disk full?")

    def frame(self, label: Mapping[str, Any], image: Image, time_ns: int) -> bool:
        """A frame with its label; False when it was lost.

        `label` must hold index, label, z_mm, encoding, width, height, and camera unless it is 0; it is written to
        /label as it is. `time_ns`: the frame's timestamp, host monotonic.
        """
        index = int(label["index"])
        seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
        camera = camera_of_label(label)
        raw = RawImage(
            frame_id=f"camera/{camera}" if camera else "camera",
            width=int(label["width"]),
            height=int(label["height"]),
            encoding=str(label["encoding"]),
            step=int(label["width"]) * CHANNELS[str(label["encoding"])],
        )
        raw.timestamp.seconds, raw.timestamp.nanos = seconds, nanoseconds
        self._add(LABEL_TOPIC, to_json(label), time_ns, index)
        self._add(f"{FRAME_TOPIC}/{camera}", _with_pixels(raw, image), time_ns, index, FRAME_TOPIC)
        return self._flush()

    def note(self, topic: str, body: Mapping[str, Any], time_ns: int, sequence: int = 0) -> None:
        """A small record on any topic that is not a frame's. Goes to disk with the next frame, or with `flush`."""
        self._add(topic, to_json(body), time_ns, sequence)
        if self._pending_bytes > _NOTES_MAX:
            self._flush()

    @property
    def waiting_s(self) -> float:
        """For how long the oldest record that is not on disk has waited."""
        return time.monotonic() - self._pending_since if self._pending else 0.0

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._whole.tell()

    def fileno(self) -> int:
        return self._file.fileno()

    def flush(self) -> None:
        """Write what waits."""
        self._flush()

    def gone(self, path: Path) -> str:
        """Why what was written is not what is at `path` any more, a few words; empty when it is."""
        mine = os.fstat(self._file.fileno())
        try:
            there = path.stat()
        except OSError:
            return "was removed while it was written"
        if mine.st_nlink == 0 or (there.st_dev, there.st_ino) != (mine.st_dev, mine.st_ino):
            return "was replaced while it was written"
        return "was cut short while it was written" if mine.st_size < self._whole.tell() else ""

    def abandon(self) -> None:
        """Let go of a file that is gone."""
        self._file.close()
        self._indexes.close()

    def close(self) -> None:
        """End the file. After a loss it gets no index (the index would name what is not there); readers do without."""
        if self._file.closed:
            return
        self._flush()
        if self.lost or not self._indexes.complete():
            builder = RecordBuilder()
            DataEnd(0).write(builder)
            Footer(0, 0, 0).write(builder)
            self._whole.retry()
            self._whole.write(builder.end() + MCAP0_MAGIC)
        else:
            self._writer.finish()
        if self._whole.failure is not None:
            self.problem = _reason(self._whole.failure)
        self._file.close()
        self._indexes.close()

    def __enter__(self) -> "RecordingWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _channel(self, topic: str, image: bool = False) -> int:
        if topic not in self._channels:
            kind = ("protobuf", self._image) if image else ("json", self._record)
            self._channels[topic] = self._writer.register_channel(topic, *kind)
            self._new.append(topic)
        return self._channels[topic]

    def _add(self, topic: str, data: bytes, time_ns: int, sequence: int, kind: str = "") -> None:
        channel = self._channel(topic, image=kind == FRAME_TOPIC)
        self._writer.add_message(channel, time_ns, data, time_ns, sequence)
        if not self._pending:
            self._pending_since = time.monotonic()
        self._pending[kind or topic] += 1
        self._pending_bytes += len(data)

    def _flush(self) -> bool:
        self._whole.retry()  # try again: space may have come back
        self._writer.flush()
        failure = self._whole.failure
        (self.written if failure is None else self.lost).update(self._pending)
        if failure is not None:
            self.problem = _reason(failure)
            for topic in self._new:  # what says whose messages they are was lost with them: to be said again
                del self._channels[topic]
        self._new.clear()
        self._pending.clear()
        self._pending_bytes = 0
        return failure is None


def _with_pixels(raw: RawImage, image: Image) -> bytes:
    """The message with its `data`, as SerializeToString would give it but for the order of fields, which is anybody's.
    Half the recorder's time was protobuf's three copies of a picture; this is one.
    """
    length, left = bytearray(), image.nbytes  # as a base-128 varint
    while left > 0x7F:
        length.append(left & 0x7F | 0x80)
        left >>= 7
    length.append(left)
    tag = bytes([RawImage.DATA_FIELD_NUMBER << 3 | 2])  # length-delimited
    return b"".join((raw.SerializeToString(), tag, length, np.ascontiguousarray(image).data))


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
