"""Every camera comes through one door, and what it says is checked."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from annulus.capture.camera import (
    BGR8,
    Camera,
    HeldRequest,
    OneRequest,
    PicameraAdapter,
    grab,
    plug,
)
from annulus.vocabulary import AnnulusError


class StubPicamera2:
    """The methods and shapes of the real one (which imports only on a Pi): configured, "main" padded to its stride."""

    def __init__(self, name: str = "RGB888", *, sequence: int | None = 41) -> None:
        self.name, self.sequence, self.released, self.controls = name, sequence, 0, {}

    def camera_configuration(self) -> dict[str, Any]:
        return {"main": {"size": (6, 4), "format": self.name}}

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...

    def set_controls(self, controls: dict[str, Any]) -> None:
        self.controls |= controls

    def capture_request(self) -> Any:
        channels = 4 if self.name.startswith("X") else 3
        array = np.zeros((4, 6, channels), np.uint8)
        array[..., 0] = 200  # the first byte in memory
        buffers = {} if self.sequence is None else {"s": SimpleNamespace(metadata=SimpleNamespace(sequence=41))}

        def release() -> None:
            self.released += 1

        return SimpleNamespace(
            make_array=lambda name: array,
            get_metadata=lambda: {"SensorTimestamp": 123, "ExposureTime": 38000},
            release=release,
            request=SimpleNamespace(buffers=buffers),
        )


@pytest.mark.parametrize(("name", "channel"), [("RGB888", 0), ("BGR888", 2), ("XRGB8888", 0), ("XBGR8888", 2)])
def test_a_picamera2_object_plugs_in_unchanged_and_its_colours_are_right(name: str, channel: int) -> None:
    theirs = StubPicamera2(name)
    camera = plug(theirs)
    assert isinstance(camera, PicameraAdapter) and isinstance(camera, Camera)
    frame = grab(camera)
    assert frame.image.shape == (4, 6, 3) and frame.image[0, 0, channel] == 200
    assert (frame.timestamp_ns, frame.sequence, frame.encoding) == (123, 41, BGR8)
    camera.set_controls({"ExposureTime": 38000})
    assert theirs.released == 1 and theirs.controls == {"ExposureTime": 38000}


def test_a_picamera2_without_a_driver_count_has_none_rather_than_a_made_up_one() -> None:
    assert grab(plug(StubPicamera2(sequence=None))).sequence is None


def test_what_cannot_be_used_is_refused_in_one_line() -> None:
    with pytest.raises(AnnulusError, match="main format is SBGGR10"):
        plug(StubPicamera2("SBGGR10"))
    with pytest.raises(AnnulusError, match="has not Picamera2's methods"):
        plug(object())


class Lying(OneRequest):
    metadata: dict[str, Any]
    image: Any

    def __init__(self) -> None:
        self.width, self.height, self.encoding = 6, 4, BGR8

    def capture_request(self) -> HeldRequest:
        return HeldRequest(self.image, self.metadata)


def test_a_frame_of_another_size_or_without_a_timestamp_is_not_let_in() -> None:
    camera = Lying()
    camera.image, camera.metadata = np.zeros((4, 7, 3), np.uint8), {"SensorTimestamp": 1}
    with pytest.raises(AnnulusError, match="4x7x3 came, expected uint8 4x6x3"):
        grab(camera)
    camera.image, camera.metadata = np.zeros((4, 6, 3), np.uint8), {}
    with pytest.raises(AnnulusError, match="SensorTimestamp None"):
        grab(camera)
