"""What was filmed before as a camera: a video file, a scan folder. As fast as it is asked; see capture/camera.py."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2

from annulus_pipe.capture.camera import BGR8, SIDE_MAX, CompletedRequest, EndOfFrames, HeldRequest, OneRequest
from annulus_pipe.scans.scan import TABLE, read_image, read_table
from annulus_pipe.vocabulary import AnnulusError

SPAN_MAX_NS = 1 << 62  # of timestamps, which have 64 bits


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

    def capture_request(self) -> CompletedRequest:
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
    """The images of one camera of a scan folder, in the order of their index, which is their FrameSequence.

    Timestamps tell the index too, from the moment of `start` on, so that what is missing shows as it does on a live
    camera and several cameras of one folder keep in step. Metadata adds Light, ZMm and, where it is known, RollDeg.
    """

    def __init__(self, folder: Path, *, fps: float = 25.0, camera: int = 0) -> None:
        """Raises AnnulusError, one line, where the folder is no scan or has no frame of that camera."""
        frames = sorted(read_table(folder), key=lambda frame: frame.index)
        self._folder = folder
        self._frames = [frame for frame in frames if frame.camera == camera]
        self._period_ns = round(1e9 / fps)
        self._first = frames[0].index
        if not self._frames:
            raise AnnulusError(f"{folder / TABLE}: lists no frame of camera {camera}")
        if (frames[-1].index - self._first) * self._period_ns > SPAN_MAX_NS:
            raise AnnulusError(
                f"{folder / TABLE}: index runs from {self._first} to {frames[-1].index}, expected frames counted one "
                "by one"
            )
        self._start_ns = 0
        self._next = 0
        self.height, self.width = read_image(folder / self._frames[0].where).shape[:2]
        self.encoding = BGR8

    def start(self) -> None:
        self._start_ns = time.monotonic_ns()
        self._next = 0

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    def capture_request(self) -> CompletedRequest:
        """Raises EndOfFrames after the last, AnnulusError for an image that is missing, truncated or damaged."""
        if self._next >= len(self._frames):
            raise EndOfFrames
        frame = self._frames[self._next]
        self._next += 1
        metadata: dict[str, Any] = {
            "SensorTimestamp": self._start_ns + (frame.index - self._first) * self._period_ns,
            "FrameSequence": frame.index,
            "Light": frame.label.value,
            "ZMm": frame.z_mm,
        }
        if frame.roll_deg is not None:
            metadata["RollDeg"] = frame.roll_deg
        return HeldRequest(read_image(self._folder / frame.where), metadata)

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        pass
