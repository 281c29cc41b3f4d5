"""What it takes to open a recording and to read a range of it, here and in an object store: by its index, by a walk.

The store is moto on loopback behind a proxy that counts, and answers late as one that is far does (tools/bench/
object_store.py). Its megabytes a second are those of two Python programs on this machine: requests and bytes are what
counts of it.
"""

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from annulus_pipe.record.codec import Codec
from annulus_pipe.record.frames import RecordedFrame
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.record.writer import RecordingWriter
from tools.bench.object_store import ObjectStore
from tools.bench.table import Row

MANY, FAR = 20_000, 150  # frames: small ones here, and of a megabyte in the store
WIDTH, HEIGHT = 1664, 1232
RANGE = range(40, 104)
LATE_S = 0.03  # before every answer
REQUESTS_MAX, SHARE_MAX = 5, 1.1
NOTE = f"Every answer of the store comes {LATE_S * 1e3:.0f} ms late."


def rows() -> list[Row]:
    with tempfile.TemporaryDirectory() as folder, ObjectStore() as store:
        os.environ["XDG_CACHE_HOME"] = folder
        store.delay_s = LATE_S
        return [*_here(Path(folder)), *_far(Path(folder), store)]


def _here(folder: Path) -> list[Row]:
    path, plain = folder / "many.mcap", folder / "plain.mcap"
    _write(path, MANY, 64, 48)
    size, before = path.stat().st_size, path.read_bytes()
    plain.write_bytes(before[: before.index(b"annulus.notes/0") - 29])  # no index: as before, or torn
    by_walk, walked = _timed(lambda: open_recording(plain))
    by_index, indexed = _timed(lambda: open_recording(path))
    assert indexed.index is not None and indexed.frames == walked.frames
    kept, _ = _timed(lambda: open_recording(plain))  # the walk took long, and is beside it
    share = (size - plain.stat().st_size) / MANY
    return [
        Row(f"{MANY} frames on this disk opened by a walk", "-", "-", f"{by_walk:.2f} s of processor"),
        Row("the same by their index", "-", "< half", f"{by_index:.2f} s of processor", by_index < by_walk / 2),
        Row("a torn one once more, its walk kept", "-", "< half", f"{kept:.2f} s of processor", kept < by_walk / 2),
        Row("index, notes and summary of a frame", "-", "-", f"{share:.0f} bytes"),
    ]


def _far(folder: Path, store: ObjectStore) -> list[Row]:
    path = folder / "far.mcap"
    _write(path, FAR, WIDTH, HEIGHT)
    size = path.stat().st_size
    url = store.put("far.mcap", path)
    out = [Row("a recording in the store", "-", "-", f"{FAR} frames, {size / 1e6:.0f} MB")]
    recording, told = _asked(store, lambda: open_recording(url))
    ok = store.requests < REQUESTS_MAX
    out.append(Row("opened by its index", "-", f"< {REQUESTS_MAX} requests", told, ok))
    which = [recording.frames[i] for i in RANGE]
    needed = sum(frame.chunk.length for frame in which if frame.chunk is not None)
    _, told = _asked(store, lambda: _read(recording, which))
    share = store.given / needed
    out.append(
        Row(
            f"a range of {len(which)} frames",
            "-",
            f"<= {SHARE_MAX} of its chunks",
            f"{told}; {share:.3f} of its chunks",
            share <= SHARE_MAX,
        )
    )
    torn = store.put("torn.mcap", path.read_bytes()[: int(0.95 * size)])
    _, told = _asked(store, lambda: open_recording(torn))
    share = store.given / (0.95 * size)
    out.append(Row("a torn one, walked", "-", "each byte once", f"{told}; {share:.3f} of the file", share <= SHARE_MAX))
    _, told = _asked(store, lambda: open_recording(torn))
    out.append(Row("the same again, the walk kept", "-", "-", told))
    return out


def _write(path: Path, frames: int, width: int, height: int) -> None:
    image = np.random.default_rng(0).integers(0, 48, (height, width), dtype=np.uint8)
    codec = Codec.ZSTD
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0, codec=codec, previews=False) as writer:
        for n in range(frames):
            label = {
                "index": n,
                "camera": 0,
                "timestamp_ns": n * 40_000_000,
                "label": "projector" if n % 5 else "led",
                "z_mm": 0.5 * n,
                "roll_deg": 0.01 * n,
                "slot": n % 5,
                "edge": n + 7,
                "confidence": "proved",
                "encoding": "bayer_rggb8",
                "width": width,
                "height": height,
            }
            if n % 4 == 0:
                writer.note("/sensor/imu", {"t": n, "gyro": [0.1, 0.2, 0.3]}, n * 40_000_000, n)
            writer.frame(label, image, n * 40_000_000)


def _read(recording: Recording, which: list[RecordedFrame]) -> None:
    for start in range(0, len(which), 8):  # as workers do
        recording.plan(which[start : start + 8])
        for frame in which[start : start + 8]:
            recording.read_raw(frame)


def _timed(work: Callable[[], Recording]) -> tuple[float, Recording]:
    began = time.process_time()
    out = work()
    return time.process_time() - began, out


def _asked(store: ObjectStore, work: Callable[[], object]) -> tuple[Recording, str]:
    store.forget()
    began = time.perf_counter()
    out = work()
    took = time.perf_counter() - began
    return out, f"{store.requests} requests, {store.given / 1e6:.2f} MB, {took:.2f} s"  # type: ignore[return-value]
