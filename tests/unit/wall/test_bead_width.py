"""A bead's width says how far it may be off: points that doubt their place are left out, but not forgotten."""

import numpy as np

from annulus.wall.joints import bead_span

CREST_MM, FROM_MM, TO_MM = 4.0, 10.0, 19.0


def _bead() -> tuple[np.ndarray, np.ndarray]:
    z = np.repeat(np.arange(5.05, 25.0, 0.1), 4)
    return z, np.where((z > FROM_MM) & (z < TO_MM), CREST_MM, 0.0)


def test_where_every_reading_agrees_nothing_is_added() -> None:
    z, height = _bead()
    sure = np.arange(len(z)) % 2 == 0
    start, end, k2 = bead_span(z, height, CREST_MM, sure)
    assert abs((end - start) - (TO_MM - FROM_MM)) < 2.0
    assert k2 < 0.5


def test_a_far_half_seen_only_in_doubt_is_in_the_widths_uncertainty() -> None:
    z, height = _bead()
    start, end, k2 = bead_span(z, height, CREST_MM, z < (FROM_MM + TO_MM) / 2)
    error = abs((end - start) - (TO_MM - FROM_MM))
    assert error > 3.0
    assert error < k2 < 3 * error
