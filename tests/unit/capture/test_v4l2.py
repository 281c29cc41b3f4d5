"""The V4L2 camera at a driver made up here, for what vivid cannot be made to do; at vivid: tests/guest."""

import errno
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from annulus_pipe.capture import v4l2, videodev
from annulus_pipe.capture.camera import NoSuchControl, grab
from annulus_pipe.capture.v4l2 import V4L2Camera
from annulus_pipe.vocabulary import AnnulusError

W, H = 64, 48
PAGE = 4096
PATH = "/dev/null"  # a character device that is always there; nothing of it is used


class Clock:
    """The monotonic clock, moved on by the driver's frames."""

    def __init__(self) -> None:
        self.ns = 5_000_000_000_000

    def monotonic_ns(self) -> int:
        return self.ns

    def monotonic(self) -> float:
        return self.ns / 1e9


class Driver:
    """A well-behaved grey camera: a frame whenever one is asked for. Tests change what they are about."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.fd = os.memfd_create("driver")
        os.truncate(self.fd, v4l2.BUFFERS * PAGE)
        self.queued: list[int] = []
        self.interval = (1, 30)
        self.values = {
            videodev.CID_EXPOSURE_ABSOLUTE: 5,
            videodev.CID_EXPOSURE_AUTO: 3,
            videodev.CID_EXPOSURE_AUTO_PRIORITY: 1,
            videodev.CID_AUTOGAIN: 1,
        }
        self.sequence, self.step, self.period_ns = 7, 1, 40_000_000
        self.stamped_ahead_ns = 0
        self.flags = videodev.BUF_FLAG_TIMESTAMP_MONOTONIC
        self.damaged: set[int] = set()
        self.error = 0
        self.streaming = False

    def call(self, request: int, argument: Any) -> Any:
        match request:
            case videodev.QUERYCAP:
                argument.device_caps = videodev.CAP_VIDEO_CAPTURE | videodev.CAP_STREAMING
                argument.capabilities = videodev.CAP_DEVICE_CAPS
            case videodev.S_FMT:
                self.set_format(argument.of.pix)
            case videodev.S_PARM:
                if self.streaming:
                    raise OSError(errno.EBUSY, "busy")
                self.interval = (argument.numerator, argument.denominator)
            case videodev.G_PARM:
                argument.numerator, argument.denominator = self.interval
            case videodev.QUERYBUF:
                argument.length, argument.at.offset = PAGE, argument.index * PAGE
            case videodev.QBUF:
                self.queued.append(argument.index)
            case videodev.STREAMON:
                self.streaming = True
            case videodev.DQBUF:
                self.fill(argument)
        return argument

    def set_format(self, pix: videodev.Pixels) -> None:
        """One size, and like many drivers the nearest to what was asked for."""
        pix.width, pix.height, pix.bytesperline = W, H, W

    def fill(self, buffer: videodev.Buffer) -> None:
        if self.error:
            raise OSError(self.error, os.strerror(self.error))
        self.clock.ns += self.period_ns
        buffer.index, buffer.bytesused, buffer.flags = self.queued.pop(0), W * H, self.flags
        buffer.sequence = self.sequence & 0xFFFF_FFFF
        buffer.seconds, buffer.microseconds = divmod((self.clock.ns + self.stamped_ahead_ns) // 1000, 10**6)
        if self.sequence in self.damaged:
            buffer.flags |= videodev.BUF_FLAG_ERROR
        os.pwrite(self.fd, bytes([self.sequence % 251]) * (W * H), buffer.index * PAGE)
        self.sequence += self.step

    def set(self, id: int, value: int) -> int:
        self.values[id] = value
        return value

    def control(self, id: int) -> videodev.ControlDescription | None:
        return videodev.ControlDescription(minimum=1, maximum=333, step=1) if id in self.values else None

    def formats(self) -> list[str]:
        return ["GREY"]

    def sizes(self, fourcc: str) -> list[str]:
        return [f"{W}x{H}"]

    def rates(self, fourcc: str, width: int, height: int) -> list[str]:
        return ["30"]

    def close(self) -> None:
        os.close(self.fd)


Make = Callable[..., tuple[V4L2Camera, Driver]]


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Make]:
    cameras, clock = [], Clock()
    monkeypatch.setattr(v4l2, "time", clock)

    def make(**of: Any) -> tuple[V4L2Camera, Driver]:
        drivers: list[Driver] = []

        def plugged(path: str) -> Driver:
            drivers.append(Driver(clock))
            for name, value in of.items():
                setattr(drivers[-1], name, value)
            return drivers[-1]

        monkeypatch.setattr(videodev, "Device", plugged)
        camera = V4L2Camera(PATH, fourcc="GREY", width=W, height=H)
        cameras.append(camera)
        camera.start()
        return camera, drivers[-1]

    yield make
    for camera in cameras:
        camera.close()


def test_frames_carry_the_drivers_count_and_their_own_picture(started: Make) -> None:
    camera, driver = started(step=3)
    frames = [grab(camera) for _ in range(10)]
    assert [frame.sequence for frame in frames] == [7 + 3 * i for i in range(10)]
    assert [int(frame.image[5, 5]) for frame in frames] == [7 + 3 * i for i in range(10)]
    assert np.ptp(np.diff([frame.timestamp_ns for frame in frames])) <= 1000 and len(driver.queued) == v4l2.BUFFERS


def test_a_count_beyond_32_bits_goes_on(started: Make) -> None:
    camera, _ = started(sequence=2**32 - 2)
    assert [grab(camera).sequence for _ in range(4)] == [2**32 - 2 + i for i in range(4)]


def test_a_driver_that_does_not_count_is_not_believed(started: Make) -> None:
    camera, _ = started(step=0)
    assert [grab(camera).sequence for _ in range(3)] == [7, None, None]


def test_a_damaged_frame_is_a_hole_in_the_count(started: Make) -> None:
    camera, _ = started(damaged={8, 9})
    assert [grab(camera).sequence for _ in range(3)] == [7, 10, 11]


def test_a_camera_that_gives_nothing_but_damage_is_silent(started: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    camera, driver = started(damaged=set(range(1000)))
    monkeypatch.setattr(camera, "_poll", Ready(camera))
    with pytest.raises(TimeoutError, match="no whole frame within 2000 ms"):
        grab(camera)
    assert 50 <= driver.sequence - 7 <= 51


class Ready:
    """A poll that says a frame is there until the time is up."""

    def __init__(self, camera: V4L2Camera) -> None:
        self._poll = camera._poll

    def poll(self, patience_ms: float) -> list[tuple[int, int]]:
        return self._poll.poll(0) if patience_ms > 0 else []

    def unregister(self, fd: int) -> None:
        self._poll.unregister(fd)


def test_another_clock_is_refused_in_words(started: Make) -> None:
    with pytest.raises(AnnulusError, match="a clock of its own, not CLOCK_MONOTONIC"):
        grab(started(flags=0x4000)[0])
    with pytest.raises(AnnulusError, match="ahead of CLOCK_MONOTONIC"):
        grab(started(stamped_ahead_ns=3_600 * 10**9)[0])
    with pytest.raises(AnnulusError, match="stamped before the start"):
        grab(started(stamped_ahead_ns=-3_600 * 10**9)[0])


def test_a_rate_that_is_another_than_was_promised_is_found_by_the_stamps(started: Make) -> None:
    camera, _ = started(period_ns=33_333_333)
    with pytest.raises(AnnulusError, match=r"frames come at 30\.0 fps, expected 25"):
        for _ in range(60):
            grab(camera)


def test_what_the_driver_makes_of_its_settings_is_read_back(started: Make) -> None:
    def another_size(pix: videodev.Pixels) -> None:
        pix.width, pix.height, pix.bytesperline = 80, 60, 80

    def interlaced(pix: videodev.Pixels) -> None:
        pix.bytesperline, pix.field = W, 4

    def no_such_format(pix: videodev.Pixels) -> None:
        raise OSError(errno.EINVAL, "invalid")

    for set_format, said in (
        (another_size, f"gives 80x60 where {W}x{H} was asked for; GREY comes in {W}x{H}"),
        (interlaced, "interlaced"),
        (no_such_format, "offers no GREY, expected one of GREY"),
    ):
        with pytest.raises(AnnulusError, match=said):
            started(set_format=set_format)


def test_everything_automatic_is_turned_off_and_what_is_not_done_is_said(started: Make) -> None:
    camera, driver = started()
    camera.set_controls({"AeEnable": False, "ExposureTime": 20_000})
    assert driver.values == {
        videodev.CID_EXPOSURE_ABSOLUTE: 200,
        videodev.CID_EXPOSURE_AUTO: videodev.EXPOSURE_MANUAL,
        videodev.CID_EXPOSURE_AUTO_PRIORITY: 0,
        videodev.CID_AUTOGAIN: 0,
    }
    with pytest.raises(NoSuchControl, match="has no AnalogueGain to set"):
        camera.set_controls({"AnalogueGain": 2.0})
    driver.set = lambda id, value: min(value, 333)  # type: ignore[method-assign]
    with pytest.raises(AnnulusError, match=r"exposure is 333, expected 380 \(x 100 us\); it takes 1 to 333"):
        camera.set_controls({"ExposureTime": 38_000})
    driver.set = lambda id, value: 3  # type: ignore[method-assign]
    with pytest.raises(AnnulusError, match="automatic exposure cannot be turned off"):
        camera.set_controls({"AeEnable": False})
    with pytest.raises(AnnulusError, match="control AwbEnable is not known"):
        camera.set_controls({"AwbEnable": True})


def test_another_rate_is_set_while_the_driver_does_not_stream(started: Make) -> None:
    camera, _ = started()
    camera.set_controls({"FrameDurationLimits": (40_000, 40_000)})
    camera.set_controls({"FrameDurationLimits": (100_000, 100_000)})
    assert grab(camera).sequence == 7  # it began anew


@pytest.mark.parametrize(
    ("number", "said"),
    [(errno.ENODEV, "the camera is gone"), (errno.EIO, "stopped streaming"), (errno.EPIPE, "stopped streaming")],
)
def test_a_device_that_goes_is_one_error_and_can_be_closed(started: Make, number: int, said: str) -> None:
    camera, driver = started()
    grab(camera)
    driver.error = number
    with pytest.raises(AnnulusError, match=said):
        grab(camera)
    camera.stop()
    camera.start()
    assert grab(camera).sequence == 7


def test_asking_a_camera_that_was_not_started_is_refused(started: Make) -> None:
    camera, _ = started()
    camera.stop()
    with pytest.raises(AnnulusError, match="not started"):
        grab(camera)
    camera.close()
