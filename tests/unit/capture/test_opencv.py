"""A camera through OpenCV, at a VideoCapture made up here; at the kernel's vivid: tests/guest."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from annulus_pipe.capture import opencv
from annulus_pipe.capture.camera import CameraDriver, NoSuchControl, grab
from annulus_pipe.capture.opencv import OpenCVCamera
from annulus_pipe.vocabulary import AnnulusError

S = 1_000_000_000
W, H = 64, 48


class Capture:
    """OpenCV's capture of a webcam. Tests change what they are about, before it is opened."""

    clock_ns = 5000 * S
    wait_ns, stamp_age_ns = 40_000_000, 6_000_000
    there = grabs = stamps = True
    refused: frozenset[int] = frozenset()
    changed: dict[int, float] = {}  # noqa: RUF012

    def __init__(self, device: int, backend: int) -> None:
        self.set_to: dict[int, float] = {}

    def isOpened(self) -> bool:
        return self.there

    def set(self, property: int, value: float) -> bool:
        self.set_to[property] = float(value)
        return property not in self.refused

    def get(self, property: int) -> float:
        if property == cv2.CAP_PROP_POS_MSEC:
            return (Capture.clock_ns - self.stamp_age_ns) / 1e6 if self.stamps else 0.0
        return self.changed.get(property, self.set_to.get(property, 0.0))

    def grab(self) -> bool:
        Capture.clock_ns += self.wait_ns
        return self.grabs

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.full((H, W, 3), 7, np.uint8)

    def release(self) -> None:
        pass


@pytest.fixture(autouse=True)
def capture(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Capture]]:
    kind = type("Made", (Capture,), {})
    monkeypatch.setattr(opencv.cv2, "VideoCapture", kind)
    monkeypatch.setattr(opencv.time, "monotonic_ns", lambda: Capture.clock_ns)
    monkeypatch.setenv("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")
    yield kind


def started() -> OpenCVCamera:
    camera = OpenCVCamera("/dev/video0", fourcc="MJPG", width=W, height=H)
    camera.start()
    return camera


def test_a_frame_has_the_drivers_stamp_its_arrival_and_no_count() -> None:
    frame = grab(started())
    assert isinstance(started(), CameraDriver) and frame.image.shape == (H, W, 3) and frame.encoding == "bgr8"
    assert frame.sequence is None and frame.arrived_ns - frame.timestamp_ns == pytest.approx(6_000_000, abs=1000)


@pytest.mark.parametrize("how", ["none", "of the wall clock"])
def test_where_no_stamp_of_the_monotonic_clock_comes_the_arrival_is_the_stamp(capture: type[Capture], how: str) -> None:
    capture.stamps, capture.stamp_age_ns = how != "none", -1_700_000_000 * S
    camera = started()
    for _ in range(3):
        frame = grab(camera)
        assert frame.timestamp_ns == frame.arrived_ns


def test_a_stamp_that_turns_odd_is_no_reason_to_change_to_arrivals(capture: type[Capture]) -> None:
    camera = started()
    grab(camera)
    capture.stamp_age_ns = 2 * S
    with pytest.raises(AnnulusError, match=r"/dev/video0: a frame is stamped 2 s before it came, expected 0 to 1 s"):
        grab(camera)


def test_a_hang_is_a_time_out_and_a_device_that_is_gone_an_error(capture: type[Capture]) -> None:
    camera = started()
    capture.grabs, capture.wait_ns = False, S
    with pytest.raises(TimeoutError, match=r"no frame within 1\.0 s"):
        grab(camera)
    capture.wait_ns = 10_000
    with pytest.raises(AnnulusError, match="the camera is gone"):
        grab(camera)


def test_all_is_set_and_read_back(capture: type[Capture]) -> None:
    camera = started()
    camera.set_controls({"AeEnable": False, "FrameDurationLimits": (40_000, 40_000)})
    camera.set_controls({"ExposureTime": 38_000, "AnalogueGain": 2.0})
    made = camera._capture.set_to  # type: ignore[union-attr]
    assert made[cv2.CAP_PROP_EXPOSURE] == 380 and made[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    capture.refused = frozenset({cv2.CAP_PROP_GAIN})
    with pytest.raises(NoSuchControl, match="OpenCV sets no gain of it"):
        camera.set_controls({"AnalogueGain": 2.0})
    capture.changed = {cv2.CAP_PROP_EXPOSURE: 333.0}
    with pytest.raises(AnnulusError, match="exposure is 333 in the device's unit, expected 380"):
        camera.set_controls({"ExposureTime": 38_000})


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({cv2.CAP_PROP_FRAME_WIDTH: 640.0}, "gives MJPG 640x48 at 25 fps through OpenCV, expected MJPG 64x48 at 25"),
        ({cv2.CAP_PROP_FPS: 30.0}, "at 30 fps"),
        ({cv2.CAP_PROP_FPS: 0.0}, "at 0 fps"),
        ({cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUYV"))}, "gives YUYV"),
    ],
)
def test_another_picture_than_wanted_is_refused(changed: dict[int, float], why: str, capture: type[Capture]) -> None:
    capture.changed = changed
    with pytest.raises(AnnulusError, match=why):
        started()


@pytest.mark.parametrize(
    ("device", "fourcc", "why"),
    [
        ("/dev/null", "MJPG", "/dev/null: not a camera for OpenCV, expected /dev/video0 or 0"),
        ("rtsp://x", "MJPG", "not a camera for OpenCV"),
        ("0", "MJ", "format is 'MJ', expected four letters"),
    ],
)
def test_a_device_or_format_that_is_none_is_one_line(device: str, fourcc: str, why: str) -> None:
    with pytest.raises(AnnulusError, match=why):
        OpenCVCamera(device, fourcc=fourcc)


def test_a_device_that_does_not_open_is_one_line(capture: type[Capture]) -> None:
    capture.there = False
    with pytest.raises(AnnulusError, match="/dev/video0: OpenCV does not open it"):
        started()
