"""Draws seeded by the block are numpy's own, to the bit."""

import numpy as np
import pytest

from annulus_pipe.twin.draws import BLOCK, Draws


@pytest.mark.parametrize("seed", [0, 1000, (1 << 32) - 1, 1 << 32])
def test_every_number_draws_what_numpy_draws(seed: int) -> None:
    draws = Draws(seed, 2)
    for number in (0, 1, BLOCK - 1, BLOCK, 77_777, 3, (1 << 32) - 1, 1 << 32):
        one, other = draws.of(number), np.random.default_rng([seed, 2, number])
        assert one.random() == other.random()
        assert one.integers(8) == other.integers(8)
        assert one.standard_normal() == other.standard_normal()
