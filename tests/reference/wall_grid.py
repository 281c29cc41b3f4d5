"""What host/native/wall_grid.c makes of cells, in NumPy and SciPy."""

import itertools

import numpy as np
from scipy import ndimage

from annulus_pipe.numeric.arrays import FloatArray, IntArray
from annulus_pipe.wall.grid import AROUND_CELLS, BRIDGE_STEP_MM, HALF_SLACK, STEP_MM


def medians(cell: IntArray, value: FloatArray, cells: int, weight: FloatArray | None) -> FloatArray:
    """(cells,) of each cell's values; where they weigh, the mean of those in which half of the weight is reached."""
    out = np.full(cells, np.nan)
    for own in np.unique(cell):
        order = np.flatnonzero(cell == own)
        order = order[np.argsort(value[order])]
        if weight is None:
            out[own] = np.median(value[order])
            continue
        sums = np.cumsum(weight[order])
        low, high = (np.searchsorted(sums, (0.5 + way * HALF_SLACK) * sums[-1]) for way in (-1, 1))
        out[own] = 0.5 * (value[order[low]] + value[order[min(high, len(order) - 1)]])
    return out


def smoothed(field: FloatArray, rows: int) -> FloatArray:
    """(Z, A) median over the seen of `rows` x 3 neighbours."""
    wide = np.pad(
        np.pad(field, ((rows // 2, rows // 2), (0, 0)), constant_values=np.nan), ((0, 0), (1, 1)), mode="wrap"
    )
    near = np.lib.stride_tricks.sliding_window_view(wide, (rows, 3)).reshape(*field.shape, -1)
    out = np.full(field.shape, np.nan, np.float32)
    for at in np.argwhere(np.isfinite(field)):
        values = near[tuple(at)]
        out[tuple(at)] = np.median(values[np.isfinite(values)])
    return out


def extremes(grid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(Z, A) least and greatest of the seen cells about each."""
    about = np.ones((3, 5), dtype=bool)
    about[1, 2] = False
    wide = np.pad(grid, ((0, 0), (2, 2)), mode="wrap")
    missing = ~np.isfinite(wide)
    low = ndimage.minimum_filter(np.where(missing, np.inf, wide), footprint=about, mode="constant", cval=np.inf)
    high = ndimage.maximum_filter(np.where(missing, -np.inf, wide), footprint=about, mode="constant", cval=-np.inf)
    return low[:, 2:-2], high[:, 2:-2]


def bridged(grid: FloatArray, sampling: float) -> FloatArray:
    """(Z, A) gaps filled round the clock, then along the pipe."""
    around = _filled(np.concatenate([grid] * 3, axis=1).T, AROUND_CELLS, BRIDGE_STEP_MM).T
    columns = grid.shape[1]
    return _filled(around[:, columns : 2 * columns], sampling, STEP_MM)


def _filled(grid: FloatArray, cells: float, rise: float) -> FloatArray:
    out = grid.copy()
    for line, to in zip(grid.T, out.T, strict=True):
        seen = np.flatnonzero(np.isfinite(line))
        for a, b in itertools.pairwise(seen):
            if b - a <= cells and -BRIDGE_STEP_MM <= line[b] - line[a] <= rise:
                to[a : b + 1] = line[a] + np.arange(b - a + 1) / (b - a) * (line[b] - line[a])
        to[seen] = line[seen]
    return out
