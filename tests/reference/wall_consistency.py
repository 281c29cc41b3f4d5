"""What host/native/wall_consistency.c decides, point by point."""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray


def votes(
    cell: IntArray,
    frame: IntArray,
    radius: FloatArray,
    weight: FloatArray,
    slack: float,
    needed: int,
    part: float,
    rows: int,
    columns: int,
) -> BoolArray:
    """(N,) not contradicted by the points of other frames in its own cell and the eight about it."""
    row, column = np.divmod(cell, columns)
    good = np.ones(len(cell), bool)
    for p in range(len(cell)):
        beside = np.abs((column - column[p] + columns // 2) % columns - columns // 2) <= 1
        others = beside & (np.abs(row - row[p]) <= 1) & (frame != frame[p])
        agree = others & (np.abs(radius - radius[p]) <= slack)
        if np.count_nonzero(others) >= needed:
            good[p] = weight[agree].sum() >= part * weight[others].sum()
    return good
