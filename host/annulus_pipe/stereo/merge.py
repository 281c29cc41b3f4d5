"""Where each ring met the wall, from what several cameras saw of it.

A ring's light leaves the projector along generators of its cone. On each of them the wall is one unknown, the distance
from the vertex. A camera that sees the ring says where its image is; how many pixels that moves with a mm of the wall
is the camera's sensitivity there, and the farther of two roots (§5.2) is the one near which it is taken. So the wall is
where the weighted squares of what is left, in pixels, are least: where one camera's ray is tangent to the cone
(delta = 0) its sensitivity is zero and it says nothing, by itself; no threshold decides (Alzuhiri 2022 has one, Delta).

Assumed: the cameras see the same wall. When they do not (an edge between them, a slit misread), they contradict each
other beyond what their sigmas allow, and neither is believed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.stereo.view import Expected, View

# What sigmas are worth, by topic stereo of the metrology table; host/native/stereo_merge.c has the method's thresholds
LEAST = 200  # points that must tell it
UNIT_LEAST = 0.5  # a factor of no less ..
UNIT_MOST = 3.0  # .. and no more
KNOWN, UNSEEN, CONTRADICTED, BLUNT, EDGE = 0, 1, 2, 3, 4

_solve = door(
    "stereo_merge",
    "f8[k,3] vertices",
    "f8[k,p,3] ways",
    "f8[k,p] start",
    "f8[k] limit",
    "f8[c,34] lenses",
    "f8[c,4,k,p] expected",
    "f8[c,k,j] course",
    "f8[c,k,j] stray",
    "f8[c,k,j] sigma_px",
    "f8[c,k,j] edge_px",
    "f8[c] bias_px",
    "b1[c,k,p]? usable",
    "f8[w]! work",
    "f8[k,p]! distance",
    "f8[k,p]! sigma",
    "i8[k,p]! camera",
    "i8[k,p]! heaviest",
    "i8[k,p]! line",
    "i8[k,p]! state",
    "f8[k,p]! apart",
)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What one camera saw of the rings. On its lines (K, J): samples, NaN for nowhere; their standard deviation, px; of
    that what a slit across an edge of the wall may be off, in all cameras alike.
    bias_px: what neighbours may be off together."""

    place: FloatArray
    sigma_px: FloatArray
    edge_px: FloatArray
    bias_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """By ring and generator (K, P): distance from the vertex, mm, NaN where not known; its standard deviation; which
    camera saw it, its place in the list or, of several, their number; the heaviest, and the line it saw it on;
    KNOWN, UNSEEN, CONTRADICTED, BLUNT (seen, but from where it says too little of the wall) or EDGE (across one)."""

    distance_mm: FloatArray
    sigma_mm: FloatArray
    camera: NDArray[np.int64]
    heaviest: NDArray[np.int64]
    line: NDArray[np.int64]
    state: NDArray[np.int64]
    apart: FloatArray  # squares of how far the cameras lie apart, in sigmas, where each has a share; NaN elsewhere

    @property
    def unit(self) -> float:
        """What sigmas are to be multiplied by: how far the cameras really lie apart says one half of the variance, by
        the median; the other they may have in common. 1 where too few points tell."""
        known = self.apart[np.isfinite(self.apart)]
        if len(known) < LEAST:
            return 1.0
        unit = float(np.clip(SIGMA_OF_MAD * np.sqrt(np.median(known)), UNIT_LEAST, UNIT_MOST))
        return math.sqrt((1.0 + unit**2) / 2.0)


def merge(
    views: Sequence[View],
    expected: Sequence[Expected],
    sights: Sequence[Sight],
    vertices: FloatArray,
    ways: FloatArray,
    start_mm: FloatArray,
    sigma_most_mm: FloatArray,
    usable: BoolArray | None = None,
) -> Merged:
    """The wall's distance along each generator.

    Parameters
    ----------
    vertices (K, 3), ways (K, P, 3), start_mm (K, P) : generators, and how far a clean pipe is along them.
    sigma_most_mm : (K,) of each ring: a distance known no better is not known.
    usable : (C, K, P) where each camera is asked, and all count alike; None, everywhere, by what each says.
    """
    shape, course = start_mm.shape, np.stack([e.course for e in expected])
    camera, heaviest, line, state = np.empty((4, *shape), np.int64)
    merged = Merged(np.empty(shape), np.empty(shape), camera, heaviest, line, state, np.empty(shape))
    _solve(
        *(np.ascontiguousarray(one, np.float64) for one in (vertices, ways, start_mm, sigma_most_mm)),
        np.stack([view.lens for view in views]),
        np.stack([e.by_generator for e in expected]),
        course,
        np.stack([s.place for s in sights]) - course,
        np.stack([s.sigma_px for s in sights]),
        np.stack([s.edge_px for s in sights]),
        np.array([s.bias_px for s in sights]),
        None if usable is None else np.ascontiguousarray(usable, np.bool_),
        np.empty(len(views) * (4 * (shape[1] + 1) + 2)),
        merged.distance_mm,
        merged.sigma_mm,
        camera,
        heaviest,
        line,
        state,
        merged.apart,
    )
    return merged
