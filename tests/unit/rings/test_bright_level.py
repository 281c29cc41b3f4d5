"""What the pedestal is judged by: ranks counted by level are what numpy makes of the same pixels."""

import numpy as np
import pytest

from annulus_pipe.rings.pedestal import _bright, _under_stripes


@pytest.mark.parametrize("seed", range(6))
def test_levels_counted_are_the_quantiles_of_their_pixels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame = rng.integers(0, rng.integers(1, 256, endpoint=True), (*rng.integers(2, 90, 2), 3)).astype(np.uint8)
    frame[rng.random(frame.shape[:2]) < rng.random()] = 0
    few, strongest = frame[::2, 1::2], np.empty(frame[::2, 1::2].shape[:2], np.uint8)
    bright = _bright(few, strongest)
    assert np.array_equal(strongest, few.max(axis=2))
    assert bright == pytest.approx(np.percentile(strongest[::2, ::2], 97))
    least = few.min(axis=2)
    under = least[strongest > 0.25 * bright]
    assert _under_stripes(strongest, least, 0.25 * bright) == pytest.approx(np.median(under) if len(under) else 0.0)
