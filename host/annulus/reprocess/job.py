"""What is to be reprocessed, and with what."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from annulus.geometry.calibration import Calibration
from annulus.numeric.arrays import Image
from annulus.record.calibration_file import load_calibration, load_part
from annulus.record.scan import Scan, open_scan
from annulus.record.walk import DamagedError
from annulus.reprocess.method import method_for
from annulus.rings.calibration.reference import Reference
from annulus.rings.colour import ColourProfile
from annulus.rings.diagnosis import Exposure, diagnose
from annulus.vocabulary import AnnulusError, Label
from annulus.wall.profile import Profile

Measured = tuple[Profile, Exposure]


@dataclass(frozen=True, slots=True)
class Job:
    """A scan with all that its frames need; plain data, so that a worker anywhere can be handed one."""

    scan: Scan
    calibration: Calibration
    colour: ColourProfile | None = None  # of the pipe; each frame's own where None
    reference: Reference | None = None  # already in the calibration; vouches for some poses only

    def which(self, label: Label) -> list[int]:
        """Numbers of the frames with that label."""
        return [i for i, frame in enumerate(self.scan.frames) if frame.label is label]

    def read(self, i: int) -> Image:
        """scan.frames[i], (H, W, 3) uint8 BGR. Raises AnnulusError when it is damaged or not of the calibrated size."""
        image = self.scan.read(i)
        height, width = image.shape[:2]
        camera = self.calibration.camera
        if (width, height) != (camera.width, camera.height):
            raise AnnulusError(
                f"calibration: camera is {camera.width}x{camera.height} but {self.scan.frames[i].where} is "
                f"{width}x{height}. Calibrate with the camera that took this scan."
            )
        return image

    def worker(self) -> Callable[[Sequence[int]], list[Measured]]:
        """Does chunks of frame numbers; in a chunk every frame is seeded with the pose of the one before.

        A frame of a recording that is damaged has no profile.
        """
        method = method_for(self.calibration, self.colour)

        def work(chunk: Sequence[int]) -> list[Measured]:
            out: list[Measured] = []
            seed = None
            for i in chunk:
                try:
                    image = self.read(i)
                except DamagedError:
                    continue
                profile = method(self.scan.frames[i], image, seed)
                seed = profile.pose
                out.append((profile, diagnose(image)))
            return out

        return work


def open_job(
    scan: Path, calibration: Path | None = None, *, colour: Path | None = None, reference: Path | None = None
) -> Job:
    """Open a scan folder or recording with the files of its calibration.

    calibration : a recording's own is used when None. colour, reference : files of `annulus calibrate colour` and
    `reference`. Raises AnnulusError, one line, for what is missing, damaged or does not belong together.
    """
    opened = roll_filled(open_scan(scan).only())  # no method joins views yet
    known = load_calibration(calibration) if calibration is not None else opened.calibration
    if known is None:
        raise AnnulusError(f"{scan}: carries no calibration. Give the calibration file of its head.")
    pattern = None if reference is None else load_part(reference, Reference.from_dict, "annulus calibrate reference")
    if pattern is not None:
        try:
            known = pattern.applied(known)
        except ValueError as error:
            raise AnnulusError(f"{reference}: {error}. Make it with this calibration.") from None
    paint = None if colour is None else load_part(colour, ColourProfile.from_dict, "annulus calibrate colour")
    return Job(opened, known, paint, pattern)


def roll_filled(scan: Scan) -> Scan:
    """The same scan, frames between two whose roll is known given one between; all of them, or none."""
    known = [(i, frame.roll_deg) for i, frame in enumerate(scan.frames) if frame.roll_deg is not None]
    if not known or len(known) == len(scan.frames):
        return scan
    turned = np.unwrap([roll for _, roll in known], period=360.0)
    rolls = np.interp(np.arange(len(scan.frames)), [i for i, _ in known], turned)
    frames = tuple(replace(frame, roll_deg=float(r)) for frame, r in zip(scan.frames, rolls, strict=True))
    return replace(scan, frames=frames)
