"""Of receivers standing at random over an arc every wider spacing was called a hole of the circle (f6abe97). Fails
without HOLE_DEG in gaps_deg."""

import numpy as np

from annulus_pipe.wings.tai.measure.sweep import gaps_deg


def test_only_what_nobody_covers_is_a_hole() -> None:
    angles = np.sort(np.random.default_rng(4).uniform(0, 270, 128))
    assert np.diff(angles).max() > 2.5 * np.median(np.diff(angles))
    assert gaps_deg(angles) == [(angles[-1], angles[-1] + (angles[0] + 360.0 - angles[-1]))]
