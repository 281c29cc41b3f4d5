"""Slits that got a ring's name and are still not believed: half covered, in a shadow's edge, or alone.

Assumed: a ring's width changes slowly round the image, and a wall has no points of its own. A defect's flank may be
steep but is seen by several neighbours; a slit that a rod's shadow cuts is narrow, dim, or by itself. Where most of a
ring is covered its usual width is wrong: then it is held near the frame's.
"""

import math

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import around, jit, middle
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.decode import NONE
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
    counts = np.zeros(3, np.int64)
    wider = np.zeros(len(ring))
    turn = 2 * math.pi / directions * np.arange(directions)
    _reject(
        ring,
        slits.direction,
        slits.width,
        slits.inside,
        slits.outside,
        radius_mm,
        step_mm,
        np.cos(turn),
        np.sin(turn),
        counts,
        wider,
    )
    found = {"width": int(counts[0]), "shaded": int(counts[1]), "alone": int(counts[2])}
    return found, wider


@jit
def _reject(ring, direction, width, inside, outside, radius, step, cosine, sine, counts, wider):  # type: ignore[no-untyped-def]
    directions = len(cosine)
    mine = np.empty(directions, np.int64)
    slit = np.empty(directions, np.int64)  # of one ring, by direction; -1 where it has none
    light = np.zeros(directions)
    work = np.empty(max(len(ring), 1))
    size = 0
    for n in range(len(ring)):
        if ring[n] != NONE:
            work[size] = width[n]
            size += 1
    frame = middle(work, size)
    for k in range(len(step)):
        size = 0
        for n in range(len(ring)):
            if ring[n] == k:
                mine[size] = n
                work[size] = width[n]
                size += 1
        if size == 0:
            continue
        # Two slits with a dark stripe between them look like one wide one, all the way round.
        usual = min(max(middle(work, size), frame / UNLIKE), frame * UNLIKE)
        mean, even, odd, spread = _usual_width(mine, size, direction, width, usual, cosine, sine, work)
        slack = min(max(1.0, WIDTH_NOISE * spread / (WIDE - 1.0)), 2.0)
        slit[:] = -1
        for m in range(size):
            n = mine[m]
            j = direction[n]
            expected = min(max(mean + even * cosine[j] + odd * sine[j], NARROW), WIDE)
            ratio = width[n] / usual / expected
            wider[n] = width[n] - usual * expected
            if ratio < 1.0 - (1.0 - NARROW) * slack or ratio > 1.0 + (WIDE - 1.0) * slack:
                ring[n] = NONE
                counts[0] += 1
            else:
                slit[j] = n
                light[j] = max(inside[n, 0], inside[n, 1], inside[n, 2]) + max(
                    outside[n, 0], outside[n, 1], outside[n, 2]
                )
        for j in range(directions):
            if slit[j] >= 0:
                brightest = 0.0
                for d in range(-SHADE_REACH, SHADE_REACH + 1):
                    other = around(j + d, directions)
                    if slit[other] >= 0:
                        brightest = max(brightest, light[other])
                if light[j] < SHADE * brightest:
                    ring[slit[j]] = NONE
                    counts[1] += 1
        for j in range(directions):
            if slit[j] >= 0 and ring[slit[j]] == NONE:
                slit[j] = -1
        for j in range(directions):
            if slit[j] >= 0:
                company = 0
                for d in range(-NEIGHBOURS, NEIGHBOURS + 1):
                    other = slit[around(j + d, directions)]
                    if d != 0 and other >= 0 and abs(radius[other, k] - radius[slit[j], k]) <= step[k]:
                        company += 1
                if company < COMPANY:
                    ring[slit[j]] = NONE
                    counts[2] += 1


@jit
def _usual_width(mine, size, direction, width, usual, cosine, sine, work):  # type: ignore[no-untyped-def]
    """A ring's width over its median as mean, cosine and sine of the direction, and the robust spread about that."""
    mean, even, odd, spread = 1.0, 0.0, 0.0, 0.2
    some = (size + WIDTH_EVERY - 1) // WIDTH_EVERY  # three numbers do not need every direction
    for _ in range(3):
        limit = max(2.5 * spread, 0.05)
        used = 0
        sc, ss, scc, sss, scs, sv, svc, svs = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(0, size, WIDTH_EVERY):
            j = direction[mine[m]]
            c, s, v = cosine[j], sine[j], width[mine[m]] / usual
            if abs(v - mean - even * c - odd * s) < limit:
                used += 1
                sc, ss, scc, sss, scs = sc + c, ss + s, scc + c * c, sss + s * s, scs + c * s
                sv, svc, svs = sv + v, svc + v * c, svs + v * s
        if used < 0.5 * some:
            break
        # Cramer's rule on the normal equations; a trace of ridge, for an arc alone does not tell the three apart
        a, b, d = used + 1e-6, scc + 1e-6, sss + 1e-6
        det = a * (b * d - scs * scs) - sc * (sc * d - scs * ss) + ss * (sc * scs - b * ss)
        mean = (sv * (b * d - scs * scs) - sc * (svc * d - scs * svs) + ss * (svc * scs - b * svs)) / det
        even = (a * (svc * d - svs * scs) - sv * (sc * d - scs * ss) + ss * (sc * svs - svc * ss)) / det
        odd = (a * (b * svs - scs * svc) - sc * (sc * svs - ss * svc) + sv * (sc * scs - b * ss)) / det
        at = 0
        for m in range(0, size, WIDTH_EVERY):
            j = direction[mine[m]]
            work[at] = abs(width[mine[m]] / usual - mean - even * cosine[j] - odd * sine[j])
            at += 1
        spread = SIGMA_OF_MAD * middle(work, at)
    return mean, even, odd, spread
