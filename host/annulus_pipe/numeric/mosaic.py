"""A picture as a colour sensor gave it, one colour a pixel: the others are made where somebody needs them.

To make them (`bgr`) takes longer than to read the frame, and three times its memory: who can reads the cells.
"""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.numeric.native import door

ORDERS = ("rggb", "bggr", "grbg", "gbrg")
_thinned = door("mosaic_thinned", "u1[h,w] cells", "i8 every", "b1 green_first", "b1 red_first", "u1[n,m,3]! out")


@dataclass(frozen=True, slots=True, eq=False)
class Mosaic:
    """cells : (H, W) uint8, perhaps read-only and another's memory. order : one of ORDERS, the colours of the first two
    pixels of the first two rows, which repeat."""

    cells: Image
    order: str

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of `bgr()`."""
        height, width = self.cells.shape
        return height, width, 3

    def bgr(self) -> Image:
        """(H, W, 3); a colour that a cell has not is the mean of the next cells that have it."""
        import cv2  # not by whom imports this: a recorder has to be up at once

        return cast(Image, cv2.cvtColor(self.cells, getattr(cv2, f"COLOR_Bayer{self.order.upper()}2BGR")))

    def thinned(self, every: int) -> Image:
        """`bgr()[every // 2 :: every, every // 2 :: every]` to the bit, from the cells there. every : times four."""
        first = every // 2
        rows, columns = (len(range(first, side, every)) for side in self.cells.shape)
        height, width = first + (rows - 1) * every, first + (columns - 1) * every
        if min(rows, columns) < 1 or height + 1 >= self.cells.shape[0] or width + 1 >= self.cells.shape[1]:
            return np.ascontiguousarray(self.bgr()[first::every, first::every])  # OpenCV repeats the margin's neighbour

        out = np.empty((rows, columns, 3), np.uint8)
        cells = np.ascontiguousarray(self.cells)
        _thinned(cells, every, self.order[0] == "g", self.order in ("rggb", "grbg"), out)
        return out


Picture = Mosaic | Image  # what a camera gave: a mosaic, or (H, W, 3) BGR


def bgr_of(picture: Picture) -> Image:
    """(H, W, 3) BGR."""
    return picture.bgr() if isinstance(picture, Mosaic) else picture


def is_colour(picture: Picture, width: int, height: int) -> bool:
    """Whether it is of that size, in colours, 8 bits each."""
    return picture.shape == (height, width, 3) and _dtype(picture) == np.uint8


def in_words(picture: Picture) -> str:
    """Its size and what its values are, to be said of one that was refused: "832x616, 3 of float64"."""
    if len(picture.shape) < 2:
        return f"an array of shape {picture.shape}"
    height, width, *rest = picture.shape
    return f"{width}x{height}, {'x'.join(map(str, rest or [1]))} of {_dtype(picture)}"


def _dtype(picture: Picture) -> np.dtype[Any]:
    return picture.cells.dtype if isinstance(picture, Mosaic) else picture.dtype


def thinned(picture: Picture, every: int) -> Image:
    """The same of every so many pixels of every so many rows, from the middle of the first."""
    if isinstance(picture, Mosaic):
        return picture.thinned(every)
    return np.ascontiguousarray(picture[every // 2 :: every, every // 2 :: every])
