"""A V4L2 device as our camera: the driver is asked directly, and everything it was told is read back.

OpenCV's own V4L2 capture is not used: it hides the driver's frame count, what clock stamped a frame, that a frame is
damaged, and that the device has gone (docs/decisions/0020-v4l2-without-opencv.md).
"""

import contextlib
import errno
import mmap
import os
import select
import stat
import time
from collections import deque
from collections.abc import Mapping
from ctypes import c_int
from fractions import Fraction
from statistics import median
from typing import Any

import numpy as np

from annulus_pipe.capture import videodev as v4l2
from annulus_pipe.capture.camera import CompletedRequest, HeldRequest, NoSuchControl, OneRequest
from annulus_pipe.capture.pixels import ENCODINGS_OF, Layout
from annulus_pipe.vocabulary import AnnulusError

BUFFERS = 4  # in the driver
TIMEOUT_S = 2.0  # without a frame
RATE_FRAMES = 50  # looked at together, ..
RATE_TOLERANCE = 0.05  # .. to see that they come at the rate the driver said; 25 fps taken for 24 pass, 30 do not
EXPOSURE_UNIT_US = 100
STALE_MAX = 2 * BUFFERS  # frames from before the start, until that is no accident any more
EARLY_PERIODS = 2  # a stamp may be the end of a readout still under way, but no later


class V4L2Camera(OneRequest):
    """See capture.camera.CameraDriver. Frames that waited in the driver while nobody asked come first, with their own
    stamps and counts; at most four.
    """

    def __init__(
        self,
        device: str | int,
        *,
        fourcc: str = "YU12",
        width: int = 1664,
        height: int = 1232,
        fps: float = 25.0,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        """Raises AnnulusError, one line, unless the device is there, free, and takes these settings."""
        self._path = f"/dev/video{device}" if isinstance(device, int) else device
        if fourcc not in ENCODINGS_OF:
            raise AnnulusError(f"{self._path}: {fourcc} is not read, expected one of {', '.join(ENCODINGS_OF)}")
        self._fourcc, self._fps, self._timeout_s = fourcc, fps, timeout_s
        self.width, self.height, self.encoding = width, height, ENCODINGS_OF[fourcc]
        self._device: v4l2.Device | None = None
        self._layout: Layout
        self._buffers: list[mmap.mmap] = []
        self._poll = select.poll()
        self._started_ns = self._stale = 0
        self._sequence: tuple[int, int] | None = None  # the driver's, 32 bits, and ours, which never wraps
        self._steps: deque[int] = deque(maxlen=RATE_FRAMES)  # ns from frame to frame
        self._last_ns = 0
        self._open()
        self.close()

    def start(self) -> None:
        if self._device is not None:
            return
        device = self._open()
        try:
            self._map(device)
            for index in range(len(self._buffers)):
                device.call(v4l2.QBUF, _buffer(index))
            self._started_ns, self._stale, self._sequence = time.monotonic_ns(), 0, None
            self._steps.clear()
            device.call(v4l2.STREAMON, c_int(v4l2.CAPTURE))
        except OSError as error:
            self.close()
            raise self._explained(error, "does not begin to stream") from None

    def stop(self) -> None:
        self.close()

    def close(self) -> None:
        device, self._device = self._device, None
        if device is None:
            return
        self._poll.unregister(device.fd)
        for buffer in self._buffers:
            with contextlib.suppress(BufferError):  # an exception on its way may still hold a frame
                buffer.close()
        self._buffers = []
        device.close()  # ends streaming, and gives the buffers back

    def capture_request(self) -> CompletedRequest:
        """A damaged frame is skipped: the next one's FrameSequence shows it missing."""
        end = time.monotonic() + self._timeout_s
        while True:
            device = self._started
            ready = self._poll.poll(max(0.0, end - time.monotonic()) * 1e3)
            if not ready:
                raise TimeoutError(f"{self._path}: no whole frame within {self._timeout_s * 1e3:g} ms")
            buffer = _buffer(0)
            try:
                device.call(v4l2.DQBUF, buffer)
                arrived_ns = time.monotonic_ns()
                image = self._picture(buffer)
                device.call(v4l2.QBUF, _buffer(buffer.index))
            except BlockingIOError:
                if ready[0][1] & select.POLLIN:
                    continue
                raise AnnulusError(f"{self._path}: stopped streaming") from None
            except OSError as error:
                raise self._explained(error, "stopped streaming") from None
            metadata = self._metadata(buffer)
            if image is not None and metadata is not None:
                return HeldRequest(image, {**metadata, "ArrivalTimestamp": arrived_ns})

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """Raises NoSuchControl for what the device cannot be told, AnnulusError for what it does not do."""
        for name, value in controls.items():
            match name:
                case "ExposureTime":
                    self._control(name, "exposure", v4l2.CID_EXPOSURE_ABSOLUTE, value / EXPOSURE_UNIT_US, "x 100 us")
                case "AnalogueGain":
                    self._control(name, "gain", v4l2.CID_GAIN, value, "in the device's own unit")
                case "AeEnable":
                    self._automatic(bool(value))
                case "FrameDurationLimits":
                    self._change_rate(1e6 / float(value[1]))
                case _:
                    raise AnnulusError(
                        f"camera: control {name} is not known, expected ExposureTime, AnalogueGain, AeEnable or "
                        "FrameDurationLimits"
                    )

    # ---- opening ----

    @property
    def _started(self) -> v4l2.Device:
        if self._device is None:
            raise AnnulusError(f"{self._path}: not started")
        return self._device

    def _open(self) -> v4l2.Device:
        """Open, told what is wanted, and found to do it."""
        try:
            if not stat.S_ISCHR(os.stat(self._path).st_mode):
                raise AnnulusError(f"{self._path}: not a camera but a file or folder. `ls /dev/video*` lists cameras.")
            self._device = device = v4l2.Device(self._path)
        except OSError as error:
            raise self._explained(error, "cannot be opened") from None
        self._poll.register(device.fd, select.POLLIN)
        try:
            self._require_camera(device)
            self._set_format(device)
            self._set_rate(device)
        except OSError as error:
            self.close()
            raise self._explained(error, "cannot be set up") from None
        except AnnulusError:
            self.close()
            raise
        return device

    def _require_camera(self, device: v4l2.Device) -> None:
        try:
            capability = device.call(v4l2.QUERYCAP, v4l2.Capability())
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                raise AnnulusError(f"{self._path}: not a camera: no V4L2 device") from None
            raise
        can = capability.device_caps if capability.capabilities & v4l2.CAP_DEVICE_CAPS else capability.capabilities
        if not can & v4l2.CAP_VIDEO_CAPTURE:
            raise AnnulusError(
                f"{self._path}: not a camera: {capability.card.decode(errors='replace')} gives no video here"
            )
        if not can & v4l2.CAP_STREAMING:
            raise AnnulusError(f"{self._path}: the driver {capability.driver.decode(errors='replace')} does not stream")

    def _set_format(self, device: v4l2.Device) -> None:
        """Format and both sides in one call: a driver with a list of sizes takes none of them alone."""
        wanted = v4l2.Format(type=v4l2.CAPTURE)
        wanted.of.pix = v4l2.Pixels(
            width=self.width,
            height=self.height,
            pixelformat=v4l2.number(self._fourcc),
            field=v4l2.FIELD_NONE,
            priv=v4l2.PRIV_MAGIC,
        )
        try:
            got = device.call(v4l2.S_FMT, wanted).of.pix
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            got = v4l2.Pixels()
        if v4l2.letters(got.pixelformat) != self._fourcc:
            offered = device.formats()
            readable = [name for name in offered if name in ENCODINGS_OF]
            raise AnnulusError(
                f"{self._path}: offers no {self._fourcc}, expected one of {', '.join(readable)}"
                if readable
                else f"{self._path}: offers {', '.join(offered)}, of which nothing is read"
            )
        if (got.width, got.height) != (self.width, self.height):
            raise AnnulusError(
                f"{self._path}: gives {got.width}x{got.height} where {self.width}x{self.height} was asked for; "
                f"{self._fourcc} comes in {_listed(device.sizes(self._fourcc))}"
            )
        if got.field not in (v4l2.FIELD_NONE, v4l2.FIELD_ANY):
            raise AnnulusError(f"{self._path}: gives interlaced pictures, expected whole ones")
        try:
            self._layout = Layout.of(got)
        except ValueError as error:
            raise AnnulusError(f"{self._path}: {error}") from None

    def _set_rate(self, device: v4l2.Device) -> None:
        """Where the driver does not know its rate, the frames' stamps tell it (`_check_rate`)."""
        interval = (1 / Fraction(self._fps)).limit_denominator(100_000)
        wanted = v4l2.StreamParameters(
            type=v4l2.CAPTURE, numerator=interval.numerator, denominator=interval.denominator
        )
        try:
            device.call(v4l2.S_PARM, wanted)
            got = device.call(v4l2.G_PARM, v4l2.StreamParameters(type=v4l2.CAPTURE))
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                return
            raise
        if got.numerator and abs(got.denominator / got.numerator - self._fps) > 0.01 * self._fps:
            rates = device.rates(self._fourcc, self.width, self.height)
            raise AnnulusError(
                f"{self._path}: frame rate is {got.denominator / got.numerator:g}, expected {self._fps:g}; "
                f"{self.width}x{self.height} {self._fourcc} comes at {_listed(rates)}"
            )

    def _map(self, device: v4l2.Device) -> None:
        asked = device.call(v4l2.REQBUFS, v4l2.RequestBuffers(count=BUFFERS, type=v4l2.CAPTURE, memory=v4l2.MMAP))
        for index in range(asked.count):
            one = device.call(v4l2.QUERYBUF, _buffer(index))
            self._buffers.append(mmap.mmap(device.fd, one.length, offset=one.at.offset))

    # ---- a frame ----

    def _picture(self, buffer: v4l2.Buffer) -> np.ndarray | None:
        if buffer.flags & v4l2.BUF_FLAG_ERROR:
            return None
        return self._layout.picture(np.frombuffer(self._buffers[buffer.index], np.uint8, buffer.bytesused))

    def _metadata(self, buffer: v4l2.Buffer) -> dict[str, Any] | None:
        """None for a frame from before the start."""
        if buffer.flags & v4l2.BUF_FLAG_TIMESTAMP_MASK != v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC:
            raise AnnulusError(f"{self._path}: the driver stamps frames with a clock of its own, not CLOCK_MONOTONIC")
        stamp = (buffer.seconds * 1_000_000 + buffer.microseconds) * 1000
        ahead_s = (stamp - time.monotonic_ns()) / 1e9
        if ahead_s > EARLY_PERIODS / self._fps:
            raise AnnulusError(f"{self._path}: a frame is stamped {ahead_s:.3g} s ahead of CLOCK_MONOTONIC")
        self._check_rate(stamp, buffer.sequence)
        metadata = {"SensorTimestamp": stamp}
        count = self._count(buffer.sequence)
        if count is not None:
            metadata["FrameSequence"] = count
        if stamp >= self._started_ns:
            return metadata
        self._stale += 1
        if self._stale > STALE_MAX:
            raise AnnulusError(f"{self._path}: frames are stamped before the start, expected CLOCK_MONOTONIC")
        return None

    def _count(self, sequence: int) -> int | None:
        """The driver's count beyond its 32 bits; None from a driver that does not count."""
        if self._sequence is None:
            self._sequence = (sequence, sequence)
        else:
            before, ours = self._sequence
            self._sequence = (sequence, ours + ((sequence - before) & 0xFFFF_FFFF))
            if sequence == before:
                return None
        return self._sequence[1]

    def _check_rate(self, stamp: int, sequence: int) -> None:
        """Drivers say a rate and come at another: in the dark, for one, where the exposure is theirs to choose."""
        if self._sequence is not None and sequence == self._sequence[0] + 1:
            self._steps.append(stamp - self._last_ns)
        self._last_ns = stamp
        if len(self._steps) == RATE_FRAMES:
            rate = 1e9 / max(1.0, median(self._steps))
            self._steps.clear()
            if abs(rate - self._fps) > RATE_TOLERANCE * self._fps:
                raise AnnulusError(f"{self._path}: frames come at {rate:.1f} fps, expected {self._fps:g}")

    # ---- controls ----

    def _control(self, name: str, what: str, id: int, wanted: float, unit: str) -> None:
        """The nearest whole value, or an error that says what can be had."""
        device = self._started
        described = device.control(id)
        if described is None:
            raise NoSuchControl(f"{self._path}: has no {name} to set: its {what} stays what it is")
        try:
            got = device.set(id, round(wanted))
        except OSError as error:
            if error.errno not in (errno.ERANGE, errno.EINVAL):
                raise self._explained(error, f"does not take its {what}") from None
            got = device.call(v4l2.G_CTRL, v4l2.Control(id)).value
        if abs(got - wanted) > max(0.5, 0.01 * abs(wanted)):
            raise AnnulusError(
                f"{self._path}: {what} is {got}, expected {wanted:g} ({unit}); it takes {described.minimum} to "
                f"{described.maximum} in steps of {described.step}"
            )

    def _automatic(self, on: bool) -> None:
        """Everything that the device would change by itself: exposure, gain, and a rate that falls in the dark."""
        device = self._started
        exposure = (v4l2.EXPOSURE_APERTURE_PRIORITY, v4l2.EXPOSURE_AUTO) if on else (v4l2.EXPOSURE_MANUAL,)
        for what, id, values in (
            ("automatic exposure", v4l2.CID_EXPOSURE_AUTO, exposure),
            ("exposure that slows the frames", v4l2.CID_EXPOSURE_AUTO_PRIORITY, (0,)),
            ("automatic gain", v4l2.CID_AUTOGAIN, (int(on),)),
        ):
            if device.control(id) is not None and not any(self._takes(id, value) for value in values):
                raise AnnulusError(f"{self._path}: {what} cannot be turned {'on' if on else 'off'}")

    def _takes(self, id: int, value: int) -> bool:
        try:
            return self._started.set(id, value) == value
        except OSError as error:
            if error.errno not in (errno.ERANGE, errno.EINVAL):
                raise self._explained(error, "does not take a control") from None
            return False

    def _change_rate(self, fps: float) -> None:
        """Most drivers take another rate only while they do not stream."""
        if abs(fps - self._fps) <= 0.01 * self._fps:
            return
        self._fps = fps
        if self._device is not None:
            self.close()
            self.start()

    # ---- errors ----

    def _explained(self, error: OSError, doing: str) -> AnnulusError:
        """What the system said, in a line that tells what to do."""
        match error.errno:
            case errno.ENOENT:
                why = "no such camera. `ls /dev/video*` lists the devices."
            case errno.ENODEV | errno.ENXIO:
                why = "the camera is gone" if self._buffers else "no such camera: it was unplugged, or has no driver"
            case errno.EACCES | errno.EPERM:
                why = f"no permission. Its group may use it: `ls -l {self._path}`, `adduser USER video`, log in again."
            case errno.EBUSY:
                why = f"in use by another program: `fuser {self._path}`"
            case errno.ENOSPC:
                why = "no room on its USB bus. Plug it in elsewhere, or ask for less."
            case _:
                why = f"{doing} ({error.strerror})"
        return AnnulusError(f"{self._path}: {why}")


def _buffer(index: int) -> v4l2.Buffer:
    return v4l2.Buffer(index=index, type=v4l2.CAPTURE, memory=v4l2.MMAP)


def _listed(words: list[str]) -> str:
    return ", ".join(words) or "what the device does not tell"
