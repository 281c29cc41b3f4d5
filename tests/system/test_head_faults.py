"""Promises of the live head's faults: the host meets each as it would on a bench, and the head counts what it did."""

import itertools
import time
from collections import Counter
from typing import Any

import numpy as np
import pytest

from annulus_pipe.capture.camera import CapturedFrame, grab
from annulus_pipe.capture.photometry import measure
from annulus_pipe.capture.remote import RemoteCamera
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import Ping
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.head import start_head
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import AnnulusError

pytestmark = pytest.mark.alone

WORLD = demo_world().scaled(208)
PERIOD_NS = 40_000_000


def frames(camera: RemoteCamera, count: int) -> list[CapturedFrame]:
    return [grab(camera) for _ in range(count)]


@pytest.mark.deep(
    gate="tests/system/test_head_faults.py::test_a_camera_that_is_unplugged_hangs_up_lets_nobody_in_and_counts_from_zero_when_it_is_back"
)
def test_pictures_repeat_and_tear_and_stamps_step_as_the_driver_says_it_did() -> None:
    faults = Faults(frames_repeated=0.1, frames_torn=0.1, stamp_steps=((60, 5),), count_jumps=((80, 7),))
    with start_head(WORLD, 25.0, faults, seed=4) as head:
        camera = RemoteCamera(head.camera_address)
        camera.start()
        seen = frames(camera, 120)
        counted = head.counters()["driver"]
        camera.stop()
        camera.close()
    prints = [measure(frame.image).fingerprint for frame in seen]
    again = sum(a == b for a, b in itertools.pairwise(prints))
    assert 1 <= again <= counted["repeated"]
    assert counted["torn"] >= 1
    steps = Counter(round((b.timestamp_ns - a.timestamp_ns) / PERIOD_NS) for a, b in itertools.pairwise(seen))
    assert steps[6] >= 1  # five frames later than the next would have been
    jumps = [b.sequence - a.sequence for a, b in itertools.pairwise(seen) if a.sequence and b.sequence]
    assert 8 in jumps


def test_a_camera_that_is_unplugged_hangs_up_lets_nobody_in_and_counts_from_zero_when_it_is_back() -> None:
    with start_head(WORLD, 25.0, Faults(unplugged=((60, 25),)), seed=4) as head:
        camera = RemoteCamera(head.camera_address)
        camera.start()
        with pytest.raises(AnnulusError, match="went away"):
            frames(camera, 200)
        camera.close()
        with pytest.raises(AnnulusError):
            RemoteCamera(head.camera_address)
        end = time.monotonic() + 10.0
        while True:
            try:
                camera = RemoteCamera(head.camera_address)
                break
            except AnnulusError:
                assert time.monotonic() < end
                time.sleep(0.05)
        camera.start()
        (first,) = frames(camera, 1)
        assert first.sequence is not None and first.sequence < 25 and np.any(first.image)
        camera.close()


@pytest.mark.deep(
    gate="tests/system/test_head_faults.py::test_a_camera_that_is_unplugged_hangs_up_lets_nobody_in_and_counts_from_zero_when_it_is_back"
)
def test_a_line_that_is_pulled_is_silent_and_a_controller_that_lost_power_has_the_boot_byte_it_had(stalls: Any) -> None:
    faults = Faults(disconnects=((50, 400.0),), power_losses=(90,))
    with start_head(WORLD, 25.0, faults, seed=4) as head, Client(head.port_url) as client:
        boot = client.identity.boot
        begun = answered = time.monotonic()
        silent_s = 0.0
        while time.monotonic() < begun + 5.0 or head.counters()["power_losses"] < 1:
            assert time.monotonic() < begun + 60.0
            try:
                client.request(Ping())
                silent_s = max(silent_s, time.monotonic() - answered)
                answered = time.monotonic()
            except AnnulusError:
                continue
        counters = head.counters()
        assert (counters["disconnects"], counters["power_losses"]) == (1, 1)
        assert silent_s > 0.3 and client.identity.boot == boot
        if stalls.since(begun) < 0.1:
            assert silent_s < 3.0
