"""Promises of the capture thread."""

import numpy as np

from annulus.capture.camera import EndOfFrames, HeldRequest
from annulus.daemon.capturing import QUEUE_FRAMES, Capturing


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


def run(film: Film) -> Capturing:
    capturing = Capturing(film)  # type: ignore[arg-type]
    capturing.start()
    capturing.join(10)
    return capturing


def test_frames_come_in_order_and_the_end_is_told() -> None:
    capturing = run(Film(3, EndOfFrames()))
    assert not capturing.ended
    assert [arrived.frame.timestamp_ns for arrived in capturing.take()] == [1, 2, 3]
    assert capturing.ended and capturing.problem == ""
    capturing.end(1.0)


def test_a_slow_daemon_costs_new_frames_and_they_are_counted() -> None:
    capturing = run(Film(10, EndOfFrames()))
    assert len(capturing.take()) == QUEUE_FRAMES
    assert capturing.counts["capture_queue"] == 10 - QUEUE_FRAMES
    capturing.end(1.0)


def test_a_camera_that_breaks_is_one_line() -> None:
    capturing = run(Film(1, RuntimeError("cable out")))
    assert len(capturing.take()) == 1
    assert capturing.ended and capturing.problem == "camera: RuntimeError: cable out"
    capturing.end(1.0)


def test_a_frame_of_another_size_ends_it() -> None:
    film = Film(2, EndOfFrames())
    film.width = 9
    assert "expected uint8 6x9" in run(film).problem
