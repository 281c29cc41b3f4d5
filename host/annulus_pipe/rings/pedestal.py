"""Light that comes from everywhere, taken off a frame: what a bright pipe throws back on itself, daylight, a veil.

Assumed: a slit is dark in every channel, so what it shows is such light; it changes slowly over the image, and no place
is farther from a slit than a few ring spacings.

What carries it: the least of a channel around each place, smoothed. An edge is looked for in the strongest channel, and
on an orange wall the red of that light is stronger all over than a blue or green stripe: without it the stripe is back.
It also draws edges aside, unlike on two sides of a slit: on a white pipe by a tenth of a pixel.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.jit import jit

# Guarded by tests/scenes/rings/test_pedestal.py, and by scenes s12a and s07a of the benchmark `scenes`.
WINDOW = 3.0  # of the least spacing of rings: whichever stripe it stands on, a slit is in it
SAMPLES = 5.0  # a spacing: how finely the image is looked at for it; some of them hit every slit
LIT = 0.25  # of the frame's bright level: a stripe
WORTH = (
    0.06  # of the bright level, median over stripes: dark pipes and clean scans have up to 0.05, left alone to the bit
)


def without_pedestal(image: NDArray[np.uint8], spacing_px: float) -> NDArray[np.uint8]:
    """The image (H, W, 3) less the light that is no stripe's; itself where that is next to nothing.

    spacing_px : least distance of two rings.
    """
    step = max(int(spacing_px / SAMPLES), 1)
    window = int(WINDOW * spacing_px / step) | 1
    if not _worth_it(image[step // 2 :: 2 * step, step // 2 :: 2 * step], window // 2 | 1):
        return image
    least = cv2.erode(image[step // 2 :: step, step // 2 :: step], np.ones((window, window), np.uint8))
    # no more than the least: a stripe that goes on beyond the last slit must not smooth its own light onto that
    smooth = cv2.blur(cv2.min(cv2.blur(least, (window, window)), least), (window // 4 | 1,) * 2)
    everywhere = cv2.resize(smooth, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.subtract(image, everywhere), np.uint8)


def _worth_it(few: NDArray[np.uint8], window: int) -> bool:
    """Whether the stripes in a coarse look at the frame stand on light that is none of theirs."""
    strongest = np.empty(few.shape[:2], np.uint8)
    bright = _bright(few, strongest)
    least = cv2.erode(strongest, np.ones((window, window), np.uint8))
    return bool(_under_stripes(strongest, least, LIT * bright) > WORTH * bright)


@jit
def _bright(few, strongest):  # type: ignore[no-untyped-def]
    """The bright level: the 97th percentile, between ranks, of every fourth pixel. Writes max(B, G, R)."""
    counted = np.zeros(256, np.int64)
    for y in range(few.shape[0]):
        for x in range(few.shape[1]):
            strongest[y, x] = max(max(few[y, x, 0], few[y, x, 1]), few[y, x, 2])
            if not (y & 1 or x & 1):
                counted[strongest[y, x]] += 1
    return _between(counted, 0.97)


@jit
def _under_stripes(strongest, least, limit):  # type: ignore[no-untyped-def]
    """Median of `least` where `strongest` is beyond a limit; 0 of nothing."""
    counted = np.zeros(256, np.int64)
    for y in range(strongest.shape[0]):
        for x in range(strongest.shape[1]):
            counted[least[y, x]] += strongest[y, x] > limit
    return _between(counted, 0.5)


@jit
def _between(counted, part):  # type: ignore[no-untyped-def]
    """The quantile of what was counted by level, linear between two ranks as numpy's; 0 of nothing."""
    size = counted.sum()
    if size == 0:
        return 0.0
    rank = part * (size - 1)
    level, below = 0, counted[0]  # how many lie at or below the level
    while below <= int(rank):
        level += 1
        below += counted[level]
    after = level
    while after < 255 and below <= int(rank) + 1 and int(rank) + 1 < size:
        after += 1
        below += counted[after]
    return level + (rank - int(rank)) * (after - level)
