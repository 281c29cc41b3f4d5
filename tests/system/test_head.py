"""The head in its own process and real time: a real serial client on one side, a camera on the other."""

import os
import signal
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from leftovers import left_in_shm

from annulus_pipe import untrusted
from annulus_pipe.capture.camera import CameraDriver, CapturedFrame, grab
from annulus_pipe.capture.picamera import plug
from annulus_pipe.capture.remote import RemoteCamera
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import Arm, ArmFlag, Commit, Edge, Stage, StatusCode
from annulus_pipe.link.session import EventReceived
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.twin.head import HeadHandle, head_timing, head_toml, start_head
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import AnnulusError, Lamp

pytestmark = pytest.mark.alone

FPS = 25.0
US = 100  # ticks


@pytest.fixture
def head() -> Iterator[HeadHandle]:
    with start_head(demo_world().scaled(208), FPS, speed_mm_s=0.0, seed=3) as handle:
        yield handle


def armed(head: HeadHandle, **changes: Any) -> Client:
    client = Client(head.port_url)
    timing = head.timing
    settings = {
        "generation": 1,
        "ratio": 1,
        "frame_period": round(timing.period_us * US),
        "exposure": round(timing.exposure_us * US),
        "readout": round(timing.readout_us * US),
        "tolerance": 50,
        "host_timeout": 2000,
        "projector_delay": 3000 * US,
        "projector_width": 5000 * US,
        "led_delay": 3000 * US,
        "led_width": 2500 * US,
    }
    for command in (Stage(**{**settings, **changes}), Commit(1), Arm(ArmFlag.LAMPS)):
        assert client.request(command).status is StatusCode.OK
    return client


def edges(client: Client) -> list[Edge]:
    return [h.event for h in client.poll() if isinstance(h, EventReceived) and isinstance(h.event, Edge)]


def shoot(camera: CameraDriver, client: Client, frames: int) -> tuple[list[CapturedFrame], list[Edge]]:
    taken, seen = [], []
    for _ in range(frames):
        taken.append(grab(camera))
        client.keep_alive()
        seen += edges(client)
    return taken, seen


def test_lamps_that_fire_show_in_the_frames_and_a_disarmed_head_is_dark(head: HeadHandle) -> None:
    camera = plug(RemoteCamera(head.camera_address))
    assert (camera.width, camera.height, camera.encoding) == (208, 154, "bayer_rggb8")
    camera.start()
    assert max(float(grab(camera).image.mean()) for _ in range(3)) < 4.0  # nothing armed, nothing lit
    client = armed(head)
    frames, seen = shoot(camera, client, 24)
    means = np.array([f.image.mean() for f in frames[6:]])
    led, projector = means > 60, (means > 6) & (means < 40)
    assert (led | projector).all()
    # R = 1: the lamps alternate, wherever the sequence has no hole
    numbers = [int(f.sequence or 0) for f in frames[6:]]
    assert len(set(zip(led, (n % 2 for n in numbers), strict=True))) == 2
    assert {e.lamp for e in seen} >= {Lamp.PROJECTOR, Lamp.LED}
    client.request(Arm(ArmFlag(0)))
    shoot(camera, client, 3)
    assert float(grab(camera).image.mean()) < 4.0
    assert head.counters()["lamps_on"] == []
    client.close()
    camera.close()


@pytest.mark.deep(gate="tests/system/test_head.py::test_lamps_that_fire_show_in_the_frames_and_a_disarmed_head_is_dark")
def test_timestamps_are_the_sync_edges_on_this_machines_clock(head: HeadHandle) -> None:
    camera = RemoteCamera(head.camera_address)
    camera.start()
    frames = [grab(camera) for _ in range(12)]
    stamps = np.array([f.timestamp_ns for f in frames])
    numbers = np.array([int(f.sequence or 0) for f in frames])
    period = np.polyfit(numbers, stamps, 1)[0]
    assert period == pytest.approx(40e6 * (1 - 30e-6), abs=1)  # the head's crystal runs 30 ppm fast
    assert 0 < time.monotonic_ns() - stamps[-1] < 60e9
    camera.stop()
    camera.close()
    again = RemoteCamera(head.camera_address)  # a camera that was closed can be opened again
    again.start()
    assert grab(again).timestamp_ns > stamps[-1]
    again.close()


@pytest.mark.deep(gate="tests/system/test_head.py::test_lamps_that_fire_show_in_the_frames_and_a_disarmed_head_is_dark")
def test_a_slow_host_costs_frames_that_show_as_holes_and_never_old_pictures(head: HeadHandle) -> None:
    camera = RemoteCamera(head.camera_address)
    camera.start()
    first = grab(camera)
    time.sleep(0.6)  # 15 frames; the head has 6 buffers
    later = [grab(camera) for _ in range(10)]
    numbers = [int(f.sequence or 0) for f in [first, *later]]
    assert numbers == sorted(set(numbers)) and max(np.diff(numbers)) > 3
    assert head.counters()["driver_dropped_no_buffer"] > 0
    camera.close()


@pytest.mark.deep(gate="tests/system/test_head.py::test_lamps_that_fire_show_in_the_frames_and_a_disarmed_head_is_dark")
def test_its_sensors_are_heard_fall_silent_and_come_back(head: HeadHandle) -> None:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.SUB)
    socket.subscribe(b"")
    socket.setsockopt(zmq.RCVTIMEO, 30_000)
    socket.connect(head.sensor_address)

    def heard() -> Sample:
        name, body = socket.recv_multipart()
        sample = Sample.from_dict(untrusted.unpack(body, 16384))
        assert name == sample.sensor.encode()
        assert abs(time.monotonic_ns() - sample.host_ns) < 60e9  # of this machine's clock
        return sample

    first = [heard() for _ in range(40)]
    assert {s.sensor for s in first} == {"imu", "supply"}
    dark = next(s for s in first if s.sensor == "supply")
    client = armed(head)
    while (lit := heard()).sensor != "supply" or lit.values["current_a"] < dark.values["current_a"] + 0.05:
        client.keep_alive()
    client.close()
    while (before := heard()).sensor != "imu":
        pass
    head.silence("imu", 1.0)
    end_ns, longest_ns = time.monotonic_ns() + 30_000_000_000, 0
    while longest_ns <= 0.9e9:
        sample = heard()
        assert sample.host_ns < end_ns
        if sample.sensor == "imu":
            longest_ns, before = max(longest_ns, sample.host_ns - before.host_ns), sample
    with pytest.raises(AnnulusError, match="expected one of imu, supply"):
        head.silence("sonar", 1.0)
    context.destroy(linger=0)


@pytest.mark.deep(gate="tests/system/test_head.py::test_lamps_that_fire_show_in_the_frames_and_a_disarmed_head_is_dark")
def test_the_head_toml_it_prints_names_all_its_addresses(head: HeadHandle) -> None:
    said = tomllib.loads(head_toml(head, demo_world().scaled(208), Path("a b.json")))
    assert said["controller"]["port"] == head.port_url
    assert said["sensor"] == [{"kind": "remote", "device": head.sensor_address}]
    assert (said["camera"]["kind"], said["camera"]["device"]) == ("remote", head.camera_address)
    timing = FrameTiming(*(said["camera"][name] for name in ("fps", "exposure_us", "readout_us")))
    lamps = said["lamps"]
    timing.check_flash(lamps["projector_delay_us"], lamps["projector_width_us"])
    timing.check_flash(lamps["led_delay_us"], lamps["led_width_us"])
    assert said["calibration"]["file"] == "a b.json"


@pytest.mark.deep(gate="tests/system/test_head.py::test_lamps_that_fire_show_in_the_frames_and_a_disarmed_head_is_dark")
def test_the_head_ends_with_its_handle_ignores_ctrl_c_and_leaves_nothing() -> None:
    before = set(os.listdir("/dev/shm"))
    head = start_head(demo_world().scaled(64), FPS)
    os.kill(head.process.pid, signal.SIGINT)
    head.counters()  # it still answers
    camera = RemoteCamera(head.camera_address)
    camera.start()
    grab(camera)
    head.close()
    head.close()
    assert head.process.poll() == 0
    with pytest.raises(AnnulusError, match="went away"):
        while True:
            grab(camera)
    with pytest.raises(AnnulusError, match="no camera is served there"):
        RemoteCamera(head.camera_address)
    assert left_in_shm(before) == set()


def test_a_head_at_any_rate_has_a_window_for_the_demo_flashes() -> None:
    for fps in (5.0, 10.0, 17.5, 25.0):
        head_timing(fps).check_flash(3000.0, 5000.0)
