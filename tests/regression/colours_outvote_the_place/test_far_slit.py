"""A false slit with the right colours was named a ring though its wall would stand nearly a tolerance off: the colours
paid for the place (5113f79). Fails with a place's price that two colours can pay (PLACE = 1)."""

import numpy as np

from annulus_pipe.rings.decode import NONE, decode


def test_no_colours_make_up_for_a_wall_that_cannot_be_there() -> None:
    red = np.array([0], np.uint8)
    far = np.array([[0.8 * 0.35, np.nan, np.nan, np.nan, np.nan]])
    assert decode(np.array([0]), red, red, far, "RRGBGR", 0.35).tolist() == [NONE]
    assert decode(np.array([0]), red, red, far / 4, "RRGBGR", 0.35).tolist() == [0]
