"""`numpy.random.default_rng([seed, stream, number])` for one number after the other, in a fifth of the time: the draws
of a frame depend on nothing but its number, and seeding is most of what they cost.

The seeds of BLOCK numbers are mixed at once, as numpy's SeedSequence mixes them; what comes is the same to the bit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK = 512  # numbers seeded at once
_WORD = 1 << 32
_POOL = 4  # words
_HASH, _HASH_TIMES = 0x43B0D7E5, 0x931E8875  # of SeedSequence, taking words in ..
_GIVE, _GIVE_TIMES = 0x8B51F9DD, 0x58F38DED  # .. giving them out ..
_LEFT, _RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)  # .. and mixing two
_SHIFT = np.uint32(16)
_LCG = 0x2360ED051FC65DA44385DF649FCCF645  # of PCG64
_MASK = (1 << 128) - 1

_Words = NDArray[np.uint32]


class Draws:
    """One stream of a seed."""

    def __init__(self, seed: int, stream: int) -> None:
        self._seed, self._stream = seed, stream
        self._bits = np.random.PCG64(0)
        self._generator = np.random.Generator(self._bits)
        self._states: list[dict[str, Any]] = []
        self._first = 0  # number of the first of these

    def of(self, number: int) -> np.random.Generator:
        """That number's, until another is asked for."""
        if max(self._seed, self._stream, number) >= _WORD:  # more words than one each: left to numpy
            return np.random.default_rng([self._seed, self._stream, number])
        at = number - self._first
        if not 0 <= at < len(self._states):
            self._first, at = number - number % BLOCK, number % BLOCK
            self._states = _states(self._seed, self._stream, self._first)
        state: Any = self._states[at]
        self._bits.state = state
        return self._generator


def _states(seed: int, stream: int, first: int) -> list[dict[str, Any]]:
    """Of the numbers from `first` on: what PCG64 begins with."""
    numbers = np.arange(first, min(first + BLOCK, _WORD), dtype=np.uint64).astype(np.uint32)
    states = []
    for high, low, odd_high, odd_low in _mixed(np.full_like(numbers, seed), np.full_like(numbers, stream), numbers):
        inc = ((odd_high << 64 | odd_low) << 1 | 1) & _MASK
        state = ((inc + (high << 64 | low)) * _LCG + inc) & _MASK
        states.append({"bit_generator": "PCG64", "state": {"state": state, "inc": inc}, "has_uint32": 0, "uinteger": 0})
    return states


def _mixed(*words: _Words) -> list[list[int]]:
    """SeedSequence(words).generate_state(4, uint64), of each row."""
    constant = _HASH

    def hashed(word: _Words) -> _Words:
        nonlocal constant
        word = word ^ np.uint32(constant)
        constant = constant * _HASH_TIMES % _WORD
        word = word * np.uint32(constant)
        return word ^ (word >> _SHIFT)

    pool = [hashed(words[i] if i < len(words) else np.zeros_like(words[0])) for i in range(_POOL)]
    for source in range(_POOL):
        for target in range(_POOL):
            if source != target:
                both = pool[target] * _LEFT - hashed(pool[source]) * _RIGHT
                pool[target] = both ^ (both >> _SHIFT)
    constant, given = _GIVE, []
    for i in range(2 * _POOL):
        word = pool[i % _POOL] ^ np.uint32(constant)
        constant = constant * _GIVE_TIMES % _WORD
        word = word * np.uint32(constant)
        given.append((word ^ (word >> _SHIFT)).astype(np.uint64))
    halves: list[list[int]] = np.stack([given[i] | given[i + 1] << np.uint64(32) for i in range(0, 8, 2)], 1).tolist()
    return halves
