"""Where a stripe's light changes along the line the steepest place of a blurred edge is drawn towards the light: slits
stood hundredths of a pixel aside (aba87d0). Fails without `_drawn` in find_slits."""

import numpy as np
from drawn import calibration

from annulus_pipe.rings.polar import polar_grid, unroll
from annulus_pipe.rings.slits import find_slits

CENTRE, WIDTH, BLUR = 60.3, 9.0, 1.6


def test_light_that_falls_off_does_not_move_a_slit() -> None:
    camera, grid = calibration().camera, polar_grid(calibration(), 72)
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    away = np.hypot(x - grid.centre[0], y - grid.centre[1]) - grid.first
    fine = np.arange(-0.5, 120.0, 1 / 16)
    light = 200.0 * np.exp(-0.03 * np.clip(fine - 30.0, 0.0, 60.0))
    light[np.abs(fine - CENTRE) < WIDTH / 2] = 0.0
    taps = np.exp(-0.5 * (np.arange(-160, 161) / 16 / BLUR) ** 2)
    row = np.convolve(light, taps / taps.sum(), "same")
    image = np.repeat(np.interp(away, fine, row, left=0.0, right=0.0)[..., None], 3, axis=2)
    image += np.random.default_rng(0).uniform(-0.5, 0.5, image.shape)  # rounding must not favour a side
    found = find_slits(unroll(np.clip(np.rint(image), 0, 255).astype(np.uint8), grid), grid)
    near = found.position[np.abs(found.position - CENTRE) < 3]
    assert len(near) == 72
    assert abs(np.median(near) - CENTRE) < 0.02
