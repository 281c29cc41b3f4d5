"""A picture as a colour sensor gave it, one colour a pixel: the others are made where somebody needs them.

To make them (`bgr`) takes longer than to read the frame, and three times its memory: who can reads the cells.
"""

from dataclasses import dataclass
from typing import cast

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


def has_bytes(picture: Picture) -> bool:
    """Whether its values are of 8 bits."""
    return bool((picture.cells if isinstance(picture, Mosaic) else picture).dtype == np.uint8)


def thinned(picture: Picture, every: int) -> Image:
    """The same of every so many pixels of every so many rows, from the middle of the first."""
    if isinstance(picture, Mosaic):
        return picture.thinned(every)
    return np.ascontiguousarray(picture[every // 2 :: every, every // 2 :: every])
