"""What is wrong with the frames themselves, in words a user can act on: light, flips, colours, the pipe's radius."""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray, arc_of
from annulus_pipe.numeric.chroma import LED_SPREAD_MAX, PROJECTOR_SPREAD_MIN, spread
from annulus_pipe.numeric.mosaic import Picture, thinned
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.rounding import clock_face
from annulus_pipe.rings.calibration.reference import ANGLE_FAR, SHIFT_FAR, Reference
from annulus_pipe.rings.colour import ColourProfile, differs, stripes
from annulus_pipe.rings.order import PlacedSlits
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.rings.slits import Slits
from annulus_pipe.vocabulary import Finding

# Those of `FrameLighting` and RADIUS_OFF are tested from both sides (test_limits, test_diagnosis), SUSPECT and
# FLIP_BETTER by test_diagnosis; CLEAR and CHANNEL_LEAST are a choice: unguarded within a factor of two.
EVERY = 8  # pixels: light varies slowly enough
DARK = 14.0  # grey levels; no stripe is so dim, and no sensor's black so bright
LIT_OF_BRIGHT = 0.25  # a pixel with this part of the frame's bright level is stripe and not slit
CLIPPED = 250  # grey level: JPEG moves full scale about by a few
CLIPPED_MOST = 0.25  # of the stripes may have their own channel at full scale: edges stay where they are ..
LOST_MOST = 0.05  # .. but where a second one is, the colour is gone
FAINT = 5  # grey level: a channel below says nothing of hue
_PART = 1.0 / np.maximum(np.arange(3 * 255 + 1), 1)  # what one grey level is of each brightness of all three channels
SECTORS = 24  # round the image's middle: 15 degrees each
GLARE = 0.5  # of a sector's stripes at full scale, in one frame ..
GLARE_FRAMES = 0.25  # .. and of the frames, before it is said: a bead that shines is not a band
NAMES_MOST = 4  # frames named in one line
RADIUS_OFF = 0.01  # of the radius; less is within what pipes of one size differ by
SUSPECT = 0.0015  # of the radius; points that scatter more about a cylinder are looked at flipped, too
FLIP_BETTER = 0.5  # a flip is believed when it leaves so little of that scatter
CLEAR = 0.15  # a stripe's colour is certain when its channel leads by this
CHANNEL_LEAST = 0.03  # of the strongest; a channel with less light is not used by the pattern
_frame_light = door(
    "frame_light",
    "u1[n,m,3] some",
    "u1[n,m] sector",
    "i8 faint",
    "i8[s,256]! tops",
    "i8[256]! seconds",
    "i8[3]! light",
    "i8[3,766]! squares",
)
KEPT, TURNED = slice(None), slice(None, None, -1)
FLIPS = {  # in words, and of which axes of the image
    "mirrored left to right": (KEPT, TURNED),
    "mirrored upside down": (TURNED, KEPT),
    "turned upside down": (TURNED, TURNED),
}


class Trouble(StrEnum):
    DARK = "dark"
    OVER_EXPOSED = "over-exposed"
    FLIPPED = "flipped"
    RADIUS = "radius"
    COLOURS = "colours"
    PAINT = "paint"
    REFERENCE = "reference"
    LAMP = "lamp"


@dataclass(frozen=True, slots=True)
class FrameLighting:
    """How one frame is lit. `bright`: grey level of the brightest channel that one pixel in two hundred exceeds.
    `clipped`: share of the lit pixels with a channel at full scale; `lost`: with two, so that no colour is left.
    `hues`: variance of chromaticity, 0..2/3: 0.3 to 0.4 of stripes, below 0.01 of a white lamp on one wall."""

    bright: float
    clipped: float
    lost: float
    hues: float
    glare: int = 0  # sectors, one a bit, clockwise from the top, in which most of the stripes are at full scale
    picture: int = 0  # CRC-32 of the pixels looked at: no camera takes the same picture twice; 0 where not known

    @property
    def dark(self) -> bool:
        return self.bright < DARK

    @property
    def over_exposed(self) -> bool:
        return self.clipped > CLIPPED_MOST or self.lost > LOST_MOST

    @property
    def of_led(self) -> bool:
        """Whether one hue is all there is: no stripes of a slide of several colours."""
        return not self.dark and self.hues <= LED_SPREAD_MAX

    @property
    def of_projector(self) -> bool:
        return not self.dark and self.hues >= PROJECTOR_SPREAD_MIN


def diagnose(picture: Picture) -> FrameLighting:
    """Light of one frame, from every eighth pixel of every eighth row."""
    some = thinned(picture, EVERY)
    tops, seconds = np.empty((SECTORS, 256), np.int64), np.empty(256, np.int64)
    light, squares = np.empty(3, np.int64), np.empty((3, len(_PART)), np.int64)
    _frame_light(some, _sectors(*some.shape[:2]), FAINT, tops, seconds, light, squares)
    above, lost = (_from_there_on(counts) for counts in (tops.sum(axis=0), seconds))
    bright = int(np.flatnonzero(above > 0.005 * above[0])[-1])
    least = int(max(LIT_OF_BRIGHT * bright, 1))
    lit = max(int(above[least]), 1)
    lit_of, clipped_of = tops[:, least:].sum(axis=1), tops[:, CLIPPED:].sum(axis=1)
    glare = np.flatnonzero(clipped_of > GLARE * np.maximum(lit_of, 1))
    return FrameLighting(
        float(bright),
        float(above[CLIPPED]) / lit,
        float(lost[CLIPPED]) / lit,
        float(spread(light.astype(np.float64), squares @ _PART)),  # sums of whole numbers: exact
        int(sum(1 << int(i) for i in glare)),
        zlib.crc32(some.data),
    )


def _from_there_on(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many have a level or a higher one."""
    return np.cumsum(counts[::-1])[::-1]


@lru_cache(maxsize=4)
def _sectors(rows: int, columns: int) -> NDArray[np.uint8]:
    """(H, W) which sector a pixel lies in, clockwise from the top."""
    y, x = np.mgrid[:rows, :columns] - 0.5 * np.array([rows - 1, columns - 1])[:, None, None]
    turn = np.arctan2(x, -y) / (2 * np.pi) % 1.0
    return np.asarray(np.minimum(turn * SECTORS, SECTORS - 1), np.uint8)


def reference_findings(reference: Reference, poses: Sequence[Pose]) -> tuple[Finding, ...]:
    """Whether a reference was learnt near enough to where the head stood to vouch for its correction there."""
    if not poses:
        return ()
    angle, shift = reference.distance(poses)
    if angle <= ANGLE_FAR and shift <= SHIFT_FAR * reference.radius_mm:
        return ()
    return (
        Finding(
            Trouble.REFERENCE,
            f"the head went {math.degrees(angle):.1f} degrees and {shift:.1f} mm from where the reference was taken: "
            "the correction is weaker there; take reference frames in such poses, too",
        ),
    )


def exposure_findings(exposures: Sequence[tuple[int, FrameLighting]]) -> tuple[Finding, ...]:
    """What (frame, exposure) of a scan's projector frames say: frames without light, frames with too much of it."""
    out: list[Finding] = []
    dark = tuple(frame for frame, exposure in exposures if exposure.dark)
    if dark:
        level = max(exposure.bright for _, exposure in exposures if exposure.dark)
        what = "all dark" if len(dark) == len(exposures) else f"{len(dark)} of {len(exposures)} projector frames dark"
        out.append(
            Finding(
                Trouble.DARK,
                f"{what} (nothing brighter than {level:.0f} of 255 in {_named(dark)}): "
                "lens cap on, projector off, or its flash outside the exposure",
                dark,
            )
        )
    over = [(frame, exposure) for frame, exposure in exposures if exposure.over_exposed]
    if over:
        frames = tuple(frame for frame, _ in over)
        clipped, lost = (100 * max(part) for part in zip(*((e.clipped, e.lost) for _, e in over), strict=True))
        harm = f"in {lost:.0f} % the colour is lost" if lost > 100 * LOST_MOST else "colours can still be read"
        out.append(
            Finding(
                Trouble.OVER_EXPOSED,
                f"{len(over)} of {len(exposures)} projector frames over-exposed: up to {clipped:.0f} % of the stripes "
                f"at full scale, {harm} ({_named(frames)}); shorten the projector's flash or lower the gain",
                frames,
            )
        )
    often = [sum(e.glare >> i & 1 for _, e in exposures) > GLARE_FRAMES * len(exposures) for i in range(SECTORS)]
    if any(often) and not all(often):
        start, arc = arc_of(np.array(often), 360.0 / SECTORS)
        where = f"{clock_face(start)} to {clock_face(start + arc)}"
        text = (
            f"a band is over-exposed as the camera sees it, clock {where}: most stripes there are at full scale in "
            f"more than {100 * GLARE_FRAMES:.0f} % of the projector frames, "
            "edges are drawn outwards and colours may be misread"
        )
        out.append(Finding(Trouble.OVER_EXPOSED, text))
    return tuple(out)


def lamp_findings(frames: Sequence[int], many: int, shown: str, labelled: str) -> tuple[Finding, ...]:
    """What is said of frames whose picture shows another lamp than their label, of so many with that label."""
    if not frames:
        return ()
    text = (
        f"{len(frames)} of {many} frames labelled {labelled} show the light of the {shown} ({_named(frames)}): their "
        "labels are wrong, and where each was taken may be, too; left out"
    )
    return (Finding(Trouble.LAMP, text, tuple(frames)),)


def _named(frames: Sequence[int]) -> str:
    shown = ", ".join(str(frame) for frame in frames[:NAMES_MOST])
    more = len(frames) - NAMES_MOST
    return f"frame{'s' if len(frames) > 1 else ''} {shown}" + (f" and {more} more" if more > 0 else "")


def examine(
    reconstructor: Reconstructor, frames: Sequence[tuple[int, NDArray[np.uint8]]], colour: ColourProfile | None = None
) -> tuple[Finding, ...]:
    """What (frame, image) of a few projector frames say against the calibration, the pipe's radius and its colours.

    Colours are not trusted for it: slits are named by their order. Flips show only where the head is asymmetric enough
    for them to matter; then the right way round leaves much less scatter than the wrong one. A few tens of milliseconds
    a frame.
    """
    calibration = reconstructor.calibration
    if calibration.kind == "line":
        profiles = [reconstructor.profile(image, frame=frame, z_mm=0.0) for frame, image in frames]
        seen = [profile for profile in profiles if profile.pose is not None]
        if not seen:
            return ()
        radii = [float(np.median(np.hypot(*profile.points_mm[:, :2].T))) for profile in seen]
        spread = float(np.median([profile.residual_mm for profile in seen]))
        return _radius_off(float(np.median(radii)), spread, calibration, tuple(profile.frame for profile in seen))
    placed: list[tuple[int, Slits, PlacedSlits]] = []
    for frame, image in frames:
        slits, place = reconstructor.slits_by_order(image)
        if place is not None:
            placed.append((frame, slits, place))
    if not placed:
        return ()
    names = tuple(frame for frame, _, _ in placed)
    out: list[Finding] = []
    scatter = float(np.median([place.fit.robust_sigma_mm for _, _, place in placed]))
    flip = _flip(reconstructor, frames, scatter) if scatter > SUSPECT * calibration.pipe_radius_mm else None
    if flip is not None:
        out.append(Finding(Trouble.FLIPPED, flip, names))
    radius = float(np.median([place.radius_mm for _, _, place in placed]))
    if flip is None:
        out += _radius_off(radius, scatter, calibration, names)
    read = _sequence([(slits, place) for _, slits, place in placed], calibration)
    if read is not None and read != calibration.colours:
        swapped = read.translate(str.maketrans("RB", "BR")) == calibration.colours
        why = "red and blue are exchanged" if swapped else "another slide, or the pattern section is wrong"
        out.append(
            Finding(
                Trouble.COLOURS,
                f"the stripes read {read} from the innermost outwards, the calibration says {calibration.colours}: "
                f"{why}",
                names,
            )
        )
    elif colour is not None:
        unlike = differs(colour, [stripes(slits, place, calibration) for _, slits, place in placed])
        if unlike is not None:
            out.append(
                Finding(
                    Trouble.PAINT,
                    f"the pipe or the white balance is not the colour profile's: {unlike}; its own colours were used",
                    names,
                )
            )
    return tuple(out)


def _radius_off(radius: float, scatter: float, calibration: Calibration, names: tuple[int, ...]) -> tuple[Finding, ...]:
    off = radius - calibration.pipe_radius_mm
    if abs(off) <= max(RADIUS_OFF * calibration.pipe_radius_mm, 2.0 * scatter):
        return ()
    return (
        Finding(
            Trouble.RADIUS,
            f"the pipe is not the calibration's: every ring lies {abs(off):.2f} mm "
            f"{'out' if off > 0 else 'in'}side its radius of {calibration.pipe_radius_mm:.2f} mm, "
            f"this pipe's is about {radius:.2f} mm",
            names,
        ),
    )


def _flip(reconstructor: Reconstructor, frames: Sequence[tuple[int, NDArray[np.uint8]]], scatter: float) -> str | None:
    """In words, if the images fit the calibration far better flipped."""
    best, least = "", scatter
    for name, (rows, columns) in FLIPS.items():
        places = [reconstructor.slits_by_order(np.ascontiguousarray(image[rows, columns]))[1] for _, image in frames]
        spreads = [place.fit.robust_sigma_mm for place in places if place is not None]
        if 2 * len(spreads) > len(frames) and float(np.median(spreads)) < least:
            best, least = name, float(np.median(spreads))
    if not best or least > FLIP_BETTER * scatter:
        return None
    return (
        f"the images are {best} against the calibration: points scatter {scatter:.2f} mm about the pipe as they are, "
        f"{least:.2f} mm flipped back. Set the camera's flip as it was when it was calibrated"
    )


def _sequence(seen: Sequence[tuple[Slits, PlacedSlits]], calibration: Calibration) -> str | None:
    """The stripes' colours as the frames show them, None where one is not clear."""
    rings = len(calibration.rings)
    total = np.zeros((rings + 1, 3))
    values: list[list[FloatArray]] = [[] for _ in range(rings + 1)]
    for slits, place in seen:
        for k in range(rings):
            mine = place.ring == k
            values[k].append(slits.inside[mine])
            values[k + 1].append(slits.outside[mine])
    for k, parts in enumerate(values):
        stacked = np.concatenate(parts)
        if not len(stacked):
            return None
        total[k] = np.median(stacked, axis=0)[::-1]
    level = total.max(axis=0)
    used = level > CHANNEL_LEAST * level.max()
    scaled = np.where(used, total / np.maximum(level, 1e-9), 0.0)
    scaled /= np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-9)
    ordered = np.sort(scaled, axis=1)
    if (ordered[:, 2] - ordered[:, 1] < CLEAR).any():
        return None
    return "".join("RGB"[i] for i in scaled.argmax(axis=1))
