"""Reading a camera that had gone failed at once, 1.1 million times in 3 s: nobody was told, it was never opened again,
and the scan never ended. Fails when an intake asks again without a pause, or does not open again."""

import time

import numpy as np

from annulus_pipe.capture.camera import HeldRequest
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.camera_feed import Arrived, Began, CameraFeed
from annulus_pipe.daemon.camera_state import CameraState
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.vocabulary import AnnulusError

AWAY_S = 2.0
ASKED_MAX = 20  # 3 to 4 are measured: the pauses double from 0.5 s on


class Pulled:
    """Gives 5 frames, then is away for AWAY_S: every word to it fails at once."""

    width, height, encoding = 8, 6, "mono8"

    def __init__(self) -> None:
        self.frames = self.asked = 0
        self.back_s = 0.0

    def _there(self) -> None:
        if self.frames == 5:
            self.back_s, self.frames = time.monotonic() + AWAY_S, 6
        if time.monotonic() < self.back_s:
            self.asked += 1
            raise AnnulusError("/dev/video9: no such device")

    def start(self) -> None:
        self._there()

    def stop(self) -> None: ...

    def close(self) -> None: ...

    def set_controls(self, controls: object) -> None: ...

    def capture_request(self) -> HeldRequest:
        self._there()
        time.sleep(0.002)
        self.frames += 1
        metadata = {"SensorTimestamp": time.monotonic_ns(), "FrameSequence": self.frames}
        return HeldRequest(np.zeros((6, 8), np.uint8), metadata)


class Told(Observer):
    def __init__(self) -> None:
        self.texts: list[str] = []

    def event(self, kind: str, text: str) -> None:
        self.texts.append(text)


def test_a_camera_that_fails_at_once_is_told_left_alone_and_opened_again() -> None:
    camera, ring, told = Pulled(), FrameRing(64, 48), Told()
    feed = CameraFeed(0, CameraConfig("v4l2", width=8, height=6), Account(), told, camera)  # type: ignore[arg-type]
    assert feed.look() == (8, 6, "mono8")
    feed.join(ring, 64)
    feed.stream()
    arrived, begun, end = 0, 0, time.monotonic() + 60.0
    while arrived < 10:
        assert time.monotonic() < end, (feed.state, told.texts)
        for one in feed.poll():
            arrived += isinstance(one, Arrived)
            begun += isinstance(one, Began)
        time.sleep(0.001)
    assert 2 <= camera.asked <= ASKED_MAX
    assert sum("is gone: /dev/video9: no such device" in text for text in told.texts) == 1
    assert any("is back after" in text for text in told.texts)
    assert begun == 2 and feed.state is CameraState.STREAMING
    feed.rest(1.0)
    feed.close()
    ring.close()
