"""What is to be reprocessed, and with what."""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.numeric.mosaic import Picture, bgr_of
from annulus_pipe.record.walk import DamagedError
from annulus_pipe.reprocess.method import Method, method_for
from annulus_pipe.reprocess.places import require_near
from annulus_pipe.rings.calibration.reference import Reference
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.diagnosis import FrameLighting, diagnose
from annulus_pipe.scans.fields import TWO_FIELDS, combed, two_fields
from annulus_pipe.scans.scan import Scan, ScanFrame, open_scan
from annulus_pipe.storage.calibration_file import load_calibration, load_part
from annulus_pipe.storage.place import Where, where
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.gyro import Turns
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.reference import ReferenceSection, sections_recorded

FLASH_MM = 0.05  # frames of one flash stand no farther apart; a tenth of what a head moves in a flash is less
LOOKED_AT = 4  # frames examined for what may be wrong with all of them
Measured = tuple[Profile, FrameLighting]


@dataclass(frozen=True, slots=True)
class Job:
    """A scan with all that its frames need; plain data, so that a worker anywhere can be handed one."""

    scan: Scan
    calibration: Calibration
    colour: ColourProfile | None = None  # of the pipe; each frame's own where None
    reference: Reference | None = None  # already in the calibration; vouches for some poses only
    sections: tuple[ReferenceSection, ...] = ()  # of the pipe, whose diameter is known

    def which(self, label: Label) -> list[int]:
        """Numbers of the frames with that label."""
        return [i for i, frame in enumerate(self.scan.frames) if frame.label is label]

    def flashes(self, label: Label) -> list[int]:
        """The same, but one number for each flash: of its frame from the first camera that has one."""
        first: dict[int, int] = {}
        for i in self.which(label):
            first.setdefault(self.scan.frames[i].index, i)
        return list(first.values())

    def picture(self, i: int) -> Picture:
        """scan.frames[i]. Raises AnnulusError when it is damaged or not of the calibrated size."""
        image = self.scan.picture(i)
        height, width = image.shape[:2]
        own = self.scan.frames[i].camera
        camera = next((one.camera for one in self.calibration.cameras if one.id == own), self.calibration.camera)
        if (width, height) != (camera.width, camera.height):
            raise AnnulusError(
                f"calibration: camera is {camera.width}x{camera.height} but {self.scan.frames[i].where} is "
                f"{width}x{height}. Calibrate with the camera that took this scan."
            )
        return image

    def read(self, i: int) -> Image:
        """The same as (H, W, 3) uint8 BGR."""
        return bgr_of(self.picture(i))

    def read_flash(self, i: int) -> dict[int, Picture]:
        """The images of scan.frames[i] and of the other cameras' frames of its flash, by camera id; damaged ones are
        left out. Raises AnnulusError as `read` does, DamagedError where all are damaged."""
        if len(self.scan.cameras) == 1:
            return {self.scan.frames[i].camera: self.picture(i)}
        out: dict[int, Picture] = {}
        damage: DamagedError | None = None
        for j in self.scan.same_flash(i):
            try:
                out[self.scan.frames[j].camera] = self.picture(j)
            except DamagedError as error:
                damage = error
        if not out and damage is not None:
            raise damage
        return out

    def ready(self) -> Callable[[Sequence[int]], list[Measured]]:
        """Does chunks of frame numbers; see `measured`."""
        method = method_for(self.calibration, self.colour)
        return lambda chunk: measured(self, method, chunk)


def measured(job: Job, method: Method, chunk: Sequence[int]) -> list[Measured]:
    """Profile and light of consecutive frames, each seeded with the pose of the one before.

    A frame of a recording that is damaged has no profile.
    """
    out: list[Measured] = []
    seed = None
    job.scan.plan([j for i in chunk for j in job.scan.same_flash(i)])
    for i in chunk:
        try:
            images = job.read_flash(i)
        except DamagedError:
            continue
        profile = method(job.scan.frames[i], images, seed)
        seed = profile.pose
        out.append((profile, max(map(diagnose, images.values()), key=lambda light: light.lost)))
    return out


def stage_medians(profiles: Sequence[Profile]) -> dict[str, float]:
    """Median ms of every stage over the frames, and `total`: of their sum."""
    stages = {name: None for profile in profiles for name in profile.timing_ms}
    out = {name: float(np.median([p.timing_ms[name] for p in profiles if name in p.timing_ms])) for name in stages}
    if "total" not in out:
        sums = [sum(p.timing_ms.values()) for p in profiles if p.timing_ms]
        out["total"] = float(np.median(sums)) if sums else 0.0
    return out


def open_job(
    scan: Where | str,
    calibration: Where | str | None = None,
    *,
    colour: Where | str | None = None,
    reference: Where | str | None = None,
    sections: Sequence[ReferenceSection] = (),
) -> Job:
    """Open a scan folder or recording with the files of its calibration: paths, or URLs of a store.

    calibration : a recording's own is used when None. colour, reference : files of `annulus calibrate colour` and
    `reference`. sections : stretches whose diameter is known; a recording's own if none is named.
    Raises AnnulusError, one line, for what is missing, damaged or does not belong together.
    """
    place = where(scan)
    opened = roll_filled(open_scan(place))
    known = load_calibration(where(calibration)) if calibration is not None else opened.calibration
    if known is None:
        raise AnnulusError(f"{place}: carries no calibration. Give the calibration file of its head.")
    made_by = "annulus calibrate reference"
    pattern = None if reference is None else load_part(where(reference), Reference.from_dict, made_by)
    if pattern is not None:
        try:
            known = pattern.applied(known)
        except ValueError as error:
            raise AnnulusError(f"{reference}: {error}. Make it with this calibration.") from None
    paint = None if colour is None else load_part(where(colour), ColourProfile.from_dict, "annulus calibrate colour")
    _belong_together(opened, known)
    if any(math.isnan(frame.z_mm) and frame.x_mm is not None for frame in opened.frames):
        raise AnnulusError(
            f"{place}: says x_mm, no z_mm: a scan of a plate. Expected the calibration of a head that projects fringes."
        )
    recorded = (opened.recording.configuration or {}) if opened.recording is not None else {}
    return Job(opened, known, paint, pattern, tuple(sections) or sections_recorded(recorded.get("reference")))


def looking_back(job: Job) -> Job:
    """The same with places that rise the way the head looks, of a head that looks back on its carrier."""
    frames = tuple(replace(frame, z_mm=-frame.z_mm) for frame in job.scan.frames)
    return replace(job, scan=replace(job.scan, frames=frames))


def look_at(job: Job) -> tuple[list[int], list[tuple[int, dict[int, Image]]]]:
    """The flashes to measure, and images of a few of them spread over the scan, by frame index. It takes a moment, so
    ask before what takes a minute. Raises AnnulusError, one line, where nothing can be measured: no flash of the
    projector, pictures of another size than the calibration's camera, none that is whole."""
    which = job.flashes(Label.PROJECTOR)
    if not which:
        raise AnnulusError(
            f"{job.scan.path}: none of its {len(job.scan.frames)} frames is labelled projector, nothing to measure."
        )
    require_near(job.scan.path, [job.scan.frames[i].z_mm for i in which])
    spread = sorted({which[k * (len(which) - 1) // (LOOKED_AT - 1)] for k in range(LOOKED_AT)})
    looked_at = []
    for i in spread:
        with contextlib.suppress(DamagedError):
            images = {number: bgr_of(picture) for number, picture in job.read_flash(i).items()}
            looked_at.append((job.scan.frames[i].index, images))
    if not looked_at:
        job.read(which[0])  # says what is wrong
    if job.calibration.kind == "line":  # light that stays on: a video's, and perhaps an interlaced one's
        combs = sum(any(combed(image) for image in images.values()) for _, images in looked_at)
        if two_fields(combs, len(looked_at)):
            raise AnnulusError(f"{job.scan.path}: {combs} of {len(looked_at)} pictures looked at {TWO_FIELDS}")
    return which, looked_at


def _belong_together(scan: Scan, calibration: Calibration) -> None:
    """Raises AnnulusError where the scan's cameras are not the calibration's, or frames of one flash are not."""
    known = [one.id for one in calibration.cameras]
    if len(known) == 1:
        scan.only()
        return
    strange = [number for number in scan.cameras if number not in known]
    if strange:
        raise AnnulusError(
            f"{scan.path}: has frames of camera {strange[0]}, but the calibration's cameras are "
            f"{', '.join(map(str, known))}. Calibrate the head that took this scan."
        )
    first: dict[int, ScanFrame] = {}
    for frame in scan.frames:
        other = first.setdefault(frame.index, frame)
        if other.label is not frame.label or not (
            abs(other.z_mm - frame.z_mm) <= FLASH_MM or (math.isnan(other.z_mm) and math.isnan(frame.z_mm))
        ):
            raise AnnulusError(
                f"{scan.path}: index {frame.index}: camera {other.camera}'s frame is {other.label.value} at "
                f"{other.z_mm:g} mm, camera {frame.camera}'s {frame.label.value} at {frame.z_mm:g} mm, expected one "
                "flash. Frames of different flashes need an index each."
            )


def turns_of(scan: Scan) -> Turns:
    """How far the head turned since the frame before, of every frame; NaN where no sensor said so."""
    unknown = (math.nan, math.nan, math.nan)
    return {frame.index: (frame.motion and frame.motion.turned_deg) or unknown for frame in scan.frames}


def roll_filled(scan: Scan) -> Scan:
    """The same scan, frames between two whose roll is known given one between; all of them, or none."""
    known = [(i, frame.roll_deg) for i, frame in enumerate(scan.frames) if frame.roll_deg is not None]
    if not known or len(known) == len(scan.frames):
        return scan
    turned = np.unwrap([roll for _, roll in known], period=360.0)
    rolls = np.interp(np.arange(len(scan.frames)), [i for i, _ in known], turned)
    frames = tuple(replace(frame, roll_deg=float(r)) for frame, r in zip(scan.frames, rolls, strict=True))
    return replace(scan, frames=frames)
