"""Promises of a scan in parts: no frame between two of them is lost, they are read as one, each can be read alone."""

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.daemon import rotation
from annulus_pipe.daemon.rotation import Bounds, RotatingWriter
from annulus_pipe.record.parts import Part, first_paths, later_paths, part_of, part_path
from annulus_pipe.record.recording import Recording, open_part, open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.vocabulary import AnnulusError

H, W = 48, 64
CALIBRATION, CONFIGURATION = {"format": "x"}, {"fps": 25}


class Recorder:
    """A RotatingWriter on virtual time: 25 frames a second, an event with each."""

    def __init__(self, folder: Path, bounds: Bounds, name: str = "scan", scan: str = "one", first: int = 0) -> None:
        self.now_s, self.next = 1000.0, first
        self.writer = RotatingWriter(folder, name, scan, bounds, self.begin, lambda: self.now_s)

    def begin(self, path: Path, part: Part) -> RecordingWriter:
        return RecordingWriter(path, calibration=CALIBRATION, configuration=CONFIGURATION, now_ns=5, part=part)

    def record(self, count: int) -> "Recorder":
        for _ in range(count):
            label = {"index": self.next, "label": "projector", "z_mm": 2.5 * self.next, "reason": ""}
            label |= {"encoding": "mono8", "width": W, "height": H}
            assert self.writer.frame(label, image_of(self.next), round(self.now_s * 1e9))
            self.writer.note("/event", {"edge": self.next}, round(self.now_s * 1e9))
            self.next += 1
            self.now_s += 0.04
        return self


def image_of(index: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(index).integers(0, 256, (H, W), dtype=np.uint8)


def edges(recording: Recording) -> list[int]:
    return [event["edge"] for event in recording.notes("/event") if "edge" in event]


def is_whole(recording: Recording, count: int) -> bool:
    assert [frame.index for frame in recording.frames] == list(range(count)) == edges(recording)
    for frame in recording.frames:
        assert np.array_equal(recording.read_raw(frame)[0], image_of(frame.index))
        assert recording.label(frame)["z_mm"] == 2.5 * frame.index
    return not recording.torn


def test_a_scan_in_parts_is_read_as_one_given_the_first_or_the_folder(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, Bounds(part_s=1.0)).record(110)
    recorder.writer.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *(f"scan-00{number}.mcap" for number in (2, 3, 4, 5)),
        "scan.mcap",
    ]
    assert is_whole(open_recording(tmp_path / "scan.mcap"), 110)
    assert recorder.writer.written["/frame"] == 110 and not recorder.writer.lost
    for way in (tmp_path, tmp_path / "scan.mcap"):
        scan = open_scan_uncalibrated(way)
        assert len(scan.frames) == 110
        assert all(scan.read(i).shape == (H, W, 3) for i in (0, 50, 109))


def open_scan_uncalibrated(path: Path) -> Any:
    """CALIBRATION is none that a method could use."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("annulus_pipe.scans.scan.Calibration.from_dict", lambda data: None)
        return open_scan(path)


def test_each_part_can_be_read_alone(tmp_path: Path) -> None:
    Recorder(tmp_path, Bounds(part_s=1.0)).record(60).writer.close()
    frames = []
    for number in (1, 2, 3):
        part = open_part(part_path(tmp_path / "scan.mcap", number))
        assert not part.torn and part.calibration == CALIBRATION and part.configuration == CONFIGURATION
        assert part.part == Part("one", number)
        frames += [frame.index for frame in part.frames]
        if number > 1:
            assert open_recording(part.path).frames == part.frames
    assert frames == list(range(60))


@settings(max_examples=20, deadline=None)
@given(
    st.floats(0.05, 3.0),
    st.one_of(st.just(0.0), st.floats(5e3, 1e5)),
    st.lists(st.integers(0, 40), max_size=4),
    st.integers(0, 2),
)
def test_wherever_parts_end_and_recorders_die_nothing_that_was_taken_is_lost(
    tmp_path_factory: pytest.TempPathFactory, part_s: float, part_bytes: float, lives: list[int], left: int
) -> None:
    folder, count = tmp_path_factory.mktemp("scan"), 0
    for frames in [*lives, left]:  # each one killed, its file left as it is
        recorder = Recorder(folder, Bounds(part_s, part_bytes), first=count).record(frames)
        recorder.writer.flush()
        count += frames
    recorder.writer.close()
    recording = open_recording(folder / "scan.mcap")
    is_whole(recording, count)
    assert recording.torn == bool(lives)


def test_a_part_that_cannot_be_begun_costs_no_frame_and_is_tried_again(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, Bounds(part_s=1.0))
    begin, full = recorder.begin, [True]

    def sometimes(path: Path, part: Part) -> RecordingWriter:
        if full[0]:
            raise AnnulusError(f"{path}: cannot be written (No space left on device)")
        return begin(path, part)

    recorder.writer._begin = sometimes
    recorder.record(200)  # 8 s
    assert recorder.writer.parts == 1 and "No space left" in recorder.writer.remark
    assert not recorder.writer.problem
    full[0] = False
    recorder.record(100)
    assert 2 <= recorder.writer.parts <= 4
    recorder.writer.close()
    assert is_whole(open_recording(tmp_path / "scan.mcap"), 300)


def test_ending_a_part_holds_up_no_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_go, close = threading.Event(), RecordingWriter.close

    def slow(self: RecordingWriter) -> None:
        let_go.wait(20.0)
        close(self)

    monkeypatch.setattr(RecordingWriter, "close", slow)
    recorder = Recorder(tmp_path, Bounds(part_s=1.0)).record(60)
    assert recorder.writer.parts == 3 and not let_go.is_set()
    let_go.set()
    recorder.writer.close()
    assert is_whole(open_recording(tmp_path / "scan.mcap"), 60)


def test_two_scans_of_one_name_are_kept_apart(tmp_path: Path) -> None:
    for scan in ("one", "two"):
        Recorder(tmp_path, Bounds(part_s=1.0), scan=scan).record(40).writer.close()
    assert {path.name for path in first_paths(tmp_path)} == {"scan.mcap", "scan-2.mcap"}
    for name in ("scan.mcap", "scan-2.mcap"):
        assert is_whole(open_recording(tmp_path / name), 40)
    with pytest.raises(AnnulusError, match=r"holds 2 recordings, expected one\. Name one: scan\.mcap, scan-2\.mcap"):
        open_scan(tmp_path)


def test_a_file_of_another_scan_is_no_part_whatever_its_name(tmp_path: Path) -> None:
    Recorder(tmp_path, Bounds(part_s=1.0)).record(40).writer.close()
    other = tmp_path / "elsewhere"
    Recorder(other, Bounds(), scan="two").record(10).writer.close()
    (other / "scan.mcap").rename(tmp_path / "scan-003.mcap")
    assert is_whole(open_recording(tmp_path / "scan.mcap"), 40)


def test_a_part_that_is_missing_or_cut_off_at_its_head_is_told(tmp_path: Path) -> None:
    Recorder(tmp_path, Bounds(part_s=1.0)).record(90).writer.close()
    (tmp_path / "scan-002.mcap").unlink()
    recording = open_recording(tmp_path / "scan.mcap")
    assert recording.torn and {30, 45}.isdisjoint(frame.index for frame in recording.frames)
    assert {20, 60, 85} <= {frame.index for frame in recording.frames}
    os.truncate(tmp_path / "scan-004.mcap", 0)
    recording = open_recording(tmp_path / "scan.mcap")
    assert recording.torn and {85}.isdisjoint(frame.index for frame in recording.frames)
    assert {20, 60} <= {frame.index for frame in recording.frames}
    assert [number for number, _ in later_paths(tmp_path / "scan.mcap")] == [3, 4]


def test_what_says_nothing_of_parts_is_read_alone(tmp_path: Path) -> None:
    for name in ("a.mcap", "a-002.mcap"):
        RecordingWriter(tmp_path / name, calibration=None, configuration={}, now_ns=0).close()
    assert part_of(tmp_path / "a.mcap") is None and open_recording(tmp_path / "a.mcap").parts == ()
    (tmp_path / "b.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 4)
    assert part_of(tmp_path / "b.mcap") is None and part_of(tmp_path / "nowhere.mcap") is None


@given(st.binary(max_size=300), st.integers(0, 400))
def test_no_bytes_make_the_look_at_a_file_fail(tmp_path_factory: pytest.TempPathFactory, data: bytes, at: int) -> None:
    folder = tmp_path_factory.mktemp("bytes")
    RecordingWriter(folder / "a.mcap", calibration=None, configuration={}, now_ns=0, part=Part("x", 1)).close()
    whole = (folder / "a.mcap").read_bytes()
    (folder / "a.mcap").write_bytes(whole[:at] + data + whole[at + len(data) :])
    part_of(folder / "a.mcap")


def test_the_disk_itself_has_everything_but_the_last_seconds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    fdatasync = os.fdatasync

    def seen(file: int) -> None:
        if os.fstat(file).st_size > 4096:  # not the folder's
            synced.append(os.fstat(file).st_size)
        fdatasync(file)

    monkeypatch.setattr(rotation.os, "fdatasync", seen)
    recorder = Recorder(tmp_path, Bounds(sync_s=2.0))
    for _ in range(500):  # 20 s
        recorder.record(1)
        if recorder.writer._syncing is not None:
            recorder.writer._syncing.join()
    assert 8 <= len(synced) <= 10
    at_risk = np.diff(synced).max() / (H * W + 500)  # frames
    assert at_risk <= 2.0 / 0.04 + 2
    recorder.writer.close()
    assert synced[-1] == (tmp_path / "scan.mcap").stat().st_size


def test_a_disk_that_takes_long_is_told_once_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_go, began = threading.Event(), []

    def slow(file: int) -> None:
        began.append(file)
        let_go.wait(20.0)

    recorder = Recorder(tmp_path, Bounds(sync_s=0.5))
    monkeypatch.setattr(rotation.os, "fdatasync", slow)
    recorder.record(200)
    assert len(began) == 1
    let_go.set()
    recorder.writer.close()
    assert is_whole(open_recording(tmp_path / "scan.mcap"), 200)


def test_a_folder_that_is_full_of_them_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rotation, "PARTS_MAX", 2)
    for scan in ("one", "two"):
        Recorder(tmp_path, Bounds(), scan=scan).writer.close()
    with pytest.raises(AnnulusError, match=r"holds scan\.mcap to scan-2\.mcap already"):
        Recorder(tmp_path, Bounds(), scan="three")
    with pytest.raises(AnnulusError, match="cannot be made"):
        Recorder(tmp_path / "scan.mcap", Bounds())
