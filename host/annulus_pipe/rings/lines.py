"""Bright lines along every polar line, to a fraction of a pixel, and which ring each is: for heads of laser rings or
planes, one colour, dark between.

Assumed: a line is brighter than what is beside it, about as wide all round, and its light is symmetrical about its
cone. What carries it: a ridge lies where the smoothed light's slope is nought, at a scale that fits the line's width
(Steger 1998: at least the half width over root 3), so neither a slope of the light beside it nor full scale moves it.
Rings are told apart by their order from the inside and by the wall that they would make.

When it breaks: a reflection is a line, too. It is believed only where it is as strong as lines of this frame are, no
stronger one on its polar line makes as good a wall, and its neighbours go on from it; two that are alike are none.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.polar import ACROSS, PolarGrid, sampled
from annulus_pipe.rings.slits import Slits

# Guarded by test_lines (place, gaps, reflections, noise) as a whole; not tried one by one.
PER_LINE = 12  # ridges kept of one polar line, the strongest
FIRST_SCALE_PX = 1.5  # of the look that tells how wide lines are
SCALE_LEAST_PX = 1.0  # of the look that measures them, standard deviation: finer, pixels show
SCALE_MOST_PX = 8.0  # .. and coarser, neighbouring lines run together
LEAST_PART = 0.2  # of the frame's usual line: what is fainter is a reflection or dirt
LEAST_SIGMA = 5.0  # times what noise makes of a ridge
NOISE_LEAST = 0.3  # grey levels: of rounding alone
SKIP = 0.5  # price of leaving a ridge out ..
STRONG = 2.0  # .. more of one of full strength; ..
PLACE = 6.0  # .. of a wall that is off by the whole tolerance
MOSAIC_PX = 0.05  # standard deviation, see `line_bias`
DRAWN_OF_WIDTH = 0.01  # of a line's width, standard deviation, see there
MARGIN = 0.2  # a name is given only if every other reading is worse by this


def find_lines(image: NDArray[np.uint8], grid: PolarGrid) -> tuple[Slits, FloatArray]:
    """Ridges of one frame (H, W, 3) uint8, as slits are given: both sides have the light of the ridge itself.

    Also (N,) how strong each is, 1 for the frame's usual line.
    """
    plane = np.ascontiguousarray(image.max(axis=2))
    lines = sampled(plane, grid)
    top = np.asarray(cv2.GaussianBlur(lines.astype(np.float32), (1, 3), sigmaX=1.0, sigmaY=ACROSS)[1:-1])
    stop = np.minimum(grid.stop, top.shape[1])
    noise = _noise(top, stop)
    found, wide, _ = _at_scale(top, stop, FIRST_SCALE_PX, noise)
    if len(found):
        strong = found[:, 2] > 0.5 * np.percentile(found[:, 2], 90)
        scale = float(np.clip(np.median(wide[strong]) / 2 / math.sqrt(3), SCALE_LEAST_PX, SCALE_MOST_PX))
        found, wide, crowded = _at_scale(top, stop, scale, noise)
    else:
        crowded = 0
    direction = found[:, 0].astype(np.int64)
    curvature = found[:, 2].astype(np.float64)
    relative = curvature / max(_usual(direction, curvature), 1e-9)
    kept = relative > LEAST_PART
    direction, position, strength = direction[kept], found[kept, 1].astype(np.float64), relative[kept]
    pixels = np.rint(grid.pixels(direction, position)).astype(np.int64)
    pixels = np.clip(pixels, 0, np.array(image.shape[1::-1]) - 1)
    light = image[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    slits = Slits(
        direction,
        position,
        wide[kept].astype(np.float64),
        light,
        light,
        1.0 / np.maximum(strength, 1e-6),
        int(np.count_nonzero(~kept)),
        crowded,
    )
    return slits, strength


def _noise(top: NDArray[np.float32], stop: NDArray[np.int64]) -> float:
    """Standard deviation of the dark between lines, grey levels. Where most of it does not change at all (drawn, or a
    codec's black), what changes is the lines."""
    step = np.abs(np.diff(top, axis=1))[np.arange(1, top.shape[1]) < stop[:, None]]
    changes = step[step != 0]
    usual = float(np.median(changes)) if len(changes) > 0.5 * len(step) else 0.0
    return max(SIGMA_OF_MAD / math.sqrt(2) * usual, NOISE_LEAST)


def _at_scale(
    top: NDArray[np.float32], stop: NDArray[np.int64], scale: float, noise: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """(N, 3) direction, position and curvature of the ridges at one scale (px), (N,) their width at half height (px),
    and how many were too many for their polar line."""
    half = math.ceil(4 * scale)
    x = np.arange(-half, half + 1) / scale
    bell = np.exp(-0.5 * x * x)
    bell /= bell.sum()
    first, second = x * bell / scale, (x * x - 1) * bell / scale**2  # correlated, so the odd one's sign is turned
    second -= second.mean()
    smooth, slope, curve = (
        cv2.sepFilter2D(top, cv2.CV_32F, kernel, np.ones(1), borderType=cv2.BORDER_REPLICATE)
        for kernel in (bell, first, second)
    )
    floor = LEAST_SIGMA * noise * float(np.linalg.norm(second))
    out = np.empty((len(top) * PER_LINE, 4), np.float32)
    crowded = np.zeros(1, np.int64)
    n = _ridges(smooth, slope, curve, np.ascontiguousarray(stop, np.int64), floor, PER_LINE, out, crowded)
    return out[:n, :3], out[:n, 3], int(crowded[0])


def _usual(direction: NDArray[np.int64], strength: FloatArray) -> float:
    """The strongest ridge of a polar line, the median over the lines that have any."""
    if not len(direction):
        return 1.0
    first = np.flatnonzero(np.append(True, np.diff(direction) > 0))
    return float(np.median(np.maximum.reduceat(strength, first)))


def line_bias(lines: Slits) -> float:
    """px, standard deviation of what all ridges of a frame may be off alike: light of one colour falls on a quarter of
    a mosaic's pixels, and changes across a line."""
    width = float(np.median(lines.width)) if len(lines.width) else 0.0
    return math.hypot(MOSAIC_PX, DRAWN_OF_WIDTH * width)


def name_lines(
    direction: NDArray[np.int64], strength: FloatArray, deviation: FloatArray, tolerance: float
) -> NDArray[np.int64]:
    """Ring of every ridge, or NONE.

    Parameters
    ----------
    direction : (N,) rising; ridges of one direction in a run, from the inside. strength : (N,) 1 is the usual one.
    deviation : (N, K) relative deviation of the wall's radius from the pipe's if ridge n were ring k; NaN: cannot be.
    tolerance : the |deviation| of a wall that no strength makes up for.

    Notes
    -----
    As `decode`: each polar line is one alignment of ridges with rings in order, either may be missing; a name is given
    only where the best alignment beats every one that reads that ridge, or that ring, otherwise.
    """
    ring = np.empty(len(direction), np.int64)
    room = PER_LINE * deviation.shape[1]
    places, work = np.empty((2, room), np.int64), np.empty((3, room))
    prices = np.array([SKIP, STRONG, PLACE, MARGIN])
    of, by = np.ascontiguousarray(strength, np.float64), np.ascontiguousarray(deviation, np.float64)
    _align(direction, of, by, tolerance, prices, places, work, ring)
    return ring


_align = door(
    "rings_align_lines",
    "i8[n] direction",
    "f8[n] strength",
    "f8[n,k] deviation",
    "f8 tolerance",
    "f8[4] prices",
    "i8[2,w]! places",
    "f8[3,w]! work",
    "i8[n]! ring",
)
_ridges = door(
    "rings_ridges",
    "f4[j,i] smooth",
    "f4[j,i] slope",
    "f4[j,i] curve",
    "i8[j] stop",
    "f4 least_bend",
    "i8 per_line",
    "f4[m,4]! out",
    "i8[1]! crowded",
    returns="i8",
)
