"""A Raspberry Pi's camera through Picamera2, as its sources say it must be treated.

Picamera2 keeps one finished request for whoever asks, and gives the others back: a host held up for two frames loses
one without a word. So requests are taken where all of them pass, in `pre_callback`, and held here. Asking it waits for
ever when the sensor falls silent; waiting is done here too, and a stop that its event loop does not answer is given up.

The sensor's own mosaic is taken, whichever colour it begins with, not the ISP's picture: 2 MB a frame instead of 6, and
nothing that mixes a frame with the one before it (a Pi 5's noise reduction does, and the one before it was lit by the
other lamp).

Nothing of Picamera2 is imported here.
"""

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import cv2
import numpy as np

from annulus_pipe.capture.camera import BGR8, MOSAICS, CameraDriver, CompletedRequest, OneRequest
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.vocabulary import AnnulusError

BUFFERS = 8  # of the driver; it fills one, has one ready
HELD_MAX = 4  # requests waiting here; the oldest makes way, and shows as a hole in the driver's count
SILENT_S = 2.0
STOP_S = 2.0
CLOCKS_APART_NS = 10_000_000  # with the clocks closer together than this no suspend lies between them
STAMP_AGE_NS = 5_000_000_000  # no frame is handed over later than this after it was exposed
SETTLE_FRAMES = 12  # controls are in force by then; libcamera needs up to 5 frames, in practice
TOLERANCES = {"ExposureTime": 0.01, "FrameDuration": 0.005, "AnalogueGain": 0.05, "ColourGains": 0.02}  # relative
READ_OF = {"FrameDurationLimits": "FrameDuration"}  # a control that reads back under another name
EXPOSURE_STEP_US = 60.0  # exposures are whole lines of the sensor

# Picamera2 names a format by its channels in a little-endian word, hence the swap: its "RGB888" is B, G, R in memory.
_PICTURES = {
    "RGB888": None,
    "BGR888": cv2.COLOR_RGB2BGR,
    "XRGB8888": cv2.COLOR_BGRA2BGR,
    "XBGR8888": cv2.COLOR_RGBA2BGR,
    "YUV420": cv2.COLOR_YUV2BGR_I420,
}


@dataclass(frozen=True, slots=True)
class RawFormat:
    """A raw format of libcamera: `SRGGB10`, `SBGGR12_CSI2P`. Raises AnnulusError for what is not read."""

    order: str  # the first two rows' colours
    bits: int
    packed: bool  # CSI-2: four pixels' upper bytes, then their lower bits in one

    @classmethod
    def named(cls, name: str) -> "RawFormat":
        pixels, _, packing = name.partition("_")
        order, bits = pixels[1:5], pixels[5:]
        if pixels[:1] != "S" or order not in MOSAICS or bits not in ("8", "10", "12", "14", "16"):
            raise AnnulusError(f"camera: raw format {name}, expected SRGGB8 to SBGGR16, unpacked or _CSI2P")
        if packing not in ("", "CSI2P") or (packing and bits not in ("10", "12")):
            raise AnnulusError(f"camera: raw format {name} is packed in a way that is not read, expected {pixels}")
        return cls(order, int(bits), bool(packing))

    @property
    def encoding(self) -> str:
        return MOSAICS[self.order]

    def picture(self, rows: Image, width: int, height: int) -> Image:
        """(H, stride) bytes to (H, W), 8 bits a pixel. The lowest bits are dropped."""
        if self.packed:
            group, kept = (5, 4) if self.bits == 10 else (3, 2)
            used = rows[:height, : width // kept * group].reshape(height, -1, group)
            return np.ascontiguousarray(used[:, :, :kept]).reshape(height, width)
        if self.bits > 8:
            words = np.ascontiguousarray(rows[:height, : 2 * width]).view("<u2")
            return (words >> (self.bits - 8)).astype(np.uint8)
        return np.ascontiguousarray(rows[:height, :width])


class PicameraCamera(OneRequest):
    """A real, configured Picamera2 object as our CameraDriver: its raw stream where one is configured, else "main"."""

    def __init__(self, camera: Any, expected: Mapping[str, Any] | None = None) -> None:
        """expected : controls that must be in force SETTLE_FRAMES after the start, by what the metadata say."""
        self.timeout_s = SILENT_S
        configuration = camera.camera_configuration()
        if not configuration or "main" not in configuration:
            raise AnnulusError('camera: Picamera2 is not configured, expected configure() with a "main" stream first')
        self._stream = "raw" if configuration.get("raw") else "main"
        stream = configuration[self._stream]
        name = str(stream["format"])
        self._mosaic = RawFormat.named(name) if self._stream == "raw" else None
        if self._mosaic is None and name not in _PICTURES:
            raise AnnulusError(f"camera: Picamera2 main format is {name}, expected one of {', '.join(_PICTURES)}")
        self._conversion = _PICTURES.get(name)
        self.width, self.height = (int(side) for side in stream["size"])
        self.encoding = self._mosaic.encoding if self._mosaic else BGR8
        self.dropped = 0  # frames that made way here
        self.sensor_crop = _shown_of_the_sensor(camera)
        self._camera, self._expected = camera, dict(expected or {})
        self._frames_seen = 0
        self._held: deque[Any] = deque()
        self._came = threading.Condition()
        self._running = False

    # ---- CameraDriver ----

    def start(self) -> None:
        self._frames_seen, self._running = 0, True
        self._camera.pre_callback = self._take
        self._camera.start()

    def stop(self) -> None:
        """Also when Picamera2's event loop answers no more: what it was asked for is cancelled first."""
        self._running = False
        self._camera.pre_callback = None
        self._let_go()
        self._camera.cancel_all_and_flush()
        try:
            self._camera.dispatch_functions([self._camera.stop_], wait=STOP_S, immediate=True)
        except TimeoutError:
            self._camera.cancel_all_and_flush()
            self._camera.stop_()
        self._let_go()

    def close(self) -> None:
        if self._running:
            self.stop()
        self._camera.close()

    def capture_request(self) -> CompletedRequest:
        """TimeoutError when none came for `timeout_s`; AnnulusError when the sensor does not do what it was told."""
        with self._came:
            if not self._came.wait_for(lambda: bool(self._held), self.timeout_s):
                raise TimeoutError(f"no frame of Picamera2 for {self.timeout_s:g} s")
            request = self._held.popleft()
        self._frames_seen += 1
        taken = _Taken(request, self)
        if self._frames_seen == SETTLE_FRAMES:
            try:
                require_controls(self._expected, request.get_metadata())
            except AnnulusError:
                taken.release()
                raise
        return taken

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        self._camera.set_controls(dict(controls))
        self._expected |= controls

    # ---- requests ----

    def _take(self, request: Any) -> None:
        """In Picamera2's event loop, once for every frame."""
        if not self._running:
            return
        request.acquire()
        old = None
        with self._came:
            self._held.append(request)
            if len(self._held) > HELD_MAX:
                old = self._held.popleft()
                self.dropped += 1
            self._came.notify()
        if old is not None:
            old.release()

    def _let_go(self) -> None:
        with self._came:
            held = list(self._held)
            self._held.clear()
        for request in held:
            request.release()

    def picture(self, request: Any) -> Image:
        """A copy, in `encoding`; padding on the right is cut off."""
        array = request.make_array(self._stream)
        if self._mosaic is not None:
            return self._mosaic.picture(array.view(np.uint8).reshape(array.shape[0], -1), self.width, self.height)
        if self._conversion is not None:
            array = cast(Image, cv2.cvtColor(array, self._conversion))
        return np.ascontiguousarray(array[: self.height, : self.width])

    def sequence(self, request: Any) -> int | None:
        """The sensor's frame count, which libcamera keeps with the buffer and Picamera2 does not pass on."""
        try:
            stream = self._camera.stream_map[self._stream]
            return int(request.request.buffers[stream].metadata.sequence)
        except (AttributeError, KeyError, TypeError, ValueError):
            return None


class _Taken:
    def __init__(self, request: Any, camera: PicameraCamera) -> None:
        self._request, self._camera = request, camera

    def make_array(self, name: str) -> Image:
        return self._camera.picture(self._request)

    def get_metadata(self) -> dict[str, Any]:
        metadata = dict(self._request.get_metadata())
        stamp, sequence = metadata.get("SensorTimestamp"), self._camera.sequence(self._request)
        if isinstance(stamp, int):
            metadata["SensorTimestamp"] = on_monotonic(stamp)
        if sequence is not None:
            metadata["FrameSequence"] = sequence
        return metadata

    def release(self) -> None:
        self._request.release()


def plug(camera: object) -> CameraDriver:
    """Make a CameraDriver of what the user has: one of ours as it is, a configured Picamera2 object in an adapter."""
    if isinstance(camera, CameraDriver):
        return camera
    if hasattr(camera, "camera_configuration") and hasattr(camera, "capture_request"):
        return PicameraCamera(camera)
    raise AnnulusError(
        f"camera: {type(camera).__name__} has not Picamera2's methods, expected start .. capture_request"
    )


def configure(
    camera: Any,
    size: tuple[int, int],
    *,
    stream: str,
    fps: float,
    exposure_us: float,
    gain: float,
    colour_gains: tuple[float, float] | None,
    sensor_crop: tuple[int, int, int, int] | None = None,
) -> PicameraCamera:
    """Settings of a Picamera2 object for this use: nothing automatic, the sensor mode pinned, all of it in force from
    the first frame on and read back.

    stream : "raw" for the sensor's mosaic, or a format of the ISP's picture ("RGB888"). colour_gains : of red and blue,
    for the ISP's picture. sensor_crop : what the mode must show of the sensor. Raises AnnulusError when no mode of the
    sensor has that size, or the one that has shows something else.
    """
    period_us = round(1e6 / fps)
    known, bayer = camera.camera_controls, stream == "raw"
    controls: dict[str, Any] = {
        "AeEnable": False,
        "FrameDurationLimits": (period_us, period_us),
        "ExposureTime": round(exposure_us),
        "AnalogueGain": gain,
        "AwbEnable": False,
        "ColourGains": colour_gains,
        "NoiseReductionMode": 0,
        "Sharpness": 0.0,
        "Contrast": 1.0,
        "Saturation": 1.0,
        "Brightness": 0.0,
    }
    controls = {name: value for name, value in controls.items() if name in known and value is not None}
    if bayer:
        mode = _mode_of(camera, size)
        small = (size[0] // 4 // 2 * 2, size[1] // 4 // 2 * 2)  # of what the ISP must make and nobody looks at
        asked = camera.create_video_configuration(
            main={"size": small},
            raw={"size": size, "format": mode},
            buffer_count=BUFFERS,
            controls=controls,
            sensor={"output_size": size, "bit_depth": RawFormat.named(mode).bits},
            display=None,
            encode=None,
        )
    else:
        asked = camera.create_video_configuration(
            main={"size": size, "format": stream},
            raw={"size": size},
            buffer_count=BUFFERS,
            controls=controls,
            sensor={"output_size": size},
            display=None,
            encode=None,
        )
        asked["raw"] = None
    camera.configure(asked)
    got = camera.camera_configuration()
    given = tuple(got["raw" if bayer else "main"]["size"])
    if given != size:
        raise AnnulusError(f"camera: Picamera2 gives {given[0]}x{given[1]}, asked for {size[0]}x{size[1]}")
    configured = PicameraCamera(camera, controls)
    shown = configured.sensor_crop
    if sensor_crop is not None and shown is not None and shown != tuple(sensor_crop):
        raise AnnulusError(
            f"camera: this mode shows {_field(shown)} of the sensor, the calibration was made with "
            f"{_field(sensor_crop)}. Another sensor, or another mode of that size: calibrate with the one in use."
        )
    return configured


def _field(crop: Sequence[int]) -> str:
    x, y, width, height = crop
    return f"{width}x{height} at {x},{y}"


def _mode_of(camera: Any, size: tuple[int, int]) -> str:
    """The unpacked raw format of the fewest bits among the sensor's modes of this size."""
    modes = [mode for mode in camera.sensor_modes if "unpacked" in mode]
    fitting = sorted((mode for mode in modes if tuple(mode["size"]) == size), key=lambda mode: int(mode["bit_depth"]))
    if not fitting:
        sizes = ", ".join(sorted({f"{w}x{h}" for w, h in (mode["size"] for mode in modes)}))
        raise AnnulusError(f"camera: the sensor has no mode of {size[0]}x{size[1]}, it has {sizes or 'none'}")
    return str(fitting[0]["unpacked"])


def on_monotonic(stamp_ns: int, monotonic_ns: int | None = None, boottime_ns: int | None = None) -> int:
    """A stamp of either clock on the monotonic one. They part by the time the machine was suspended, and which of them
    is read depends on the driver; a frame is young when it comes, so only one of the two can be right.
    """
    monotonic_ns = time.monotonic_ns() if monotonic_ns is None else monotonic_ns
    boottime_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) if boottime_ns is None else boottime_ns
    apart_ns = boottime_ns - monotonic_ns
    is_boottime = apart_ns > CLOCKS_APART_NS and 0 <= boottime_ns - stamp_ns < min(apart_ns, STAMP_AGE_NS)
    return stamp_ns - apart_ns if is_boottime else stamp_ns


def require_controls(expected: Mapping[str, Any], metadata: Mapping[str, Any]) -> None:
    """Raises AnnulusError naming what the sensor does otherwise than it was told; what it does not report passes."""
    for control, wanted in expected.items():
        name = READ_OF.get(control, control)
        reported = metadata.get(name)
        if name not in TOLERANCES or reported is None:
            continue
        slack = EXPOSURE_STEP_US if name == "ExposureTime" else 0.0
        pairs = zip(_several(wanted), _several(reported), strict=False)
        if any(abs(says - wants) > TOLERANCES[name] * abs(wants) + slack for wants, says in pairs):
            raise AnnulusError(f"camera: {name} is {reported}, it was told {wanted}. Is another sensor mode in force?")


def _shown_of_the_sensor(camera: Any) -> tuple[int, int, int, int] | None:
    """x, y, width, height in pixels of the whole sensor, of the mode that is configured; None where it does not say."""
    try:
        x, y, width, height = (int(value) for value in camera.camera_controls["ScalerCrop"][1])
    except (AttributeError, KeyError, IndexError, TypeError, ValueError):
        return None
    return x, y, width, height


def _several(value: Any) -> list[float]:
    return [float(one) for one in (value if isinstance(value, tuple | list) else [value])]
