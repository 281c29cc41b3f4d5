"""Where two rolls of a bead meet in a cusp finer than a voxel, T came out up to 1 mm too large, with a k = 2 of 0.2 mm.

A blurred floor lies too high, by how steeply the rolls rise beside it; sigma knew of a tenth of a voxel only.
"""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from annulus_pipe.wings.joints.measure.image import NOTCH_CUSP
from annulus_pipe.wings.joints.measure.surface import Bead, bead_of

VOXEL, FINE, HEIGHT, FLOOR = 0.4, 20, 2.0, 0.3  # mm; parts of a voxel; of a roll; of the roll's height
BLUR = 0.7  # of a voxel


def seen(width: float, flat: float) -> Bead:
    """Two half ellipses of that width, mm, over a floor as wide as `flat`, mm, in voxels."""
    z = np.arange(-12.0, 12.0, VOXEL / FINE)
    away = np.clip(np.abs(z) - 0.5 * flat, 0.0, None)
    roll = HEIGHT * np.sqrt(np.clip(1 - (2 * away / width - 1) ** 2, 0.0, None))
    over = np.where(away < 0.5 * width, np.maximum(roll, FLOOR * HEIGHT), roll)
    voxels = gaussian_filter1d(over, BLUR * FINE)[::FINE][:, None]
    return bead_of(voxels, np.zeros((2, 1)), z[::FINE], (-width, width), 0.3)


@pytest.mark.parametrize("width", [3.0, 4.0, 5.0])
def test_a_cusp_is_no_deeper_than_its_sigma_says(width: float) -> None:
    bead = seen(width, 0.0)
    off = float(bead.notch[0]) - FLOOR * HEIGHT
    assert 0.15 < off < 2 * math.hypot(NOTCH_CUSP * float(bead.cusp[0]), 0.1 * VOXEL)


def test_a_floor_that_is_wide_is_seen() -> None:
    bead = seen(5.0, 3 * VOXEL)
    assert abs(float(bead.notch[0]) - FLOOR * HEIGHT) < 0.05
    assert bead.cusp[0] == 0.0
