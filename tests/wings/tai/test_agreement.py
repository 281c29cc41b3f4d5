"""Speed of sound and bad receivers, on small spheres in space whose sound is known in closed form.

A heated sphere sounds as an N: pressure v (R - c t) / 2 R while |R - c t| < its radius. Sound in a plane, made by the
solver, is in tests/wings/tai.
"""

from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.agreement import disagreeing, likelier_arrival, search_sound_speed
from annulus_pipe.wings.tai.measure.imaging import Region, back_projection
from annulus_pipe.wings.tai.measure.sweep import Sweep, band_passed

C, RADIUS, RATE = 1478.0, 25.0, 25e6
ANGLES = np.arange(50) * 7.2
SMALL = np.array(
    [
        [6.0, 2.0, 0.2, 1.2, 1.0],
        [-4.0, 5.0, -0.3, 0.8, 0.8],
        [-2.0, -7.0, 0.1, 1.0, 0.6],
        [3.0, -3.0, 0.0, 0.6, 0.9],
        [-8.0, -1.0, 0.3, 1.4, 0.7],
    ]
)


def spheres(parts: np.ndarray, speed: float = C, samples: int = 950) -> np.ndarray:
    """(positions, samples) of spheres (x, y, z, radius mm, value); each sample the mean over its own interval."""
    turn = np.radians(ANGLES)
    receivers = RADIUS * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    edges = (np.arange(samples + 1) - 0.5) / RATE * speed * 1e3
    total = np.zeros((len(ANGLES), samples))
    for x, y, z, radius, value in parts:
        far = np.linalg.norm(receivers - [x, y, z], axis=1)[:, None]
        off = np.clip(far - edges, -radius, radius)
        total += np.diff(value * (radius**2 - off**2) / (4 * far), axis=1) / np.diff(edges)
    return total


@pytest.fixture(scope="module")
def sweep() -> Sweep:
    clean = spheres(SMALL)
    noise = np.random.default_rng(3).standard_normal(clean.shape)
    # a band that ends at 1.2 MHz keeps the looks coarse and the test quick
    return band_passed(Sweep(clean + 0.2 * clean.std() * noise, ANGLES, RADIUS, RATE, 0.0, C), 0.0, 1.2e6)


def test_the_speed_in_space_is_found_within_a_tenth_of_a_percent(sweep: Sweep) -> None:
    best, other = search_sound_speed(sweep, 1400.0, 1560.0)
    assert best.arrival == "space"
    assert abs(best.sound_speed_m_s / C - 1) < 0.001
    assert best.agreement > 1.1 * other.agreement  # else a hair decides
    assert other.sound_speed_m_s / C - 1 > 0.005  # what taking it for sound in a plane would have cost
    told, _ = search_sound_speed(sweep, 1400.0, 1560.0, "plane")
    assert (told.arrival, told.sound_speed_m_s) == ("plane", other.sound_speed_m_s)
    assert len(best.tried_m_s) == len(best.agreements) >= 21


def test_a_maximum_at_the_end_of_the_range_is_none(sweep: Sweep) -> None:
    with pytest.raises(AnnulusError, match="widen the range"):
        search_sound_speed(sweep, 1490.0, 1560.0)
    with pytest.raises(AnnulusError, match="two rising speeds"):
        search_sound_speed(sweep, 1500.0, 1400.0)
    with pytest.raises(AnnulusError, match="at least 12 positions"):
        search_sound_speed(sweep.only(range(11)), 1400.0, 1560.0)


def test_noise_has_no_speed_of_sound() -> None:
    noise = np.random.default_rng(1).standard_normal((50, 950))
    with pytest.raises(AnnulusError, match=r"halves of the circle never agree .*correlation 0\.0"):
        search_sound_speed(band_passed(Sweep(noise, ANGLES, RADIUS, RATE, 0.0, C), 0.0, 1.2e6), 1400.0, 1560.0)


def test_the_speed_is_that_of_the_region_asked_for(sweep: Sweep) -> None:
    """A louder part in another liquid, slower by 4 %, beside the sample."""
    left, right = SMALL.copy(), SMALL.copy()
    left[:, 0], right[:, 0] = -9.0 + 0.3 * SMALL[:, 0], 9.0 + 0.3 * SMALL[:, 0]
    right[:, 4] *= 3.0
    both = replace(sweep, signals=spheres(left) + spheres(right, 0.96 * C))
    both = band_passed(both, 0.0, 1.2e6)
    best, _ = search_sound_speed(both, 1380.0, 1560.0, region=Region(-14.0, -4.0, -9.0, 9.0))
    assert abs(best.sound_speed_m_s / C - 1) < 0.002
    loud, _ = search_sound_speed(both, 1380.0, 1560.0)
    assert loud.sound_speed_m_s / C - 1 < -0.02


def test_sound_receivers_are_not_accused(sweep: Sweep) -> None:
    assert likelier_arrival(sweep) == "space"
    assert disagreeing(sweep, "space") == []


@pytest.mark.parametrize("damage", ["turned round", "late", "deaf"])
@pytest.mark.parametrize("position", [0, 17, 33])
def test_one_damaged_receiver_is_named(sweep: Sweep, damage: str, position: int) -> None:
    signals = sweep.signals.copy()
    hiss = np.random.default_rng(5).standard_normal(signals.shape[1]) * signals.std()
    signals[position] = {
        "turned round": -signals[position],
        "late": np.roll(signals[position], 25),  # 1 us
        "deaf": band_passed(replace(sweep, signals=np.tile(hiss, (50, 1))), 0.0, 1.2e6).signals[0],
    }[damage]
    found = disagreeing(replace(sweep, signals=signals), "space")
    assert [one[0] for one in found] == [position]
    _, own, beside = found[0]
    assert own < beside - 0.2


def test_a_sweep_at_the_wrong_speed_accuses_no_receiver(sweep: Sweep) -> None:
    assert disagreeing(replace(sweep, sound_speed_m_s=1300.0), "space") == []


def test_a_region_is_the_same_image_cut_out(sweep: Sweep) -> None:
    whole = back_projection(sweep, pixel=0.5)
    part = back_projection(sweep, pixel=0.5, region=Region(-3.0, 8.1, -9.0, -1.2))
    assert (part.x_mm[0], part.x_mm[-1], part.y_mm[0], part.y_mm[-1]) == (-3.0, 8.0, -9.0, -1.5)
    rows, columns = (np.isin(a, b) for a, b in ((whole.y_mm, part.y_mm), (whole.x_mm, part.x_mm)))
    assert np.array_equal(part.values, whole.values[np.ix_(rows, columns)])
    with pytest.raises(AnnulusError, match="outside the circle"):
        back_projection(sweep, pixel=0.5, region=Region(30.0, 40.0, 0.0, 1.0))
    with pytest.raises(AnnulusError, match="expected to rise"):
        Region(1.0, -1.0, 0.0, 1.0)


def test_a_band_keeps_its_sound_and_nothing_else() -> None:
    """Amplitude and time in the middle of the band; half at its ends; a hundredth an octave and more outside."""
    rate, times = 20e6, np.arange(4000) / 20e6
    window = np.exp(-(((times - 100e-6) / 25e-6) ** 2))

    def through(frequency_hz: float) -> tuple[float, float]:
        tone = window * np.cos(2e6 * np.pi * frequency_hz * 1e-6 * (times - 100e-6))
        out = band_passed(Sweep(np.stack([tone] * 3), np.arange(3) * 120.0, 10.0, rate), 0.5e6, 4e6).signals[0]
        return float(np.abs(out).max()), float(times[np.argmax(out)])

    gain, at_s = through(1.4e6)
    assert gain == pytest.approx(1.0, abs=2e-3) and at_s == pytest.approx(100e-6, abs=1e-12)
    assert [through(f)[0] for f in (0.5e6, 4e6)] == pytest.approx([0.5, 0.5], abs=0.01)
    assert max(through(f)[0] for f in (0.25e6, 8e6)) < 0.01
    with pytest.raises(AnnulusError, match=r"a band of 2\.\.1 MHz"):
        band_passed(Sweep(np.zeros((3, 100)), np.arange(3) * 120.0, 10.0, rate), 2e6, 1e6)
    with pytest.raises(AnnulusError, match="at most half the sampling rate, 10 MHz"):
        band_passed(Sweep(np.zeros((3, 100)), np.arange(3) * 120.0, 10.0, rate), 1e6, 11e6)
