"""Promise: a list of recordings says what each is at the price of a few of its bytes, whole, torn or in parts."""

from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.console.glance import glance
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.parts import Part, part_path
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.vocabulary import AnnulusError

ROOT = Path(__file__).resolve().parents[3]
START_NS = 1_800_000_000_000_000_000
SIDE = 256


def write(path: Path, first: int, frames: int, part: Part | None = None, job: str = "", close: bool = True) -> Path:
    writer = RecordingWriter(
        path,
        calibration={"provenance": {"camera": {"utc": "2026-11-01T00:00:00+00:00"}}},
        configuration={"job": {"site": "Elm Street", "pipe": "P-1"}},
        now_ns=0,
        codec=Codec.RAW,
        clock=Clock(0, START_NS),
        part=part,
    )
    picture = np.random.default_rng(1).integers(0, 255, (SIDE, SIDE), dtype=np.uint8)
    for index in range(first, first + frames):
        at = 40_000_000 * index
        label = {
            "index": index,
            "label": "projector",
            "reason": "",
            "z_mm": None if index < 3 else 2.0 * index,
            "encoding": "bayer_rggb8",
            "width": SIDE,
            "height": SIDE,
            "timestamp_ns": at,
        }
        writer.frame(label, picture, at)
    if job:
        writer.note("/job", {"pipe": job}, 40_000_000 * (first + frames - 1))
    writer.flush()
    if close:
        writer.close()
    return path


def test_a_recording_says_what_it_is(tmp_path: Path) -> None:
    seen = glance(write(tmp_path / "a.mcap", 0, 200, job="P-2"))
    assert (seen.frames, seen.from_mm, seen.to_mm, seen.whole) == (200, 6.0, 398.0, True)
    assert (seen.job.site, seen.job.pipe) == ("Elm Street", "P-2")
    assert seen.calibrated and seen.provenance["camera"]["utc"].startswith("2026-11-01")
    assert seen.begun is not None and seen.ended is not None
    assert seen.begun.timestamp() == START_NS / 1e9
    assert (seen.ended - seen.begun).total_seconds() == pytest.approx(199 * 0.04)


def test_a_torn_one_says_so_and_how_far_it_went(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", 0, 200)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    seen = glance(path)
    assert not seen.whole and seen.frames is None
    assert seen.from_mm == 6.0 and seen.to_mm is not None and 180.0 < seen.to_mm < 210.0


def test_parts_are_one_scan_and_a_missing_one_is_seen(tmp_path: Path) -> None:
    first = tmp_path / "a.mcap"
    for number in (1, 2, 3):
        write(part_path(first, number), 100 * (number - 1), 100, Part("scan", number))
    write(part_path(first, 4), 0, 3, Part("another", 4))
    seen = glance(first)
    assert (seen.frames, seen.to_mm, seen.whole, len(seen.files)) == (300, 598.0, True, 3)
    part_path(first, 2).unlink()
    assert not glance(first).whole


def test_what_it_reads_does_not_grow_with_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import annulus_pipe.console.glance as room

    monkeypatch.setattr(room, "HEAD", 1 << 18)
    monkeypatch.setattr(room, "TAIL", 1 << 18)
    path = write(tmp_path / "a.mcap", 0, 400)
    read = [0]
    real = room.piece

    def counted(file: object, offset: int, length: int) -> bytes:
        read[0] += length
        return real(file, offset, length)  # type: ignore[arg-type]

    monkeypatch.setattr(room, "piece", counted)
    monkeypatch.setattr("annulus_pipe.record.walk.piece", counted)
    assert glance(path).to_mm == 798.0
    assert read[0] < 2 * (1 << 20) < path.stat().st_size / 10


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\xff" * 5000, b"not one"])
def test_what_is_no_recording_costs_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    try:
        assert not glance(path).whole
    except AnnulusError as error:
        assert "\n" not in str(error) and str(path) in str(error)


def test_recordings_of_before_are_seen_too() -> None:
    seen = glance(ROOT / "tests/data/before/recording.mcap")
    assert seen.whole and seen.frames == 6 and seen.begun is None
    assert (seen.from_mm, seen.to_mm) == (59.95, 83.95)
