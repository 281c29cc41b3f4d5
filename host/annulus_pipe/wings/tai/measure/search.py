"""Codes of other lengths: bipolar ones of least peak sidelobe, on/off ones that lose least in their decoding filter."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.controller import CHIPS_MAX
from annulus_pipe.numeric.arrays import Chips
from annulus_pipe.numeric.native import door
from annulus_pipe.vocabulary import AnnulusError

EXHAUSTIVE_MAX = 28  # chips; twice the time for each more. Guard: test_bad_input_is_one_line (templates)

_code = door("tai_code", "i8 length", "i8 bound", returns="u8")


def least_peak_sidelobe(length: int) -> tuple[NDArray[np.int8], int]:
    """The first bipolar code (+-1) of that length with the least possible peak sidelobe: (code, that sidelobe).

    Every code is looked at, a branch given up as soon as a sidelobe that both ends already fix is too high; mirror
    images and negatives are left out.
    """
    if not 2 <= length <= EXHAUSTIVE_MAX:
        raise AnnulusError(f"a search over codes of {length} chips, expected 2..{EXHAUSTIVE_MAX}")
    bound = 1
    while not (chips := int(_code(length, bound))):
        bound += 1
    return np.array([1 if chips >> i & 1 else -1 for i in range(length)], np.int8), bound


def on_off_gain_db(chips: Chips, points: int = 4096) -> float:
    """Gain over one pulse of the filter that leaves no sidelobe at all (the inverse, of any length).

    -10 log10 of the mean of 1 / |C(f)|^2: the noise that an ideal mismatched filter lets through. Between that of a
    practical template and the ceiling 10 log10(number of ones); -inf where the code has a zero in its spectrum.
    """
    power = np.abs(np.fft.fft(chips.astype(float), points)) ** 2
    return -10 * math.log10(float(np.mean(1 / np.maximum(power, 1e-300))))


def best_on_off(
    length: int, seed: int = 0, restarts: int = 40, progress: Callable[[int, int], None] | None = None
) -> tuple[Chips, float]:
    """An on/off code with a high `on_off_gain_db`: climbs from random codes, one and two chips turned at a time.

    Chip 0 and the last are on, so that the length is what it says. Not proven best beyond what `restarts` saw.
    """
    if not 2 <= length <= CHIPS_MAX:
        raise AnnulusError(f"a code of {length} chips, expected 2..{CHIPS_MAX}")
    rng = np.random.default_rng(seed)
    best, value = np.ones(length, np.uint8), -math.inf
    points = 1 << math.ceil(math.log2(8 * length))
    for turn in range(restarts):
        code = (rng.random(length) < rng.uniform(0.3, 0.6)).astype(np.uint8)
        code[[0, -1]] = 1
        code, gain = _climb(code, points)
        if gain > value:
            best, value = code, gain
        if progress:
            progress(turn + 1, restarts)
    return best, on_off_gain_db(best)


def _climb(code: Chips, points: int) -> tuple[Chips, float]:
    gain = on_off_gain_db(code, points)
    turns = np.exp(-2j * np.pi * np.outer(np.arange(len(code)), np.arange(points // 2 + 1)) / points)
    weight = np.full(points // 2 + 1, 2.0)
    weight[[0, -1]] = 1.0
    while True:
        spectrum = code.astype(float) @ turns
        change = np.where(code[1:-1, None] == 1, -1.0, 1.0) * turns[1:-1]
        singles = _gains(spectrum + change, weight)
        if not len(singles):
            return code, gain
        move = [int(singles.argmax()) + 1]
        most = float(singles.max())
        if most <= gain + 1e-9:
            for i in range(len(change) - 1):
                pairs = _gains(spectrum + change[i] + change[i + 1 :], weight)
                if float(pairs.max()) > most:
                    most, move = float(pairs.max()), [i + 1, i + 2 + int(pairs.argmax())]
        if most <= gain + 1e-9:
            return code, gain
        code = code.copy()
        code[move] ^= 1
        gain = most


def _gains(spectra: NDArray[np.complex128], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    power = np.maximum(spectra.real**2 + spectra.imag**2, 1e-12)
    return np.asarray(-10 * np.log10((weight / power).sum(axis=-1) / weight.sum()))
