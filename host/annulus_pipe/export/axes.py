"""The pipe's frame (x right, y down, z forward along the first straight, mm) in the frames that other programs expect.

Both are turns, not mirror images: what lies at 3 o'clock stays at the right of who looks forward.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError

MM_MAX = 1e8  # of a coordinate
Z_UP = "x right, y forward along the first straight, z up (12 o'clock)"
Y_UP = "x right, y up (12 o'clock), z backward: -z is forward along the first straight"


def z_up(points: NDArray[np.floating]) -> FloatArray:
    """(N, 3) right, down, forward -> right, forward, up: as survey and CAD programs stand."""
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1).astype(np.float64)


def y_up(points: NDArray[np.floating]) -> FloatArray:
    """(N, 3) right, down, forward -> right, up, backward: as glTF demands."""
    return np.stack([points[:, 0], -points[:, 1], -points[:, 2]], axis=1).astype(np.float64)


def in_space(records: NDArray[np.void], file: Path) -> FloatArray:
    """(N, 3) places of a PLY's records, mm. Raises AnnulusError, naming the file, where one is no place."""
    points = np.stack([records[name] for name in "xyz"], axis=1).astype(np.float64)
    if not (np.abs(points) <= MM_MAX).all():
        raise AnnulusError(f"{file}: has points that are nowhere, expected finite x, y, z within 100 km")
    return points
