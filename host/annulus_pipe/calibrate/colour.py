"""`annulus calibrate colour`: what the stripes look like on this pipe, from a few frames in it."""

from dataclasses import dataclass
from pathlib import Path

from annulus_pipe.calibrate.sample import Progress, Sampled, sample
from annulus_pipe.calibrate.wall import MeasuredWall, measure_wall
from annulus_pipe.rings.colour import ColourProfile, Stripes, learn, stripes
from annulus_pipe.rings.diagnosis import FrameLighting, Trouble, exposure_findings
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.vocabulary import AnnulusError

FRAMES = 12  # are plenty: every one has thousands of stripe observations


@dataclass(frozen=True, slots=True)
class LearntColours:
    """The profile, how many frames were looked at, and what may be wrong with them. Where it was asked for, how far
    light goes on in this wall, or why that could not be measured."""

    profile: ColourProfile
    looked_at: int
    warnings: tuple[str, ...]
    wall: MeasuredWall | str | None = None


def calibrate_colour(
    scan: Path,
    calibration: Path,
    *,
    camera_gains: tuple[float, float] = (1.0, 1.0),
    diameter_u_mm: float | None = None,
    progress: Progress | None = None,
) -> LearntColours:
    """Learn a pipe's colours from up to twelve projector frames of a scan in it.

    camera_gains : white balance that was set, red and blue relative to green; the gains to set are told in the same
    terms (ColourGains of Picamera2). diameter_u_mm : how well, k = 2, this pipe's inner diameter is known to be the
    calibration's: then its wall is measured, too. Raises AnnulusError, one line, where nothing can be learnt.
    """
    known = load_calibration(calibration)
    reconstructor = Reconstructor(known)
    seen: list[Stripes] = []
    exposures: list[tuple[int, FrameLighting]] = []
    frames: list[Sampled] = []
    for frame in sample(open_scan(scan), known.camera, FRAMES, progress):
        exposures.append((frame.index, frame.exposure))
        slits, placed = reconstructor.slits_by_order(frame.image)
        if placed is not None:
            seen.append(stripes(slits, placed, known))
            frames.append(frame)
    found = exposure_findings(exposures)
    if not seen:
        dark = [finding.text for finding in found if finding.kind is Trouble.DARK]
        raise AnnulusError(f"{scan}: {dark[0] if dark else 'no frame shows the rings of this calibration'}.")
    try:
        profile = learn(seen, camera_gains)
    except ValueError as error:
        raise AnnulusError(f"{scan}: {error}.") from None
    wall: MeasuredWall | str | None = None
    if diameter_u_mm is not None:
        try:
            wall = measure_wall(frames, known, diameter_u_mm, profile)
        except AnnulusError as error:
            wall = str(error)
    return LearntColours(profile, len(exposures), tuple(finding.text for finding in found), wall)
