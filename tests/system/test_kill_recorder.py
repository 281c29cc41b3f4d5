"""Promises of the recorder killed with SIGKILL: what it answered for is in the file, whole; at most the chunk under way
is not, and the reader says so.
"""

import os
import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import zmq

from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.orphan import child
from annulus_pipe.stream.pool_events import Done
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared, WorkerKind, WorkerPool
from annulus_pipe.vocabulary import Label

pytestmark = pytest.mark.deep(gate="tests/unit/daemon/test_recorder.py::test_all_parts_have_the_clock_of_the_scan")

KILLS, H, W, DEPTH = 20, 616, 832, 4
RNG = random.Random(20261125)
MOMENTS = [(RNG.choice(list(Codec)), RNG.randrange(1, 25), RNG.uniform(0.0, 0.02)) for _ in range(KILLS)]


def picture(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 32, (H, W), dtype=np.uint8)


def killed(folder: Path, codec: Codec, after_frames: int, after_s: float) -> tuple[set[int], int]:
    """Frames that were answered for, and how many were handed out; then the recorder was killed."""
    setup = {
        "folder": str(folder),
        "name": "scan",
        "calibration": None,
        "configuration": {},
        "bounds": [0.0, 0.0, 0.0],
        "scan": "x",
        "realtime": False,
        "codec": codec.value,
        "clock": Clock.now().to_dict(),
    }
    context, ring = zmq.Context(), FrameRing(2 * DEPTH, H * W)
    sockets = folder / "sockets"
    sockets.mkdir(parents=True)
    kind = WorkerKind("recorder", child("annulus_pipe.daemon.recorder"), setup, 1, DEPTH)
    pool = WorkerPool(kind, Shared(ring, context, sockets))
    written: set[int] = set()
    index = 0
    try:
        end = time.monotonic() + 60
        while len(written) < after_frames:
            assert time.monotonic() < end
            pool.results.poll(5)
            written |= {event.header.index for event in pool.poll() if isinstance(event, Done) and event.body}
            while pool.ready and pool.room and (place := ring.claim()) is not None:
                header = FrameHeader(
                    index, None, time.monotonic_ns(), Label.LED, "", None, None, None, float(index), "bayer_rggb8", W, H
                )
                ring.write(place, picture(index))
                assert pool.offer(header, place)
                ring.release(place)
                index += 1
        time.sleep(after_s)  # a moment in its life, not a wait for something
        os.kill(pool.pids[0], signal.SIGKILL)
        written |= {event.header.index for event in pool.poll() if isinstance(event, Done) and event.body}
    finally:
        pool.stop(0.0)
        context.destroy(linger=0)
        ring.close()
    return written, index


def bytes_behind(recording: Recording) -> int:
    """After the last chunk that is whole, its indexes aside: of one that is not."""
    data = recording.path.read_bytes()
    at = max(chunk.offset + chunk.length for chunk in recording._chunks if chunk.crc is not None)
    while at + 9 <= len(data) and data[at] == 7:  # a message index
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return max(0, len(data) - at)


def test_a_kill_costs_the_chunk_under_way_at_most_and_the_reader_says_how_many_frames(tmp_path: Path) -> None:
    for number, (codec, after_frames, after_s) in enumerate(MOMENTS):
        folder = tmp_path / str(number)
        written, handed_out = killed(folder, codec, after_frames, after_s)
        recording = open_recording(folder / "scan.mcap")
        here = {frame.index for frame in recording.frames}
        where = f"{codec} after {after_frames} frames and {after_s:.3f} s"
        assert recording.torn and recording.damage == () and recording.check() == (), where
        assert written <= here, f"{where}: answered for and not there: {written - here}"
        assert here == set(range(len(here))) and len(here) <= handed_out, where
        for frame in recording.frames:
            image, encoding = recording.read_raw(frame)
            if codec is Codec.JPEG:
                assert encoding == "bgr8" and image.shape == (H, W, 3)
            else:
                assert np.array_equal(image, picture(frame.index)), where
        assert recording.cut_frames is not None and recording.cut_frames <= 1, where
        assert bytes_behind(recording) == 0 or recording.cut_frames == 1, where
