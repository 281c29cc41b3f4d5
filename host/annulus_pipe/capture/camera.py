"""Cameras behind one door, with Picamera2's method names, so that a real Picamera2 object plugs in unchanged.

    camera = plug(Picamera2())             # capture.picamera; or V4L2Camera("/dev/video0"), RemoteCamera(address), ..
    camera.start()
    while True:
        frame = grab(camera)               # CapturedFrame; TimeoutError when none came, EndOfFrames after the last
    camera.stop()

No camera here has a thread or a queue of its own: what waits, waits in the driver's buffers, and what the driver drops
shows as a hole in `FrameSequence` or in the timestamps.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.vocabulary import AnnulusError, CameraSequence

BGR8 = "bgr8"  # (H, W, 3), as OpenCV keeps it
MONO8 = "mono8"  # (H, W)
MOSAICS = {order: f"bayer_{order.lower()}8" for order in ("RGGB", "BGGR", "GRBG", "GBRG")}
"""By the colours of the first two rows; (H, W)."""
BAYER_RGGB8 = MOSAICS["RGGB"]
ENCODINGS = (BGR8, *MOSAICS.values(), MONO8)

SIDE_MAX = 16384  # pixels; a larger side is a broken header, not a camera


class EndOfFrames(Exception):
    """The file or folder has no frame left. A live camera never raises it."""


class NoSuchControl(AnnulusError):
    """The device cannot be set to this."""


@runtime_checkable
class CompletedRequest(Protocol):
    """One captured frame that still belongs to the camera (Picamera2: CompletedRequest). Release it soon."""

    def make_array(self, name: str) -> Image:
        """The picture of stream `name` ("main"), in the camera's `encoding`. A copy the caller owns."""

    def get_metadata(self) -> dict[str, Any]:
        """At least SensorTimestamp: int, ns on the monotonic clock. FrameSequence: int, where the driver counts.
        ArrivalTimestamp: when we had it, where `capture_request` does more than wait for it.
        """

    def release(self) -> None:
        """Hand the buffer back."""


@runtime_checkable
class CameraDriver(Protocol):
    """What the rest of annulus asks of a camera. The methods are Picamera2's; the three attributes are ours."""

    width: int
    height: int
    encoding: str  # one of ENCODINGS

    def start(self) -> None:
        """Begin to stream. Frames from before the call are not delivered."""

    def stop(self) -> None:
        """Stop streaming; `start` may follow."""

    def close(self) -> None:
        """Give the device back. Safe to call twice."""

    def capture_request(self) -> CompletedRequest:
        """Wait for the next frame. TimeoutError when none came in time, EndOfFrames after the last of a file."""

    def capture_array(self, name: str = "main") -> Image:
        """The next frame's picture."""

    def capture_metadata(self) -> dict[str, Any]:
        """The next frame's metadata. That frame's picture is gone; use `capture_request` to have both."""

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """Picamera2's names: ExposureTime (us), AnalogueGain, FrameDurationLimits (us, us), AeEnable."""


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """A frame that no longer depends on the camera."""

    image: Image  # (H, W, 3) or (H, W), see `encoding`
    encoding: str
    timestamp_ns: (
        int  # SensorTimestamp; which moment of the exposure it marks differs by driver (pairing calibrates it)
    )
    sequence: CameraSequence | None  # None where the driver does not count
    metadata: Mapping[str, Any]
    arrived_ns: int  # when we had it, before anything was done with it; host monotonic


def grab(camera: CameraDriver) -> CapturedFrame:
    """The next frame, checked and released. Raises TimeoutError, EndOfFrames, AnnulusError as the camera does."""
    request = camera.capture_request()
    arrived_ns = time.monotonic_ns()
    try:
        image = request.make_array("main")
        metadata = request.get_metadata()
    finally:
        request.release()
    shape = (camera.height, camera.width, 3) if camera.encoding == BGR8 else (camera.height, camera.width)
    if image.dtype != np.uint8 or image.shape != shape:
        raise AnnulusError(
            f"camera: a frame of {image.dtype} {'x'.join(map(str, image.shape))} came, expected uint8"
            f" {'x'.join(map(str, shape))} ({camera.encoding})"
        )
    timestamp = metadata.get("SensorTimestamp")
    if not isinstance(timestamp, int):
        raise AnnulusError(
            f"camera: frame metadata has SensorTimestamp {timestamp!r}, expected nanoseconds; no frame can be labelled"
        )
    sequence = metadata.get("FrameSequence")
    return CapturedFrame(
        image,
        camera.encoding,
        timestamp,
        CameraSequence(sequence) if isinstance(sequence, int) else None,
        MappingProxyType(metadata),
        metadata.get("ArrivalTimestamp", arrived_ns),
    )


class HeldRequest:
    """A CompletedRequest whose picture is already in our memory: nothing to hand back."""

    def __init__(self, image: Image, metadata: dict[str, Any]) -> None:
        self._image = image
        self._metadata = metadata

    def make_array(self, name: str = "main") -> Image:
        return self._image

    def get_metadata(self) -> dict[str, Any]:
        return self._metadata

    def release(self) -> None:
        pass


class OneRequest:
    """`capture_array` and `capture_metadata` of a camera that has `capture_request`."""

    def capture_request(self) -> CompletedRequest:
        raise NotImplementedError

    def capture_array(self, name: str = "main") -> Image:
        request = self.capture_request()
        try:
            return request.make_array(name)
        finally:
            request.release()

    def capture_metadata(self) -> dict[str, Any]:
        request = self.capture_request()
        try:
            return request.get_metadata()
        finally:
            request.release()
