"""Rings followed round an image: what is left out before they calibrate anything."""

import numpy as np
from drawn import calibration, draw

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.calibration.contours import follow, wide_grid


def test_slits_beside_over_exposed_stripes_go_where_enough_of_their_ring_is_left() -> None:
    cal = calibration(scale=0.5)
    image = draw(cal, Pose(0.0, 0.0, 1.0, -1.0))
    grid = wide_grid(cal.camera, np.array([cal.camera.cx, cal.camera.cy]))
    whole = follow(image, grid, cal.colours)
    assert not whole.clipped.any() and len(whole.whole().ring) == len(whole.ring)

    right = image.copy()
    half = right[:, right.shape[1] // 2 :]
    half[half.max(axis=2) > 0.7 * image.max()] = 255  # what lies to the right is too near to the lamp
    seen = follow(right, grid, cal.colours)
    left_of = seen.pixels[:, 0] < right.shape[1] / 2 - 8
    assert not seen.clipped[left_of].any()
    kept = seen.whole()
    assert not kept.clipped.any() and len(kept.ring) >= np.count_nonzero(left_of)

    everywhere = np.where(image.max(axis=2, keepdims=True) > 0.5 * image.max(), np.uint8(255), image)
    seen = follow(np.ascontiguousarray(everywhere), grid, cal.colours)
    assert len(seen.whole().ring) == len(seen.ring)  # nothing would be left
