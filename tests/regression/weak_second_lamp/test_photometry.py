"""Both lamps at once passed as the LED alone: the witness let chromaticity spread to 0.06 where
an LED frame has less than 0.01 (cfd2ab4). Fails with that bound."""

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.capture.photometry import Light, measure

H, W = 308, 416


def picture(projector: float, led: float) -> NDArray[np.uint8]:
    """Stripes R R G B G around a dark middle over white light; noise of 3 grey levels."""
    y, x = np.mgrid[0:H, 0:W].astype(float)
    radius = np.hypot(x - W / 2 + 0.5, y - H / 2 + 0.5) / (H / 2)
    stripe = np.floor((radius - 0.35) / 0.1).astype(int)
    lit = (stripe >= 0) & (stripe < 5)
    light = np.full((H, W, 3), 100.0 * led)
    light[lit] += projector * np.array([(5, 5, 180), (5, 5, 180), (9, 180, 9), (145, 18, 7), (9, 180, 9)])[stripe[lit]]
    return np.clip(light + np.random.default_rng(0).normal(2, 3, light.shape), 0, 255).astype(np.uint8)


def test_two_lamps_at_once_are_not_one() -> None:
    assert measure(picture(0.0, 1.0)).light is Light.LED
    assert measure(picture(0.8, 1.0)).light is Light.BOTH
