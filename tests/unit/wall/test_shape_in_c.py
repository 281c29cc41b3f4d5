"""Shapes of stations, their covariances and running medians, in C against tests/reference/wall_shape.py."""

import numpy as np
import wall_shape
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY
from annulus_pipe.wall.shape import LEAST_SIGMA_MM, ROUND_OF_RADIUS, _fitted, _medians, _shape_covariances, harmonics

few = settings(max_examples=60, deadline=None, derandomize=True)
R = 76.2


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    columns=st.sampled_from([7, 24, 90, 360]),
    unseen=st.sampled_from([0.0, 0.1, 0.3, 0.45, 0.7, 1.0]),
    noise=st.sampled_from([0.0, 0.05, 1.0]),
    dent=st.sampled_from([0.0, 0.5, -4.0, 30.0]),
    known=st.sampled_from([None, "as it is", "another"]),
)
def test_they_are_the_references(
    seed: int, columns: int, unseen: float, noise: float, dent: float, known: str | None
) -> None:
    rng = np.random.default_rng(seed)
    clock = (np.arange(columns) + 0.5) * 360.0 / columns
    basis, shape = harmonics(clock), np.array([R, *rng.normal(0, 1, 4)])
    line = basis @ shape + rng.normal(0, noise, columns)
    line[rng.integers(columns) :][: columns // 4] += dent
    line[np.roll(np.arange(columns) < round(unseen * columns), int(rng.integers(columns)))] = np.nan
    usual = {None: np.full(5, np.nan), "as it is": shape, "another": shape + np.array([2.0, 3.0, 0.0, -2.0, 0.0])}[
        known
    ]
    (found,), expected = _fitted(basis, line[None], usual), wall_shape.fitted(basis, line, usual)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)  # sums in another order, twelve times
    out = np.full((1, 5, 5), np.inf)
    constants = (LEAST_SIGMA_MM, 20.0, ROUND_OF_RADIUS, TUKEY, SIGMA_OF_MAD)
    _shape_covariances(line[None], basis, expected[None], *constants, np.empty((8, columns)), out)
    if np.isfinite(expected).all():
        known_to = wall_shape.covariance(basis, line, expected, 20.0)
        scale = np.sqrt(np.outer(known_to.diagonal(), known_to.diagonal()))
        np.testing.assert_allclose(out[0] / scale, known_to / scale, rtol=0, atol=1e-7)
    else:
        assert np.isinf(out).all()


@few
@given(st.lists(st.floats(), min_size=12, max_size=12), st.lists(st.floats(), min_size=5, max_size=5))
def test_rubbish_has_some_shape_or_none(line: list[float], usual: list[float]) -> None:
    basis = harmonics(np.arange(12) * 30.0)
    fits = _fitted(basis, np.array([line]), np.array(usual))
    constants = (LEAST_SIGMA_MM, 20.0, ROUND_OF_RADIUS, TUKEY, SIGMA_OF_MAD)
    _shape_covariances(np.array([line]), basis, fits, *constants, np.empty((8, 12)), np.empty((1, 5, 5)))


@few
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 30),
    st.lists(st.tuples(st.integers(-3, 33), st.integers(-3, 33)), max_size=9),
)
def test_medians_are_numpys(seed: int, size: int, ranges: list[tuple[int, int]]) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(-4, 4, (size, 3)) / 8.0
    values[rng.random((size, 3)) < 0.3] = np.nan
    first, last = np.array([r[0] for r in ranges], np.int64), np.array([r[1] for r in ranges], np.int64)
    out = _medians(values, first, last)
    for row, a, b in zip(out, first, last, strict=True):
        part = values[max(a, 0) : max(b, 0)]
        expected = [np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in part.T]
        np.testing.assert_array_equal(row, expected)
