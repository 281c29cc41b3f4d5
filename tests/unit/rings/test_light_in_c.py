"""The light of a frame: what C counts is what counting by numpy, channel by channel, gives."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.numeric.chroma import spread
from annulus_pipe.numeric.mosaic import Mosaic, Picture, bgr_of, thinned
from annulus_pipe.rings.diagnosis import CLIPPED, EVERY, FAINT, GLARE, LIT_OF_BRIGHT, SECTORS, _sectors, diagnose


def counted(picture: Picture) -> tuple[float, float, float, float, int]:
    some = thinned(bgr_of(picture), EVERY)
    _, second, top = np.moveaxis(np.sort(some, axis=2), 2, 0)
    bright = max(level for level in range(256) if (top >= level).sum() > 0.005 * top.size)
    least = int(max(LIT_OF_BRIGHT * bright, 1))
    lit = max(int((top >= least).sum()), 1)
    kept = np.where(some > FAINT, some, 0).reshape(-1, 3).astype(float)
    pure = kept**2 / np.maximum(kept.sum(axis=1, keepdims=True), 1)
    sector, glare = _sectors(*top.shape), 0
    for one in range(SECTORS):
        here = top[sector == one]
        if (here >= CLIPPED).sum() > GLARE * max((here >= least).sum(), 1):
            glare |= 1 << one
    hues = float(spread(kept.sum(axis=0), pure.sum(axis=0)))
    return bright, (top >= CLIPPED).sum() / lit, (second >= CLIPPED).sum() / lit, hues, glare


@settings(max_examples=40)
@given(
    size=st.tuples(st.integers(16, 90), st.integers(16, 90)),
    most=st.sampled_from([1, 5, 60, 256]),
    least=st.sampled_from([0, 249]),
    order=st.sampled_from([None, "rggb", "gbrg"]),
    seed=st.integers(0, 99),
)
def test_light_is_as_it_is_counted(size: tuple[int, int], most: int, least: int, order: str | None, seed: int) -> None:
    draw = np.random.default_rng(seed)
    low, high = (least, 256) if least < most else (0, most)
    shape = size if order else (*size, 3)
    pixels = draw.integers(low, high, shape, dtype=np.uint8)
    picture = Mosaic(pixels, order) if order else pixels
    found = diagnose(picture)
    observed = found.bright, found.clipped, found.lost, found.hues, found.glare
    assert np.allclose(observed, counted(picture), rtol=0, atol=1e-12)
