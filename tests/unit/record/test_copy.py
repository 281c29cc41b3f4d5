"""Promises of `annulus record recover`, `export` and `import`: what can be read is kept, as it was, and what is not is
said.
"""

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from annulus_pipe.cli import main
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import Codec, to_bgr
from annulus_pipe.record.copy import copy, recover
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.scans.folder import export_folder
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.scans.video import import_video, read_chainage
from annulus_pipe.vocabulary import AnnulusError

FRAMES, H, W = 12, 48, 64
CLOCK = Clock(5_000, 1_800_000_000_000_000_000)


def image_of(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(60, 90, (H, W), dtype=np.uint8)


def write(path: Path, codec: Codec = Codec.ZSTD, close: bool = True) -> Path:
    writer = RecordingWriter(
        path, calibration={"format": "x"}, configuration={"fps": 25}, now_ns=5_000, codec=codec, clock=CLOCK
    )
    for index in range(FRAMES):
        label = {
            "index": index,
            "label": "led" if index % 5 == 4 else "projector",
            "reason": "",
            "slot": index % 5,
            "z_mm": None if index == 7 else 2.5 * index,
            "roll_deg": 1.25,
            "encoding": "bayer_rggb8",
            "width": W,
            "height": H,
            "timestamp_ns": 10_000 * index,
        }
        writer.frame(label, image_of(index), 10_000 * index)
        writer.note("/mark", {"text": f"mark {index}"}, 10_000 * index + 1)
    writer.flush()
    if close:
        writer.close()
    return path


def same(a: Recording, b: Recording, but: set[int] = frozenset()) -> None:  # type: ignore[assignment]
    assert [f.index for f in b.frames] == [f.index for f in a.frames if f.index not in but]
    assert (b.calibration, b.configuration) == (a.calibration, a.configuration)
    left = {f.index: f for f in a.frames}
    for frame in b.frames:
        other = left[frame.index]
        assert (frame.label, frame.timestamp_ns, frame.roll_deg) == (other.label, other.timestamp_ns, other.roll_deg)
        assert frame.z_mm == other.z_mm or frame.index == 7
    for topic in ("/mark", "/event"):
        assert set(map(str, a.timed_notes(topic))) <= set(map(str, b.timed_notes(topic)))


@pytest.mark.parametrize("codec", list(Codec))
def test_a_torn_recording_becomes_a_whole_one_of_all_that_can_be_read(tmp_path: Path, codec: Codec) -> None:
    path = write(tmp_path / "a.mcap", codec, close=False)
    data = path.read_bytes()
    chunk = open_recording(path).frames[-1].chunk
    assert chunk is not None
    path.write_bytes(data[: chunk.offset + chunk.length // 2])
    torn = open_recording(path)
    assert torn.torn and torn.cut_frames == 1
    found = recover(torn, tmp_path / "b.mcap")
    assert (found.torn, found.cut_frames, found.copied.frames, found.damage) == (True, 1, FRAMES - 1, ())
    whole = open_recording(tmp_path / "b.mcap")
    assert not whole.torn and not whole.check() and whole.utc_offset_ns == CLOCK.offset_ns
    same(torn, whole)
    for a, b in zip(torn.frames, whole.frames, strict=True):
        if codec is Codec.JPEG:
            assert whole.read_jpeg(b) == torn.read_jpeg(a)
        else:
            assert np.array_equal(whole.read_raw(b)[0], image_of(b.index))
    (said,) = whole.notes("/recovered")
    assert said["from"] == "a.mcap" and said["cut_frames_at_most"] == 1


def test_a_damaged_frame_is_left_out_and_named(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", Codec.RAW)
    data = bytearray(path.read_bytes())
    data[open_recording(path).frames[3].offset + 100] ^= 1
    path.write_bytes(data)
    damaged = open_recording(path)
    found = recover(damaged, tmp_path / "b.mcap")
    assert found.copied.frames == FRAMES - 1 and "frame 3 is damaged" in found.copied.damaged[0]
    assert len(found.damage) == 1
    same(damaged, open_recording(tmp_path / "b.mcap"), but={3})
    with pytest.raises(AnnulusError, match="is there already"):
        recover(damaged, tmp_path / "b.mcap")


@pytest.mark.parametrize("before", list(Codec))
@pytest.mark.parametrize("after", [None, *Codec])
def test_pictures_are_kept_otherwise_and_nothing_else_changes(
    tmp_path: Path, before: Codec, after: Codec | None
) -> None:
    old = open_recording(write(tmp_path / "a.mcap", before))
    assert copy(old, tmp_path / "b.mcap", codec=after).frames == FRAMES
    new = open_recording(tmp_path / "b.mcap")
    same(old, new)
    for a, b in zip(old.frames, new.frames, strict=True):
        was, now = old.read(a).astype(int), new.read(b).astype(int)
        loses = after is Codec.JPEG and before is not Codec.JPEG
        assert np.abs(was - now).max() <= (20 if loses else 0)
        assert b.jpeg is (Codec.JPEG in (before, after) and after in (None, Codec.JPEG))


def test_a_recording_of_before_keeps_its_times_and_one_that_knows_the_hour_gets_it(tmp_path: Path) -> None:
    for utc_ns in (None, CLOCK.utc_ns):
        path = tmp_path / f"{utc_ns}.mcap"
        with RecordingWriter(path, calibration=None, configuration={}, now_ns=5, clock=Clock(0, 0)) as writer:
            if utc_ns is not None:
                writer.note("/identity", {"host_ns": 5_000, "utc_ns": utc_ns}, 5)
            label = {"index": 0, "label": "led", "z_mm": 1.0, "encoding": "mono8", "width": W, "height": H}
            writer.frame(label, image_of(0), 10)
        old = open_recording(path)
        copy(old, tmp_path / "new.mcap")
        new = open_recording(tmp_path / "new.mcap")
        assert [f.timestamp_ns for f in new.frames] == [10]
        assert new.utc_offset_ns == (0 if utc_ns is None else CLOCK.offset_ns)
        new.path.unlink()


@pytest.mark.parametrize("form", ["png", "jpeg"])
def test_a_recording_becomes_a_scan_folder_that_is_read_as_the_recording_is(tmp_path: Path, form: str) -> None:
    recording = open_recording(write(tmp_path / "a.mcap"))
    exported = export_folder(recording, tmp_path / "scan", form)
    assert (exported.frames, exported.without_place, exported.damaged) == (FRAMES - 1, 1, [])
    scan, there = open_scan(tmp_path / "scan"), [frame for frame in recording.frames if frame.index != 7]
    assert [(f.index, f.label, f.z_mm, f.roll_deg) for f in scan.frames] == [
        (f.index, f.label, f.z_mm, f.roll_deg) for f in there
    ]
    assert [f.slot for f in scan.frames] == [f.index % 5 for f in there]
    for i, frame in enumerate(there):
        off = np.abs(scan.read(i).astype(int) - to_bgr(image_of(frame.index), "bayer_rggb8"))
        assert off.max() <= (0 if form == "png" else 20)
    assert json.loads((tmp_path / "scan/calibration.json").read_text()) == {"format": "x"}
    with pytest.raises(AnnulusError, match="not empty"):
        export_folder(recording, tmp_path / "scan")


def test_a_folder_of_pictures_becomes_a_scan_in_the_order_people_count_in(tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for number in range(1, 13):
        cv2.imwrite(str(pictures / f"img{number}.png"), np.full((H, W, 3), number * 10, np.uint8))
    (pictures / "notes.txt").write_text("not a picture")
    made = import_video(pictures, tmp_path / "even", speed_mm_s=50.0, fps=25.0)
    scan = open_scan(tmp_path / "even")
    assert made.frames == 12 and [f.z_mm for f in scan.frames] == pytest.approx([2.0 * i for i in range(12)])
    assert [int(scan.read(i)[0, 0, 0]) for i in range(12)] == [10 * number for number in range(1, 13)]
    (tmp_path / "counter.csv").write_text("frame,chainage_m\n2,1.0\n10,1.8\n")
    made = import_video(pictures, tmp_path / "counted", chainage=read_chainage(tmp_path / "counter.csv"))
    assert (made.frames, made.without_place) == (9, 3)
    assert [f.z_mm for f in open_scan(tmp_path / "counted").frames] == pytest.approx([1000 + 100 * i for i in range(9)])


def test_a_folder_that_is_no_series_of_pictures_is_one_clear_line(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(AnnulusError, match=r"empty: holds no pictures"):
        import_video(empty, tmp_path / "x", speed_mm_s=1.0, fps=25.0)
    cv2.imwrite(str(empty / "1.png"), np.zeros((H, W, 3), np.uint8))
    with pytest.raises(AnnulusError, match="names no frame rate"):
        import_video(empty, tmp_path / "x", speed_mm_s=1.0)
    cv2.imwrite(str(empty / "2.png"), np.zeros((H, W + 2, 3), np.uint8))
    with pytest.raises(AnnulusError, match=r"2\.png: a picture of 66x48, those before are 64x48"):
        import_video(empty, tmp_path / "x", speed_mm_s=1.0, fps=25.0)
    assert not (tmp_path / "x").exists()


def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: object) -> tuple[int, Any]:
    monkeypatch.setattr(sys, "argv", ["annulus", "record", *map(str, words), "--json"])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().out
    return int(ended.value.code or 0), json.loads(said) if said else None


def test_the_verbs_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "a.mcap", Codec.RAW, close=False)
    status, told = run(capsys, monkeypatch, "info", path)
    assert status == 0 and told["codecs"] == {"raw": FRAMES} and told["torn"] and told["cut_frames_at_most"] == 0
    assert told["first_frame"].startswith("2027-01-15T07:59:59.99") and told["bytes"] == path.stat().st_size
    assert run(capsys, monkeypatch, "verify", path)[0] == 1
    status, told = run(capsys, monkeypatch, "recover", path)
    assert (status, told["frames"], told["damage"]) == (0, FRAMES, [])
    whole = tmp_path / "a-recovered.mcap"
    assert run(capsys, monkeypatch, "verify", whole)[0] == 0
    status, told = run(capsys, monkeypatch, "export", whole, "-o", tmp_path / "b.mcap", "--codec", "jpeg")
    assert (status, told["frames"]) == (0, FRAMES)
    assert run(capsys, monkeypatch, "info", tmp_path / "b.mcap")[1]["codecs"] == {"jpeg": FRAMES}
    assert run(capsys, monkeypatch, "export", whole, "-o", tmp_path / "scan")[1]["without_place"] == 1
    assert run(capsys, monkeypatch, "export", whole, "-o", tmp_path / "c", "--codec", "raw") == (1, None)
