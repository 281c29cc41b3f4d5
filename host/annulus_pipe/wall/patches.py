"""Patches of the wall's grid, (Z, A) cells whose columns close round the pipe: grown, numbered, measured."""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, LabelArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.native import door

_box_grown = door(
    "box_grown", "b1[z,a] mask", "i8 rows", "i8 columns", "b1 closes", "b1[a]! line", "i4[a]! left", "b1[z,a]! out"
)
_box_opened = door("box_opened", "b1[z,a] mask", "i8 rows", "i8 columns", "b1[z,a]! held", "i4[a]! run", "b1[z,a]! out")
_label_patches = door("label_patches", "b1[z,a] mask", "i4[w]! waiting", "i4[z,a]! label", returns="i8")
_run_lengths = door("run_lengths", "b1[z,a] mask", "f8[z,a]! out")


def grown(mask: BoolArray, rows: int, columns: int, *, closes: bool = True) -> BoolArray:
    """Cells with a marked one within so many rows and columns on either side; columns `closes` round the pipe."""
    mask = np.ascontiguousarray(mask)
    out, width = np.empty(mask.shape, np.bool_), mask.shape[1]
    _box_grown(mask, rows, columns, closes, np.empty(width, np.bool_), np.empty(width, np.int32), out)
    return out


def closed(mask: BoolArray, rows: int, columns: int) -> BoolArray:
    """The mask with gaps closed that are no more than twice so many cells wide one way."""
    ends = np.zeros((2 * rows, mask.shape[1]), bool)
    wide = grown(np.concatenate([ends, mask, ends]), rows, columns)
    return np.asarray(~grown(~wide, rows, columns)[2 * rows : len(wide) - 2 * rows]) | mask


def opened(mask: BoolArray, rows: int, columns: int) -> BoolArray:
    """Cells of the mask that lie in a box of so many rows and columns of it."""
    mask = np.ascontiguousarray(mask)
    held, out = np.empty(mask.shape, np.bool_), np.empty(mask.shape, np.bool_)
    _box_opened(mask, rows, columns, held, np.empty(mask.shape[1], np.int32), out)
    return out


def label_around(mask: BoolArray) -> tuple[LabelArray, int]:
    """Connected parts (corners count): labels 1..n in order of their first rows, and n."""
    label = np.empty(mask.shape, np.int32)
    n = _label_patches(np.ascontiguousarray(mask), np.empty(max(mask.size, 1), np.int32), label)
    return label, int(n)


def runs(mask: BoolArray) -> FloatArray:
    """(Z, A) columns of the run round the pipe that each marked cell lies in; 0 elsewhere."""
    out = np.empty(mask.shape)
    _run_lengths(np.ascontiguousarray(mask), out)
    return out


def without_holes(place: BoolArray) -> BoolArray:
    """The place with the cells it encloses; a hole that reaches the seam of the grid is still enclosed."""
    rows = np.flatnonzero(place.any(axis=1))
    out = place.copy()
    if len(rows):
        part = slice(int(rows[0]), int(rows[-1]) + 1)  # beyond its own rows it encloses nothing
        mine, half = place[part], place.shape[1] // 2
        turned = np.roll(ndimage.binary_fill_holes(np.roll(mine, half, axis=1)), -half, axis=1)
        out[part] = ndimage.binary_fill_holes(mine) | turned
    return out
