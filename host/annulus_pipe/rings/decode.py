"""Which ring each slit is: colours of both sides, order along the line, and a plausible wall must all agree.

Assumed: the slide's colours are a De Bruijn sequence, so a slit's two stripes and its neighbours' name it; the
pattern's colours are as the calibration says, whatever the paint does to their strengths.

What carries it: along a line rings keep their order, so a reading is an alignment of slits with rings, and a slit gets
a name only where the best alignment beats every one that reads it otherwise. A wrong name is the one sin here: it moves
a point by centimetres, a missing one costs a point.

When it breaks: stripes too pale or too alike are UNKNOWN and prove nothing, ties are NONE; a pattern that is not the
calibration's leaves no names and no pose, and `diagnosis` reads what it is.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import jit, middle, ranked

UNKNOWN = 255  # a stripe whose colour is not clear: matches any, proves nothing
NONE = -1  # a slit that is no ring, or could be more than one
# Prices and cosines, no unit. Measured by topic colour (points read, wrong rings) and few_rings; a wrong name for any
# missing or false slit fails test_decode.
LIKENESS = 0.06  # a colour must be nearer its reference than any other by this much of the cosine
SKIP = 0.5  # price of leaving a slit out, against 1 for each colour that fits
PLACE = 6.0  # price of a wall that is off by the whole tolerance: more than a slit that fits can pay
LEARNT_FROM = 500  # stripes that tell a frame's colours
BRIGHT = 0.98  # the part of them below a frame's bright level
MARGIN = 0.1  # a label is given only if every runner-up reading of the line is worse by this


@dataclass(frozen=True, slots=True, eq=False)
class StripeColours:
    """gain (3,): of red, green, blue light, to make the channels equally strong. reference (C, 3): what each colour of
    the pattern, in the order of "RGB", then looks like; unit length."""

    gain: FloatArray
    reference: FloatArray


def classify(side: FloatArray, colours: str, seen: StripeColours | None = None) -> NDArray[np.uint8]:
    """(N, 3) BGR light of stripes -> (N,) index into "RGB", or UNKNOWN.

    Each channel the pattern uses is first scaled by its own bright level, which undoes most of what the wall's paint
    does; then the references move to what this frame's stripes really look like (crosstalk), and a stripe is named
    after the nearest, if that is clear. `seen` has both from before; without, this frame's own light tells.
    """
    if not len(side):
        return np.zeros(0, np.uint8)
    used = ["RGB".index(c) for c in "RGB" if c in colours]
    if seen is None or len(seen.reference) != len(used):
        seen = _learnt(side, used)
    out = np.empty(len(side), np.uint8)
    _name(side, seen.gain, seen.reference, np.array(used, np.uint8), out)
    return out


def _learnt(side: FloatArray, used: list[int]) -> StripeColours:
    gain, reference = np.zeros(3), np.eye(3)[used]
    _learn(side, max(1, len(side) // LEARNT_FROM), np.array(used), gain, reference)
    return StripeColours(gain, reference)


@jit
def _learn(side, every, used, gain, reference):  # type: ignore[no-untyped-def]
    some = (len(side) + every - 1) // every
    work = np.empty(some)
    for i in range(len(used)):
        for n in range(some):
            work[n] = side[every * n, 2 - used[i]]
        gain[used[i]] = 1.0 / max(ranked(work, some, int(BRIGHT * some)), 1e-6)
    unit = np.empty((some, 3))
    name = np.empty(some, np.int64)
    size = 0
    for n in range(some):
        r, g, b = (side[every * n, 2] * gain[0], side[every * n, 1] * gain[1], side[every * n, 0] * gain[2])
        length = math.sqrt(r * r + g * g + b * b)
        if length > 1e-6:
            unit[size, 0], unit[size, 1], unit[size, 2] = r / length, g / length, b / length
            size += 1
    for _ in range(2):
        for n in range(size):
            best = -1.0
            for i in range(len(used)):
                likeness = unit[n, 0] * reference[i, 0] + unit[n, 1] * reference[i, 1] + unit[n, 2] * reference[i, 2]
                if likeness > best:
                    best, name[n] = likeness, i
        for i in range(len(used)):
            x, y, z = 0.0, 0.0, 0.0
            members = 0
            for c in range(3):
                members = 0
                for n in range(size):
                    if name[n] == i:
                        work[members] = unit[n, c]
                        members += 1
                if members < max(8, 0.02 * size):
                    break
                x, y, z = y, z, middle(work, members)
            length = math.sqrt(x * x + y * y + z * z)
            if members >= max(8, 0.02 * size) and length > 0.0:
                reference[i, 0], reference[i, 1], reference[i, 2] = x / length, y / length, z / length


@jit
def _name(side, gain, reference, used, out):  # type: ignore[no-untyped-def]
    for n in range(len(side)):
        r, g, b = side[n, 2] * gain[0], side[n, 1] * gain[1], side[n, 0] * gain[2]
        length = math.sqrt(r * r + g * g + b * b)
        first, second, name = -1.0, -1.0, 0
        for i in range(len(used)):
            likeness = reference[i, 0] * r + reference[i, 1] * g + reference[i, 2] * b
            if likeness > first:
                first, second, name = likeness, first, i
            elif likeness > second:
                second = likeness
        clear = length > 1e-6 and (len(used) == 1 or first - second > LIKENESS * length)
        out[n] = used[name] if clear else UNKNOWN


def readings(inside: NDArray[np.uint8], outside: NDArray[np.uint8], colours: str) -> NDArray[np.bool_]:
    """(N, K): slit n has the two colours of ring k, as far as they are known, and at least one is."""
    pattern = np.array(["RGB".index(c) for c in colours], np.uint8)
    out = np.empty((len(inside), len(pattern) - 1), np.bool_)
    _read(inside, outside, pattern, out)
    return out


@jit
def _read(inside, outside, pattern, out):  # type: ignore[no-untyped-def]
    for n in range(len(inside)):
        for k in range(len(pattern) - 1):
            left, right = inside[n] == pattern[k], outside[n] == pattern[k + 1]
            out[n, k] = (left and right) or (left and outside[n] == UNKNOWN) or (right and inside[n] == UNKNOWN)


def decode(
    direction: NDArray[np.int64],
    inside: NDArray[np.uint8],
    outside: NDArray[np.uint8],
    deviation: FloatArray | None,
    colours: str,
    tolerance: float,
) -> NDArray[np.int64]:
    """Ring of every slit, or NONE.

    Parameters
    ----------
    direction : (N,) rising; slits of one direction stand in a run, from the centre outwards.
    inside, outside : (N,) colour of the stripe on each side, index into "RGB" or UNKNOWN.
    deviation : (N, K) relative deviation of the wall's radius from the pipe's if slit n were ring k; NaN = cannot be.
        None where no wall is known to deviate from, as with straight stripes: then colours and order alone decide.
    colours : K + 1 letters from the innermost stripe outwards (a De Bruijn sequence).
    tolerance : the |deviation| of a wall at which no colours make up for it; 0.65 of it is the most a slit can have.

    Notes
    -----
    Each line is one alignment of its slits with the rings: both in order, any slit may be false and any ring missing.
    A label is given only where the best alignment beats every alignment that reads that slit as another ring or that
    ring as another slit; so a tie, such as two slits in one stripe pair, is no label instead of a guess.
    Alzuhiri 2022, §3.4.2 slides a window of the code's length along the line; this is that, with holes.
    """
    pattern = np.array(["RGB".index(c) for c in colours], np.uint8)
    if deviation is None:
        deviation = np.zeros((len(direction), len(colours) - 1))
    ring = np.full(len(direction), NONE, np.int64)
    if len(direction):
        _align(direction, inside, outside, deviation, pattern, tolerance, ring)
    return ring


@jit
def choose(slit, name, own, ahead, behind, size, margin, ring):  # type: ignore[no-untyped-def]
    """The best alignment of one line's candidates, in order; a ring is given only where every other reading is worse by
    `margin`. slit, name, own (worth) : of the first `size`; ahead, behind : room to work in."""
    for c in range(size):
        ahead[c] = 0.0
        for p in range(c):
            if slit[p] < slit[c] and name[p] < name[c]:
                ahead[c] = max(ahead[c], ahead[p])
        ahead[c] += own[c]
    for c in range(size - 1, -1, -1):
        behind[c] = 0.0
        for p in range(c + 1, size):
            if slit[p] > slit[c] and name[p] > name[c]:
                behind[c] = max(behind[c], behind[p] + own[p])
    best = 0.0
    for c in range(size):
        best = max(best, ahead[c] + behind[c])
    for c in range(size):
        total = ahead[c] + behind[c]
        if total < best - 1e-9 or total <= 0.0:
            continue
        alone = True
        for p in range(size):
            if p != c and (slit[p] == slit[c] or name[p] == name[c]) and ahead[p] + behind[p] > total - margin:
                alone = False
        if alone:
            ring[slit[c]] = name[c]


@jit
def _align(direction, inside, outside, deviation, pattern, tolerance, ring):  # type: ignore[no-untyped-def]
    rings = len(pattern) - 1
    most = 0
    start = 0
    for n in range(1, len(direction) + 1):
        if n == len(direction) or direction[n] != direction[start]:
            most = max(most, n - start)
            start = n
    slit = np.empty(most * rings, np.int64)  # the candidates (slit, name) of one line, in order
    name = np.empty(most * rings, np.int64)
    own = np.empty(most * rings)
    ahead = np.empty(most * rings)  # best alignment up to and with this candidate
    behind = np.empty(most * rings)  # best alignment after it
    start = 0
    for n in range(1, len(direction) + 1):
        if n < len(direction) and direction[n] == direction[start]:
            continue
        size = 0
        for i in range(start, n):
            for k in range(rings):
                d = deviation[i, k]
                if not abs(d) <= tolerance:
                    continue
                fit = 0.0
                if inside[i] == pattern[k]:
                    fit += 1.0
                elif inside[i] != UNKNOWN:
                    continue
                if outside[i] == pattern[k + 1]:
                    fit += 1.0
                elif outside[i] != UNKNOWN:
                    continue
                if fit < 0.5:
                    continue
                slit[size], name[size] = i, k
                own[size] = fit + SKIP - PLACE * (d / tolerance) ** 2
                if own[size] <= 0.0:
                    continue
                size += 1
        choose(slit, name, own, ahead, behind, size, MARGIN, ring)
        start = n
