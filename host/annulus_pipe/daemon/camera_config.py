"""One camera of head.toml. Apart from the rest of it: an intake must be up quickly, and methods take long to import."""

from dataclasses import dataclass
from typing import Literal

from annulus_pipe.capture.timing import FrameTiming

CameraKind = Literal["v4l2", "picamera2", "opencv", "video", "folder", "remote"]
CAMERA_KINDS = ("v4l2", "picamera2", "opencv", "video", "folder", "remote")
Trigger = Literal["none", "xtrig", "pulse", "xtrig_on_sync", "pulse_on_sync"]
FILES = ("video", "folder")  # cameras that end, and do not come back
USUAL_TIMING = FrameTiming(25.0, 38_000.0, 28_000.0)


@dataclass(frozen=True, slots=True)
class CameraConfig:
    kind: CameraKind = "v4l2"
    device: str = "/dev/video0"  # or the file, folder or address
    width: int = 1664
    height: int = 1232
    format: str = "YU12"  # the fourcc that a V4L2 device is asked for; of Picamera2 "raw" or a format of its "main"
    gain: float = 1.0
    timing: FrameTiming = USUAL_TIMING
    trigger: Trigger = "none"
    colour_gains: tuple[float, float] | None = None  # red and blue over green, Picamera2's ColourGains
    slides: tuple[int, ...] = ()  # of those lit in turn, the ones whose light it sees, from 0; none: all
    sensor_crop: tuple[int, int, int, int] | None = None  # the calibration's: what the mode must show of the sensor

    @property
    def flash_timing(self) -> FrameTiming:
        """What a flash must fit. Raises AnnulusError when a camera that is triggered has no time for its frames."""
        return self.timing if self.trigger == "none" else self.timing.triggered(self.trigger).flashes_in
