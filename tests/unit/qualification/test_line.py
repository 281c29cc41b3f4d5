"""A line through points with errors both ways, against a published example and drawn points."""

import numpy as np
import pytest

from annulus_pipe.qualification.line import StraightLine, fit_line

# Pearson's data with York's weights, which papers on such lines share.
X = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
X_WEIGHT = np.array([1000.0, 1000.0, 500.0, 800.0, 200.0, 80.0, 60.0, 20.0, 1.8, 1.0])
Y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
Y_WEIGHT = np.array([1.0, 1.8, 4.0, 8.0, 20.0, 20.0, 70.0, 70.0, 100.0, 500.0])


def test_pearsons_line_with_yorks_weights_comes_out_to_its_digits() -> None:
    """Intercept and slope as the documentation of the GUM Tree Calculator prints them (type_a.line_fit_wtls)."""
    line = fit_line(X, Y, X_WEIGHT**-0.5, Y_WEIGHT**-0.5, 0.95)
    assert line is not None
    assert (round(line.intercept_mm, 5), round(line.slope, 6)) == (5.47991, -0.480533)


def drawn(chance: np.random.Generator, n: int, bias: float, slope: float) -> StraightLine | None:
    true = chance.uniform(0.5, 4.0, n)
    x_sigma, y_sigma = chance.uniform(0.03, 0.08, n), chance.uniform(0.05, 0.15, n)
    x = true + x_sigma * chance.normal(size=n)
    return fit_line(x, bias + slope * true + y_sigma * chance.normal(size=n), x_sigma, y_sigma, 0.95)


@pytest.mark.parametrize(
    ("studies", "n", "bias", "slope"),
    [
        (200, 12, 0.0, 1.0),
        *(pytest.param(500, n, b, s, marks=pytest.mark.deep) for n in (6, 12, 40) for b, s in ((0.0, 1.0), (0.1, 0.9))),
    ],
)
def test_the_true_line_lies_in_its_intervals_as_stated(studies: int, n: int, bias: float, slope: float) -> None:
    """Stated: 95 %. Scaling up where points happen to scatter more, never down, makes it a little more."""
    chance = np.random.default_rng(n)
    lines = [line for _ in range(studies) if (line := drawn(chance, n, bias, slope)) is not None]
    held = [
        (abs(one.intercept_mm - bias) <= one.intercept_k_mm, abs(one.slope - slope) <= one.slope_k) for one in lines
    ]
    assert len(lines) == studies
    assert np.mean(held, axis=0).min() >= 0.93
    if (bias, slope) == (0.0, 1.0):
        assert np.mean([one.is_unity for one in lines]) >= 0.93


def test_a_bias_that_hides_in_either_interval_shows_in_both_together() -> None:
    """Deep points far from 0: intercept and slope trade against each other, and their region is narrow."""
    x = np.linspace(2.0, 3.0, 12)
    line = fit_line(x, x + 0.15, 0 * x + 0.02, 0 * x + 0.1, 0.95)
    assert line is not None and not line.is_unity
    assert line.intercept_k_mm > 0.15 and line.slope_k > 0.0


def test_a_slope_is_not_flattened_by_what_the_digs_are_off() -> None:
    """Ordinary least squares reads 0.80 here: errors of x as large as half the spread."""
    chance = np.random.default_rng(1)
    true = chance.uniform(1.0, 3.0, 2000)
    sigma = np.full(2000, 0.28)
    x, y = true + sigma * chance.normal(size=2000), true + 0.05 * chance.normal(size=2000)
    line = fit_line(x, y, sigma, np.full(2000, 0.05), 0.95)
    assert np.polyfit(x, y, 1)[0] < 0.85
    assert line is not None and line.slope == pytest.approx(1.0, abs=0.03) and line.is_unity


@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_points_determine_no_line(n: int) -> None:
    x = np.arange(float(n))
    assert fit_line(x, x, 0 * x + 0.01, 0 * x + 0.01, 0.95) is None


def test_depths_that_are_all_alike_tell_no_slope() -> None:
    x = 1.0 + 0.01 * np.arange(8.0)
    assert fit_line(x, x, 0 * x + 0.1, 0 * x + 0.1, 0.95) is None
    assert fit_line(0 * x + 1.0, x, 0 * x, 0 * x + 0.1, 0.95) is None
