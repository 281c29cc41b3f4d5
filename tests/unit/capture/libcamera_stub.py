"""libcamera's Python face as far as Picamera2 uses it, with a sensor that exposes a frame when it is told to.

What a Pi's kernel and ISP would do is left out; queues, requests, buffers with padded rows, controls and the sensor's
modes are there, so that Picamera2's own code runs between them and us.
"""

import contextlib
import enum
import importlib.util
import os
import sys
import time
import types
from collections import deque
from typing import Any

import numpy as np


class Value:
    """A small value that compares and hashes by its fields."""

    def __init__(self, *values: Any, **named: Any) -> None:
        self.values = (*values, *sorted((name, value) for name, value in named.items() if value))

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.values == other.values  # type: ignore[attr-defined]

    def __hash__(self) -> int:
        return hash((type(self).__name__, self.values))

    def __str__(self) -> str:
        return str(self.values)


class Transform(Value):
    def __init__(self, other: Any = None, hflip: int = 0, vflip: int = 0, transpose: int = 0) -> None:
        if other is not None:
            hflip, vflip, transpose = other.hflip, other.vflip, other.transpose
        super().__init__(hflip, vflip, transpose)
        self.hflip, self.vflip, self.transpose = hflip, vflip, transpose


class ColorSpace(Value):
    class YcbcrEncoding(enum.Enum):
        Null = 0

    class Range(enum.Enum):
        Full = 0

    def __init__(self, kind: Any) -> None:
        kind = kind.primaries if isinstance(kind, ColorSpace) else kind
        super().__init__(kind)
        self.primaries = self.transferFunction = kind
        self.ycbcrEncoding: Any = None
        self.range: Any = None

    Sycc = classmethod(lambda cls: cls("sycc"))
    Smpte170m = classmethod(lambda cls: cls("smpte170m"))
    Rec709 = classmethod(lambda cls: cls("rec709"))
    Raw = classmethod(lambda cls: cls("raw"))


class Size:
    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


class Rectangle:
    def __init__(self, x: int, y: int, width: int, height: int) -> None:
        self.x, self.y, self.width, self.height = x, y, width, height

    def __str__(self) -> str:
        return f"({self.x}, {self.y})/{self.width}x{self.height}"


class PixelFormat(Value):
    def __str__(self) -> str:
        return str(self.values[0])


class Orientation(enum.Enum):
    Rotate0, Rotate0Mirror, Rotate180, Rotate180Mirror = range(4)
    Rotate90, Rotate90Mirror, Rotate270, Rotate270Mirror = range(4, 8)


class ControlType(enum.Enum):
    Integer, Rectangle, Size = range(3)


class StreamRole(enum.Enum):
    Viewfinder, Raw, StillCapture, VideoRecording = range(4)


class Id:
    """Of a control or property."""

    def __init__(self, name: str) -> None:
        self.name, self.type, self.id = name, ControlType.Integer, name


class SensorConfiguration:
    bit_depth = 0
    output_size: Any = None


class Plane:
    fd, offset, length = -1, 0, 0


class FrameMetadata:
    class Status(enum.Enum):
        Success, Error = range(2)


class FrameBuffer:
    Plane = Plane

    def __init__(self, planes: list[Plane]) -> None:
        self.planes = planes
        self.metadata = types.SimpleNamespace(
            status=FrameMetadata.Status.Success,
            sequence=0,
            planes=[types.SimpleNamespace(bytes_used=plane.length) for plane in planes],
        )


class Stream:
    configuration: Any = None


class StreamConfiguration:
    def __init__(self, formats: Any) -> None:
        self.stream, self.formats = Stream(), formats
        self.size, self.pixel_format, self.buffer_count, self.stride = Size(0, 0), PixelFormat("XBGR8888"), 4, 0
        self.color_space: Any = None
        self.frame_size = 0


class CameraConfiguration:
    class Status(enum.Enum):
        Valid, Adjusted, Invalid = range(3)

    def __init__(self, streams: list[StreamConfiguration]) -> None:
        self.streams = streams
        self.orientation = Orientation.Rotate0
        self.sensor_config: Any = None

    def __iter__(self) -> Any:
        return iter(self.streams)

    def at(self, index: int) -> StreamConfiguration:
        return self.streams[index]

    def validate(self) -> Any:
        """Rows are padded to 64 bytes and one block more, as an ISP's are."""
        for stream in self.streams:
            name = str(stream.pixel_format)
            width = stream.size.width
            used = {"RGB888": 3 * width, "BGR888": 3 * width, "XBGR8888": 4 * width, "XRGB8888": 4 * width}.get(name)
            if used is None:
                bits = int("".join(c for c in name.split("_")[0] if c.isdigit()))
                used = width * bits // 8 if "CSI2P" in name else width * (2 if bits > 8 else 1)
            stream.stride = -(-used // 64) * 64 + 64
            stream.frame_size = stream.stride * stream.size.height
        return self.Status.Adjusted


class Request:
    class Status(enum.Enum):
        Pending, Complete, Cancelled = range(3)

    def __init__(self, cookie: int) -> None:
        self.cookie, self.status = cookie, self.Status.Pending
        self.buffers: dict[Any, FrameBuffer] = {}
        self.metadata: dict[Id, Any] = {}

    def add_buffer(self, stream: Any, buffer: FrameBuffer) -> None:
        self.buffers[stream] = buffer

    def set_control(self, control: Id, value: Any) -> None:
        Sensor.the.told[control.name] = value

    def reuse(self) -> None:
        self.status = self.Status.Pending


class Limits:
    """Of a control."""

    def __init__(self, least: Any, most: Any, default: Any) -> None:
        self.min, self.max, self.default = least, most, default


CONTROLS = (
    "AeEnable",
    "FrameDurationLimits",
    "ExposureTime",
    "AnalogueGain",
    "AwbEnable",
    "ColourGains",
    "NoiseReductionMode",
    "Sharpness",
    "Contrast",
    "Saturation",
    "Brightness",
)
IDS = {
    name: Id(name) for name in (*CONTROLS, "FrameDuration", "SensorTimestamp", "ExposureTimeMode", "AnalogueGainMode")
}


class Sensor:
    """The one camera there is. `expose` makes frames of the requests that are queued; too few, and frames are lost."""

    the: "Sensor"

    def __init__(self, modes: list[tuple[str, tuple[int, int]]]) -> None:
        Sensor.the = self
        self.id, self.modes = "/base/imx219", modes
        self.controls = {
            **{IDS[name]: Limits(100, 1_000_000, 100) for name in CONTROLS},
            Id("ScalerCrop"): Limits(*[Rectangle(0, 0, 3280, 2464)] * 3),
        }
        self.properties = {Id("ColorFilterArrangement"): 0, Id("Model"): "imx219"}
        self.fields: dict[tuple[int, int], tuple[int, int, int, int]] = {}  # what a mode shows of it, if not all
        self.told: dict[str, Any] = {}
        self.does: dict[str, Any] = {}  # what it does otherwise than it was told
        self.queued: deque[Request] = deque()
        self.ready: list[Request] = []
        self.sequence = 0
        self.configuration: Any = None
        self.event_fd, self.event_w = os.pipe()
        self.cameras = [self]
        self.clock = time.CLOCK_MONOTONIC
        self.value = 0

    # ---- CameraManager ----

    def get_ready_requests(self) -> list[Request]:
        os.set_blocking(self.event_fd, False)
        with contextlib.suppress(BlockingIOError):
            os.read(self.event_fd, 4096)
        ready, self.ready = self.ready, []
        return ready

    # ---- Camera ----

    def acquire(self) -> None: ...

    def release(self) -> None: ...

    def generate_configuration(self, roles: list[StreamRole]) -> CameraConfiguration:
        sizes: dict[str, list[Size]] = {}
        for name, size in self.modes:
            sizes.setdefault(name, []).append(Size(*size))
        formats = types.SimpleNamespace(
            pixel_formats=[PixelFormat(name) for name in sizes], sizes=lambda pixel: sizes[str(pixel)]
        )
        return CameraConfiguration([StreamConfiguration(formats) for _ in roles])

    def configure(self, configuration: CameraConfiguration) -> int:
        self.configuration = configuration
        size = next((c.size for c in configuration if str(c.pixel_format).startswith("S")), None)
        field = self.fields.get((size.width, size.height)) if size is not None else None
        shown = Rectangle(*(field or (0, 0, 3280, 2464)))
        self.controls[next(one for one in self.controls if one.name == "ScalerCrop")] = Limits(*[shown] * 3)
        return 0

    def create_request(self, cookie: int) -> Request:
        return Request(cookie)

    def start(self, controls: dict[Id, Any]) -> None:
        self.told |= {control.name: value for control, value in controls.items()}
        self.sequence = 0

    def queue_request(self, request: Request) -> None:
        self.queued.append(request)

    def stop(self) -> None:
        self.queued.clear()

    # ---- the world ----

    def expose(self, frames: int = 1) -> None:
        for _ in range(frames):
            self.sequence += 1
            if not self.queued:
                continue  # the driver has no buffer: lost
            request = self.queued.popleft()
            told = {**self.told, **self.does}
            stamp = time.clock_gettime_ns(self.clock)
            request.metadata = {IDS["SensorTimestamp"]: stamp}
            for name in ("ExposureTime", "AnalogueGain", "ColourGains"):
                if name in told:
                    request.metadata[IDS[name]] = told[name]
            if "FrameDurationLimits" in told:
                request.metadata[IDS["FrameDuration"]] = told["FrameDurationLimits"][0]
            for buffer in request.buffers.values():
                buffer.metadata.sequence = self.sequence
            self.paint(request)
            request.status = Request.Status.Complete
            self.ready.append(request)
            os.write(self.event_w, b"\0")

    def paint(self, request: Request) -> None:
        """Every pixel of a raw buffer has its colour's value; padding is 0xEE."""
        colours = {"R": 200, "G": 120, "B": 40}
        for config in self.configuration:
            name, (width, height) = str(config.pixel_format), (config.size.width, config.size.height)
            rows = np.full((height, config.stride), 0xEE, np.uint8)
            pixels, _, packing = name.partition("_")
            if pixels.startswith("S"):
                order, bits = pixels[1:5], int(pixels[5:])
                tile = np.array([colours[c] for c in order], np.uint16).reshape(2, 2)
                mosaic = np.tile(tile, (height // 2, width // 2))
                if packing == "CSI2P":
                    group, kept = (5, 4) if bits == 10 else (3, 2)
                    packed = np.zeros((height, width // kept, group), np.uint8)
                    packed[:, :, :kept] = mosaic.reshape(height, -1, kept)
                    packed[:, :, kept] = 0x5A  # lower bits, which nobody is to see
                    rows[:, : width // kept * group] = packed.reshape(height, -1)
                elif bits > 8:
                    words = (mosaic << (bits - 8)) | 1
                    rows[:, : 2 * width] = words.astype("<u2").view(np.uint8).reshape(height, -1)
                else:
                    rows[:, :width] = mosaic
            else:
                rows[:, : 3 * width] = np.tile(np.array([40, 120, 200], np.uint8), (height, width))
            os.pwrite(request.buffers[config.stream].planes[0].fd, rows.tobytes(), 0)


def install(modes: list[tuple[str, tuple[int, int]]]) -> Sensor:
    """As `libcamera`, with empty stand-ins for what Picamera2 imports and this use never calls."""
    sensor = Sensor(modes)
    module = types.ModuleType("libcamera")
    for thing in (
        Transform,
        ColorSpace,
        Size,
        Rectangle,
        PixelFormat,
        Orientation,
        ControlType,
        StreamRole,
        SensorConfiguration,
        FrameMetadata,
        FrameBuffer,
        CameraConfiguration,
        Request,
    ):
        setattr(module, thing.__name__, thing)
    noise = types.SimpleNamespace(Off=0, Fast=1, HighQuality=2, Minimal=3)
    module.controls = types.SimpleNamespace(**IDS, draft=types.SimpleNamespace(NoiseReductionModeEnum=noise))  # type: ignore[attr-defined]
    arrangement = types.SimpleNamespace(MONO=4)
    module.properties = types.SimpleNamespace(draft=types.SimpleNamespace(ColorFilterArrangementEnum=arrangement))  # type: ignore[attr-defined]
    module.CameraManager = types.SimpleNamespace(singleton=lambda: Sensor.the)  # type: ignore[attr-defined]
    module.Camera = Sensor  # type: ignore[attr-defined]
    module._libcamera = module  # type: ignore[attr-defined]
    sys.modules["libcamera"] = module
    names = ("piexif", "simplejpeg", "pidng", "pidng.camdefs", "pidng.core", "av", "prctl", "pykms", "videodev2")
    for name in [
        name for name in names if name not in sys.modules and not importlib.util.find_spec(name.split(".")[0])
    ]:
        sys.modules[name] = StandIn(name)
    return sensor


class StandIn(types.ModuleType):
    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.__path__ = []

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Anything


class _AnyAttribute(type):
    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return cls


class _Anything(metaclass=_AnyAttribute):
    def __init__(self, *args: object, **named: object) -> None: ...

    def __class_getitem__(cls, item: object) -> type:
        return cls


class MemoryAllocator:
    """Buffers in memory files, where Picamera2's own wants a Pi's dma heap."""

    needs_sync = False

    def __init__(self) -> None:
        from picamera2.allocators.allocator import Sync

        self.sync = Sync
        self._buffers: dict[Any, list[FrameBuffer]] = {}

    def allocate(self, configuration: CameraConfiguration, use_case: object) -> None:
        self.close()
        for stream in configuration:
            self._buffers[stream.stream] = [self._buffer(stream.frame_size) for _ in range(stream.buffer_count)]

    @staticmethod
    def _buffer(size: int) -> FrameBuffer:
        plane = Plane()
        plane.fd, plane.length = os.memfd_create("frame"), size
        os.ftruncate(plane.fd, size)
        return FrameBuffer([plane])

    def buffers(self, stream: Any) -> list[FrameBuffer]:
        return self._buffers[stream]

    def acquire(self, buffers: object) -> None: ...

    def release(self, buffers: object) -> None: ...

    def close(self) -> None:
        for buffers in self._buffers.values():
            for buffer in buffers:
                os.close(buffer.planes[0].fd)
        self._buffers = {}
