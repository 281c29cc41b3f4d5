"""What the decoding filters promise, from a code on the air to a peak in time."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.controller import CODES
from annulus_pipe.link.codes import pattern
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.search import best_on_off, least_peak_sidelobe, on_off_gain_db
from annulus_pipe.wings.tai.measure.templates import Transducer, decode, decode_pair, design, pair_correlation

CHIP = 0.5e-6


@pytest.fixture(scope="module")
def minimax():
    return design(pattern("mpsl25-stuffed"))


def test_the_stuffed_code_reaches_the_optimum(minimax):
    assert minimax.psr >= 59.0
    assert minimax.gain_db >= 7.8
    assert minimax.ceiling_db == pytest.approx(10 * math.log10(11))
    full = np.convolve(pattern("mpsl25-stuffed"), minimax.taps)
    assert full[minimax.peak] == pytest.approx(1.0)
    assert np.abs(np.delete(full, minimax.peak)).max() == pytest.approx(1 / minimax.psr)


def test_what_a_design_calls_gain_is_what_noise_does(minimax):
    """Amplitude 1 over the filtered noise, against amplitude 1 over the noise as it was."""
    rng = np.random.default_rng(2)
    noise = rng.standard_normal(400_000)
    through = np.convolve(noise, minimax.taps, mode="valid").std() / noise.std()
    assert -20 * math.log10(through) == pytest.approx(minimax.gain_db, abs=0.003)


def test_behind_a_transducer_a_floor_keeps_the_gain():
    """The full-size design is a row of `make bench-thermoacoustic`."""
    receiver = Transducer.band(2.25e6, 0.7, 8e6)
    options = {"transducer": receiver, "samples_per_chip": 4, "guard_chips": 2}
    kept = design(pattern("mpsl25"), 50, gain_floor_db=7.0, **options)
    greedy = design(pattern("mpsl25"), 50, gain_floor_db=4.0, **options)
    assert kept.gain_db >= 7.0 - 1e-6
    assert greedy.psr > kept.psr > 12
    assert kept.ceiling_db != pytest.approx(10 * math.log10(11), abs=0.01)  # pulses ring into each other


def test_the_pair_peaks_at_52_and_is_silent_elsewhere():
    found = pair_correlation([pattern("manchester1"), pattern("manchester2")])
    middle = len(found) // 2
    assert found[middle] == 52
    assert (found[[middle - 1, middle + 1]] == [-25, -26]).all()
    assert np.abs(np.delete(found, [middle - 1, middle, middle + 1])).max() <= 1


def heard(code, flight_s, rate, samples=3000):
    """A shot as an ideal receiver hears it: the code's envelope, late by the flight."""
    times = np.arange(samples) / rate
    trace = np.zeros(samples)
    for n in np.flatnonzero(pattern(code)):
        start = flight_s + n * CHIP
        trace += np.clip((times - start) * rate + 0.5, 0, 1) - np.clip((times - start - CHIP) * rate + 0.5, 0, 1)
    return trace


@cache
def least_squares(code):
    return design(pattern(code), 3 * len(CODES[code]), "least-squares")


@settings(deadline=None, max_examples=40)
@given(
    flight=st.floats(2e-6, 6e-6),
    rate=st.sampled_from([10e6, 17.3e6, 50e6]),
    code=st.sampled_from(["barker13", "mpsl25"]),
)
def test_a_decoded_shot_peaks_at_the_time_of_flight(flight, rate, code):
    template = least_squares(code)
    out = decode(heard(code, flight, rate), rate, template, CHIP)
    pulse = np.flatnonzero(out > 0.5 * out.max())
    assert (pulse[0] + pulse[-1]) / 2 / rate == pytest.approx(flight, abs=1.01 / rate)
    assert out.max() == pytest.approx(1.0, abs=0.25)  # an edge between samples rings


def test_a_decoded_pair_peaks_at_the_time_of_flight():
    rate, flight = 20e6, 7e-6
    codes = ["manchester1", "manchester2"]
    out = decode_pair([heard(c, flight, rate) for c in codes], rate, [pattern(c) for c in codes], CHIP)
    assert np.argmax(out) / rate == pytest.approx(flight, abs=CHIP / 2)
    assert out.max() == pytest.approx(1.0)


def test_another_codes_template_makes_no_peak(minimax):
    rate = 20e6
    right = decode(heard("mpsl25-stuffed", 5e-6, rate), rate, minimax, CHIP)
    wrong = decode(heard("manchester1", 5e-6, rate), rate, minimax, CHIP)
    sharpness = [np.abs(x).max() / np.sqrt(np.mean(x**2)) for x in (right, wrong)]
    assert sharpness[0] > 2 * sharpness[1]


def test_the_search_finds_barkers_and_the_least_known_sidelobes():
    for length, known in ((2, 1), (5, 1), (7, 1), (11, 1), (13, 1), (14, 2), (21, 2)):
        code, lobe = least_peak_sidelobe(length)
        full = np.correlate(code.astype(int), code.astype(int), mode="full")
        assert lobe == known
        assert np.abs(np.delete(full, length - 1)).max() == known


def test_an_on_off_search_beats_what_it_started_from():
    code, gain = best_on_off(25, seed=1, restarts=4)
    assert code[0] == code[-1] == 1
    assert gain == pytest.approx(on_off_gain_db(code))
    assert gain >= on_off_gain_db(pattern("mpsl25"))
    assert gain < 10 * math.log10(code.sum())


def test_bad_input_is_one_line():
    chips = pattern("mpsl25")
    with pytest.raises(AnnulusError, match=r"no filter gains more than 10\.41 dB"):
        design(chips, gain_floor_db=11.0)
    with pytest.raises(AnnulusError, match="taps"):
        design(chips, 0)
    with pytest.raises(AnnulusError, match="need a transducer"):
        design(chips, samples_per_chip=4)
    with pytest.raises(AnnulusError, match="no numbers"):
        decode(np.array([0.0, np.nan]), 1e7, design(chips, method="matched"), CHIP)
    with pytest.raises(AnnulusError, match="cannot be told apart"):
        decode(np.zeros(100), 1e6, design(chips, method="matched"), CHIP)
    with pytest.raises(AnnulusError, match="below half"):
        Transducer.band(9e6, 0.5, 10e6)
    with pytest.raises(AnnulusError, match="chips"):
        least_peak_sidelobe(60)
