"""Cameras behind one door, with Picamera2's method names, so that a real Picamera2 object plugs in unchanged.

    camera = plug(Picamera2())        # or V4L2Camera("/dev/video0"), ScanFolderCamera(path), RemoteCamera(address)
    camera.start()
    while True:
        frame = grab(camera)               # CapturedFrame; TimeoutError when none came, EndOfFrames after the last
    camera.stop()

No camera here has a thread or a queue of its own: what waits, waits in the driver's buffers, and what the driver drops
shows as a hole in `FrameSequence` or in the timestamps.
"""

import csv
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, cast, runtime_checkable

import cv2
import numpy as np

from annulus.numeric.arrays import Image
from annulus.vocabulary import AnnulusError, CameraSequence

BGR8 = "bgr8"  # (H, W, 3), as OpenCV keeps it
BAYER_RGGB8 = "bayer_rggb8"  # (H, W), red at (0, 0)
MONO8 = "mono8"  # (H, W)
ENCODINGS = (BGR8, BAYER_RGGB8, MONO8)

SIDE_MAX = 16384  # pixels; a larger side is a broken header, not a camera


class EndOfFrames(Exception):
    """The file or folder has no frame left. A live camera never raises it."""


@runtime_checkable
class Request(Protocol):
    """One captured frame that still belongs to the camera (Picamera2: CompletedRequest). Release it soon."""

    def make_array(self, name: str) -> Image:
        """The picture of stream `name` ("main"), in the camera's `encoding`. A copy the caller owns."""

    def get_metadata(self) -> dict[str, Any]:
        """At least SensorTimestamp: int, ns on the monotonic clock. FrameSequence: int, where the driver counts."""

    def release(self) -> None:
        """Hand the buffer back."""


@runtime_checkable
class Camera(Protocol):
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

    def capture_request(self) -> Request:
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


def grab(camera: Camera) -> CapturedFrame:
    """The next frame, checked and released. Raises TimeoutError, EndOfFrames, AnnulusError as the camera does."""
    request = camera.capture_request()
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
    )


class HeldRequest:
    """A Request whose picture is already in our memory: nothing to hand back."""

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

    def capture_request(self) -> Request:
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


# ---- Picamera2 ---------------------------------------------------------------------------------------------------


def plug(camera: object) -> Camera:
    """Make a Camera of what the user has: one of ours as it is, a configured Picamera2 object in an adapter."""
    if isinstance(camera, Camera):
        return camera
    if hasattr(camera, "camera_configuration") and hasattr(camera, "capture_request"):
        return PicameraAdapter(camera)
    raise AnnulusError(
        f"camera: {type(camera).__name__} has not Picamera2's methods, expected start .. capture_request"
    )


# Picamera2 names a format by its channels in a little-endian word, hence the swap: its "RGB888" is B, G, R in memory.
_PICAMERA_FORMATS = {"RGB888": None, "BGR888": cv2.COLOR_RGB2BGR, "XRGB8888": cv2.COLOR_BGRA2BGR,
                     "XBGR8888": cv2.COLOR_RGBA2BGR, "YUV420": cv2.COLOR_YUV2BGR_I420}  # fmt: skip


class PicameraAdapter:
    """A real, configured Picamera2 object as our Camera. Nothing of Picamera2 is imported here."""

    def __init__(self, camera: Any) -> None:
        configuration = camera.camera_configuration()
        if not configuration or "main" not in configuration:
            raise AnnulusError('camera: Picamera2 is not configured, expected configure() with a "main" stream first')
        main = configuration["main"]
        name = str(main["format"])
        if name not in _PICAMERA_FORMATS:
            raise AnnulusError(
                f"camera: Picamera2 main format is {name}, expected one of {', '.join(_PICAMERA_FORMATS)}"
            )
        self._camera = camera
        self._conversion = _PICAMERA_FORMATS[name]
        self.width, self.height = (int(side) for side in main["size"])
        self.encoding = BGR8

    def start(self) -> None:
        self._camera.start()

    def stop(self) -> None:
        self._camera.stop()

    def close(self) -> None:
        self._camera.close()

    def capture_request(self) -> Request:
        return _PicameraRequest(self._camera.capture_request(), self)

    def capture_array(self, name: str = "main") -> Image:
        return self.convert(self._camera.capture_array(name))

    def capture_metadata(self) -> dict[str, Any]:
        return cast(dict[str, Any], self._camera.capture_metadata())

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        self._camera.set_controls(dict(controls))

    def convert(self, array: Image) -> Image:
        """Picamera2's array to (H, W, 3) BGR; padding that the stride left on the right is cut off."""
        if self._conversion is not None:
            array = cast(Image, cv2.cvtColor(array, self._conversion))
        return np.ascontiguousarray(array[: self.height, : self.width])


class _PicameraRequest:
    def __init__(self, request: Any, adapter: PicameraAdapter) -> None:
        self._request = request
        self._adapter = adapter

    def make_array(self, name: str) -> Image:
        return self._adapter.convert(self._request.make_array(name))

    def get_metadata(self) -> dict[str, Any]:
        metadata = dict(self._request.get_metadata())
        sequence = self._sequence()
        if sequence is not None:
            metadata.setdefault("FrameSequence", sequence)
        return metadata

    def release(self) -> None:
        self._request.release()

    def _sequence(self) -> int | None:
        """The sensor's frame counter, which libcamera keeps with the buffer and Picamera2 does not pass on."""
        try:
            buffer = next(iter(self._request.request.buffers.values()))
            return int(buffer.metadata.sequence)
        except (AttributeError, StopIteration, TypeError, ValueError):
            return None


# ---- V4L2 --------------------------------------------------------------------------------------------------------


class V4L2Camera(OneRequest):
    """A V4L2 device through OpenCV. Every setting is read back: drivers accept what they then do not do.

    OpenCV passes the buffer's monotonic timestamp on, but not its sequence number: `FrameSequence` is absent, and a
    dropped frame shows in the timestamps only.
    """

    def __init__(
        self,
        device: str | int,
        *,
        width: int = 1664,
        height: int = 1232,
        fps: float = 25.0,
        fourcc: str = "YU12",
        timeout_s: float = 2.0,
        buffers: int = 4,
    ) -> None:
        if not (isinstance(device, int) or Path(device).exists()):
            raise AnnulusError(f"{device}: no such camera. `ls /dev/video*` lists the devices.")
        self._device = device
        self._settings: tuple[tuple[str, int, float], ...] = (
            ("format", cv2.CAP_PROP_FOURCC, float(cv2.VideoWriter.fourcc(*fourcc))),
            ("width", cv2.CAP_PROP_FRAME_WIDTH, float(width)),
            ("height", cv2.CAP_PROP_FRAME_HEIGHT, float(height)),
            ("frame rate", cv2.CAP_PROP_FPS, fps),
        )
        self._timeout_ms = round(timeout_s * 1000)
        self._buffers = buffers
        self._capture: Any = None
        self._oldest_ns = 0
        self.width, self.height, self.encoding = width, height, BGR8

    def start(self) -> None:
        if self._capture is None:
            self._capture = self._open()
        self._oldest_ns = time.monotonic_ns()  # after a pause the driver hands out the frames it had kept: skip those

    def stop(self) -> None:
        self.close()  # cv2 streams from open to release

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def capture_request(self) -> Request:
        for _ in range(self._buffers + 1):
            if self._capture is None:
                raise AnnulusError(f"{self._device}: not started")
            good, image = self._capture.read()
            if not good or image is None:
                raise TimeoutError(f"{self._device}: no frame within {self._timeout_ms} ms")
            timestamp = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            if timestamp >= self._oldest_ns:
                return HeldRequest(image, {"SensorTimestamp": timestamp})
        raise AnnulusError(f"{self._device}: frames carry timestamps from before the start, expected CLOCK_MONOTONIC")

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        for name, value in controls.items():
            for what, prop, wanted in _v4l2_control(name, value):
                self._set(what, prop, wanted)

    def _open(self) -> Any:
        parameters = [cv2.CAP_PROP_READ_TIMEOUT_MSEC, self._timeout_ms]
        self._capture = cv2.VideoCapture(self._device, cv2.CAP_V4L2, parameters)
        if not self._capture.isOpened():
            self.close()
            raise AnnulusError(f"{self._device}: cannot be opened as a V4L2 camera. In use, or no permission?")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, self._buffers)
        try:
            for what, prop, wanted in self._settings:
                self._set(what, prop, wanted)
        except AnnulusError:
            self.close()
            raise
        return self._capture

    def _set(self, what: str, prop: int, wanted: float) -> None:
        if self._capture is None:
            raise AnnulusError(f"{self._device}: start the camera before its {what} is set")
        self._capture.set(prop, wanted)
        got = float(self._capture.get(prop))
        if abs(got - wanted) > 0.01 * abs(wanted):
            if prop == cv2.CAP_PROP_FOURCC:
                raise AnnulusError(f"{self._device}: format is {_letters(got)}, expected {_letters(wanted)}")
            raise AnnulusError(f"{self._device}: {what} is {got:g}, expected {wanted:g}")


def _v4l2_control(name: str, value: Any) -> list[tuple[str, int, float]]:
    match name:
        case "ExposureTime":  # V4L2 counts in 100 us
            return [("exposure (100 us)", cv2.CAP_PROP_EXPOSURE, float(round(value / 100)))]
        case "AnalogueGain":
            return [("gain", cv2.CAP_PROP_GAIN, float(value))]
        case "AeEnable":  # V4L2_EXPOSURE_APERTURE_PRIORITY = 3, _MANUAL = 1
            return [("automatic exposure", cv2.CAP_PROP_AUTO_EXPOSURE, 3.0 if value else 1.0)]
        case "FrameDurationLimits":
            return [("frame rate", cv2.CAP_PROP_FPS, 1e6 / float(value[1]))]
    raise AnnulusError(
        f"camera: control {name} is not known, expected ExposureTime, AnalogueGain, AeEnable or FrameDurationLimits"
    )


def _letters(fourcc: float) -> str:
    return int(fourcc).to_bytes(4, "little").decode("ascii", "replace")


# ---- files -------------------------------------------------------------------------------------------------------


class VideoFileCamera(OneRequest):
    """A video file as a camera, as fast as it is asked. Timestamps: the file's, from the moment of `start` on."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._capture: Any = None
        self._start_ns = 0
        self._next = 0
        probe = self._open()
        self.width = int(probe.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(probe.get(cv2.CAP_PROP_FRAME_HEIGHT))
        fps = float(probe.get(cv2.CAP_PROP_FPS))
        self._period_ns = round(1e9 / fps) if 0.1 <= fps <= 10_000 else 40_000_000
        self.encoding = BGR8
        probe.release()
        if not (0 < self.width <= SIDE_MAX and 0 < self.height <= SIDE_MAX):
            raise AnnulusError(f"{path}: frames of {self.width}x{self.height}, expected a video file")

    def start(self) -> None:
        if self._capture is None:
            self._capture = self._open()
            self._start_ns = time.monotonic_ns()
            self._next = 0

    def stop(self) -> None:
        self.close()

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def capture_request(self) -> Request:
        if self._capture is None:
            raise AnnulusError(f"{self._path}: not started")
        good, image = self._capture.read()
        if not good:
            raise EndOfFrames
        index, self._next = self._next, self._next + 1
        return HeldRequest(image, {"SensorTimestamp": self._start_ns + index * self._period_ns, "FrameSequence": index})

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        pass  # a file has been exposed already

    def _open(self) -> Any:
        if not self._path.is_file():
            raise AnnulusError(f"{self._path}: no such video file")
        capture = cv2.VideoCapture(str(self._path))
        if not capture.isOpened():
            raise AnnulusError(f"{self._path}: cannot be read as a video")
        return capture


class ScanFolderCamera(OneRequest):
    """The images a scan folder's frames.csv lists, in its order, as a camera. Metadata adds its Light and ZMm."""

    def __init__(self, folder: Path, *, fps: float = 25.0) -> None:
        self._folder = folder
        self._rows = _scan_rows(folder / "frames.csv")
        self._period_ns = round(1e9 / fps)
        self._start_ns = 0
        self._next = 0
        first = self._read(self._rows[0][0])
        self.height, self.width = first.shape[:2]
        self.encoding = BGR8

    def start(self) -> None:
        self._start_ns = time.monotonic_ns()
        self._next = 0

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    def capture_request(self) -> Request:
        if self._next >= len(self._rows):
            raise EndOfFrames
        index, self._next = self._next, self._next + 1
        name, light, z_mm = self._rows[index]
        stamp = self._start_ns + index * self._period_ns
        metadata = {"SensorTimestamp": stamp, "FrameSequence": index, "Light": light, "ZMm": z_mm}
        return HeldRequest(self._read(name), metadata)

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        pass

    def _read(self, name: str) -> Image:
        path = self._folder / name
        image = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
        if image is None:
            raise AnnulusError(f"{path}: not a readable image, though frames.csv lists it")
        return cast(Image, image)


def _scan_rows(path: Path) -> list[tuple[str, str, float]]:
    if not path.is_file():
        raise AnnulusError(f"{path}: not there, expected a scan folder with index,file,light,z_mm")
    rows = []
    with path.open(newline="", encoding="utf-8") as file:
        for number, row in enumerate(csv.DictReader(file), start=2):
            try:
                rows.append((str(row["file"]), str(row["light"]), float(row["z_mm"])))
            except (KeyError, TypeError, ValueError):
                raise AnnulusError(f"{path}:{number}: expected index,file,light,z_mm, got {dict(row)}") from None
    if not rows:
        raise AnnulusError(f"{path}: lists no frame")
    return rows
