"""A chunk of zeros, 8 kB that unpack to 256 MB, cost 0.6 s whenever its recording was opened, and a file of them
a minute a megabyte."""

import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard

from annulus_pipe.record import allowance, walk
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.writer import RecordingWriter

SIZE = 1 << 20


def chunk_of(records: bytes) -> bytes:
    packed = zstandard.ZstdCompressor().compress(records)
    head = struct.pack("<QQQII", 0, 0, len(records), 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    return struct.pack("<BQ", 6, len(head) + len(packed)) + head + packed


NOTHING = {
    "no records": bytes(SIZE),
    "one message and another": struct.pack("<BQ", 5, SIZE - 100) + bytes(SIZE - 100) + struct.pack("<BQ", 5, 0),
}


@pytest.mark.parametrize("what", NOTHING)
def test_no_more_is_unpacked_than_a_recording_has(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(allowance, "NOTHING_MAX", 8 * SIZE)
    made = []
    unpacker = walk._unpacker

    class Counting:
        def __init__(self, stream: object) -> None:
            self._stream = stream

        def read(self, length: int) -> bytes:
            made.append(len(data := self._stream.read(length)))  # type: ignore[attr-defined]
            return data

        def __enter__(self) -> "Counting":
            return self

        def __exit__(self, *_: object) -> None: ...

    class Unpacker:
        def stream_reader(self, *args: object, **more: object) -> Counting:
            return Counting(unpacker().stream_reader(*args, **more))

    monkeypatch.setattr(walk, "_unpacker", Unpacker)
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        label = {"index": 7, "label": "led", "z_mm": 1.0, "encoding": "mono8", "width": 8, "height": 8}
        writer.frame(label, np.full((8, 8), 9, np.uint8), 7)
    whole = path.read_bytes()
    torn = whole[: whole.index(b"annulus.notes/0") - 29]
    path.write_bytes(torn[:8] + 200 * chunk_of(NOTHING[what]) + torn[8:])
    recording = open_recording(path)
    checked = recording.check()
    assert sum(made) < 2.5 * (8 * SIZE + allowance.NOTHING_TIMES * path.stat().st_size)
    assert any("one too many" in one.text for one in checked)
    assert len(recording.frames) == 1 and recording.frames[0].label.value == "led"
