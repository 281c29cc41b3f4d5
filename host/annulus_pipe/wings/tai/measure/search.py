"""Codes of other lengths: bipolar ones of least peak sidelobe, on/off ones that lose least in their decoding filter."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.controller import CHIPS_MAX
from annulus_pipe.numeric.arrays import Chips
from annulus_pipe.numeric.jit import jit
from annulus_pipe.vocabulary import AnnulusError

EXHAUSTIVE_MAX = 28  # chips; twice the time for each more. Guard: test_bad_input_is_one_line (templates)


def least_peak_sidelobe(length: int) -> tuple[NDArray[np.int8], int]:
    """The first bipolar code (+-1) of that length with the least possible peak sidelobe: (code, that sidelobe).

    Every code is looked at, a branch given up as soon as a sidelobe that both ends already fix is too high; mirror
    images and negatives are left out.
    """
    if not 2 <= length <= EXHAUSTIVE_MAX:
        raise AnnulusError(f"a search over codes of {length} chips, expected 2..{EXHAUSTIVE_MAX}")
    code = np.ones(length, np.int8)
    bound = 1
    while not _search(code, bound):
        bound += 1
    return code, bound


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


@jit
def _search(code, bound):  # type: ignore[no-untyped-def]
    """Fills `code` with the first one whose sidelobes are at most `bound`; False where there is none.

    Chips are set in pairs from both ends inwards; sidelobe s is known once the s outermost chips of both ends are.
    """
    length = len(code)
    half = (length + 1) // 2
    choice = np.zeros(half + 1, np.int64)
    depth = 0
    choice[0] = 0
    while depth >= 0:
        pair = 2 if length - 1 - depth == depth else 4
        if choice[depth] >= pair or (depth == 0 and choice[0] >= 2):  # the first chip is +1
            depth -= 1
            if depth >= 0:
                choice[depth] += 1
            continue
        first = 1 - 2 * (choice[depth] & 2) // 2 if depth else 1
        last = 1 - 2 * (choice[depth] & 1)
        if pair == 2:
            first = last
        code[depth], code[length - 1 - depth] = first, last
        lag = length - 1 - depth
        total = 0
        for i in range(depth + 1):
            total += code[i] * code[i + lag]
        good = abs(total) <= bound
        if good and depth == half - 1:
            for s in range(1, length):
                total = 0
                for i in range(length - s):
                    total += code[i] * code[i + s]
                if abs(total) > bound:
                    good = False
                    break
            if good:
                return True
        if good and depth < half - 1:
            depth += 1
            choice[depth] = 0
        else:
            choice[depth] += 1
    return False
