"""Between two bright stripes a dim one was no light coming back, so its two slits were read as one wide one (851e2e6).
Fails when light must come back by a part of the fall (0.35) instead of a multiple of the slit's own darkness."""

import numpy as np
from drawn import calibration

from annulus_pipe.rings.polar import polar_grid, unroll
from annulus_pipe.rings.slits import find_slits

SLITS, WIDTH, BLUR = (50.0, 74.0), 6.0, 1.0


def test_a_dim_stripe_beside_a_bright_one_is_a_stripe() -> None:
    camera, grid = calibration().camera, polar_grid(calibration(), 72)
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    away = np.hypot(x - grid.centre[0], y - grid.centre[1]) - grid.first
    fine = np.arange(-0.5, 120.0, 1 / 16)
    stripe = np.digitize(fine, SLITS)
    row = np.array([(0.0, 200.0, 0.0), (0.0, 4.0, 22.0), (0.0, 0.0, 200.0)])[stripe]
    row[np.abs(fine[:, None] - SLITS).min(axis=1) < WIDTH / 2] = 0.0
    taps = np.exp(-0.5 * (np.arange(-80, 81) / 16 / BLUR) ** 2)
    blurred = [np.convolve(channel, taps / taps.sum(), "same") for channel in row.T]
    image = np.stack([np.interp(away, fine, channel, left=0.0, right=0.0) for channel in blurred], axis=2)
    image += np.random.default_rng(0).normal(0, 1.5, image.shape)
    found = find_slits(unroll(np.clip(np.rint(image), 0, 255).astype(np.uint8), grid), grid)
    assert len(found.position) == 2 * 72
    assert np.abs(found.position.reshape(-1, 2) - SLITS).max() < 0.8
