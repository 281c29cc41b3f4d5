"""What images show of places, in C: as OpenCV's remap and SciPy's filters have it."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from annulus_pipe.wall.pace import SECTORS, _averaged, _correlations, _light_at
from annulus_pipe.wall.texture import _add_colours, _colours_at, row_medians

few = settings(max_examples=25, deadline=None, derandomize=True)


@few
@given(seed=st.integers(0, 2**32 - 1), size=st.tuples(st.integers(3, 40), st.integers(3, 40)))
def test_between_pixels_it_is_opencvs(seed: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (*size, 3)).astype(np.uint8)
    pixels = rng.uniform(-2.0, 42.0, (200, 2))
    pixels[:9] = [[1, 1], [size[1] - 2, size[0] - 2], [np.nan, 5], [np.inf, 5], [1e300, 2], [2, 2.5], [0.999, 2]] + [
        [1.5, 1]
    ] * 2
    colour, inside = np.empty((200, 3), np.uint8), np.empty(200, bool)
    _colours_at(image, pixels, colour, inside)
    x, y = pixels.T
    expected = (x >= 1) & (x <= size[1] - 2) & (y >= 1) & (y <= size[0] - 2)
    assert (inside == expected).all()
    at = np.where(inside[:, None], pixels, 1.0).astype(np.float32)[None]
    remapped = cv2.remap(image, at, None, cv2.INTER_LINEAR)[0]
    assert (np.abs(colour.astype(int) - remapped)[inside] <= 1).all()  # half of a level rounds either way
    light = np.empty(200, np.float32)
    _light_at(image, pixels, light, inside)
    remapped = cv2.remap(image.max(axis=2).astype(np.float32), at, None, cv2.INTER_LINEAR)[0]
    np.testing.assert_allclose(light[inside], remapped[inside], rtol=0, atol=1e-3)


@few
@given(seed=st.integers(0, 2**32 - 1), dark=st.sampled_from([0.0, 4.0, 250.0]))
def test_colours_add_up_as_they_weigh(seed: int, dark: float) -> None:
    rng = np.random.default_rng(seed)
    colour, inside = rng.integers(0, 256, (4, 7, 3)).astype(np.uint8), rng.random((4, 7)) < 0.8
    gain, near = np.array([80.0, 60.0, np.nan, 0.5], np.float32), np.array([1.0, 0.5, 2.0, 0.1], np.float32)
    total, weight = np.ones((4, 7, 3), np.float32), np.ones((4, 7), np.float32)
    _add_colours(colour, inside, gain, near, dark, total, weight)
    counts = inside & (colour.max(axis=2) > dark) & np.isfinite(gain)[:, None]
    expected = np.where(counts[..., None], colour / gain[:, None, None] * near[:, None, None], 0.0)
    np.testing.assert_allclose(total, 1.0 + expected, rtol=1e-6)
    np.testing.assert_allclose(weight, 1.0 + np.where(counts, near[:, None], 0.0), rtol=1e-6)


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    size=st.sampled_from([(1.5, 0.7), (10.0, 4.0), (0.1, 3.0)]),
)
def test_a_bell_averages_as_scipys(seed: int, shape: tuple[int, int], size: tuple[float, float]) -> None:
    field = np.random.default_rng(seed).normal(3.0, 1.0, shape).astype(np.float32)
    np.testing.assert_allclose(_averaged(field, size), ndimage.gaussian_filter(field, size), rtol=2e-5, atol=1e-5)


@few
@given(seed=st.integers(0, 2**32 - 1), unseen=st.sampled_from([0.0, 0.4, 1.0]))
def test_medians_and_correlations_are_numpys(seed: int, unseen: float) -> None:
    rng = np.random.default_rng(seed)
    other = rng.normal(0, 1, (60, 360)).astype(np.float32)
    one = (other[3:53] + 0.5 * rng.normal(0, 1, (50, 360))).astype(np.float32)
    for strip in (one, other):
        strip[rng.random(strip.shape) < unseen] = np.nan
    middle = row_medians(one)
    some = np.isfinite(one).any(axis=1)
    np.testing.assert_allclose(middle[some], np.nanmedian(one[some], axis=1), rtol=1e-6)
    assert np.isnan(middle[~some]).all()
    found = _correlations(one.copy(), other.copy(), 11)
    for shift, sector in np.ndindex(11, SECTORS):
        of = slice(sector * 30, sector * 30 + 30)
        x, y = one[:, of].ravel(), other[shift : shift + 50, of].ravel()
        both = np.isfinite(x) & np.isfinite(y)
        expected = np.corrcoef(x[both], y[both])[0, 1] if both.sum() >= 500 else -1.0
        np.testing.assert_allclose(found[shift, sector], expected, rtol=0, atol=1e-5)
