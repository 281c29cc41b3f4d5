"""Promises of packed chunks to whoever opens a stranger's file: no more is unpacked than a chunk says, none that says
too much, and what was looked at is let go.
"""

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard

from annulus_pipe.record import walk
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.walk import DamagedError
from annulus_pipe.record.writer import RecordingWriter

FRAMES, H, W = 8, 96, 128
CODEC = b"\4\0\0\0zstd"


def image_of(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 32, (H, W), dtype=np.uint8)


def write(path: Path) -> Path:
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0, codec=Codec.ZSTD) as writer:
        for index in range(FRAMES):
            label = {"index": index, "label": "led", "z_mm": 1.0, "encoding": "mono8", "width": W, "height": H}
            writer.frame(label, image_of(index), index)
            writer.note("/mark", {"n": index, "text": "x" * 500}, index)
    return path


def again(path: Path, index: int, packed: bytes, size: int, crc: int) -> None:
    """Frame `index`'s chunk says something else; what follows it moves."""
    data, chunk = path.read_bytes(), open_recording(path).frames[index].chunk
    assert chunk is not None and data[chunk.offset - 16 : chunk.offset - 8] == CODEC
    head = data[chunk.offset - 44 : chunk.offset - 28] + struct.pack("<QI", size, crc) + CODEC
    record = head + struct.pack("<Q", len(packed)) + packed
    begin = chunk.offset - 53
    path.write_bytes(data[:begin] + struct.pack("<BQ", 6, len(record)) + record + data[chunk.offset + chunk.length :])


def inside(path: Path, index: int) -> bytes:
    chunk = open_recording(path).frames[index].chunk
    assert chunk is not None
    return zstandard.decompress(path.read_bytes()[chunk.offset : chunk.offset + chunk.length])


@pytest.mark.parametrize("level, sized", [(1, True), (19, False)])
def test_chunks_that_another_program_packed_are_read(tmp_path: Path, level: int, sized: bool) -> None:
    path = write(tmp_path / "a.mcap")
    records = inside(path, 3)
    packed = zstandard.ZstdCompressor(level, write_content_size=sized, write_checksum=True).compress(records)
    again(path, 3, packed, len(records), zlib.crc32(records))
    recording = open_recording(path)
    assert np.array_equal(recording.read_raw(recording.frames[3])[0], image_of(3)) and not recording.check()


@pytest.mark.parametrize("claimed", [10_000_000_000, 2**63, walk.PACKED_MAX + 1])
def test_a_chunk_that_claims_gigabytes_is_refused_and_costs_itself(tmp_path: Path, claimed: int) -> None:
    path = write(tmp_path / "a.mcap")
    again(path, 3, zstandard.compress(bytes(64 << 20)), claimed, 0)
    tracemalloc.start()
    try:
        recording = open_recording(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert [frame.index for frame in recording.frames] == [0, 1, 2, 4, 5, 6, 7] and recording.damage
    assert peak < 2e6, "bytes"


def test_no_more_is_unpacked_than_a_chunk_says(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    records = inside(path, 3)
    packed = zstandard.compress(records + bytes(200 << 20))  # 10 kB
    again(path, 3, packed, len(records), zlib.crc32(records))
    recording = open_recording(path)
    tracemalloc.start()
    try:
        with pytest.raises(DamagedError, match=r"frame 3 is damaged: the chunk at byte \d+ cannot be unpacked"):
            recording.read_raw(recording.frames[3])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2e6, "bytes"
    assert [note["n"] for note in recording.notes("/mark")] == list(range(FRAMES))


def test_what_was_looked_at_is_let_go(tmp_path: Path) -> None:
    """The unpacker is nothing that Python's collector sees through: a ring with it was never let go."""
    path = write(tmp_path / "a.mcap")

    def mapped() -> int:
        return int(Path("/proc/self/statm").read_text().split()[0]) * 4096

    open_recording(path)
    before = mapped()
    for _ in range(40):
        open_recording(path)
    assert mapped() - before < 20e6, "bytes; it was 7 MB for each that was opened"


def test_opening_unpacks_no_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "large.mcap"
    image = np.random.default_rng(0).integers(0, 32, (1232, 1664), dtype=np.uint8)
    label = {"label": "led", "z_mm": 1.0, "encoding": "mono8", "width": 1664, "height": 1232}
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        for index in range(4):
            writer.frame({**label, "index": index}, image, index)
    read = 0

    def counted(file: object, offset: int, length: int) -> bytes:
        nonlocal read
        read += length
        return piece(file, offset, length)  # type: ignore[arg-type]

    piece = walk.piece
    monkeypatch.setattr(walk, "piece", counted)
    frames = open_recording(path).frames
    assert len(frames) == 4 and all(frame.chunk is not None and frame.chunk.size > 2_000_000 for frame in frames)
    first = frames[0].chunk
    assert first is not None  # it says what /frame/0 is, and is checked
    assert read < first.length + 4 * 200_000, "bytes, of 5 MB"
