"""Names of the array types that travel between rooms, and the arc that columns round the clock lie on."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
LabelArray = NDArray[np.int32]  # patches of a grid by their numbers from 1, 0 elsewhere
Chips = NDArray[np.uint8]  # of an on/off code: 0 or 1, chip 0 first
Image = NDArray[np.uint8]  # (H, W) or (H, W, C)


def arc_of(columns: BoolArray, step_deg: float) -> tuple[float, float]:
    """Start and length (deg) of the smallest arc that holds all marked columns: the circle less its widest gap."""
    marked = np.flatnonzero(columns)
    gaps = np.diff(np.append(marked, marked[0] + len(columns)))
    widest = int(np.argmax(gaps))
    start = marked[(widest + 1) % len(marked)]
    return float(start * step_deg), float((len(columns) - gaps[widest] + 1) * step_deg)
