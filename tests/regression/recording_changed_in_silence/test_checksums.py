"""A chunk's checksum was never looked at: 205 of 2000 mutated recordings gave other pixels, or their frames another
place, and nothing was told. Fails where `Chunk.read` leaves its checksum alone."""

import random
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.record.codec import Codec
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.walk import DamagedError
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.vocabulary import AnnulusError

FRAMES, H, W = 6, 24, 32


def image(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 32, (H, W), dtype=np.uint8)


@pytest.fixture(scope="module", params=[Codec.RAW, Codec.ZSTD])
def codec(request: pytest.FixtureRequest) -> Codec:
    return Codec(request.param)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, codec: Codec) -> bytes:
    path = tmp_path_factory.mktemp("written") / "scan.mcap"
    more = {"calibration": {"format": "x"}, "configuration": {"fps": 25}}
    with RecordingWriter(path, now_ns=0, codec=codec, **more) as writer:
        for index in range(FRAMES):
            label = {"index": index, "label": "led", "z_mm": 2.5 * index, "encoding": "mono8", "width": W, "height": H}
            writer.frame(label, image(index), index)
            writer.note("/mark", {"n": index}, index)
    return path.read_bytes()


def changed(written: bytes, seed: int) -> bytes:
    rng, data = random.Random(seed), bytearray(written)
    at = rng.randrange(8, len(data))
    match seed % 5:
        case 0:
            data[at] ^= 1 << rng.randrange(8)
        case 1:
            data[at : at + 20] = rng.randbytes(20)
        case 2:
            length = min(rng.randrange(1, 2000), len(data) - at)
            data[at : at + length] = bytes(length)
        case 3:
            del data[at:]
        case 4:
            begin = rng.randrange(len(data))
            data[at:at] = data[begin : begin + rng.randrange(3000)]
    return bytes(data)


def test_what_comes_out_is_what_was_written_or_the_damage_is_told(written: bytes, tmp_path: Path) -> None:
    path, wrong, untold = tmp_path / "changed.mcap", 0, 0
    for seed in range(600):
        path.write_bytes(changed(written, seed))
        try:
            recording = open_recording(path)
        except AnnulusError:
            continue
        told = recording.torn or bool(recording.damage)
        right = set()
        for frame in recording.frames:
            try:
                seen = recording.read_raw(frame)[0]
            except AnnulusError:
                told = True
                continue
            if np.array_equal(seen, image(frame.index)) and frame.z_mm == 2.5 * frame.index:
                right.add(frame.index)
            else:
                wrong += 1
        untold += not told and (len(right) < FRAMES or recording.calibration != {"format": "x"})
        told = told or bool(recording.check())
        untold += not told and [note["n"] for note in recording.notes("/mark")] != list(range(FRAMES))
    assert wrong == untold == 0


def test_one_damaged_chunk_costs_its_frame_and_nothing_else(written: bytes, codec: Codec, tmp_path: Path) -> None:
    path, data = tmp_path / "scan.mcap", bytearray(written)
    path.write_bytes(data)
    frames = open_recording(path).frames
    data[frames[2].chunk.offset + 200] ^= 1  # a pixel
    head = frames[4].chunk.offset - 40
    data[head : head + 20] = bytes(20)  # where a chunk begins
    path.write_bytes(data)
    recording = open_recording(path)
    assert [frame.index for frame in recording.frames] == list(range(FRAMES)), "the index at the end is whole"
    with pytest.raises(DamagedError, match=r"frame 2 is damaged: the chunk at byte \d+ has the wrong checksum, 2 mess"):
        recording.read_raw(recording.frames[2])
    for frame in (frame for frame in recording.frames if frame.index != 2):  # of 4 only what says where it is, is gone
        assert np.array_equal(recording.read_raw(frame)[0], image(frame.index))
    assert [note["n"] for note in recording.notes("/mark")] == list(range(FRAMES))  # in chunks of their own
    told = [damage.text for damage in recording.check()]
    assert any("no records" in text for text in told), told
    assert any(text.startswith("26 messages were written, 2") for text in told), told
    assert any("wrong checksum" in text for text in told) and len(told) == 4, told


def test_a_chunk_that_alone_says_it_has_no_checksum_is_not_believed(
    written: bytes, codec: Codec, tmp_path: Path
) -> None:
    """Fails where a checksum of 0 always means that there is none."""
    path, data = tmp_path / "scan.mcap", bytearray(written)
    path.write_bytes(data)
    frame = open_recording(path).frames[3]
    assert frame.chunk is not None
    end = frame.chunk.offset - 12 - (len("zstd") if codec is Codec.ZSTD else 0)
    data[end - 4 : end] = bytes(4)
    data[frame.chunk.offset + 200] ^= 1
    path.write_bytes(data)
    recording = open_recording(path)
    for frame in recording.frames:
        if frame.index == 3:
            with pytest.raises(DamagedError, match="wrong checksum"):
                recording.read_raw(frame)
    assert codec is Codec.ZSTD or 3 in [frame.index for frame in recording.frames]
    assert any("checksum" in one.text or "unpacked" in one.text for one in recording.check())


def test_a_label_that_took_another_frames_number_changes_no_place(written: bytes, codec: Codec, tmp_path: Path) -> None:
    """Fails where the last of two labels with one number is the frame's, whatever its chunk's checksum says."""
    if codec is not Codec.RAW:
        return  # nothing to be found by its bytes
    path, data = tmp_path / "scan.mcap", bytearray(written)
    text = data.index(b'"z_mm":7.5')
    head = data.rindex(b"{", 0, text) - 22
    assert data[head + 2 : head + 6] == (3).to_bytes(4, "little")
    data[head + 2 : head + 6] = (1).to_bytes(4, "little")
    path.write_bytes(data)
    recording = open_recording(path)
    assert {frame.index: frame.z_mm for frame in recording.frames}[1] == 2.5
    with pytest.raises(DamagedError, match="wrong checksum"):
        recording.read_raw(recording.frames[3])
    assert any("wrong checksum" in one.text for one in recording.check())


def test_a_length_that_makes_what_follows_look_like_a_footer_ends_nothing(written: bytes, tmp_path: Path) -> None:
    """Fails where any record with a footer's opcode ends the walk: one frame of four was left, and no damage told."""
    path, data = tmp_path / "scan.mcap", bytearray(written)
    path.write_bytes(data)
    frames = open_recording(path).frames
    chunk = frames[1].chunk
    assert chunk is not None and frames[-1].chunk is not None
    index = chunk.offset + chunk.length
    assert data[index] == 7  # a message index
    data[index + 1 : index + 9] = bytes(8)
    data[index + 9] = 2
    path.write_bytes(data)
    recording = open_recording(path)
    assert [frame.index for frame in recording.frames] == list(range(FRAMES))
    assert any("no records" in one.text for one in recording.check())
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: frames[-1].chunk.offset + frames[-1].chunk.length])  # .. nor where there is only the walk
    walked = open_recording(cut)
    assert [frame.index for frame in walked.frames] == list(range(FRAMES))
    assert any("no records" in one.text for one in walked.damage)


def test_an_attachment_that_alone_says_it_has_no_checksum_is_not_believed(written: bytes, tmp_path: Path) -> None:
    """Fails where a checksum of 0 means that an attachment has none."""
    path, data = tmp_path / "scan.mcap", bytearray(written)
    at = data.index(b'{"format":"x"}')
    data[at + 14 : at + 18] = bytes(4)
    data[at + 11] ^= 1
    path.write_bytes(data)
    recording = open_recording(path)
    assert recording.calibration is None and [one.text for one in recording.damage] == [
        "an attachment with the wrong checksum"
    ]
