"""A CT in Hounsfield units, or in any grey with plastic near nought, was refused: "no cylinder in the volume".

What lies beyond the image was taken for nought, which is plastic where air is -1000: a ray never left the pipe.
"""

import numpy as np
import pytest

from annulus_pipe.wings.joints.measure.axis import circle_of

PIXEL = (0.3, 0.3)


@pytest.mark.parametrize(("air", "plastic"), [(-1000.0, -60.0), (-9.0, -1.0), (0.0, 0.02), (150.0, 1900.0)])
def test_a_pipe_is_seen_in_any_grey(air: float, plastic: float) -> None:
    y, x = np.mgrid[:120, :120] * PIXEL[0]
    rho = np.hypot(x - 18.3, y - 17.6)
    solid = np.clip(0.5 + (15.0 - rho) / PIXEL[0], 0, 1) * np.clip(0.5 + (rho - 11.0) / PIXEL[0], 0, 1)
    image = (air + (plastic - air) * solid).astype(np.float32)
    circle = circle_of(image, PIXEL, 0.5 * (air + plastic))
    assert circle == pytest.approx((18.3, 17.6, 15.0), abs=0.02)
