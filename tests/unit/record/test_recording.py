"""Promises of the recording: what was written is read; neither a kill nor a full disk costs what was there before."""

import errno
import io
import json
import os
import resource
import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from annulus_pipe.cli import main
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import Codec, to_bgr
from annulus_pipe.record.frames import from_json, to_json
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.viewers import preview
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.vocabulary import AnnulusError, Label

H, W = 48, 64


def label_of(index: int, label: str = "projector") -> dict:
    return {
        "index": index,
        "label": label,
        "reason": "",
        "z_mm": 2.5 * index,
        "encoding": "bayer_rggb8",
        "width": W,
        "height": H,
    }


def image_of(index: int) -> np.ndarray:
    """Noise of five bits: packed it is three quarters."""
    return np.random.default_rng(index).integers(0, 32, (H, W), dtype=np.uint8)


def write(path: Path, count: int, **more: object) -> RecordingWriter:
    writer = RecordingWriter(path, calibration={"format": "x"}, configuration={"fps": 25}, now_ns=5, **more)
    for index in range(count):
        writer.frame(label_of(index, "led" if index % 5 == 4 else "projector"), image_of(index), 1000 * index)
        writer.note("/event", {"kind": "edge", "edge": index}, 1000 * index)
    return writer


def test_what_the_head_lost_is_read_back(tmp_path: Path) -> None:
    """The last that is sound counts; what is none is passed over."""
    with RecordingWriter(tmp_path / "a.mcap", calibration=None, configuration={}, now_ns=5) as writer:
        writer.frame(label_of(0), image_of(0), 6)
        writer.note("/drops", {"new": {"disk": 2}, "all": {"disk": 2}}, 10)
        writer.note("/drops", {"new": {"disk": 1}, "all": {"disk": 3, "recorder_busy": 17}}, 20)
        for bad in ({"all": {"disk": -1}}, {"all": [3]}, {"all": {"disk": True}}, {"all": {"x" * 41: 1}}, {}):
            writer.note("/drops", bad, 30)
    assert open_scan(tmp_path / "a.mcap").lost() == {"disk": 3, "recorder_busy": 17}
    with RecordingWriter(tmp_path / "b.mcap", calibration=None, configuration={}, now_ns=5) as writer:
        writer.frame(label_of(0), image_of(0), 6)
    assert open_scan(tmp_path / "b.mcap").lost() == {}


def test_what_was_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path, 10).close()
    recording = open_recording(path)
    assert not recording.torn
    assert [f.index for f in recording.frames] == list(range(10))
    assert [f.z_mm for f in recording.frames] == [2.5 * i for i in range(10)]
    assert [f.label for f in recording.frames].count(Label.LED) == 2
    for frame in recording.frames:
        image, encoding = recording.read_raw(frame)
        assert encoding == "bayer_rggb8"
        assert np.array_equal(image, image_of(frame.index))
        assert recording.read(frame).shape == (H, W, 3)
    assert recording.calibration == {"format": "x"}
    assert recording.configuration == {"fps": 25}
    assert [n["edge"] for n in recording.notes("/event") if n["kind"] == "edge"] == list(range(10))


def test_cameras_of_one_flash_do_not_collide(tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        for index in range(3):
            for camera in (5, 2):
                label = {**label_of(index, "led" if index else "projector"), "camera": camera, "slot": camera}
                writer.frame(label, image_of(10 * camera + index), 1000 * index)
        assert writer.written["/frame"] == 6  # all cameras' together
    recording = open_recording(path)
    assert recording.cameras == (2, 5)
    assert [(f.index, f.camera) for f in recording.frames] == [(i, camera) for i in range(3) for camera in (2, 5)]
    for frame in recording.frames:
        assert recording.label(frame)["slot"] == frame.camera
        assert np.array_equal(recording.read_raw(frame)[0], image_of(10 * frame.camera + frame.index))
    scan = open_scan(path)
    assert scan.frames[1].where.endswith("frame 0 of camera 5") and scan.frames[1].camera == 5
    with pytest.raises(AnnulusError, match=r"two\.mcap: has frames of cameras 2, 5, expected one"):
        scan.only()


def test_any_topic_is_a_note(tmp_path: Path) -> None:
    path = tmp_path / "notes.mcap"
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        writer.note("/sensor/imu", {"values": {"roll": 1.5}}, 5)
        writer.frame(label_of(0), image_of(0), 6)
        writer.note("/mark", {"text": "joint"}, 7)
        writer.note("/sensor/imu", {"values": {"roll": 2.5}}, 8)
    recording = open_recording(path)
    assert [note["values"]["roll"] for note in recording.notes("/sensor/imu")] == [1.5, 2.5]
    assert list(recording.notes("/mark")) == [{"text": "joint"}] and list(recording.notes("/state")) == []
    assert recording.cameras == (0,)


def test_other_mcap_readers_read_it(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path, 7).close()
    with path.open("rb") as file:
        messages = [(c.topic, m.sequence) for _, c, m in make_reader(file, validate_crcs=True).iter_messages()]
    assert [s for t, s in messages if t == "/frame/0"] == list(range(7))
    assert [s for t, s in messages if t == "/label"] == list(range(7))


@pytest.mark.parametrize("size", [(1, 1), (1, 127), (8, 16), (3, 5461), (127, 129), (128, 128), (1448, 1449)])
def test_pictures_of_any_size_are_foxgloves_message(size: tuple[int, int], tmp_path: Path) -> None:
    height, width = size  # their products lie about the lengths where one byte more tells them
    image = np.random.default_rng(height).integers(0, 256, (2 * height, 2 * width), dtype=np.uint8)[::2, ::2]
    label = label_of(3) | {"encoding": "mono8", "width": width, "height": height}
    with RecordingWriter(
        tmp_path / "a.mcap", calibration=None, configuration={}, now_ns=5, clock=Clock(0, 0)
    ) as writer:
        writer.frame(label, image, 1_500_000_000)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        [raw] = [message for *_, message in reader.iter_decoded_messages(topics=["/frame/0"])]
    assert (raw.width, raw.height, raw.step, raw.encoding) == (width, height, width, "mono8")
    assert (raw.timestamp.seconds, raw.timestamp.nanos) == (1, 500_000_000)
    assert raw.data == image.tobytes()


@pytest.mark.parametrize(
    "encoding, red",
    [
        ("bayer_rggb8", (0, 0)),
        ("bayer_bggr8", (1, 1)),
        ("bayer_grbg8", (0, 1)),
        ("bayer_gbrg8", (1, 0)),
        ("mono8", None),
    ],
)
def test_a_red_world_stays_red(encoding: str, red: tuple[int, int] | None) -> None:
    mosaic = np.zeros((H, W), np.uint8)
    if red is None:
        mosaic[:] = 200
        assert (to_bgr(mosaic, encoding) == 200).all()
        return
    mosaic[red[0] :: 2, red[1] :: 2] = 200
    blue, green, red_channel = cv2.split(to_bgr(mosaic, encoding)[4:-4, 4:-4])
    assert red_channel.min() == 200 and green.max() == 0 and blue.max() == 0
    b, g, r = cv2.imdecode(preview(mosaic, encoding), cv2.IMREAD_COLOR).reshape(-1, 3).mean(0)
    assert r > 190 and b < 10 and g < 10


_CHILD = """
import os, signal, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from test_recording import write
writer = write(Path({path!r}), 40)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_every_frame_written_before_a_kill_is_readable(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    child = subprocess.run([sys.executable, "-c", _CHILD.format(tests=str(Path(__file__).parent), path=str(path))])
    assert child.returncode == -signal.SIGKILL
    recording = open_recording(path)
    assert recording.torn
    assert [f.index for f in recording.frames] == list(range(40))
    assert np.array_equal(recording.read_raw(recording.frames[-1])[0], image_of(39))
    with path.open("rb") as file:  # and an outside reader finds them too, up to where the file ends
        seen, topics = 0, {}
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                seen += isinstance(record, Message) and topics[record.channel_id] == "/frame/0"
        except Exception:
            pass
    assert seen == 40


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("codec", list(Codec))
def test_a_recording_cut_at_any_byte_gives_the_frames_before_the_cut(tmp_path: Path, codec: Codec) -> None:
    path, cut = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    write(path, 6, codec=codec).close()
    whole = path.read_bytes()
    chunks = [f.chunk for f in open_recording(path).frames]
    assert all((chunk.size > 0) is (codec is Codec.ZSTD) for chunk in chunks)
    ends = [chunk.offset + chunk.length for chunk in chunks]
    inside = [(chunk.offset, chunk.offset + chunk.length) for chunk in chunks]
    first = chunks[0].offset  # well after the channels
    for at in np.random.default_rng(1).integers(first, len(whole), 60):
        cut.write_bytes(whole[:at])
        recording = open_recording(cut)
        assert [f.index for f in recording.frames] == [i for i, end in enumerate(ends) if end <= at]
        assert recording.cut_frames in (0, 1) and (recording.cut_frames or all(not a < at < b for a, b in inside))
        for frame in recording.frames:
            image, encoding = recording.read_raw(frame)
            if codec is Codec.JPEG:
                assert encoding == "bgr8" and image.shape == (H, W, 3)
            else:
                assert np.array_equal(image, image_of(frame.index))


@given(data=st.binary(max_size=300), at=st.integers(0, 20_000), seed=st.integers(0, 5))
def test_damage_never_raises_anything_but_one_clear_line(data: bytes, at: int, seed: int, tmp_path_factory) -> None:
    path = tmp_path_factory.getbasetemp() / f"damaged-{seed}.mcap"
    path.unlink(missing_ok=True)
    write(path, seed).close()
    whole = bytearray(path.read_bytes())
    at = min(at, len(whole))
    whole[at : at + len(data)] = data
    path.write_bytes(whole)
    try:
        recording = open_recording(path)
        for frame in recording.frames:
            recording.read(frame)
    except AnnulusError as error:
        assert "\n" not in str(error)


class Disk(io.RawIOBase):
    """A disk of so many bytes; `grow` makes room."""

    def __init__(self, path: Path, size: int) -> None:
        self.file = path.open("w+b", buffering=0)
        self.size = size

    def write(self, data) -> int:
        room = self.size - self.file.tell()
        if room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self.file.write(memoryview(data)[:room])

    def seek(self, offset: int, whence: int = 0) -> int:
        return self.file.seek(offset, whence)

    def truncate(self, size: int | None = None) -> int:
        return self.file.truncate(size)

    def close(self) -> None:
        self.file.close()
        super().close()


def test_a_full_disk_costs_frames_but_neither_the_file_nor_the_scan(tmp_path: Path) -> None:
    path = tmp_path / "full.mcap"
    disk = Disk(path, 30_000)
    writer = write(path, 12, file=disk)
    written = writer.written["/frame"]
    assert 0 < written < 12 and writer.lost["/frame"] == 12 - written
    assert writer.problem == "No space left on device"
    disk.size = 1 << 20  # somebody tidied up
    assert writer.frame(label_of(12), image_of(12), 12_000)
    writer.close()
    recording = open_recording(path)
    assert not recording.torn
    assert [f.index for f in recording.frames] == [*range(written), 12]
    assert np.array_equal(recording.read_raw(recording.frames[-1])[0], image_of(12))


def test_a_topic_that_began_on_a_full_disk_is_readable_later(tmp_path: Path) -> None:
    path = tmp_path / "full.mcap"
    disk = Disk(path, 1 << 20)
    writer = write(path, 1, file=disk)
    disk.size = 0
    second = {**label_of(1), "camera": 1}
    assert not writer.frame(second, image_of(1), 1000)
    writer.note("/mark", {"text": "lost"}, 1500)
    writer.flush()
    disk.size = 1 << 20
    writer.note("/mark", {"text": "kept"}, 1800)
    assert writer.frame({**second, "index": 2}, image_of(2), 2000)
    writer.close()
    recording = open_recording(path)
    assert [(f.index, f.camera) for f in recording.frames] == [(0, 0), (2, 1)]
    assert np.array_equal(recording.read_raw(recording.frames[1])[0], image_of(2))
    assert list(recording.notes("/mark")) == [{"text": "kept"}]


def test_a_disk_full_to_the_end_leaves_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "full.mcap"
    writer = write(path, 12, file=Disk(path, 30_000))
    writer.close()
    recording = open_recording(path)
    assert len(recording.frames) == writer.written["/frame"] > 0


def test_the_kernel_refusing_to_write_is_the_same(tmp_path: Path) -> None:
    path = tmp_path / "limited.mcap"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, hard))
        writer = write(path, 20)
        writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert writer.lost["/frame"] > 0 and writer.problem
    assert len(open_recording(path).frames) == writer.written["/frame"] > 0


def test_a_recording_that_cannot_begin_says_why(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="cannot be written"):
        write(tmp_path / "no" / "such.mcap", 0)
    with pytest.raises(AnnulusError, match="disk full"):
        write(tmp_path / "none.mcap", 0, file=Disk(tmp_path / "none.mcap", 100))
    (tmp_path / "old.mcap").write_bytes(b"precious")
    with pytest.raises(AnnulusError, match="File exists"):
        write(tmp_path / "old.mcap", 0)
    assert (tmp_path / "old.mcap").read_bytes() == b"precious"


def test_what_is_no_recording_says_so(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with pytest.raises(AnnulusError, match="cannot be read"):
        open_recording(path)
    path.write_bytes(b"hello")
    with pytest.raises(AnnulusError, match="not an MCAP"):
        open_recording(path)


def test_a_frame_whose_label_was_lost_is_unknown(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        writer.frame({**label_of(0), "z_mm": None}, image_of(0), 0)
        writer.frame({**label_of(1), "label": "nonsense"}, image_of(1), 0)
    assert [f.label for f in open_recording(path).frames] == [Label.UNKNOWN, Label.UNKNOWN]
    assert open_recording(path).calibration is None


@given(
    st.dictionaries(
        st.text(max_size=5).filter(lambda k: k != "base64"),
        st.one_of(st.binary(), st.integers(1 - 2**64, 2**64 - 1), st.text(), st.lists(st.binary())),
    )
)
def test_json_carries_bytes(value: dict) -> None:
    assert from_json(to_json(value)) == value


def test_json_has_no_nan() -> None:
    assert json.loads(to_json({"a": float("nan"), "b": (1.5, float("inf"))})) == {"a": None, "b": [1.5, None]}


@pytest.mark.deep(gate="tests/unit/record/test_recording.py::test_a_recording_is_checked_from_the_command_line")
def test_a_long_recording_costs_no_memory_and_keeps_its_index(tmp_path: Path) -> None:
    image = np.zeros((6, 8), np.uint8)
    label = {"index": 0, "label": "led", "z_mm": 0.0, "encoding": "mono8", "width": 8, "height": 6}
    tracemalloc.start()
    try:
        with RecordingWriter(tmp_path / "a.mcap", calibration=None, configuration={}, now_ns=0) as writer:
            for index in range(2000):
                if index == 500:
                    before = tracemalloc.get_traced_memory()[0]
                assert writer.frame(label | {"index": index}, image, index)
            grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 20_000, "bytes over 1500 frames; the indexes of chunks in memory were 900 000"
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and len(summary.chunk_indexes) == 4001  # a frame's, and what is beside it
    assert os.listdir(tmp_path) == ["a.mcap"]


def test_a_recording_is_checked_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scan.mcap"
    write(path, 40).close()
    assert main_check(path, capsys) == (0, {"frames": 40, "torn": False, "cut_frames_at_most": 0, "damage": []})
    whole = path.read_bytes()
    at = open_recording(path).frames[20].chunk.offset + 200
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    status, found = main_check(path, capsys)
    assert status == 1 and any("checksum" in one["text"] or "unpacked" in one["text"] for one in found["damage"])
    path.write_bytes(whole[: len(whole) // 2])
    status, found = main_check(path, capsys)
    assert status == 1 and found["torn"] and 10 <= found["frames"] <= 22


def main_check(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    with (
        patch.object(sys, "argv", ["annulus", "record", "verify", str(path), "--json"]),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    return int(ended.value.code or 0), json.loads(capsys.readouterr().out)
