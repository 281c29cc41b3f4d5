"""The statistics every fit rests on, against what they promise."""

import numpy as np
import pytest

from annulus_pipe.numeric.robust import CAUCHY, TUKEY, biweight, cauchy, prior_sigma, robust_sigma


def test_a_third_of_wild_values_moves_the_robust_sigma_by_less_than_their_share() -> None:
    rng = np.random.default_rng(1)
    clean = rng.normal(0.0, 2.0, 40_000)
    assert robust_sigma(clean) == pytest.approx(2.0, rel=0.015)
    clean[:12_000] = 1e6
    assert robust_sigma(clean) < 2.0 * 1.6


@pytest.mark.parametrize(("weight", "tuning"), [(biweight, TUKEY), (cauchy, CAUCHY)])
def test_a_weighted_mean_is_95_percent_efficient_on_normal_errors(weight, tuning) -> None:  # type: ignore[no-untyped-def]
    """Efficiency of an M-estimate: (E psi')^2 / E psi^2, psi = weight times error."""
    x = np.linspace(-8.0, 8.0, 40_001)
    density = np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi)
    psi = x * weight(x / tuning)
    efficiency = np.trapezoid(np.gradient(psi, x) * density, x) ** 2 / np.trapezoid(psi**2 * density, x)
    assert efficiency == pytest.approx(0.95, abs=0.001)


def test_a_biweight_forgets_and_a_cauchy_weight_never_does() -> None:
    assert biweight(np.array([0.0, 0.5, 1.0, -3.0])).tolist() == [1.0, 0.5625, 0.0, 0.0]
    assert cauchy(np.array([0.0, 1.0, -3.0])).tolist() == [1.0, 0.5, 0.1]


@pytest.mark.parametrize("sigma", [0.05, 1.0, 30.0])
def test_the_prior_is_found_from_noisy_values(sigma: float) -> None:
    """Values of that size, each seen with unit noise so often that its own error is half the prior's."""
    rng = np.random.default_rng(2)
    weight = np.full(5_000, 4.0 / sigma**2)
    value = rng.normal(0.0, sigma, len(weight)) + rng.normal(0.0, 1.0, len(weight)) / np.sqrt(weight)
    assert prior_sigma(weight, weight * value) == pytest.approx(sigma, rel=0.03)
