"""`annulus calibrate colour`: what the stripes look like on this pipe, from a few frames in it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from annulus.record.calibration_file import load_calibration
from annulus.record.scan import open_scan
from annulus.rings.colour import ColourProfile, Stripes, learn, stripes
from annulus.rings.diagnosis import Exposure, Trouble, diagnose, exposure_findings
from annulus.rings.reconstructor import Reconstructor
from annulus.vocabulary import AnnulusError, Label

Progress = Callable[[str, int, int], None]

FRAMES = 12  # are plenty: every one has thousands of stripe sightings


@dataclass(frozen=True, slots=True)
class LearntColours:
    """The profile, how many frames were looked at, and what may be wrong with them."""

    profile: ColourProfile
    looked_at: int
    warnings: tuple[str, ...]


def calibrate_colour(
    scan: Path,
    calibration: Path,
    *,
    camera_gains: tuple[float, float] = (1.0, 1.0),
    progress: Progress | None = None,
) -> LearntColours:
    """Learn a pipe's colours from up to twelve projector frames of a scan in it.

    camera_gains : white balance that was set, red and blue relative to green; the gains to set are told in the same
    terms (ColourGains of Picamera2). Raises AnnulusError, one line, where nothing can be learnt.
    """
    opened, known = open_scan(scan), load_calibration(calibration)
    projector = [i for i, frame in enumerate(opened.frames) if frame.label is Label.PROJECTOR]
    if not projector:
        raise AnnulusError(f"{scan}: none of its {len(opened.frames)} frames is labelled projector, nothing to learn.")
    chosen = [projector[k * (len(projector) - 1) // max(FRAMES - 1, 1)] for k in range(FRAMES)]
    chosen = sorted(set(chosen))
    reconstructor = Reconstructor(known)
    seen: list[Stripes] = []
    exposures: list[tuple[int, Exposure]] = []
    for done, i in enumerate(chosen):
        image = opened.read(i)
        if image.shape[:2] != (known.camera.height, known.camera.width):
            raise AnnulusError(
                f"calibration: camera is {known.camera.width}x{known.camera.height} but {opened.frames[i].where} is "
                f"{image.shape[1]}x{image.shape[0]}. Calibrate with the camera that took this scan."
            )
        exposures.append((opened.frames[i].index, diagnose(image)))
        slits, placed = reconstructor.sightings(image)
        if placed is not None:
            seen.append(stripes(slits, placed, known))
        if progress is not None:
            progress("frames", done + 1, len(chosen))
    found = exposure_findings(exposures)
    if not seen:
        dark = [finding.text for finding in found if finding.trouble is Trouble.DARK]
        raise AnnulusError(f"{scan}: {dark[0] if dark else 'no frame shows the rings of this calibration'}.")
    try:
        profile = learn(seen, camera_gains)
    except ValueError as error:
        raise AnnulusError(f"{scan}: {error}.") from None
    return LearntColours(profile, len(chosen), tuple(finding.text for finding in found))
