"""Colour from several cameras: what stands before one of them does not darken what another sees."""

import numpy as np

from annulus_pipe.wall.texture import _unhidden


def test_a_cell_that_one_camera_has_hidden_is_the_others() -> None:
    weight = np.array([[2.0, 2.0, 0.0]], np.float32)
    clear = np.full((1, 3, 3), 100.0, np.float32) * weight[..., None]
    hidden = clear.copy()
    hidden[0, 0] *= 0.3  # something before it
    hidden[0, 1] *= 0.95  # its own light, a little less
    total, known = _unhidden([(clear, weight), (hidden, weight)])
    colour = total[0, :2, 0] / known[0, :2]
    assert colour[0] == 100.0
    assert 97.0 < colour[1] < 98.0
    assert known[0].tolist() == [2.0, 4.0, 0.0]
    assert _unhidden([(hidden, weight)])[0] is hidden
