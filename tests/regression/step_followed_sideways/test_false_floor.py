"""Of a step plain in one column and seen in few cells beside it, false floors half way down were kept there: 36 of 216
cells that no ring lit carried a radius (edb2eac). Fails without SIDEWAYS_DEG in between_levels."""

import numpy as np

from annulus_pipe.wall.shadow import between_levels


def test_half_way_down_beside_a_plain_step_is_still_no_floor() -> None:
    radius = np.full((60, 90), 76.2)
    radius[20:40, 10:30] += 2.0
    radius[20:24, 10:12] = 77.1  # half on the rim, half on the floor ..
    for column, rows in ((12, 26), (13, 26)):
        radius[18:rows, column] = np.nan  # .. and where little is seen, a ramp as far as anyone can tell
        radius[22, column] = 77.1
    false = between_levels(radius, 1.0, 0.55)
    assert false[22, 10:14].all()
