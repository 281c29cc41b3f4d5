"""Which light a frame shows, judged from the picture alone: the witness that checks what timing says.

The projector throws pure red, green and blue stripes, so hue differs from place to place; the LED is white, so hue is
that of the wall everywhere, even on a yellow one. The variance of chromaticity over the picture, weighted with
brightness, is 0.3 to 0.4 for the one, below 0.01 for the other, whatever the gain, pose or exposure.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

THUMBNAIL_SIDE = 96  # samples along the shorter side; stripes must not melt into one another
NOISE_GREY = 5.0  # a channel below this says nothing of hue
DARK_GREY = 20.0  # brightest percentile of an unlit frame stays below
LED_SPREAD_MAX = 0.015
PROJECTOR_SPREAD_MIN = 0.18
LIT_EVERYWHERE = 0.5  # of the samples: stripes alone never light that many


class Light(StrEnum):
    """What a picture shows. UNCLEAR: lit, but by nothing that is known."""

    DARK = "dark"
    PROJECTOR = "projector"
    LED = "led"
    BOTH = "both"
    UNCLEAR = "unclear"


@dataclass(frozen=True, slots=True)
class Photometry:
    """Thumbnail statistics of one frame."""

    peak: float  # 99th percentile of the brightest channel, grey levels
    lit: float  # fraction of the samples brighter than a fifth of the peak
    spread: float  # brightness-weighted variance of chromaticity, 0..2/3

    @property
    def light(self) -> Light:
        if self.peak < DARK_GREY:
            return Light.DARK
        if self.spread <= LED_SPREAD_MAX:
            return Light.LED
        if self.spread >= PROJECTOR_SPREAD_MIN:
            return Light.PROJECTOR
        return Light.BOTH if self.lit >= LIT_EVERYWHERE else Light.UNCLEAR


def measure(image: NDArray[np.uint8]) -> Photometry:
    """Statistics of a frame, (H, W, 3) BGR or (H, W) raw RGGB mosaic.

    Samples single pixels (or 2x2 cells), never averages: an average over a stripe's edge is white.
    """
    channels = _samples(image)
    brightest = np.maximum(np.maximum(channels[0], channels[1]), channels[2])
    peak = float(np.percentile(brightest, 99))
    says_hue = brightest > NOISE_GREY
    total = np.where(says_hue, channels[0] + channels[1] + channels[2], 1.0)
    weight = np.where(says_hue, total, 0.0)
    weight_sum = float(weight.sum())
    if weight_sum <= 0.0:
        return Photometry(peak, 0.0, 0.0)
    spread = 0.0
    for channel in channels:
        chroma = channel / total
        mean = float(np.vdot(weight, chroma)) / weight_sum
        spread += float(np.vdot(weight, (chroma - mean) ** 2)) / weight_sum
    return Photometry(peak, float((brightest > 0.2 * peak).mean()), spread)


def _samples(image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Blue, green, red of every so many pixels."""
    step = max(1, min(image.shape[:2]) // THUMBNAIL_SIDE)
    if image.ndim == 3:
        pixels = image[step // 2 :: step, step // 2 :: step].astype(np.float32)
        return pixels[..., 0].copy(), pixels[..., 1].copy(), pixels[..., 2].copy()
    step = max(2, step + step % 2)  # stay on the mosaic's 2x2 cells
    rows, columns = (side // 2 * 2 for side in image.shape)
    cells = image[:rows, :columns]
    green = np.multiply(cells[0::step, 1::step].astype(np.float32) + cells[1::step, 0::step], np.float32(0.5))
    return cells[1::step, 1::step].astype(np.float32), green, cells[0::step, 0::step].astype(np.float32)
