"""A V4L2 device through OpenCV's VideoCapture, for a camera that our own V4L2 does not open. Thin: it hides the
driver's count, so frames that the driver lost show in stamps only, and a frame beside which a stamp has to be believed
alone gets no label (pairing). Prefer `capture.v4l2` (docs/decisions/0020-v4l2-without-opencv.md).
"""

import os
import time
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from annulus_pipe.capture.camera import BGR8, CompletedRequest, HeldRequest, NoSuchControl, OneRequest
from annulus_pipe.capture.v4l2 import EXPOSURE_UNIT_US
from annulus_pipe.vocabulary import AnnulusError

GRAB_S = 1  # OpenCV waits whole seconds, of the environment; its own 10 would be a hang nobody knows of
GONE_S = 0.5  # a grab that fails sooner has not waited for a frame: the device is gone. Guard: test_opencv.py
STAMP_AGE_S = 1.0  # a stamp that is older, or ahead, is not of CLOCK_MONOTONIC; 4 buffers at 5 fps are 0.8 s
RATE_TOLERANCE = 0.01  # of fps, between what is wanted and what OpenCV reports
MANUAL, AUTO = 1.0, 3.0  # V4L2's exposure_auto, which OpenCV passes on


class OpenCVCamera(OneRequest):
    """See capture.camera.CameraDriver. No FrameSequence ever. SensorTimestamp is the driver's stamp where OpenCV passes
    one of CLOCK_MONOTONIC on, else the moment of arrival; which of both is settled by the first frame.
    """

    def __init__(
        self, device: str, *, fourcc: str = "YU12", width: int = 1664, height: int = 1232, fps: float = 25.0
    ) -> None:
        """device : "/dev/video0" or "0". Raises AnnulusError, one line, unless it is there and takes these settings."""
        number = device.removeprefix("/dev/video")
        if not (number.isascii() and number.isdecimal() and len(number) <= 3):
            raise AnnulusError(f"{device}: not a camera for OpenCV, expected /dev/video0 or 0")
        if not (len(fourcc) == 4 and fourcc.isascii()):
            raise AnnulusError(f"{device}: format is {fourcc!r}, expected four letters such as YU12 or MJPG")
        self._device, self._number, self._fourcc, self._fps = device, int(number), fourcc, fps
        self.width, self.height, self.encoding = width, height, BGR8
        self._capture: cv2.VideoCapture | None = None
        self._stamped: bool | None = None
        self.start()
        self.close()

    def start(self) -> None:
        if self._capture is not None:
            return
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(GRAB_S))
        self._capture = capture = cv2.VideoCapture(self._number, cv2.CAP_V4L2)
        self._stamped = None
        try:
            if not capture.isOpened():
                raise AnnulusError(
                    f"{self._device}: OpenCV does not open it: no such camera, no permission, or in use. "
                    "`ls -l /dev/video*` lists them."
                )
            self._set_up(capture)
        except BaseException:
            self.close()
            raise

    def stop(self) -> None:
        self.close()

    def close(self) -> None:
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def capture_request(self) -> CompletedRequest:
        capture = self._started
        begun_ns = time.monotonic_ns()
        grabbed = capture.grab()
        arrived_ns = time.monotonic_ns()
        if not grabbed:
            if arrived_ns - begun_ns < GONE_S * 1e9:
                raise AnnulusError(f"{self._device}: stopped streaming: the camera is gone, or in use")
            raise TimeoutError(f"{self._device}: no frame within {(arrived_ns - begun_ns) / 1e9:.1f} s")
        stamp_ns = round(1e6 * capture.get(cv2.CAP_PROP_POS_MSEC))
        retrieved, image = capture.retrieve()
        if not retrieved or image is None:
            raise AnnulusError(f"{self._device}: a frame that OpenCV does not decode")
        metadata = {"SensorTimestamp": self._moment(stamp_ns, arrived_ns), "ArrivalTimestamp": arrived_ns}
        return HeldRequest(np.asarray(image), metadata)

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """Raises NoSuchControl for what the device cannot be set to."""
        for name, value in controls.items():
            match name:
                case "ExposureTime":
                    self._control("exposure", cv2.CAP_PROP_EXPOSURE, value / EXPOSURE_UNIT_US)
                case "AnalogueGain":
                    self._control("gain", cv2.CAP_PROP_GAIN, value)
                case "AeEnable":
                    self._control("automatic exposure", cv2.CAP_PROP_AUTO_EXPOSURE, AUTO if value else MANUAL)
                case "FrameDurationLimits":  # OpenCV takes another rate only when it opens
                    if abs(1e6 / value[1] - self._fps) > RATE_TOLERANCE * self._fps:
                        raise NoSuchControl(f"{self._device}: its rate stays {self._fps:g} fps while it streams")
                case _:
                    raise AnnulusError(f"camera: control {name} is not known to OpenCV's cameras")

    @property
    def _started(self) -> cv2.VideoCapture:
        if self._capture is None:
            raise AnnulusError(f"{self._device}: not started")
        return self._capture

    def _set_up(self, capture: cv2.VideoCapture) -> None:
        """Set, and read back: OpenCV says yes to much that the driver then does otherwise."""
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*self._fourcc))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, self.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self.height)
        capture.set(cv2.CAP_PROP_FPS, self._fps)
        fourcc = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).decode("ascii", "replace")
        size = tuple(round(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        fps = capture.get(cv2.CAP_PROP_FPS)
        wanted = (self._fourcc, (self.width, self.height))
        if (fourcc, size) != wanted or abs(fps - self._fps) > RATE_TOLERANCE * self._fps:
            raise AnnulusError(
                f"{self._device}: gives {fourcc} {size[0]}x{size[1]} at {fps:g} fps through OpenCV, expected "
                f"{self._fourcc} {self.width}x{self.height} at {self._fps:g}"
            )

    def _moment(self, stamp_ns: int, arrived_ns: int) -> int:
        """Stamp or arrival, always the same of both: an offset between them would move frames to other edges."""
        stamped = 0 <= arrived_ns - stamp_ns <= STAMP_AGE_S * 1e9
        if self._stamped is None:
            self._stamped = stamped
        if self._stamped and not stamped:
            raise AnnulusError(
                f"{self._device}: a frame is stamped {(arrived_ns - stamp_ns) / 1e9:.3g} s before it came, "
                f"expected 0 to {STAMP_AGE_S:g} s"
            )
        return stamp_ns if self._stamped else arrived_ns

    def _control(self, what: str, property: int, wanted: float) -> None:
        capture = self._started
        if not capture.set(property, wanted):
            raise NoSuchControl(f"{self._device}: OpenCV sets no {what} of it: it stays what it is")
        got = capture.get(property)
        if abs(got - wanted) > max(0.5, 0.01 * abs(wanted)):
            raise AnnulusError(f"{self._device}: {what} is {got:g} in the device's unit, expected {wanted:g}")
