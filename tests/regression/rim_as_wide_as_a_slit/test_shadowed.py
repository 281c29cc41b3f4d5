"""The last of a rim is not seen either, for a slit has a width: what a step hides was taken for a rod's shadow where it
was a slit longer than Eq. 3.24 says (edb2eac). Fails with two cells of slack instead of a slit's width."""

import numpy as np

from annulus_pipe.wall.shadow import shadowed


def test_what_a_step_and_a_slits_width_hide_is_said_to_be_hidden() -> None:
    radius, z_step, tangent = np.full((200, 90), 76.2), 0.5, 0.34
    radius[60:160, 10:30] += 1.0
    dark = round((1.0 / tangent + 2.5) / z_step)  # Eq. 3.24's length and most of a slit
    radius[60 : 60 + dark, 10:30] = np.nan
    assert shadowed(radius, z_step, tangent)[60 : 60 + dark, 10:30].all()
