"""A recording written: a kill costs the last moments, a full disk the frames that did not fit, neither the file.

What is in the file: recording.py. What is small lies in chunks of its own, each frame with its label in another: so
opening a recording unpacks no pictures, and looking at a note checks none.
"""

import os
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record import viewers
from annulus_pipe.record.clock import CLOCK_FILE, Clock
from annulus_pipe.record.codec import DEFAULT, Codec, is_mosaic, jpeg
from annulus_pipe.record.container import ChannelForm, Container, Piece
from annulus_pipe.record.frames import FRAME_TOPIC, LABEL_TOPIC, camera_of_label, to_json
from annulus_pipe.record.parts import PART_FILE, Part
from annulus_pipe.stream.frames import CHANNELS
from annulus_pipe.vocabulary import AnnulusError

RECORD = ChannelForm("annulus_pipe.record", "jsonschema", b'{"type":"object"}')
_NOTES_MAX = 1 << 18  # bytes of small records that may wait for the next frame
_PIXELS_FIELD = 6  # of a RawImage


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
        codec: Codec = DEFAULT,
        clock: Clock | None = None,
        previews: bool = True,
    ) -> None:
        """Creates `path`, which must not exist (`file`, an unbuffered binary file, is written instead when given).

        now_ns : host monotonic, as all times here. clock : what they are by the clock on the wall; read now if None.
        previews : mosaics have a small picture beside them, for viewers.
        Raises AnnulusError when the file cannot be begun.
        """
        self.lost: Counter[str] = Counter()  # by topic, frames of all cameras as "/frame"
        self.written: Counter[str] = Counter()
        self.problem = ""  # the last reason for a loss
        self.hurried = False  # frames come faster than they are written: those that follow are not compressed
        self._codec, self._previews = codec, previews
        self._clock = clock or Clock.now()
        self._pending: Counter[str] = Counter()
        self._pending_bytes = 0
        self._pending_since = 0.0
        self._latest: dict[str, int] = {}  # by topic
        try:
            self._file = path.open("xb", buffering=0) if file is None else file
        except OSError as error:
            raise AnnulusError(f"{path}: cannot be written ({error.strerror}). Choose another folder.") from None
        self._container = Container(self._file, path.parent, (LABEL_TOPIC, FRAME_TOPIC))
        done = self._container.begun
        attached = {
            PART_FILE: None if part is None else part.to_dict(),  # first: it is looked for at the beginning of the file
            CLOCK_FILE: self._clock.to_dict(),
            "calibration.json": calibration,
            "configuration.json": configuration,
        }
        # On disk before anything else: without these nothing that follows could be read.
        for name, content in attached.items():
            if content is not None:
                done = done and self._container.attach(self._clock.utc(now_ns), name, to_json(content))
        self._container.channel(LABEL_TOPIC, "json", RECORD)
        for topic, message in viewers.of_calibration(calibration or {}, self._clock.utc(now_ns)):
            self._say(topic, message, now_ns)
        self.note("/event", {"kind": "recording_started", "text": "recording started"}, now_ns)
        if not (done and self._flush()):
            self.abandon()
            path.unlink(missing_ok=True)
            why = self.problem or _reason(self._container.failure)
            raise AnnulusError(f"{path}: cannot be written ({why}). Is the disk full?")

    def frame(
        self,
        label: Mapping[str, Any],
        image: Image,
        time_ns: int,
        as_jpeg: bytes | None = None,
        *,
        preview: bool = True,
    ) -> bool:
        """A frame with its label; False when it was lost.

        `label` must hold index, label, z_mm, encoding, width, height, and camera unless it is 0; it is written to
        /label as it is. `time_ns`: the frame's timestamp, host monotonic. `as_jpeg`: the picture where it is one
        already, to be kept as it is. `preview`: False leaves a mosaic's small picture out.
        """
        index, camera, encoding = int(label["index"]), camera_of_label(label), str(label["encoding"])
        utc_ns, frame_id = self._clock.utc(time_ns), viewers.of_camera(camera)
        for topic, message in viewers.of_label(label, utc_ns):
            self._say(topic, message, time_ns)
        if self._codec is Codec.JPEG and as_jpeg is None:
            as_jpeg = jpeg(image, encoding)
        preview = preview and self._previews and not self.hurried
        if as_jpeg is None and is_mosaic(encoding) and preview and min(image.shape) > 1:
            small = viewers.preview(image, encoding)
            picture = viewers.jpeg_message(small.tobytes(), viewers.of_camera(camera, viewers.PREVIEW), utc_ns)
            self._say(f"{viewers.PREVIEW_TOPIC}/{camera}", picture, time_ns, index)
        self._flush()
        form: Any = viewers.RAW
        if as_jpeg is not None:
            form = viewers.JPEG
            content: tuple[Piece, ...] = (viewers.jpeg_message(as_jpeg, frame_id, utc_ns).SerializeToString(),)
        else:
            width, height = int(label["width"]), int(label["height"])
            raw = viewers.raw_message(width, height, encoding, width * CHANNELS[encoding], frame_id, utc_ns)
            content = _with_pixels(raw.SerializeToString(), image)
        self._add(LABEL_TOPIC, to_json(label), time_ns, index)
        self._put(f"{FRAME_TOPIC}/{camera}", "protobuf", viewers.form(form), time_ns, index, *content, kind=FRAME_TOPIC)
        packed = self._codec is Codec.ZSTD and not self.hurried and as_jpeg is None
        return self._flush(packed, cells=as_jpeg is None and CHANNELS[encoding] == 1)

    def note(self, topic: str, body: Mapping[str, Any], time_ns: int, sequence: int = 0) -> None:
        """A small record on any topic that is not a frame's. Goes to disk with the next frame, or with `flush`."""
        self._add(topic, to_json(body), time_ns, sequence)
        for shown, message in viewers.of_note(topic, body, self._clock.utc(time_ns)):
            self._say(shown, message, time_ns, sequence)
        if self._pending_bytes > _NOTES_MAX:
            self._flush()

    @property
    def waiting_s(self) -> float:
        """For how long the oldest record that is not on disk has waited."""
        return time.monotonic() - self._pending_since if self._pending else 0.0

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._container.size

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
        return "was cut short while it was written" if mine.st_size < self._container.size else ""

    def abandon(self) -> None:
        """Let go of a file that is gone."""
        self._file.close()
        self._container.close()

    def close(self) -> None:
        """End the file: with an index of what is in it, unless there is no room for one; readers of ours do without."""
        if self._file.closed:
            return
        self._flush()
        if not self._container.finish():
            self.problem = _reason(self._container.failure)
        self.abandon()

    def __enter__(self) -> "RecordingWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _say(self, topic: str, message: Any, time_ns: int, sequence: int = 0) -> None:
        """To viewers."""
        self._put(topic, "protobuf", viewers.form(type(message)), time_ns, sequence, message.SerializeToString())

    def _add(self, topic: str, data: bytes, time_ns: int, sequence: int, kind: str = "") -> None:
        form = ("json", RECORD) if kind != FRAME_TOPIC else ("protobuf", viewers.form(viewers.RAW))
        self._put(topic, *form, time_ns, sequence, data, kind=kind)

    def _put(
        self, topic: str, encoding: str, form: ChannelForm, time_ns: int, sequence: int, *content: Piece, kind: str = ""
    ) -> None:
        utc_ns = self._clock.utc(time_ns)
        if kind != FRAME_TOPIC:  # what was sent first and comes later is not shown before what came
            utc_ns = self._latest[topic] = max(utc_ns, self._latest.get(topic, 0))
        self._container.message(self._container.channel(topic, encoding, form), utc_ns, sequence, *content)
        if not self._pending:
            self._pending_since = time.monotonic()
        self._pending[kind or topic] += 1
        self._pending_bytes += sum(map(len, content))

    def _flush(self, compressed: bool | None = None, cells: bool = False) -> bool:
        """`compressed`: by default as notes are."""
        packed = self._codec is not Codec.RAW and not self.hurried if compressed is None else compressed
        done = self._container.end_chunk(packed, cells)
        (self.written if done else self.lost).update(self._pending)
        if not done:
            self.problem = _reason(self._container.failure)
        self._pending.clear()
        self._pending_bytes = 0
        return done


def _with_pixels(raw: bytes, image: Image) -> tuple[Piece, ...]:
    """A RawImage with its `data`, as SerializeToString would give it but for the order of fields, which is anybody's:
    protobuf would copy the picture three times.
    """
    length, left = bytearray(), image.nbytes  # as a base-128 varint
    while left > 0x7F:
        length.append(left & 0x7F | 0x80)
        left >>= 7
    length.append(left)
    tag = bytes([_PIXELS_FIELD << 3 | 2])  # length-delimited
    return raw + tag + bytes(length), np.ascontiguousarray(image).data.cast("B")


def _reason(error: OSError | None) -> str:
    return "" if error is None else error.strerror or str(error)
