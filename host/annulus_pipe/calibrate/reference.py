"""`annulus calibrate reference`: what the pattern is off its cones, from frames in a clean pipe."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from annulus_pipe.calibrate.sample import Progress, sample
from annulus_pipe.rings.calibration.reference import Reference, learn
from annulus_pipe.rings.diagnosis import FrameLighting, Trouble, exposure_findings
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile

FRAMES = 24  # of a longer scan, evenly taken
CORRECTION_MOST = 3.0  # degrees; no slide is so far off, a defect or another calibration is; unguarded


@dataclass(frozen=True, slots=True)
class LearntReference:
    """The reference, how many frames were looked at, and what may be wrong with it."""

    reference: Reference
    looked_at: int
    warnings: tuple[str, ...]


def calibrate_reference(
    scan: Path, calibration: Path, *, radius_mm: float | None = None, progress: Progress | None = None
) -> LearntReference:
    """Learn the pattern's artefacts from up to 24 projector frames in a clean, round pipe.

    radius_mm : of that pipe, the calibration's if not given. Raises AnnulusError where nothing can be learnt.
    """
    known = load_calibration(calibration)
    if radius_mm is not None:
        known = replace(known, pipe_radius_mm=radius_mm)
    reconstructor = Reconstructor(known)
    profiles: list[Profile] = []
    exposures: list[tuple[int, FrameLighting]] = []
    for frame in sample(open_scan(scan), known.camera, FRAMES, progress):
        exposures.append((frame.index, frame.exposure))
        seed = profiles[-1].pose if profiles else None
        place = 0.0 if math.isnan(frame.z_mm) else frame.z_mm
        profiles.append(reconstructor.profile(frame.image, frame=frame.index, z_mm=place, seed=seed))
    found = exposure_findings(exposures)
    try:
        reference = learn(profiles, known)
    except ValueError as error:
        dark = [finding.text for finding in found if finding.kind is Trouble.DARK]
        raise AnnulusError(f"{scan}: {dark[0] if dark else error}.") from None
    warnings = [finding.text for finding in found]
    if len(reference.poses) == 1:
        warnings.append("from one frame nothing can be checked, and a flaw of its wall is taken for the pattern's")
    largest = max((abs(v) for ring in reference.offset_rad for v in ring if not math.isnan(v)), default=0.0)
    if math.degrees(largest) > CORRECTION_MOST:
        warnings.append(
            f"a correction of {math.degrees(largest):.1f} degrees is no slide's: is the pipe clean, its radius "
            f"{known.pipe_radius_mm:g} mm, and the calibration this head's?"
        )
    return LearntReference(reference, len(exposures), tuple(warnings))
