"""Promises of a head with two cameras of different sizes on one frame-sync: the simulated head in real time."""

import queue
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.capture.camera import CameraDriver, CompletedRequest, HeldRequest, OneRequest
from annulus_pipe.capture.photometry import Light, measure
from annulus_pipe.capture.remote import RemoteCamera
from annulus_pipe.daemon.config import SLOTS
from annulus_pipe.daemon.session import Session
from annulus_pipe.demo import demo_config
from annulus_pipe.record.recording import open_recording
from annulus_pipe.twin.head import start_head
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import Label

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(
        gate="tests/unit/daemon/test_two_cameras.py::test_no_pair_is_wrong_when_one_camera_loses_one_frame_in_ten"
    ),
]

WORLD = demo_world(travel_mm=330.0).scaled(416)
LATE_NS = 9_000_000  # the second camera's driver stamps so much later than the first one's


class First(OneRequest):
    """The head's own camera; what it sees the second sees too."""

    def __init__(self, camera: RemoteCamera) -> None:
        self.camera, self.copies = camera, queue.Queue[CompletedRequest]()
        self.width, self.height, self.encoding = camera.width, camera.height, camera.encoding
        self.start, self.stop, self.close = camera.start, camera.stop, camera.close
        self.set_controls = camera.set_controls

    def capture_request(self) -> CompletedRequest:
        request = self.camera.capture_request()
        image, metadata = request.make_array("main"), request.get_metadata()
        h, w = self.height // 4, self.width // 4
        cells = image[: 4 * h, : 4 * w].reshape(h, 4, w, 4)[:, :2, :, :2]  # every other cell of the mosaic
        number = metadata["FrameSequence"]
        if number % 7:  # its driver drops some of its own
            told = {"SensorTimestamp": metadata["SensorTimestamp"] + LATE_NS, "FrameSequence": 5000 + number}
            self.copies.put(HeldRequest(np.ascontiguousarray(cells.reshape(2 * h, 2 * w)), told))
        return request


class Second(OneRequest):
    def __init__(self, first: First) -> None:
        self.first = first
        self.width, self.height, self.encoding = first.width // 4 * 2, first.height // 4 * 2, first.encoding

    def capture_request(self) -> CompletedRequest:
        try:
            return self.first.copies.get(timeout=2.0)
        except queue.Empty:
            raise TimeoutError("no frame") from None

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...

    def set_controls(self, controls: object) -> None: ...


def test_two_cameras_are_labelled_recorded_and_paired_by_their_flash(tmp_path: Path) -> None:
    with start_head(WORLD, 8.0, seed=5, speed_mm_s=25.0) as head:
        first = First(RemoteCamera(head.camera_address))
        cameras: list[CameraDriver] = [first, Second(first)]
        config = demo_config(head, WORLD, tmp_path)
        sizes = [replace(config.cameras[0], width=camera.width, height=camera.height) for camera in cameras]
        session = Session(
            replace(config, cameras=tuple(sizes), calibration=None, slots=2 * SLOTS), cameras, name="scan"
        )
        end = time.monotonic() + 60.0
        report = session.run(lambda: session.labelled >= 80 or time.monotonic() > end)
        assert head.counters()["lamps_on"] == []
    assert report.frames["projector"] + report.frames["led"] >= 80
    assert not any(report.telemetry["in_hand"].values())
    recording = open_recording(tmp_path / "scan.mcap")
    assert len(recording.frames) == sum(report.frames.values())
    expected = {Label.PROJECTOR: Light.PROJECTOR, Label.LED: Light.LED}
    known = [frame for frame in recording.frames if frame.label in expected]
    seen: dict[int, dict[int, object]] = {}
    for frame in known:
        image, _ = recording.read_raw(frame)
        assert image.shape == (cameras[frame.camera].height, cameras[frame.camera].width)
        assert measure(image).light is expected[frame.label], frame
        label = recording.label(frame)
        seen.setdefault(frame.index, {})[frame.camera] = label["edge"], label["z_mm"], label["label"]
    both = [one for one in seen.values() if len(one) == 2]
    assert len(both) >= 25 and all(one[0] == one[1] for one in both), "one index, one flash"
    edges = [next(iter(one.values()))[0] for one in seen.values()]  # type: ignore[index]
    assert len(set(edges)) == len(edges), "one flash, one index"
    assert report.drops["camera"] >= 3  # the holes of the second
    offsets = [camera["offset_ns"] for camera in report.telemetry["cameras"]]
    assert offsets[1] - offsets[0] == pytest.approx(LATE_NS, abs=1_000_000)
