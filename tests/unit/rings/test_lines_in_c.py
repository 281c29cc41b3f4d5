"""Ridges in C against tests/reference/rings_lines.py: few, too many, none, and rubbish."""

import numpy as np
import pytest
import rings_lines
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.rings.lines import _ridges


def found(smooth, slope, curve, stop, least_bend, per_line, most):
    out, crowded = np.full((most, 4), np.nan, np.float32), np.zeros(1, np.int64)
    return out[: _ridges(smooth, slope, curve, stop, least_bend, per_line, out, crowded)], int(crowded[0])


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 4, 5, 70, 200]),
    st.sampled_from([0.5, 0.02]),
    st.sampled_from([0.0, 0.3, 50.0]),
    st.sampled_from([1, 3, 12]),
)
def test_ridges_are_the_references(seed, samples, period, least_bend, per_line):
    rng = np.random.default_rng(seed)
    at = np.arange(samples) * period
    phase, steepness = rng.uniform(0, 6, (2, 4, 1))
    smooth = (40 * np.sin(at + phase) ** 2 + rng.normal(0, 0.3, (4, samples))).astype(np.float32)
    slope = (np.sin(2 * (at + phase)) + rng.normal(0, 0.1, (4, samples))).astype(np.float32)
    curve = (steepness * np.cos(2 * (at + phase))).astype(np.float32)
    stop = rng.integers(-3, samples + 4, 4)
    ridges, crowded = found(smooth, slope, curve, stop, least_bend, per_line, 4 * per_line)
    expected, too_many = rings_lines.ridges(smooth, slope, curve, stop, np.float32(least_bend), per_line)
    assert crowded == too_many
    np.testing.assert_array_equal(ridges[:, :3], expected[:, :3])
    np.testing.assert_allclose(ridges[:, 3], expected[:, 3], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, 0.0])
def test_rubbish_harms_nothing(value):
    rng = np.random.default_rng(5)
    three = np.where(rng.random((3, 6, 90)) < 0.5, value, rng.normal(0, 1, (3, 6, 90))).astype(np.float32)
    stop = np.array([-(2**62), -1, 0, 3, 90, 2**62])
    for most in (0, 1, 72):
        ridges, _ = found(*three, stop, 0.0, 12, most)
        assert len(ridges) <= most
        assert not np.isnan(ridges[:, 0]).any()
