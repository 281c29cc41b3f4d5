"""Promises of recordings in a store: few requests, no byte twice, and the same frames, labels and pixels as here."""

import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.record.codec import Codec
from annulus_pipe.record.frames import RecordedFrame
from annulus_pipe.record.parts import Part
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage import remote
from annulus_pipe.storage.remote import Patience
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.object_store import ObjectStore

FRAMES, H, W = 60, 120, 160


@pytest.fixture(scope="module")
def running() -> Iterator[ObjectStore]:
    with ObjectStore() as store:
        yield store


@pytest.fixture
def store(running: ObjectStore, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[ObjectStore]:
    monkeypatch.setattr(remote, "PATIENCE", Patience(attempts=9, answer_s=20.0, wait_s=0.02))
    monkeypatch.setattr(remote, "_KEPT", remote._Kept())
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    running.slow_s = 3.0
    running.forget()
    yield running
    running.fault = lambda number, asked: None


def image_of(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 64, (H, W), dtype=np.uint8)


def write(path: Path, first: int = 0, count: int = FRAMES, codec: Codec = Codec.ZSTD, part: Part | None = None) -> Path:
    with RecordingWriter(
        path, calibration={"a": 1}, configuration={"b": 2}, now_ns=0, codec=codec, part=part
    ) as writer:
        for index in range(first, first + count):
            label = {
                "index": index,
                "label": "projector" if index % 5 else "led",
                "z_mm": 0.5 * index,
                "encoding": "mono8",
                "width": W,
                "height": H,
                "slot": index % 5,
            }
            writer.note("/drops", {"all": {"lost": index}}, index, index)
            writer.frame(label, image_of(index), index)
    return path


def same(one: Recording, other: Recording) -> bool:
    """All that was said, and every picture."""
    assert [label_of(one, frame) for frame in one.frames] == [label_of(other, frame) for frame in other.frames]
    assert list(one.timed_notes("/drops")) == list(other.timed_notes("/drops"))
    one.plan(one.frames)
    return all(
        np.array_equal(one.read_raw(a)[0], other.read_raw(b)[0]) for a, b in zip(one.frames, other.frames, strict=True)
    )


def label_of(recording: Recording, frame: RecordedFrame) -> object:
    return frame, recording.label(frame)


@pytest.mark.deep(
    gate="tests/unit/record/test_far_recordings.py::test_a_walk_is_kept_in_a_cache_where_nobody_may_write_beside"
)
@pytest.mark.parametrize("codec", [Codec.ZSTD, Codec.RAW])
def test_the_index_of_a_closed_recording_is_four_requests(store: ObjectStore, tmp_path: Path, codec: Codec) -> None:
    path = write(tmp_path / "scan.mcap", count=300, codec=codec)
    recording = open_recording(store.put("a/scan.mcap", path))
    assert store.requests <= 4 and len(recording.frames) == 300, store.asked
    assert store.given < 0.1 * path.stat().st_size, "bytes"
    assert same(recording, open_recording(path))


@pytest.mark.deep(gate="tests/unit/record/test_far_recordings.py::test_a_recording_that_is_replaced_is_told")
def test_a_range_moves_no_more_than_its_chunks(store: ObjectStore, tmp_path: Path) -> None:
    scan = open_scan(store.put("b/scan.mcap", uncalibrated(write(tmp_path / "scan.mcap", count=200))))
    assert scan.recording is not None
    which = [i for i in range(40, 120) if i % 5]
    needed = sum(scan.recording.frames[i].chunk.length for i in which)  # type: ignore[union-attr]
    store.forget()
    scan.plan(which)
    for i in which:
        scan.read(i)
    assert store.given <= 1.1 * needed and store.requests <= 20, (store.given / needed, store.requests)


def uncalibrated(path: Path) -> Path:
    """Whose calibration a scan may be opened with."""
    out = path.with_name("bare.mcap")
    with RecordingWriter(out, calibration=None, configuration={}, now_ns=0) as writer:
        recording = open_recording(path)
        for frame in recording.frames:
            writer.frame(recording.label(frame), recording.read_raw(frame)[0], frame.timestamp_ns)
    return out


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("fault", ["500", "slow", "cut", "half"])
def test_faults_of_a_store_leave_the_same_bits(
    store: ObjectStore, tmp_path: Path, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "scan.mcap", count=20)
    url = store.put(f"faults/{fault}.mcap", path)
    store.fault = lambda number, asked: fault if number % 3 else None
    if fault == "slow":
        store.fault = lambda number, asked: fault if number % 3 == 0 else None
        monkeypatch.setattr(remote, "PATIENCE", Patience(attempts=9, answer_s=2.0, wait_s=0.02))
    assert same(open_recording(url), open_recording(path))
    assert store.faults


def test_parts_of_a_scan_are_one(store: ObjectStore, tmp_path: Path) -> None:
    for number in (1, 2, 3):
        name = "scan.mcap" if number == 1 else f"scan-{number:03d}.mcap"
        store.put(f"parts/{name}", write(tmp_path / name, 20 * number, 20, part=Part("s", number)))
    store.put("parts/scan-004.mcap", write(tmp_path / "scan-004.mcap", 200, 5, part=Part("other", 2)))
    here, far = open_recording(tmp_path / "scan.mcap"), open_recording(store.url("parts/scan.mcap"))
    assert len(far.parts) == 3 and not far.torn and store.requests <= 12
    assert same(far, here)
    again = pickle.loads(pickle.dumps(far))
    assert np.array_equal(again.read_raw(again.frames[-1])[0], image_of(79))


def test_a_worker_reads_with_what_it_is_handed(store: ObjectStore, tmp_path: Path) -> None:
    recording = open_recording(store.put("w/scan.mcap", write(tmp_path / "scan.mcap")))
    handed = pickle.dumps(recording)
    remote._KEPT.files.clear()
    store.forget()
    again = pickle.loads(handed)
    assert np.array_equal(again.read_raw(again.frames[7])[0], image_of(7)) and store.requests == 1


def test_a_recording_that_is_replaced_is_told(store: ObjectStore, tmp_path: Path) -> None:
    url = store.put("c/scan.mcap", write(tmp_path / "scan.mcap"))
    recording = open_recording(url)
    store.put("c/scan.mcap", write(tmp_path / "b.mcap", 100))
    with pytest.raises(AnnulusError, match="not what it was"):
        recording.read_raw(recording.frames[30])  # of the first the bytes are here
    store.delete("c/scan.mcap")
    with pytest.raises(AnnulusError, match="cannot be read"):
        recording.read_raw(recording.frames[30])


@pytest.mark.parametrize("url", ["s3://scans/none.mcap", "s3://nobodys/a.mcap", "s3://scans/empty"])
def test_what_is_not_there_is_one_line(store: ObjectStore, url: str) -> None:
    with pytest.raises(AnnulusError, match=r"no such|cannot be read"):
        open_scan(url)
    assert store.requests <= 6


def test_no_permission_is_one_line(store: ObjectStore, tmp_path: Path) -> None:
    url = store.put("secret/scan.mcap", write(tmp_path / "scan.mcap", count=5))
    store.fault = lambda number, asked: "403"
    with pytest.raises(AnnulusError, match="no permission"):
        open_scan(url)
    assert store.requests <= 4
    store.fault = lambda number, asked: "403" if "list-type" in asked.path else None  # may read, and not list
    assert len(open_recording(url).frames) == 5


def test_a_scan_folder_may_lie_in_a_store(store: ObjectStore, tmp_path: Path) -> None:
    import cv2

    for index in range(3):
        picture = np.repeat(image_of(index)[..., None], 3, axis=2)
        store.put(f"folder/frames/{index}.png", bytes(cv2.imencode(".png", picture)[1].data))
    table = "index,file,light,z_mm\n" + "".join(f"{i},frames/{i}.png,led,{i}\n" for i in range(3))
    store.put("folder/frames.csv", table.encode())
    scan = open_scan(store.url("folder"))
    assert [frame.z_mm for frame in scan.frames] == [0.0, 1.0, 2.0]
    assert np.array_equal(scan.read(2)[..., 0], image_of(2))


def test_a_folder_in_a_store_may_hold_one_recording(store: ObjectStore, tmp_path: Path) -> None:
    path = uncalibrated(write(tmp_path / "scan.mcap", count=5))
    store.put("one/scan.mcap", path)
    assert len(open_scan(store.url("one")).frames) == 5
    store.put("one/other.mcap", path)
    with pytest.raises(AnnulusError, match="holds 2 recordings"):
        open_scan(store.url("one"))


def torn(path: Path, keep: float = 0.7) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    return path


@pytest.mark.deep(but="raw")
@pytest.mark.parametrize("codec", [Codec.ZSTD, Codec.RAW])
def test_a_torn_recording_is_walked_once_and_the_walk_is_kept_beside_it(
    store: ObjectStore, tmp_path: Path, codec: Codec
) -> None:
    path = torn(write(tmp_path / "scan.mcap", count=200, codec=codec))
    size, url = path.stat().st_size, store.put(f"torn-{codec}/scan.mcap", path)
    first = open_recording(url)
    assert first.torn and store.given <= 1.2 * size and store.requests < 12, (store.given / size, store.requests)
    store.forget()
    again = open_recording(url)
    assert store.given < 0.1 * size and store.requests <= 6, (store.given / size, store.asked)
    here = open_recording(path)
    for one in (first, again):
        assert (one.torn, one.damage, one.cut_frames) == (here.torn, here.damage, here.cut_frames)
        assert same(one, here)
    store.put(f"torn-{codec}/scan.mcap", torn(path, 0.9))
    assert len(open_recording(url).frames) == len(open_recording(path).frames) < len(here.frames)


def test_a_walk_is_kept_in_a_cache_where_nobody_may_write_beside(store: ObjectStore, tmp_path: Path) -> None:
    path = torn(write(tmp_path / "scan.mcap"))
    url = store.put("read-only/scan.mcap", path)
    store.fault = lambda number, asked: "403" if asked.method == "PUT" else None
    open_recording(url)
    kept = list((tmp_path / "cache" / "annulus").iterdir())
    assert len(kept) == 1
    store.forget()
    assert same(open_recording(url), open_recording(path)) and store.given < 1.1 * path.stat().st_size


@pytest.mark.deep(
    gate="tests/unit/record/test_far_recordings.py::test_a_walk_is_kept_in_a_cache_where_nobody_may_write_beside"
)
def test_what_is_kept_of_a_walk_is_checked(store: ObjectStore, tmp_path: Path) -> None:
    path = torn(write(tmp_path / "scan.mcap", count=10))
    url = store.put("mended/scan.mcap", path)
    open_recording(url)
    kept = store.get("mended/scan.mcap.index")
    for broken in (b"", kept[:100], kept[:-20], kept[:50] + b"x" + kept[51:], kept[:-1] + b"x"):
        store.put("mended/scan.mcap.index", broken)
        assert same(open_recording(url), open_recording(path))


def test_a_long_local_walk_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = torn(write(tmp_path / "scan.mcap"))
    open_recording(path)
    assert not path.with_name("scan.mcap.index").exists()
    monkeypatch.setattr("annulus_pipe.record.kept.KEEP_S", 0.0)
    before = open_recording(path)
    assert path.with_name("scan.mcap.index").exists()
    monkeypatch.setattr("annulus_pipe.record.recording.Walk", None)
    assert same(open_recording(path), before)


@pytest.mark.deep(gate="tests/unit/record/test_far_recordings.py::test_a_recording_that_is_replaced_is_told")
def test_a_far_recording_is_checked_whole(store: ObjectStore, tmp_path: Path) -> None:
    path = write(tmp_path / "scan.mcap", count=30)
    recording = open_recording(store.put("checked/scan.mcap", path))
    assert recording.check() == ()
