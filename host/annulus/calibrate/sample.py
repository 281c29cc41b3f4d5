"""A few projector frames of a scan, read and checked."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from annulus.geometry.calibration import Calibration
from annulus.numeric.arrays import Image
from annulus.record.scan import open_scan
from annulus.rings.diagnosis import Exposure, diagnose
from annulus.vocabulary import AnnulusError, Label

Progress = Callable[[str, int, int], None]  # stage, done, total


@dataclass(frozen=True, slots=True)
class Sampled:
    """One frame: its index and place, how it is lit, and the image, (H, W, 3) BGR."""

    index: int
    z_mm: float
    exposure: Exposure
    image: Image


def sample(scan: Path, calibration: Calibration, most: int, progress: Progress | None = None) -> Iterator[Sampled]:
    """At most so many projector frames, evenly over the scan.

    Raises AnnulusError where there are none, one is damaged, or they are not of the calibrated camera's size.
    """
    opened = open_scan(scan)
    projector = [i for i, frame in enumerate(opened.frames) if frame.label is Label.PROJECTOR]
    if not projector:
        raise AnnulusError(f"{scan}: none of its {len(opened.frames)} frames is labelled projector, nothing to learn.")
    chosen = sorted({projector[k * (len(projector) - 1) // max(most - 1, 1)] for k in range(most)})
    for done, i in enumerate(chosen):
        frame, image, camera = opened.frames[i], opened.read(i), calibration.camera
        if image.shape[:2] != (camera.height, camera.width):
            raise AnnulusError(
                f"calibration: camera is {camera.width}x{camera.height} but {frame.where} is "
                f"{image.shape[1]}x{image.shape[0]}. Calibrate with the camera that took this scan."
            )
        yield Sampled(frame.index, frame.z_mm, diagnose(image), image)
        if progress is not None:
            progress("frames", done + 1, len(chosen))
