"""Light that comes from everywhere, taken off a frame: what a bright pipe throws back on itself, daylight, a veil.

Assumed: a slit is dark in every channel, so what it shows is such light; it changes slowly over the image, and no place
is farther from a slit than a few ring spacings.

What carries it: the least of a channel around each place, smoothed. An edge is looked for in the strongest channel, and
on an orange wall the red of that light is stronger all over than a blue or green stripe: without it the stripe is back.
It also draws edges aside, unlike on two sides of a slit: on a white pipe by a tenth of a pixel.
"""

from collections.abc import Callable

import numpy as np

from annulus_pipe.numeric.mosaic import Picture, bgr_of
from annulus_pipe.numeric.native import Like, door
from annulus_pipe.rings.polar import laid_out

# Guarded by tests/scenes/rings/test_pedestal.py, and by scenes s12a and s07a of the benchmark `scenes`.
WINDOW = 3.0  # of the least spacing of rings: whichever stripe it stands on, a slit is in it
SAMPLES = 5.0  # a spacing: how finely the image is looked at for it; some of them hit every slit
LIT = 0.25  # of the frame's bright level: a stripe
WORTH = (
    0.06  # of the bright level, median over stripes: dark pipes and clean scans have up to 0.05, left alone to the bit
)


class Pedestal:
    """Takes it off frames of one size (H, W), for rings at least `spacing_px` apart; in memory that is used again."""

    def __init__(self, size: tuple[int, int], spacing_px: float) -> None:
        self._step = max(int(spacing_px / SAMPLES), 1)
        self._window = int(WINDOW * spacing_px / self._step) | 1
        self._worth_it = {channels: _look(size, channels, 2 * self._step, self._window // 2 | 1) for channels in (1, 3)}

    def taken_off(self, image: Picture) -> Picture:
        """The frame less the light that is no stripe's; itself where that is next to nothing."""
        cells, phase = laid_out(image)
        if not self._worth_it[cells.shape[2]](cells, phase):
            return image
        image = np.ascontiguousarray(bgr_of(image))
        height, width = image.shape[:2]
        rows, columns = (-(-(size - self._step // 2) // self._step) for size in (height, width))
        out = np.empty((height, width, 3), np.uint8)
        small, sums = np.empty((4, rows, columns, 3), np.uint8), np.empty(3 * columns, np.uint32)
        between = np.empty((2, width), np.int32), np.empty(columns, np.uint64), np.empty((2, 3 * width), np.uint16)
        smooth = (self._window // 4 | 1) // 2
        _without_veil(image, self._step, self._window // 2, smooth, small, sums, *between, out)
        return out


def without_pedestal(image: Picture, spacing_px: float) -> Picture:
    """`Pedestal.taken_off` of one frame."""
    return Pedestal((image.shape[0], image.shape[1]), spacing_px).taken_off(image)


def _look(size: tuple[int, int], channels: int, step: int, window: int) -> Callable[..., int]:
    """Whether stripes stand on light that is none of theirs, by a coarse look: at every step-th pixel."""
    rows, columns = (-(-(one - step // 4) // step) for one in size)
    image, room = Like(np.empty((*size, channels), np.uint8)), np.empty((3, rows, columns), np.uint8)
    return _pedestal.held(image, ..., step, window // 2, LIT, WORTH, *room)


_pedestal = door(
    "rings_pedestal",
    "u1[h,w,c] image",
    "i8 phase",
    "i8 step",
    "i8 half",
    "f8 lit",
    "f8 worth",
    "u1[a,b]! strongest",
    "u1[a,b]! rows",
    "u1[a,b]! darkest",
    returns="i8",
)
_without_veil = door(
    "rings_without_veil",
    "u1[h,w,3] image",
    "i8 step",
    "i8 half",
    "i8 smooth",
    "u1[4,a,b,3]! small",
    "u4[m]! sums",
    "i4[2,w]! columns",
    "u8[b]! spread",
    "u2[2,v]! wide",
    "u1[h,w,3]! out",
)
