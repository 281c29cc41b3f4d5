"""Promises of a camera's frames on their way in."""

import threading
import time

import numpy as np
import pytest

from annulus.capture.camera import EndOfFrames, HeldRequest
from annulus.daemon.account import Account
from annulus.daemon.config import CameraConfig
from annulus.daemon.intake import QUEUE_FRAMES, CaptureThread, Intake
from annulus.labelling.labelling import CameraMode, Labelling
from annulus.labelling.navigation import Navigation
from annulus.stream.ring import FrameRing

PERIOD = 20_000_000


class Film:
    """So many frames, then the end or an error."""

    width, height, encoding = 8, 6, "mono8"

    def __init__(self, count: int, end: Exception) -> None:
        self.count, self.end, self.next = count, end, 0

    def capture_request(self) -> HeldRequest:
        if self.next == self.count:
            raise self.end
        self.next += 1
        return HeldRequest(
            np.full((6, 8), self.next, np.uint8), {"SensorTimestamp": self.next, "FrameSequence": self.next}
        )


def run(film: Film) -> CaptureThread:
    thread = CaptureThread(film)  # type: ignore[arg-type]
    thread.start()
    thread.join(10)
    return thread


def test_frames_come_in_order_and_the_end_is_told() -> None:
    thread = run(Film(3, EndOfFrames()))
    assert not thread.ended
    assert [arrived.frame.timestamp_ns for arrived in thread.take()] == [1, 2, 3]
    assert thread.ended and thread.problem == ""
    thread.end(1.0)


def test_a_slow_daemon_costs_new_frames_and_they_are_counted() -> None:
    thread = run(Film(10, EndOfFrames()))
    assert len(thread.take()) == QUEUE_FRAMES
    assert thread.counts["capture_queue"] == 10 - QUEUE_FRAMES
    thread.end(1.0)


def test_a_camera_that_breaks_is_one_line() -> None:
    thread = run(Film(1, RuntimeError("cable out")))
    assert len(thread.take()) == 1
    assert thread.ended and thread.problem == "camera: RuntimeError: cable out"
    thread.end(1.0)


def test_a_frame_of_another_size_ends_it() -> None:
    film = Film(2, EndOfFrames())
    film.width = 9
    assert "expected uint8 6x9" in run(film).problem


class Live(Film):
    """As many frames as asked, at 50 fps; `numbers` are its driver's."""

    def __init__(self, numbers: list[int], counts: bool = True) -> None:
        super().__init__(len(numbers), EndOfFrames())
        self.numbers, self.counts, self.begun_ns = numbers, counts, time.monotonic_ns()

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def capture_request(self) -> HeldRequest:
        request = super().capture_request()
        number = self.numbers[self.next - 1]
        told = {"SensorTimestamp": self.begun_ns + number * PERIOD, "Light": "led", "ZMm": float(number)}
        return HeldRequest(request.make_array(), {**told, **({"FrameSequence": number} if self.counts else {})})


def taken(film: Live, slots: int = 8) -> tuple[Intake, FrameRing, Account]:
    ring, account = FrameRing(slots, 48), Account()
    mode = CameraMode(0, 8, 6, "mono8", PERIOD)
    intake = Intake(film, mode, Labelling(mode, Navigation(0.05), lambda *_: None, True), ring)  # type: ignore[arg-type]
    intake.start(CameraConfig("folder"))
    end = time.monotonic() + 10
    while not intake._thread.ended and time.monotonic() < end:
        intake.take(account)
    return intake, ring, account


@pytest.mark.parametrize("counts", [True, False])
def test_what_the_driver_dropped_is_counted_by_its_numbers_or_by_its_clock(counts: bool) -> None:
    intake, _, account = taken(Live([3, 4, 6, 10], counts))
    assert account.drops == {"camera": 4} and account.taken == 4
    out = list(intake.labelled())
    assert [header.z_mm for header, _ in out] == [3.0, 4.0, 6.0, 10.0]
    assert all(header.arrived_ns == frame.at_ns > header.timestamp_ns for header, frame in out)
    assert intake.ended
    intake.stop()


def test_without_a_slot_a_frame_is_lost_and_counted_and_the_others_are_numbered_on() -> None:
    intake, ring, account = taken(Live([0, 1, 2, 3, 4]), slots=3)
    assert account.drops == {"no_slot": 2} and account.in_hand["label"] == 3
    out = list(intake.labelled())
    assert [header.index for header, _ in out] == [0, 1, 2]
    for header, frame in out:
        assert ring.view(header, frame.place)[0, 0] == header.z_mm + 1
        ring.release(frame.place)
    assert ring.free == 3


def test_a_camera_without_a_frame_when_one_is_due_is_in_trouble_until_it_has_one() -> None:
    class Hesitant(Live):
        def capture_request(self) -> HeldRequest:
            if self.next == 1 and not self.hesitated.is_set():
                self.hesitated.set()
                self.go.wait(10)
                raise TimeoutError
            if self.next == 1:
                self.again.wait(10)
            return super().capture_request()

    film = Hesitant([0, 1])
    film.hesitated, film.go, film.again = threading.Event(), threading.Event(), threading.Event()
    ring, account = FrameRing(4, 48), Account()
    mode = CameraMode(2, 8, 6, "mono8", PERIOD)
    intake = Intake(film, mode, Labelling(mode, Navigation(0.05), lambda *_: None, True), ring)  # type: ignore[arg-type]
    intake.start(CameraConfig("folder"))
    assert film.hesitated.wait(10) and intake.trouble == ""
    film.go.set()
    end = time.monotonic() + 10
    while not intake.trouble and time.monotonic() < end:
        time.sleep(0.001)
    assert intake.trouble == "camera 2 is silent"
    film.again.set()
    while intake.trouble and time.monotonic() < end:
        time.sleep(0.001)
    assert intake.trouble == ""
    intake.take(account)
    assert account.drops["camera_silent"] == 1
    intake.stop()


def test_what_the_daemon_was_too_slow_for_is_not_counted_as_the_drivers_too() -> None:
    film = Live(list(range(30)))
    ring, account = FrameRing(40, 48), Account()
    mode = CameraMode(0, 8, 6, "mono8", PERIOD)
    intake = Intake(film, mode, Labelling(mode, Navigation(0.05), lambda *_: None, True), ring)  # type: ignore[arg-type]
    intake.start(CameraConfig("folder"))
    end = time.monotonic() + 20
    while intake._thread.counts["capture_queue"] < 3 and time.monotonic() < end:
        time.sleep(0.001)
    while not intake._thread.ended and time.monotonic() < end:
        intake.take(account)
        time.sleep(0.001)
    lost = account.drops["capture_queue"]
    assert account.drops == {"capture_queue": lost} and account.taken + lost == 30 and lost >= 3
