"""Frames of a scan for a calibration, read and checked."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.rings.diagnosis import FrameLighting, diagnose
from annulus_pipe.scans.scan import Scan
from annulus_pipe.vocabulary import AnnulusError, Label

Progress = Callable[[str, int, int], None]  # stage, done, total


@dataclass(frozen=True, slots=True)
class Sampled:
    """One frame: its index and place, how it is lit, and the image, (H, W, 3) BGR."""

    index: int
    z_mm: float
    exposure: FrameLighting
    image: Image


ALONE = -1  # no camera's id: the scan is of one camera


def projector_frames(scan: Scan, camera_id: int | None = ALONE) -> list[int]:
    """Which of the scan's frames, of one camera or (None) of all, the projector lit. Raises AnnulusError where none is,
    or several cameras took them and it is not said which."""
    if camera_id == ALONE:
        scan.only()
    out = [
        i
        for i, frame in enumerate(scan.frames)
        if frame.label is Label.PROJECTOR and camera_id in (ALONE, None, frame.camera)
    ]
    if not out:
        raise AnnulusError(f"{scan.path}: none of its {len(scan.frames)} frames is labelled projector.")
    return out


def sample(
    scan: Scan, camera: Camera, most: int, progress: Progress | None = None, camera_id: int = ALONE
) -> Iterator[Sampled]:
    """At most so many projector frames, evenly over the scan, of one of its cameras.

    Raises AnnulusError where there are none, one is damaged, or they are not of the camera's size.
    """
    projector = projector_frames(scan, camera_id)
    chosen = sorted({projector[k * (len(projector) - 1) // max(most - 1, 1)] for k in range(most)})
    for done, i in enumerate(chosen):
        image = read_frame(scan, i, camera)
        yield Sampled(scan.frames[i].index, scan.frames[i].z_mm, diagnose(image), image)
        if progress is not None:
            progress("read", done + 1, len(chosen))


def read_frame(scan: Scan, i: int, camera: Camera) -> Image:
    """The image of one frame. Raises AnnulusError where it is damaged or not of the camera's size."""
    image = scan.read(i)
    if image.shape[:2] != (camera.height, camera.width):
        raise AnnulusError(
            f"{scan.frames[i].where}: is {image.shape[1]}x{image.shape[0]} but the camera's file says "
            f"{camera.width}x{camera.height}. Give the file of the camera that took this scan."
        )
    return image
