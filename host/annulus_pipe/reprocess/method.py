"""Which method a head's frames need, and the one function from the frames of a flash to their profile."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.numeric.mosaic import Picture
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.diagnosis import Trouble, examine
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.stereo import StereoReconstructor, swapped
from annulus_pipe.vocabulary import AnnulusError, Finding
from annulus_pipe.wall.profile import Profile


class FrameFacts(Protocol):
    """What a method must know of a frame besides its image; a live frame's header says it as a scan's table does."""

    @property
    def index(self) -> int: ...
    @property
    def z_mm(self) -> float | None: ...
    @property
    def roll_deg(self) -> float | None: ...


# (frame, pictures by camera id, pose of a frame nearby or None) -> profile. All images
# are of one flash; a camera whose frame was lost is missing. Raises AnnulusError for an image of another size than its
# camera's, ValueError for a frame whose place along the pipe is not known.
Method = Callable[[FrameFacts, Mapping[int, Picture], Pose | None], Profile]


def method_for(calibration: Calibration, colour: ColourProfile | None = None) -> Method:
    """The method of a head, ready for its frames; holds all that the calibration fixes, so make it once.

    Raises AnnulusError for a head that no method here knows. The only place that chooses: the next kind is a line here.
    """
    if calibration.others and calibration.kind == "slits":
        return _method(StereoReconstructor(calibration, colour=colour).profile)
    match calibration.kind:
        case "slits" | "line":
            one = Reconstructor(calibration, colour=colour)
            return _method(lambda images, **known: one.profile(*images.values(), **known))
    raise AnnulusError(
        f"calibration: the head projects {calibration.kind}, for which there is no method frame by frame"
    )


def _method(profile_of: Callable[..., Profile]) -> Method:
    def profile(frame: FrameFacts, pictures: Mapping[int, Picture], seed: Pose | None) -> Profile:
        if frame.z_mm is None or not math.isfinite(frame.z_mm):
            raise ValueError("no place along the pipe is known for this frame")
        return profile_of(pictures, frame=frame.index, z_mm=frame.z_mm, seed=seed, roll_deg=frame.roll_deg)

    return profile


def examined(
    calibration: Calibration, colour: ColourProfile | None, some: Sequence[tuple[int, Mapping[int, Image]]]
) -> tuple[ColourProfile | None, tuple[Finding, ...]]:
    """What (frame, images) of a few flashes spread over a scan decide for all of them: the colour profile to use, None
    where the one given is not this pipe's, and what is wrong with every frame."""
    if calibration.others and calibration.kind == "slits":
        return colour, tuple(swapped(StereoReconstructor(calibration, colour=colour), some))
    alone = [(index, image) for index, images in some for image in images.values()]
    findings = examine(Reconstructor(calibration, colour=colour), alone, colour)
    return None if any(finding.kind == Trouble.PAINT for finding in findings) else colour, findings
