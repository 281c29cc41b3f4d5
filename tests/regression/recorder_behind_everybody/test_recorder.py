"""Beside twenty busy processes every label held and 418 of 659 frames were not recorded: the recorder alone had no
priority, and made small pictures while frames waited."""

import os
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq
from mcap.reader import make_reader

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.pools import Recorder, RecordingSetup
from annulus_pipe.daemon.priority import LEVEL, PUBLISHER_LEVEL, RECORDER_LEVEL, raise_priority
from annulus_pipe.daemon.recorder import PAUSE_S, PREVIEW_NS, RecorderJob
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.recording import open_recording
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared
from annulus_pipe.vocabulary import Label

REFUSED = "no real-time priority (Operation not permitted)"


@pytest.fixture
def shared(tmp_path: Path) -> Iterator[Shared]:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    with_room = FrameRing(4, 48)
    yield Shared(with_room, context, tmp_path)
    context.destroy(linger=0)
    with_room.close()


def policies(pid: int) -> dict[str, tuple[int, int]]:
    """Policy and level of a process's first thread and libzmq's."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        name = (task / "comm").read_text().strip()
        if int(task.name) == pid or name.startswith("ZMQbg"):
            policy = os.sched_getscheduler(int(task.name)) & ~os.SCHED_RESET_ON_FORK
            found["main" if int(task.name) == pid else name] = policy, os.sched_getparam(int(task.name)).sched_priority
    return found


@pytest.mark.parametrize("wanted", [None, False])
def test_the_recorder_is_raised_as_head_toml_says(shared: Shared, tmp_path: Path, wanted: bool | None) -> None:
    remark: list[str] = []
    asking = threading.Thread(target=lambda: remark.append(raise_priority(True)))
    asking.start()
    asking.join()
    if remark != [""]:
        pytest.skip("this system allows no real-time priority")
    assert LEVEL > RECORDER_LEVEL > PUBLISHER_LEVEL, "it holds up nobody who feeds it"
    setup = RecordingSetup(tmp_path / "scans", "scan", None, {}, realtime=wanted)
    recorder = Recorder(setup, shared, Account(), Observer())
    try:
        end = time.monotonic() + 60.0
        while not recorder.ready:
            assert time.monotonic() < end and not recorder.broken
            recorder.poll()
            time.sleep(0.005)
        raised = policies(recorder.pids[0])
        expected = (os.SCHED_FIFO, RECORDER_LEVEL) if wanted is None else (os.SCHED_OTHER, 0)
        assert len(raised) > 1 and set(raised.values()) == {expected}, raised
    finally:
        recorder.finish(5.0)


def previews(folder: Path, cameras: int, paused: bool) -> list[int]:
    """How many of ten flashes got a small picture, by camera; with a pause before each, or none."""
    job = RecorderJob(folder, "scan", None, {}, codec=Codec.RAW)
    image = np.zeros((16, 16), np.uint8)
    for index in range(10):
        time.sleep(2 * PAUSE_S if paused else 0.0)
        for camera in range(cameras):
            header = FrameHeader(
                index,
                None,
                index * PREVIEW_NS,
                Label.LED,
                "",
                None,
                None,
                None,
                0.0,
                "bayer_rggb8",
                16,
                16,
                camera=camera,
            )
            job._done_s += PAUSE_S if camera else 0.0  # however long this machine stood still: they came together
            assert job.frame(header, image, None)
            if not paused:
                job._done_s = time.monotonic() + 1.0
    job.close()
    recording = open_recording(folder / "scan.mcap")
    assert len(recording.frames) == 10 * cameras
    with (folder / "scan.mcap").open("rb") as file:
        told = Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())
    return [told[f"/preview/{camera}"] for camera in range(cameras)]


def test_no_small_picture_is_made_while_frames_wait(tmp_path: Path) -> None:
    assert previews(tmp_path / "one", 1, paused=True) == [10]
    assert previews(tmp_path / "behind", 1, paused=False) == [1]


def test_frames_of_one_flash_do_not_wait_for_each_other(tmp_path: Path) -> None:
    first, second = previews(tmp_path / "two", 2, paused=True)
    assert first == 10 and second >= 9


def test_small_pictures_are_made_five_times_a_second_of_each_lamp(tmp_path: Path) -> None:
    job = RecorderJob(tmp_path, "scan", None, {}, codec=Codec.RAW)
    image, lamps = np.zeros((16, 16), np.uint8), [*4 * [Label.PROJECTOR], Label.LED]
    for index in range(50):  # two seconds at 25 frames a second
        header = FrameHeader(
            index, None, index * 40_000_000, lamps[index % 5], "", None, None, None, 0.0, "bayer_rggb8", 16, 16
        )
        job._done_s, job._without_pause = 0.0, 0  # frames that come one by one
        assert job.frame(header, image, None)
    job.close()
    with (tmp_path / "scan.mcap").open("rb") as file:
        shown = [message.sequence for _, _, message in make_reader(file).iter_messages(topics=["/preview/0"])]
    assert sorted(shown) == [index for index in range(50) if index % 5 in (0, 4)]


def test_where_no_priority_is_allowed_the_start_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert raise_priority(None).startswith(REFUSED) and "not be recorded" in raise_priority(None)
    assert raise_priority(False) == "", "it was not wanted"
