"""How much the hue of a picture varies: what tells light of one colour from stripes of several."""

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray

# Variance of chromaticity, 0..2/3: of the white LED's light on a wall of one colour at most, of the projector's stripes
# at least. test_photometry and test_weak_second_lamp.
LED_SPREAD_MAX = 0.015
PROJECTOR_SPREAD_MIN = 0.18


def spread(light: FloatArray, pure: FloatArray) -> FloatArray:
    """Brightness-weighted variance of chromaticity from sums over pixels, one a column; 0 where there is no light.

    light (3, N): of each channel. pure (3, N): of each channel's light times its share of the pixel's.
    """
    weight = np.maximum(light.sum(0), 1e-9)
    found: FloatArray = np.maximum((pure / weight).sum(0) - ((light / weight) ** 2).sum(0), 0.0)
    return found
