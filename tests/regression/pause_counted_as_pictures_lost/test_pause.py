"""A frame of before a pause came first after it, and the pause of 58 s was counted as 175 pictures lost."""

import os
import threading
import time
from collections import Counter
from typing import Any

import numpy as np
import pytest

from annulus_pipe.capture.photometry import measure
from annulus_pipe.capture.remote import RemoteCamera
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.camera_feed import Arrived, Began, Happened
from annulus_pipe.daemon.intake import Intake
from annulus_pipe.labelling.labelling import CameraMode, Labelling
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.twin.camera_server import SLOTS, CameraServer
from annulus_pipe.vocabulary import CameraSequence

PERIOD = 330_000_000
PAUSE = 58_000_000_000
PICTURE = measure(np.zeros((6, 8), np.uint8), green_first=False)


class Scripted:
    """A feed that brings what is put into it."""

    is_open, ended, problem, refused, trouble = True, False, "", "", ""

    def __init__(self) -> None:
        self.coming: list[Happened] = []

    def stream(self) -> None: ...

    def rest(self, patience_s: float) -> list[Happened]:
        return self.poll()

    def poll(self) -> list[Happened]:
        came, self.coming = self.coming, []
        return came


def frame(number: int, stamp: int, arrived: int, counts: bool) -> Arrived:
    return Arrived(None, CameraSequence(number) if counts else None, stamp, arrived, PICTURE, {})


def intake() -> tuple[Scripted, Intake, Account]:
    feed, mode = Scripted(), CameraMode(0, 8, 6, "mono8", PERIOD)
    labelling = Labelling(mode, Navigation(0.05), lambda *_: None, True)
    return feed, Intake(feed, mode, labelling, FrameRing(2, 48)), Account()  # type: ignore[arg-type]


@pytest.mark.parametrize("counts", [True, False])
@pytest.mark.parametrize("late", [1, 3])
def test_no_pause_is_counted_whatever_late_frame_comes_after_it(counts: bool, late: int) -> None:
    feed, mine, account = intake()
    resumed = 4 * PERIOD + PAUSE
    feed.coming = [Began(0), *(frame(i, i * PERIOD, i * PERIOD, counts) for i in range(4))]
    mine.take(account)
    mine.stop()
    mine.take(account)
    mine.go_on()
    first = (resumed + PERIOD) // PERIOD
    feed.coming = [
        Began(resumed),
        *(frame(4 + i, (4 + i) * PERIOD, resumed + 1000 * (i + 1), counts) for i in range(late)),
        *(frame(first + i, (first + i) * PERIOD, (first + i) * PERIOD, counts) for i in range(3)),
        frame(first + 5, (first + 5) * PERIOD, (first + 5) * PERIOD, counts),
    ]
    mine.take(account)
    assert account.drops["camera"] == 2, "those that really were missed, and no other"


def test_a_count_that_leaps_is_held_against_the_clock() -> None:
    feed, mine, account = intake()
    feed.coming = [Began(0), frame(1, PERIOD, PERIOD, True), frame(1_000_000, 3 * PERIOD, 3 * PERIOD, True)]
    mine.take(account)
    assert account.drops["camera"] == 1


def test_what_waits_in_a_served_camera_when_it_is_stopped_is_no_frame_of_the_next_stream() -> None:
    hello: dict[str, Any] = {
        "width": 8,
        "height": 6,
        "encoding": "mono8",
        "timing": {"fps": 3.0, "exposure_us": 1e4, "readout_us": 1e4},
    }
    server = CameraServer(hello, Counter(), number=os.getpid())
    server._listener.setblocking(False)
    done = threading.Event()

    def admit() -> None:
        while not done.is_set():
            server.serve(server.waitables())
            time.sleep(0.001)

    def deliver(number: int) -> None:
        slot = server.take()
        assert slot is not None
        server.deliver(slot, server.generation, {"SensorTimestamp": number, "FrameSequence": number})

    helper = threading.Thread(target=admit)
    helper.start()
    try:
        camera = RemoteCamera(server.address, 1.0)
        camera.start()
        end = time.monotonic() + 30.0
        while not server.streaming and time.monotonic() < end:
            time.sleep(0.001)
    finally:
        done.set()
        helper.join()
    deliver(1)
    deliver(2)
    camera.stop()
    camera.start()
    server.serve(server.waitables())
    deliver(176)
    assert camera.capture_request().get_metadata()["FrameSequence"] == 176
    server.serve(server.waitables())
    assert len(server._free) == SLOTS, "those of before have their slots again"
    camera.close()
    server.close()
