"""The source's phase shifting: its closed form, its least squares, and the oscillation it is known by."""

import numpy as np

from annulus_pipe.wings.fringe.measure.source import direct, four_step, height, iterated, least_squares

RATE, BASE, FAR = 2 * np.pi / 0.0133, 0.1, 1.5
QUARTER = np.arange(4) * FAR / RATE * np.pi / 2


def test_four_steps_give_phase_and_the_three_pictures() -> None:
    phase = np.linspace(-3, 3, 50)
    frames = np.stack([80 + 40 * np.cos(phase + n * np.pi / 2) for n in range(4)])
    told, dc, ac, ratio = four_step(frames)
    np.testing.assert_allclose(told, phase, atol=1e-12)
    np.testing.assert_allclose(dc, 80)
    np.testing.assert_allclose(ac, 40 / np.sqrt(2))  # Eq. 6.18: an rms
    np.testing.assert_allclose(ratio, 40 / np.sqrt(2) / 80)


def test_least_squares_takes_uneven_steps() -> None:
    phase, theta = np.linspace(-3, 3, 50), np.array([0.0, 0.7, 2.2, 2.9, 4.4])
    told, dc, swing = least_squares(80 + 40 * np.cos(phase + theta[:, None]), theta)
    np.testing.assert_allclose(told, phase, atol=1e-12)
    np.testing.assert_allclose(dc, 80)
    np.testing.assert_allclose(swing, 40)


def test_the_direct_formulation_oscillates_and_the_iterated_does_not() -> None:
    x = np.linspace(0.0, 0.2, 400)
    h = np.full(400, 0.1)
    reference = RATE * (x - BASE) / FAR
    theta = RATE * QUARTER[:, None] / (FAR - h)
    above = RATE * BASE * (1 / (FAR - h) - 1 / FAR)
    frames = 1 + 0.8 * np.cos(reference + above + theta)
    wrong = direct(frames, QUARTER, reference, RATE, BASE, FAR) - h
    assert np.ptp(wrong) > 0.003
    np.testing.assert_allclose(iterated(frames, QUARTER, reference, RATE, BASE, FAR), h, atol=1e-9)


def test_height_is_the_sources_to_first_order() -> None:
    np.testing.assert_allclose(height(np.array([1e-5]), RATE, BASE, FAR), 1e-5 * FAR**2 / (RATE * BASE), rtol=1e-5)
