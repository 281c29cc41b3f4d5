"""Slits that got a ring's name and are still not believed: half covered, in a shadow's edge, or alone.

Assumed: a ring's width changes slowly round the image, and a wall has no points of its own. A defect's flank may be
steep but is seen by several neighbours; a slit that a rod's shadow cuts is narrow, dim, or by itself. Where most of a
ring is covered its usual width is wrong: then it is held near the frame's.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.slits import Slits

# Measured by topic uncertainty: true radii inside k = 2, which a slit believed wrongly leaves; and by the wrong and
# read points of topic colour, whose frames have rods' shadows.
NARROW = 0.7  # of the ring's width around there: narrower, a slit is half covered ..
WIDE = 1.35  # .. and wider, part of a shadow ..
WIDTH_NOISE = 4.0  # .. unless widths scatter so much that this many sigma reach farther
WIDTH_EVERY = 4  # points: what the ring's width is learnt from
UNLIKE = 2.0  # a ring's usual width is within this factor of the frame's
SHADE = 0.5  # a slit has at least this part of its ring's light ..
SHADE_REACH = 2  # .. so many directions to the side
NEIGHBOURS = 4  # a point needs company among so many directions on each side ..
COMPANY = 3  # .. of so many points of its ring


def reject_outliers(
    ring: NDArray[np.int64], slits: Slits, radius_mm: FloatArray, step_mm: FloatArray, directions: int
) -> tuple[dict[str, int], FloatArray]:
    """Set `ring` (N,) to NONE, in place, where a slit is not to be believed, and count why.

    Also says how much wider than its ring around there each slit is, (N,) px; 0 for those that are no ring.

    Parameters
    ----------
    radius_mm : (N, K) the wall's radius if slit n were ring k. step_mm : (K,) how much two neighbours may differ.

    Notes
    -----
    Width: much narrower or wider than the ring is around there, where a mean and a first harmonic over the direction
    follow a leaning head. Shade: much dimmer than the ring a step to the side. Alone: too few neighbours of its own
    ring at nearly its radius.
    """
    size = len(ring)
    bright = _brightest(slits.inside) + _brightest(slits.outside)
    radius = np.take_along_axis(radius_mm, np.maximum(ring, 0)[:, None], axis=1)[:, 0] if size else np.empty(0)
    named = NamedSlits(
        ring,
        np.asarray(slits.direction),
        np.array(slits.width, np.float64),
        np.array(bright, np.float64),
        np.arange(size, dtype=np.int32),
        np.array(radius - 1.0, np.float64),
    )
    judge = Outliers(named, 1.0, step_mm, directions)
    judge.reject(size)
    return judge.counts(), judge.wider


def _brightest(light: FloatArray) -> FloatArray:
    """(N,) of (N, 3); max over so short an axis takes numpy twenty times as long."""
    return np.maximum(np.maximum(light[:, 0], light[:, 1]), light[:, 2])


class NamedSlits(NamedTuple):
    """Slits (N,): ring, direction, width, bright (of their stripes together), and which of the deviations (C,) of the
    wall's radius from the pipe's is theirs."""

    ring: NDArray[np.int64]
    direction: NDArray[np.int64]
    width: FloatArray
    bright: FloatArray
    chosen: NDArray[np.int32]
    deviation: FloatArray


class Outliers:
    """`reject_outliers` in memory that is used again for each frame. `wider` is as there."""

    def __init__(self, slits: NamedSlits, pipe_radius_mm: float, step_mm: FloatArray, directions: int) -> None:
        most = len(slits.ring)
        self.wider = np.zeros(most)
        turn = 2 * math.pi / directions * np.arange(directions)
        limits = np.array([NARROW, WIDE, WIDTH_NOISE, UNLIKE, SHADE, SIGMA_OF_MAD])
        work, self._counts = np.empty(max(most + 1, 6 * (directions + 16))), np.zeros(3, np.int64)
        fixed = pipe_radius_mm, np.array(step_mm, np.float64), np.cos(turn), np.sin(turn), limits
        asked = WIDTH_EVERY, SHADE_REACH, NEIGHBOURS, COMPANY
        room = work, np.empty(most + 1, np.int32), np.empty(directions, np.int64), self._counts, self.wider
        self._reject = _reject.held(*slits, *fixed, *asked, ..., *room)

    def reject(self, size: int) -> None:
        """Of the first `size` slits."""
        self._reject(size)

    def counts(self) -> dict[str, int]:
        """How many were set to NONE, by reason."""
        return dict(zip(("width", "shaded", "alone"), self._counts.tolist(), strict=True))


_reject = door(
    "rings_reject",
    "i8[n]! ring",
    "i8[n] direction",
    "f8[n] width",
    "f8[n] bright",
    "i4[n] chosen",
    "f8[c] deviation",
    "f8 pipe",
    "f8[k] step",
    "f8[j] cosine",
    "f8[j] sine",
    "f8[l] limits",
    "i8 every",
    "i8 reach",
    "i8 neighbours",
    "i8 company",
    "i8 size",
    "f8[w]! work",
    "i4[o]! order",
    "i8[j]! slit",
    "i8[3]! counts",
    "f8[n]! wider",
)
