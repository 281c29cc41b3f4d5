"""Which ring each slit is: colours of both sides, order along the line, and a plausible wall must all agree.

Assumed: the slide's colours are a De Bruijn sequence, so a slit's two stripes and its neighbours' name it; the
pattern's colours are as the calibration says, whatever the paint does to their strengths.

What carries it: along a line rings keep their order, so a reading is an alignment of slits with rings, and a slit gets
a name only where the best alignment beats every one that reads it otherwise. A wrong name is the one sin here: it moves
a point by centimetres, a missing one costs a point.

When it breaks: stripes too pale or too alike are UNKNOWN and prove nothing, ties are NONE; a pattern that is not the
calibration's leaves no names and no pose, and `diagnosis` reads what it is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door

UNKNOWN = 255  # a stripe whose colour is not clear: matches any, proves nothing
NONE = -1  # a slit that is no ring, or could be more than one
# Prices and cosines, no unit. Measured by topic colour (points read, wrong rings) and few_rings; a wrong name for any
# missing or false slit fails test_decode.
LIKENESS = 0.06  # a colour must be nearer its reference than any other by this much of the cosine
SKIP = 0.5  # price of leaving a slit out, against 1 for each colour that fits
PLACE = 6.0  # price of a wall that is off by the whole tolerance: more than a slit that fits can pay
LEARNT_FROM = 500  # stripes that tell a frame's colours
BRIGHT = 0.98  # the part of them below a frame's bright level
SHARE = 0.02  # of them, and eight, that a colour's reference is learnt from
LINE_MOST = 256  # slits of one line that an alignment looks at; twice what any finder keeps
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
    out = np.empty((1, len(side)), np.uint8)
    StripeNames(np.array(side.T, np.float64, order="C"), colours, seen, out).name(len(side))
    return np.asarray(out[0])


class StripeNames:
    """`classify` of stripes that lie in rows blue, green, red, S times: light (3 S, C), to out (S, C); in memory that
    is used again. candidates : of slits whose two stripes those are, listed on the way."""

    def __init__(
        self,
        light: FloatArray,
        colours: str,
        seen: StripeColours | None,
        out: NDArray[np.uint8],
        candidates: "Candidates | None" = None,
    ) -> None:
        used = np.array(["RGB".index(c) for c in "RGB" if c in colours], np.int64)
        start, gain = np.eye(3)[used], np.zeros(3)
        reference = start.copy()
        self._known = seen is not None and len(seen.reference) == len(used)
        if seen is not None and self._known:
            gain[:], reference[:] = seen.gain, seen.reference
        self._stripes, self._candidates = len(light) // 3, candidates
        work = np.empty((5, 2 * LEARNT_FROM + 1))
        listed = (None,) * 5 if candidates is None else candidates.listed
        asked = used, start, BRIGHT, SHARE, LIKENESS, work, gain, reference, out
        self._name = _name.held(light, ..., ..., *asked, *listed)

    def name(self, size: int) -> None:
        """Of the first `size` columns."""
        self._name(size, 0 if self._known or not size else max(1, size * self._stripes // LEARNT_FROM))
        if self._candidates is not None:
            self._candidates.count()


def readings(inside: NDArray[np.uint8], outside: NDArray[np.uint8], colours: str) -> NDArray[np.bool_]:
    """(N, K): slit n has the two colours of ring k, as far as they are known, and at least one is."""
    pattern = letters(colours)
    out = np.empty((len(inside), len(pattern) - 1), np.bool_)
    _read(inside, outside, pattern, out)
    return out


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
    pattern = letters(colours)
    colour = np.ascontiguousarray(np.stack([inside, outside]), np.uint8)
    candidates = Candidates(np.ascontiguousarray(direction, np.int64), colour, pattern)
    candidates.list_by_colour(len(direction))
    listed = candidates.size
    if deviation is None:
        candidates.deviation[:listed] = 0.0
    else:
        candidates.deviation[:listed] = deviation[candidates.slit[:listed], candidates.ring[:listed]]
    return candidates.align(len(direction), tolerance)


def letters(colours: str) -> NDArray[np.uint8]:
    """A pattern's colours as indices into "RGB"."""
    return np.array(["RGB".index(c) for c in colours], np.uint8)


class Candidates:
    """Which rings each slit may be, listed slit by slit: only those whose two stripes have its colours. In memory that
    is used again; of the list the first `size` count."""

    def __init__(self, direction: NDArray[np.int64], colour: NDArray[np.uint8], pattern: NDArray[np.uint8]) -> None:
        """direction (N,) of slits, rising. colour (2, N) of their stripes inside and outside."""
        slits, rings = len(direction), len(pattern) - 1
        most = slits * rings
        self.size, self.unclear, self.left_out = 0, 0, 0
        self.slit, self.ring = np.empty(most, np.int32), np.empty(most, np.int32)
        self.deviation = np.empty(most)  # of the pipe's radius, if the slit were that ring; NaN: it cannot be
        self.named = np.empty(slits, np.int64)  # by slit: its ring, or NONE
        self.chosen = np.zeros(slits, np.int32)  # .. and where in the list that is
        self._counts, self._direction = np.empty(2, np.int64), direction
        fits = self.slit, self.ring, np.empty(most, np.uint8)
        self.listed = pattern, *fits, self._counts
        self._list = _list.held(colour, ..., *self.listed)
        room = rings * min(slits, LINE_MOST)
        work = np.array([SKIP, PLACE, MARGIN]), np.empty(most), np.empty((2, room), np.int64), np.empty((3, room))
        self._aligned = (direction, ..., *fits, self.deviation, ...), (..., ..., *work, self.named, self.chosen)
        self.lie_at(None, None, None)

    def lie_at(self, points: FloatArray | None, rotation: FloatArray | None, shift: FloatArray | None) -> None:
        """Where they lie, (3, C) mm, camera frame, and how the pipe's frame is turned, (3, 3), and shifted against it,
        (3,): tables that `align` takes their deviations from. Without, `deviation` holds them."""
        before, after = self._aligned
        self._align = _align.held(*before, points, rotation, shift, *after)

    def list_by_colour(self, slits: int) -> None:
        """Those of the first `slits`."""
        self._list(slits)
        self.count()

    def count(self) -> None:
        """Of what was just listed. unclear : slits that have a stripe that is UNKNOWN."""
        self.size, self.unclear = self._counts.tolist()

    def list_all(self, slits: int) -> None:
        """Every ring for each of the first `slits`, whose colours say nothing."""
        rings = len(self.slit) // max(len(self.named), 1)
        self.size = slits * rings
        self.slit[: self.size] = np.repeat(np.arange(slits), rings)
        self.ring[: self.size] = np.tile(np.arange(rings), slits)

    def take(self, ring: NDArray[np.int64]) -> NDArray[np.int64]:
        """Rings (N,) that something else than colours gave, where every ring is listed."""
        rings = len(self.slit) // max(len(self.named), 1)
        self.named[: len(ring)] = ring
        self.chosen[: len(ring)] = rings * np.arange(len(ring)) + np.maximum(ring, 0)
        self.left_out = int(np.count_nonzero(ring < 0))
        return self.named[: len(ring)]

    def align(self, slits: int, tolerance: float, radius_mm: float = 1.0) -> NDArray[np.int64]:
        """Ring of each of the first `slits`, or NONE, by the deviations; see `decode`. radius_mm : of the pipe that
        they are deviations from. left_out : slits that are none."""
        self.left_out = slits - self._align(slits, self.size, radius_mm, tolerance)
        return self.named[:slits]


_name = door(
    "rings_name",
    "f8[r,c] light",
    "i8 size",
    "i8 every",
    "i8[u] used",
    "f8[u,3] start",
    "f8 bright",
    "f8 share",
    "f8 likeness",
    "f8[5,w]! work",
    "f8[3]! gain",
    "f8[u,3]! reference",
    "u1[s,c]! out",
    "u1[p]? pattern",
    "i4[n]!? slit",
    "i4[n]!? name",
    "u1[n]!? fit",
    "i8[2]!? counts",
)
_read = door("rings_read", "u1[n] inside", "u1[n] outside", "u1[p] pattern", "b1[n,k]! out")
_list = door(
    "rings_list",
    "u1[2,c] colour",
    "i8 size",
    "u1[p] pattern",
    "i4[n]! slit",
    "i4[n]! name",
    "u1[n]! fit",
    "i8[2]! counts",
)
_align = door(
    "rings_align",
    "i8[c] direction",
    "i8 size",
    "i4[n] slit",
    "i4[n] name",
    "u1[n] fit",
    "f8[n]! deviation",
    "i8 listed",
    "f8[3,n]? points",
    "f8[3,3]? rotation",
    "f8[3]? shift",
    "f8 radius",
    "f8 tolerance",
    "f8[3] prices",
    "f8[n]! worth",
    "i8[2,w]! places",
    "f8[3,w]! work",
    "i8[c]! ring",
    "i4[c]! chosen",
    returns="i8",
)
