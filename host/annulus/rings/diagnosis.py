"""What is wrong with the frames themselves, in words a user can act on: light, flips, colours, the pipe's radius."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

EVERY = 8  # pixels: light varies slowly enough
DARK = 14.0  # grey levels; no stripe is so dim, and no sensor's black so bright
LIT_OF_BRIGHT = 0.25  # a pixel with this part of the frame's bright level is stripe and not slit
CLIPPED = 250  # grey level: JPEG moves full scale about by a few
CLIPPED_MOST = 0.25  # of the stripes may have their own channel at full scale: edges stay where they are ..
LOST_MOST = 0.05  # .. but where a second one is, the colour is gone
NAMES_MOST = 4  # frames named in one line


class Trouble(StrEnum):
    DARK = "dark"
    OVER_EXPOSED = "over-exposed"
    FLIPPED = "flipped"
    RADIUS = "radius"
    COLOURS = "colours"
    PAINT = "paint"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong: its kind for programs, one line for people, and the frames it was seen in."""

    trouble: Trouble
    text: str
    frames: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Exposure:
    """How one frame is lit. `bright`: grey level of the brightest channel that one pixel in two hundred exceeds.
    `clipped`: share of the lit pixels with a channel at full scale; `lost`: with two, so that no colour is left."""

    bright: float
    clipped: float
    lost: float

    @property
    def dark(self) -> bool:
        return self.bright < DARK

    @property
    def over_exposed(self) -> bool:
        return self.clipped > CLIPPED_MOST or self.lost > LOST_MOST


def diagnose(image_bgr: NDArray[np.uint8]) -> Exposure:
    """Light of one frame, (H, W, 3) uint8, from every eighth pixel of every eighth row."""
    some = np.ascontiguousarray(image_bgr[EVERY // 2 :: EVERY, EVERY // 2 :: EVERY])
    blue, green, red = cv2.split(some)
    larger, smaller = cv2.max(blue, green), cv2.min(blue, green)
    top, second = cv2.max(larger, red), cv2.max(smaller, cv2.min(larger, red))
    above, lost = (np.cumsum(np.bincount(np.ravel(c), minlength=256)[::-1])[::-1] for c in (top, second))
    bright = int(np.flatnonzero(above > 0.005 * above[0])[-1])
    lit = max(int(above[int(max(LIT_OF_BRIGHT * bright, 1))]), 1)
    return Exposure(float(bright), float(above[CLIPPED]) / lit, float(lost[CLIPPED]) / lit)


def exposure_findings(exposures: Sequence[tuple[int, Exposure]]) -> tuple[Finding, ...]:
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
    return tuple(out)


def _named(frames: Sequence[int]) -> str:
    shown = ", ".join(str(frame) for frame in frames[:NAMES_MOST])
    more = len(frames) - NAMES_MOST
    return f"frame{'s' if len(frames) > 1 else ''} {shown}" + (f" and {more} more" if more > 0 else "")
