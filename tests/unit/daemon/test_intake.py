"""Promises of a camera's frames on their way in: from a scripted camera, through its intake, to a slot and a label."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from annulus_pipe.capture.camera import EndOfFrames, HeldRequest
from annulus_pipe.daemon import camera, camera_state
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.camera_feed import CameraFeed
from annulus_pipe.daemon.camera_state import CameraState
from annulus_pipe.daemon.intake import InSlot, Intake
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.labelling.labelling import CameraMode, Labelling
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.vocabulary import AnnulusError

PERIOD = 20_000_000
AHEAD = 3_600_000_000_000


class Film:
    """Frames with these numbers of their driver, each brightness its place in the list, then `end`."""

    width, height, encoding = 8, 6, "mono8"

    def __init__(self, numbers: list[int], end: Exception | None = None, counts: bool = True) -> None:
        self.numbers, self.end, self.counts, self.next = numbers, end or EndOfFrames(), counts, 0
        self.begun_ns, self.starts, self.ahead_ns = time.monotonic_ns(), 0, 0

    def start(self) -> None:
        self.starts += 1

    def stop(self) -> None: ...

    def close(self) -> None: ...

    def set_controls(self, controls: object) -> None: ...

    def capture_request(self) -> HeldRequest:
        if self.next == len(self.numbers):
            raise self.end
        number = self.numbers[self.next]
        self.next += 1
        told = {
            "SensorTimestamp": self.begun_ns + self.ahead_ns + number * PERIOD,
            "Light": "led",
            "ZMm": float(number),
        }
        return HeldRequest(
            np.full((6, 8), self.next, np.uint8), {**told, **({"FrameSequence": number} if self.counts else {})}
        )


class Rig(Observer):
    """A scripted camera, its intake, and what came of it."""

    def __init__(self, film: Film, slots: int, kind: str) -> None:
        self.ring, self.account, self.told = FrameRing(slots, 48), Account(), list[str]()
        mode = CameraMode(2, 8, 6, "mono8", PERIOD)
        config = CameraConfig(kind, width=8, height=6)  # type: ignore[arg-type]
        self.feed = CameraFeed(2, config, self.account, self, film)  # type: ignore[arg-type]
        assert self.feed.look() == (8, 6, "mono8")
        self.feed.join(self.ring, slots)
        self.labelling = Labelling(mode, Navigation(0.05), lambda *_: None, True)
        self.intake = Intake(self.feed, mode, self.labelling, self.ring)
        self.intake.start()

    def event(self, kind: str, text: str) -> None:
        self.told.append(text)

    def until(self, condition: Callable[[], object]) -> None:
        end = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < end, (self.feed.state, self.feed.trouble, self.told)
            self.intake.take(self.account)
            time.sleep(0.001)

    def labelled(self, final: bool = False) -> list[tuple[FrameHeader, InSlot]]:
        out = list(self.intake.labelled(final))
        for header, _ in out:
            self.account.label(header)
        return out


@contextmanager
def rig(film: Film, slots: int = 8, kind: str = "folder") -> Iterator[Rig]:
    one = Rig(film, slots, kind)
    yield one
    one.intake.stop()
    one.intake.take(one.account)
    one.labelled(final=True)
    assert one.account.in_hand["label"] == 0
    one.feed.close()


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Silence and back-off a hundred times as fast as in service."""
    monkeypatch.setattr(camera, "SILENT_S", 0.02)
    monkeypatch.setattr(camera, "SILENT_PERIODS", 0.5)
    monkeypatch.setattr(camera_state, "RETRY_FIRST_S", 0.005)
    monkeypatch.setattr(camera_state, "RETRY_LAST_S", 0.05)


def test_its_process_imports_no_method_and_is_up_soon() -> None:
    code = "import sys, annulus_pipe.daemon.camera; print(*{'scipy', 'annulus_pipe.rings'} & set(sys.modules))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).split() == []


def test_frames_come_in_order_and_the_end_is_told() -> None:
    with rig(Film([1, 2, 3])) as one:
        one.until(lambda: one.feed.ended)
        assert not one.intake.ended
        assert [header.z_mm for header, _ in one.labelled()] == [1.0, 2.0, 3.0]
        assert one.intake.ended and one.intake.problem == ""


def test_no_frame_is_lost_while_slots_are_free_however_late_the_daemon_comes() -> None:
    film = Film(list(range(24)))
    with rig(film, slots=24) as one:
        while film.next < 24:
            time.sleep(0.01)  # not a single turn meanwhile
        one.until(lambda: one.feed.ended)
        out = one.labelled()
        assert one.account.drops == {} and len(out) == 24
        assert [one.ring.view(header, frame.place)[0, 0] for header, frame in out] == list(range(1, 25))


def test_a_film_that_breaks_is_one_line() -> None:
    with rig(Film([1], RuntimeError("torn"))) as one:
        one.until(lambda: one.feed.ended)
        assert one.intake.problem == "camera: RuntimeError: torn"


def test_a_frame_of_another_size_ends_a_film() -> None:
    film = Film([1, 2])
    with rig(film) as one:
        film.width = 9
        one.until(lambda: one.feed.ended)
        assert "expected uint8 6x9" in one.intake.problem or one.account.taken


@pytest.mark.parametrize("counts", [True, False])
def test_what_the_driver_dropped_is_counted_by_its_numbers_or_by_its_clock(counts: bool) -> None:
    with rig(Film([3, 4, 6, 10], counts=counts)) as one:
        one.until(lambda: one.feed.ended)
        assert one.account.drops == {"camera": 4} and one.account.taken == 4
        out = one.labelled()
        assert [header.z_mm for header, _ in out] == [3.0, 4.0, 6.0, 10.0]
        assert all(header.arrived_ns == frame.at_ns > one.account._began_ns for header, frame in out)


def test_without_a_slot_a_frame_is_lost_and_counted_and_the_others_are_numbered_on() -> None:
    with rig(Film([0, 1, 2, 3, 4]), slots=3) as one:
        one.until(lambda: one.feed.ended)
        assert one.account.drops == {"no_slot": 2} and one.account.in_hand["label"] == 3
        out = one.labelled()
        assert [header.index for header, _ in out] == [0, 1, 2]
        for header, frame in out:
            assert one.ring.view(header, frame.place)[0, 0] == header.z_mm + 1
            one.ring.release(frame.place)
        assert one.ring.free == 3


@pytest.mark.usefixtures("hurried")
def test_a_camera_that_goes_is_told_once_opened_again_and_its_hole_is_counted() -> None:
    class Unplugged(Film):
        away = False

        def start(self) -> None:
            super().start()
            if self.away:
                raise AnnulusError("/dev/video9: no such camera")

        def capture_request(self) -> HeldRequest:
            time.sleep(0.001)
            if self.away or self.next == 3:
                self.away |= self.next == 3
                self.next += self.next == 3
                raise AnnulusError("/dev/video9: the camera is gone")
            return super().capture_request()

    film = Unplugged(list(range(200)))
    with rig(film, slots=64, kind="v4l2") as one:
        one.until(lambda: film.starts >= 4)
        assert one.intake.trouble.startswith("camera 2 is gone: /dev/video9") and one.intake.problem == ""
        taken = one.account.taken
        time.sleep(0.1)
        film.away, film.next = False, 50  # its count and clock go on from elsewhere
        one.until(lambda: one.account.taken > taken + 5)
        assert one.intake.trouble == "" and one.feed.state is CameraState.STREAMING
        drops = one.account.drops
        assert drops["camera_gone"] == 1 and drops["camera_away"] >= 4 and "camera" not in drops
        assert sum("is gone: /dev/video9: the camera is gone" in text for text in one.told) == 1
        assert sum("is gone: /dev/video9: no such camera" in text for text in one.told) == 1, "attempts are not told"
        assert any("is back after" in text for text in one.told)
        entered = one.feed.numbers()["entered"]
        assert entered["opening"] == film.starts and entered["gone"] == film.starts - 1


@pytest.mark.usefixtures("hurried")
def test_a_camera_that_cannot_be_opened_at_first_is_the_scans_problem() -> None:
    class Absent(Film):
        def start(self) -> None:
            raise AnnulusError("/dev/video9: no such camera")

    with rig(Absent([]), kind="v4l2") as one:
        one.until(lambda: one.intake.problem)
        assert one.intake.problem == "/dev/video9: no such camera" and not one.intake.is_open


@pytest.mark.usefixtures("hurried")
def test_a_silent_camera_is_told_and_its_stream_begun_anew() -> None:
    class Silent(Film):
        def capture_request(self) -> HeldRequest:
            if self.next == 2 and self.starts < 3:
                time.sleep(0.005)
                raise TimeoutError("no frame within 5 ms")
            return super().capture_request()

    with rig(Silent([0, 1, 2, 3], TimeoutError()), kind="v4l2") as one:
        one.until(lambda: one.account.taken == 4)
        assert one.account.drops["camera_silent"] >= 1
        assert "camera 2 is silent: no frame within 5 ms; it is tried again until it is back" in one.told


def test_stamps_of_the_future_stall_a_film_but_no_camera() -> None:
    live = Film(list(range(20)), TimeoutError())
    live.ahead_ns = AHEAD
    with rig(live, slots=32, kind="v4l2") as one:
        begun = time.monotonic()
        one.until(lambda: one.account.taken == 20)
        assert time.monotonic() - begun < 10.0  # a second each, where they are waited for
        assert len(one.labelled()) == 20
    film = Film([0, 20])  # 0.4 s apart
    with rig(film) as one:
        one.until(lambda: one.feed.ended)
        first, last = (frame.at_ns for _, frame in one.labelled())
        assert last - first >= 18 * PERIOD


def test_frames_taken_before_the_camera_began_anew_are_labelled_by_what_was_known_then() -> None:
    gone = threading.Event()

    class Again(Film):
        def capture_request(self) -> HeldRequest:
            if self.next == 3 and not gone.is_set():
                gone.set()
                raise AnnulusError("gone")
            return super().capture_request()

    with rig(Again(list(range(8)), TimeoutError()), kind="v4l2") as one:
        known = list[int]()
        one.labelling.restarted = lambda: known.append(one.account.taken)  # type: ignore[method-assign]
        one.until(lambda: one.account.taken == 8)
        assert known == [3]
        assert [header.z_mm for header, _ in one.labelled()] == [float(n) for n in range(8)]
