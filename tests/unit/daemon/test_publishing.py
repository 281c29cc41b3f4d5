"""Promises of the publisher's process: what strangers do to it costs the session nothing, and it is soon back."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import SocketConfig
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.publishing import PUBLISHER_SHARE, Publishing
from annulus_pipe.stream import workers
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.publish import parse
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared
from annulus_pipe.vocabulary import Label
from tests.unit.daemon.test_live_wall import CALIBRATION, profile


class Stand:
    def __init__(self, folder: Path, address: str = "tcp://127.0.0.1:*", calibration=None) -> None:
        self.context, self.ring, self.account, self.index = zmq.Context(), FrameRing(8, 1200), Account(), 0
        self.publishing = Publishing(
            SocketConfig(address, None),
            Shared(self.ring, self.context, folder),
            self.account,
            Observer(),
            calibration=calibration,
        )
        self.viewer = self.context.socket(zmq.SUB)
        self.viewer.subscribe(b"")

    def until(self, done) -> None:
        end = time.monotonic() + 60.0
        while not done():
            assert time.monotonic() < end and not self.publishing.broken, self.publishing.broken
            self.publishing.poll()
            time.sleep(0.005)

    def offer(self) -> float:
        """A frame; how long that took, in seconds."""
        place = self.ring.claim()
        assert place is not None
        self.ring.write(place, np.full((30, 40), self.index % 256, np.uint8))
        header = FrameHeader(self.index, None, 0, Label.LED, "", None, None, None, 0.0, "mono8", 40, 30)
        self.index += 1
        began = time.monotonic()
        self.publishing.label(header)
        self.publishing.offer(header, place)
        took_s = time.monotonic() - began
        self.ring.release(place)
        return took_s

    def receive(self, topic: str, also: Callable[[], None] = lambda: None) -> tuple[int, dict, bytes]:
        """The next of that topic, frames being offered all the while, and `also`: a note may be dropped on a busy
        machine.
        """
        end = time.monotonic() + 100.0
        while True:
            assert time.monotonic() < end
            self.publishing.poll()
            also()
            if self.ring.free > 2:
                self.offer()
            while self.viewer.poll(10):
                found, number, body, part = parse(self.viewer.recv_multipart())
                if found == topic:
                    return number, body, part

    def close(self) -> None:
        pids = self.publishing.pids + self.publishing.spare_pids
        self.publishing.stop(5.0)
        self.context.destroy(linger=0)
        assert self.ring.free == 8 and not any(Path(f"/proc/{pid}").exists() for pid in pids)
        self.ring.close()


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that got no processor for a second is not taken for hung: those that are replaced are counted here."""
    monkeypatch.setattr(workers, "HUNG_LEAST_S", 60.0)


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Stand]:
    stand = Stand(tmp_path)
    try:
        stand.until(lambda: stand.publishing.ready and not stand.publishing.address.endswith("*"))
        stand.viewer.connect(stand.publishing.address)
        yield stand
    finally:
        stand.close()


@pytest.mark.deep(
    gate="tests/unit/daemon/test_publishing.py::test_pictures_are_made_while_somebody_looks_and_a_wall_for_who_comes_late"
)
def test_frames_and_labels_reach_a_viewer_and_one_that_takes_over_numbers_on(stand: Stand) -> None:
    number, body, pixels = stand.receive("frame/0")
    assert pixels == bytes([body["index"] % 256]) * 1200 and number == body["index"]
    number, body, pixels = stand.receive("label")
    assert number == body["index"] and pixels == b""
    first = stand.publishing.pids
    os.kill(first[0], signal.SIGKILL)
    stand.until(lambda: stand.publishing.ready and stand.publishing.pids != first)
    killed_at = stand.index
    body = {"index": 0}
    while body["index"] < killed_at:  # what the first one had sent still waits to be read
        number, body, _ = stand.receive("frame/0")
        assert number == body["index"]
    assert stand.account.drops["publishers_replaced"] == 1
    account = stand.account
    stand.until(lambda: stand.publishing.in_hand == 0)
    assert {"publisher_busy", "publisher_died", "publishers_replaced"} >= set(account.drops)


@pytest.mark.deep(
    gate="tests/unit/daemon/test_publishing.py::test_pictures_are_made_while_somebody_looks_and_a_wall_for_who_comes_late"
)
def test_a_publisher_that_stands_still_holds_its_share_and_nobody_up(stand: Stand, stalls) -> None:
    os.kill(stand.publishing.pids[0], signal.SIGSTOP)
    begun = time.monotonic()
    longest_s = max(stand.offer() for _ in range(200))
    if stalls.since(begun) < 0.02:
        assert longest_s < 0.1
    assert stand.ring.free == 8 - PUBLISHER_SHARE
    assert stand.account.drops == {"publisher_busy": 200 - PUBLISHER_SHARE}
    stand.until(lambda: stand.account.drops.get("publishers_replaced"))


def test_frames_that_nobody_asked_for_are_not_copied(stand: Stand) -> None:
    stand.receive("frame/0")
    stand.viewer.unsubscribe(b"")
    stand.viewer.subscribe(b"label")
    for _ in range(20):  # until the publisher has heard of it
        stand.receive("label")
    stand.viewer.subscribe(b"frame/0")  # .. and it has them again as soon as it asks
    assert stand.receive("frame/0")[2]


@pytest.mark.deep(gate="tests/unit/daemon/test_publishing.py::test_frames_that_nobody_asked_for_are_not_copied")
def test_an_address_that_is_taken_is_one_clear_line(stand: Stand, tmp_path: Path) -> None:
    (folder := tmp_path / "other").mkdir()
    other = Stand(folder, stand.publishing.address)
    with pytest.raises(AssertionError, match=r"cannot publish on tcp://.*Expected"):
        other.until(lambda: False)
    other.close()


def test_pictures_are_made_while_somebody_looks_and_a_wall_for_who_comes_late(tmp_path: Path) -> None:
    stand = Stand(tmp_path, calibration=CALIBRATION)
    try:
        stand.until(lambda: stand.publishing.ready and not stand.publishing.address.endswith("*"))
        stand.viewer.unsubscribe(b"")
        stand.viewer.subscribe(b"label")
        stand.viewer.connect(stand.publishing.address)
        stand.receive("label")
        stand.publishing.begun(77)
        for z in range(0, 400, 2):
            stand.publishing.profile(profile(float(z)))
            stand.publishing.poll()
        stand.receive("label")
        before = stand.index
        for topic in (b"preview/0", b"rows/0", b"slits/0", b"wall"):
            stand.viewer.subscribe(topic)
        number, body, jpeg = stand.receive("preview/0")
        assert number <= stand.index - before + PUBLISHER_SHARE, "none was made before it was asked for"
        assert body["preview"] == {"width": 20, "height": 15} and jpeg[:2] == b"\xff\xd8"
        assert len(stand.receive("rows/0")[2]) == 4 * 64
        rows: set[int] = set()
        end = time.monotonic() + 30.0
        while len(rows) < 110 and time.monotonic() < end:
            _, body, part = stand.receive("wall")
            assert body["scan"] == 77 and len(part) == 2 * 360 * body["rows"]
            rows |= set(range(body["first"], body["first"] + body["rows"])) if body["of"] == "whole" else set()
        assert len(rows) >= 110
        _, body, part = stand.receive("slits/0", also=lambda: stand.publishing.profile(profile(402.0)))
        assert body == {"index": 402, "camera": 0} and len(part) % 5 == 0
    finally:
        stand.close()
