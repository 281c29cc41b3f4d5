"""Beside a deep step the surface swings to the other side within a slit's width: listed as a defect of its own, and
after a first mending still where it lay a little off the rim (a3caf7d, 7f98104, 29d4b0e). Fails without _is_ripple, and
with RIPPLE_EDGES = 0.5."""

import numpy as np
from synthetic_pipe import SHADOW_RATIO, RadiusMap, pocket, round_pipe, scan

from annulus_pipe.wall.defects import Kind, find_defects
from annulus_pipe.wall.grid import build_wall


def swinging(inner: RadiusMap, z0: float) -> RadiusMap:
    """6 mm of wall 1.2 mm too far in, all along the far rim."""

    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        return inner(clock, z) - 1.2 * ((np.abs(clock - 90.0) < 12.0) & (z > z0) & (z < z0 + 6.0))

    return radius


def test_the_swing_beside_a_step_is_no_bump() -> None:
    pipe = swinging(pocket(round_pipe, 90, 12, 130, 165, 3.0), 171.0)
    found = find_defects(build_wall(scan(pipe)), shadow_ratio=SHADOW_RATIO).defects
    assert [defect.kind for defect in found] == [Kind.LOSS]
