"""Promises of the index at the end of a recording: what a walk finds, and never a wrong label, whoever wrote it."""

import io
import pickle
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

from annulus_pipe.record import index
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.frames import LABEL_TOPIC, from_json, sorted_out, to_json
from annulus_pipe.record.indexed import read_index
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.walk import DamagedError, Walk
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.untrusted import unpack
from annulus_pipe.vocabulary import AnnulusError

FRAMES, H, W = 40, 24, 32
ATTACHED = ("calibration.json", "configuration.json", "part.json", "clock.json")


def image_of(n: int) -> np.ndarray:
    return np.random.default_rng(n).integers(0, 64, (H, W), dtype=np.uint8)


def write(path: Path, codec: Codec = Codec.ZSTD, count: int = FRAMES) -> Path:
    with RecordingWriter(path, calibration={"a": 1}, configuration={"b": 2}, now_ns=5, codec=codec) as writer:
        for n in range(count):
            for camera in (0, 1):
                label = {
                    "index": n,
                    "camera": camera,
                    "label": "projector" if n % 5 else "led",
                    "z_mm": 0.5 * n,
                    "roll_deg": 0.1 * n,
                    "encoding": "bayer_rggb8",
                    "width": W,
                    "height": H,
                }
                writer.frame(label, image_of(2 * n + camera), 1000 * n + camera)
            if n % 3 == 0:
                writer.note("/mark", {"n": n, "raw": b"abc"}, 1000 * n, n)
    return path


@pytest.mark.parametrize("codec", list(Codec))
@pytest.mark.parametrize("rows", [8, index.ROWS])
def test_an_index_says_what_a_walk_finds(
    tmp_path: Path, codec: Codec, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(index, "ROWS", rows)
    path = write(tmp_path / "a.mcap", codec)
    with path.open("rb") as file:
        walk = Walk(file, path.stat().st_size, ATTACHED, LABEL_TOPIC)
        found = read_index(file, path.stat().st_size, ATTACHED, LABEL_TOPIC)
        assert found is not None
        said = sorted_out(walk)
        assert sorted_out(found) == said and not walk.damage
        assert (found.chunks, found.attachments, found.channels, found.schemas) == (
            walk.chunks,
            walk.attachments,
            walk.channels,
            walk.schemas,
        )
        for topic, messages in said[2].items():
            if topic != LABEL_TOPIC:
                told = [from_json(content) for _, _, content in found.notes.of(topic, file)]
                assert told == [from_json(walk.content(message)) for message in messages]


def test_a_closed_recording_is_not_walked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.mcap")
    monkeypatch.setattr("annulus_pipe.record.recording.Walk", None)
    recording = open_recording(path)
    assert [one["n"] for one in recording.notes("/mark")] == list(range(0, FRAMES, 3))
    again = pickle.loads(pickle.dumps(recording))
    for frame in again.frames:
        assert np.array_equal(again.read_raw(frame)[0], image_of(2 * frame.index + frame.camera))


def test_other_programs_pass_over_it(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    reader = make_reader(io.BytesIO(path.read_bytes()), validate_crcs=True)
    assert sum(channel.topic == LABEL_TOPIC for _, channel, _ in reader.iter_messages()) == 2 * FRAMES
    assert {one.name for one in reader.iter_attachments()} > {"annulus.index", "annulus.index/0", "annulus.notes/0"}


def test_a_check_reads_all_and_holds_the_index_against_it(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    recording = open_recording(path)
    assert recording.check() == ()
    data = bytearray(path.read_bytes())
    chunk = recording.frames[9].chunk
    assert chunk is not None
    data[chunk.offset + chunk.length // 2] ^= 1
    path.write_bytes(data)
    recording = open_recording(path)
    assert recording.check()
    with pytest.raises(DamagedError):
        recording.read_raw(recording.frames[9])
    assert np.array_equal(recording.read_raw(recording.frames[8])[0], image_of(8))


def lying(path: Path, change: Callable[[dict[str, Any]], None], name: str = "annulus.index/0") -> None:
    """The first block says something else, in as many bytes, its checksum right."""
    data = bytearray(path.read_bytes())
    start = data.index(struct.pack("<I", len(name)) + name.encode()) - 16 - 9
    (length,) = struct.unpack_from("<Q", data, start + 1)
    at = start + 9 + 16 + 4 + len(name)
    (media,) = struct.unpack_from("<I", data, at)
    at += 4 + media
    (size,) = struct.unpack_from("<Q", data, at)
    said = unpack(zstandard.decompress(bytes(data[at + 8 : at + 8 + size])), 1 << 30)
    change(said)
    for level in range(1, 23):  # in as many bytes as there were, or fewer and filled up
        packed = zstandard.ZstdCompressor(level=level).compress(msgpack.packb(said))
        if len(packed) <= size - 8:
            break
    else:
        pytest.fail("does not fit")
    packed += struct.pack("<II", 0x184D2A50, size - len(packed) - 8) + bytes(size - len(packed) - 8)  # is passed over
    data[at + 8 : at + 8 + size] = packed
    data[start + 9 + length - 4 : start + 9 + length] = struct.pack(
        "<I", zlib.crc32(data[start + 9 : start + 5 + length])
    )
    path.write_bytes(data)


def other_label(said: dict[str, Any]) -> None:
    said["labels"] = said["labels"].replace(b'"label":"projector"', b'"label":"led"      ')


def other_place(said: dict[str, Any]) -> None:
    said["labels"] = said["labels"].replace(b'"z_mm":1', b'"z_mm":2')


def other_camera(said: dict[str, Any]) -> None:
    said["labels"] = said["labels"].replace(b'"camera":0', b'"camera":9').replace(b'"camera":1', b'"camera":0')


def other_sequence(said: dict[str, Any]) -> None:
    step = np.frombuffer(said["row"][2], np.uint8).reshape(8, -1).copy()
    step[0, 0] += 1  # all are one later
    said["row"][2] = step.tobytes()


def no_labels(said: dict[str, Any]) -> None:
    said["labels"] = b" " * len(said["labels"])


def far_away(said: dict[str, Any]) -> None:
    step = np.frombuffer(said["chunk"][0], np.uint8).reshape(8, -1).copy()
    step[7, 3] = 77
    said["chunk"][0] = step.tobytes()


def many(said: dict[str, Any]) -> None:
    said["rows"] = 1 << 60


@pytest.mark.parametrize(
    "change", [other_label, other_place, other_camera, other_sequence, no_labels, far_away, many, dict.clear]
)
def test_a_lying_index_gives_no_wrong_label(tmp_path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    path = write(tmp_path / "a.mcap")
    true = open_recording(path)
    honest = {(frame.index, frame.camera): true.label(frame) for frame in true.frames}
    lying(path, change)
    try:
        recording = open_recording(path)
    except AnnulusError:
        return
    damaged = 0
    for frame in recording.frames:
        try:
            image, _ = recording.read_raw(frame)
        except DamagedError:
            damaged += 1
            continue
        assert np.array_equal(image, image_of(2 * frame.index + frame.camera))
        assert recording.label(frame) in (honest[frame.index, frame.camera], {})
    believed = change in (other_label, other_place, other_camera, other_sequence)
    assert (recording.index is not None and damaged > 0) if believed else recording.index is None


@pytest.mark.parametrize("chunk_size", [1 << 10, 1 << 20])
def test_an_index_that_another_program_copied_is_none(tmp_path: Path, chunk_size: int) -> None:
    path, other = write(tmp_path / "a.mcap"), tmp_path / "b.mcap"
    reader = make_reader(io.BytesIO(path.read_bytes()))
    with other.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size)
        writer.start()
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        for one in reader.iter_attachments():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        writer.finish()
    with other.open("rb") as file:
        assert read_index(file, other.stat().st_size, ATTACHED, LABEL_TOPIC) is None
    mine, others = open_recording(path), open_recording(other)
    assert others.index is None and not others.damage
    for frame, same in zip(mine.frames, others.frames, strict=True):
        assert mine.label(frame) == others.label(same)
        assert np.array_equal(mine.read_raw(frame)[0], others.read_raw(same)[0])


def test_bytes_of_nobody_are_no_index(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", count=4)
    data = path.read_bytes()
    random = np.random.default_rng(3)
    begin = data.index(b"annulus.notes/0") - 30
    for _ in range(150):
        broken = bytearray(data)
        for at in random.integers(begin, len(data), random.integers(1, 4)):
            broken[at] = random.integers(256)
        if random.random() < 0.3:
            del broken[random.integers(begin, len(data)) :]
        file = io.BytesIO(broken)
        found = read_index(file, len(broken), ATTACHED, LABEL_TOPIC)
        if found is not None:
            assert len(sorted_out(found)[0]) == 8


def test_two_frames_of_one_name_are_no_scan(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        for z in (1.0, 2.0):
            label = {"index": 7, "label": "led", "z_mm": z, "encoding": "mono8", "width": W, "height": H}
            writer.frame(label, image_of(7), 7)
    with pytest.raises(AnnulusError, match=r"a\.mcap: holds more than one scan \(frame 7 "):
        open_recording(path)


def test_of_two_frames_of_one_name_the_sound_one_counts(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", Codec.RAW, count=3)
    honest = open_recording(path)
    second = next(frame for frame in honest.frames if (frame.index, frame.camera) == (1, 0))
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, second.offset - 20, 2)  # its number, in a chunk whose checksum then is wrong
    path.write_bytes(data[: data.index(b"annulus.notes/0") - 100])
    found = open_recording(path)
    (third,) = [frame for frame in found.frames if (frame.index, frame.camera) == (2, 0)]
    assert np.array_equal(found.read_raw(third)[0], image_of(4)) and found.label(third)["z_mm"] == 1.0


def test_json_is_the_same_by_either_way() -> None:
    said = {"a": [1, 2.5, None, {"b": b"\0\1"}], "z": "ä"}
    assert from_json(to_json(said)) == said


def test_a_list_of_attachments_that_lost_one_loses_none(tmp_path: Path) -> None:
    """Found by fuzzing: the summary's list has no checksum that is looked at, and the index its own."""
    path = write(tmp_path / "a.mcap", count=4)
    data = bytearray(path.read_bytes())
    data[data.rindex(b"calibration.json")] ^= 1
    path.write_bytes(data)
    assert open_recording(path).calibration == {"a": 1}
