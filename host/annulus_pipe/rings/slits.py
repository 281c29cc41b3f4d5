"""Dark slits along every polar line, to a fraction of a pixel, with the light on both sides of each.

Assumed: a slit is dark between two lit stripes, wider than its blur; light along a stripe changes slowly.

What carries it: an edge is where the strongest channel's slope is steepest, which neither the stripes' unequal
brightness nor their slope moves; a slit is halfway between its two edges, so blur moves it only as far as it blurs the
two unlike. All thresholds are parts of the light beside the slit or of the frame's own bright level and noise.

When it breaks: noise scatters places, which `uncertainty` measures in the frame itself; light at full scale
cuts half an edge away, which `uncertainty` counts; what is merely dim (a shadow, a groove) is `shallow`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import Like, door
from annulus_pipe.rings.polar import PolarGrid, Unrolled

# Parts of light unless named. What is found at all is measured by topic colour (share of visible points read) and
# test_slits; where an edge lies by topics uncertainty and diameter. PER_LINE: unguarded.
PER_LINE = 48  # slits kept of one line; a wall that shows more is not a wall
FALL = 0.72  # a slit is darker than this part of the light before it and after it
SHALLOW = 0.65  # a slit is at least this part as deep as the frame's usual one
HALFWAY = 0.5  # an edge ends where this part of the light is back ..
LEVEL = 0.4  # .. and the slope is down to this part of its steepest
CLEAR = 5  # samples from an edge, where its blur has ended
BESIDE = 8  # .. and over how many more the light's slope is read
STEEPEST = 4.0  # a power of the distance from the centre: light that changes faster is another edge
BLUR_MOST = 9.0  # samples: no edge is taken for softer
FAINT = 0.03  # stripes dimmer than this part of the frame's bright level are darkness


@dataclass(frozen=True, slots=True, eq=False)
class Slits:
    """What was found, sorted by direction, then outwards. Positions in samples of the grid's lines."""

    direction: NDArray[np.int64]  # (N,)
    position: NDArray[np.float64]  # (N,) halfway between the two edges
    width: NDArray[np.float64]  # (N,) between the edges
    inside: NDArray[np.float64]  # (N, 3) BGR of the stripe on the inner side, the slit's own darkness taken off
    outside: NDArray[np.float64]  # (N, 3)
    edge_blur: NDArray[np.float64]  # (N,) of both edges: root of the sum of squares of 1 / curvature of the slope there
    shallow: int  # dips left out because they were not nearly as dark as this frame's slits are
    crowded: int  # slits left out because a line had more than PER_LINE


class FrameSlits:
    """The slits of one frame at a time, in memory that is used again for each; of all arrays the first `size` count."""

    def __init__(self, grid: PolarGrid) -> None:
        lines, length = grid.address.shape[0] - 2, grid.address.shape[1]
        most = lines * PER_LINE
        self.grid = grid
        self.size, self.shallow, self.crowded = 0, 0, 0
        self.direction = np.empty(most, np.int64)
        self.position, self.width, self.blur = np.empty(most), np.empty(most), np.empty(most)
        self.light = np.empty((6, most))  # blue, green, red of the stripe inside, then of the one outside
        self.bright = np.empty(most)  # the strongest of either, together
        self._counts, self._limits = np.empty(3, np.int64), np.empty(9, np.float32)
        self._limits[:] = (FALL, HALFWAY, LEVEL, STEEPEST, BLUR_MOST, 0.0, grid.spacing_px, 0.0, grid.step)
        work, marks = np.empty(3 * length + 8, np.float32), np.empty(length + 8, np.uint8)
        depth, samples = np.empty((2, most), np.float32), np.empty((most, 5), np.int32)
        asked = smoothing(grid.spacing_px), self._limits, PER_LINE, CLEAR, BESIDE, SHALLOW, _ways(grid)
        found = self.direction, self.position, self.width, self.blur, depth[1], samples
        written = work, marks, depth[0], *found, self.light, self.bright, self._counts
        top = Like(np.empty(lines * length, np.uint8))
        self._find = {
            channels: _find.held(
                Like(np.empty((*grid.size, channels), np.uint8)), ..., top, grid.stop, ..., ..., *asked, *written
            )
            for channels in (1, 3)
        }

    def find(self, unrolled: Unrolled) -> None:
        """The slits of a frame laid out by `polar.unroll`, the light beside them included."""
        cells, first = unrolled.cells, unrolled.first
        self._limits[5] = max(FAINT * unrolled.bright, 4.0 * unrolled.noise, 2.0)
        self._limits[7] = self.grid.first + self.grid.step * first
        self._find[cells.shape[2]](cells, unrolled.phase, unrolled.flat, first, unrolled.length)
        self.size, self.shallow, self.crowded = self._counts.tolist()

    def take(self, slits: Slits) -> None:
        """What was found some other way, as many as there is room for."""
        n = self.size = min(len(slits.position), len(self.position))
        self.shallow, self.crowded = slits.shallow, slits.crowded
        self.direction[:n], self.position[:n], self.width[:n] = (
            slits.direction[:n],
            slits.position[:n],
            slits.width[:n],
        )
        self.blur[:n], self.light[:3, :n], self.light[3:, :n] = (
            slits.edge_blur[:n],
            slits.inside[:n].T,
            slits.outside[:n].T,
        )
        self.bright[:n] = slits.inside[:n].max(axis=1) + slits.outside[:n].max(axis=1) if n else 0.0

    def slits(self) -> Slits:
        """A copy."""
        n = self.size
        inside, outside = self.light[:3, :n].T.copy(), self.light[3:, :n].T.copy()
        direction, position, width = self.direction[:n].copy(), self.position[:n].copy(), self.width[:n].copy()
        return Slits(direction, position, width, inside, outside, self.blur[:n].copy(), self.shallow, self.crowded)


def find_slits(unrolled: Unrolled, grid: PolarGrid) -> Slits:
    """Slits of one frame laid out by `polar.unroll`.

    Each edge is the steepest place of the strongest channel between a slit's bottom and its stripe, so neither the
    stripes' unequal brightness nor their slope moves it (raw luma does, by up to a millimetre). Thresholds are parts of
    the light beside the slit and of the frame's own bright level and noise.
    """
    table = FrameSlits(grid)
    table.find(unrolled)
    return table.slits()


def _ways(grid: PolarGrid) -> FloatArray:
    """(J, 4) x and y of each line's first sample and of its step, px; half a pixel is added, so that what lies before
    the point is the nearest pixel."""
    way = np.stack([grid.cosine, grid.sine], axis=1)
    return np.hstack([grid.centre + grid.first * way + 0.5, grid.step * way])


def smoothing(spacing_px: float) -> NDArray[np.float32]:
    """Middle and one side of the taps that lines are smoothed with: the stripes of the densest ring survive it."""
    sigma = min(1.4, max(0.6, spacing_px / 16.0))
    taps = np.exp(-0.5 * (np.arange(5) / sigma) ** 2)
    return np.asarray(taps / (taps[0] + 2 * taps[1:].sum()), np.float32)


_find = door(
    "rings_find",
    "u1[h,w,b] image",
    "i8 phase",
    "u1[t] top",
    "i8[j] stop",
    "i8 first",
    "i8 m",
    "f4[5] taps",
    "f4[9] limits",
    "i8 per_line",
    "i8 clear",
    "i8 beside",
    "f4 shallow",
    "f8[j,4] ways",
    "f4[r]! work",
    "u1[q]! marks",
    "f4[n]! depths",
    "i8[n]! direction",
    "f8[n]! place",
    "f8[n]! width",
    "f8[n]! blur",
    "f4[n]! depth",
    "i4[n,5]! samples",
    "f8[6,n]! light",
    "f8[n]! bright",
    "i8[3]! counts",
)
