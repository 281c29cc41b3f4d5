"""What the pedestal is judged by: the quantiles, and the darkest place around each, as numpy and OpenCV make them."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.rings.pedestal import LIT, WORTH, _look


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(0, 3), st.floats(0.0, 12.0))
def test_a_coarse_look_is_judged_as_numpy_judges_it(seed: int, quarter: int, half: int, veil: float) -> None:
    rng = np.random.default_rng(seed)
    step, window = 4 * quarter, 2 * half + 1
    shape = rng.integers(2 * step, 160, 2)
    frame = (
        rng.integers(0, 200, (*shape, 3)) * (rng.random(shape) < rng.random())[..., None]
        + rng.poisson(veil, shape)[..., None]
    )
    image = np.clip(frame, 0, 255).astype(np.uint8)
    strongest = image[step // 4 :: step, step // 4 :: step].max(axis=2)
    bright = np.percentile(strongest[::2, ::2], 97)
    darkest = cv2.erode(strongest, np.ones((window, window), np.uint8))[strongest > LIT * bright]
    level = np.median(darkest) if len(darkest) else 0.0
    worth_it = _look((image.shape[0], image.shape[1]), 3, step, window)(image, 0)
    assert bool(worth_it) == (level > WORTH * bright) or abs(level - WORTH * bright) < 1e-9
