"""Which points are believed and how far, to be read: host/native/rings_outliers.c and rings_sigma of rings_sigma.c."""

import math

import numpy as np
from rings_points import across

from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.decode import NONE
from annulus_pipe.rings.outliers import (
    COMPANY,
    NARROW,
    NEIGHBOURS,
    SHADE,
    SHADE_REACH,
    UNLIKE,
    WIDE,
    WIDTH_EVERY,
    WIDTH_NOISE,
)
from annulus_pipe.rings.uncertainty import BLUR_LEAST, BLUR_MOST, CLIPPED_PX, DRAWN_PX, LAG, LEAST, UNKNOWN_PX


def middle(values):
    """Median, the upper one of two; 0 of nothing."""
    return float(np.sort(values)[len(values) // 2]) if len(values) else 0.0


def reject(ring, direction, width, bright, radius, step, directions):
    """Ring (N,) with NONE where a slit is not to be believed, how many for its width, as shaded, as alone, and by how
    much each is wider than its ring around there (N,). radius (N,), mm: the wall's there."""
    ring, wider, counts = ring.copy(), np.zeros(len(ring)), [0, 0, 0]
    frame = middle(width[ring != NONE])
    for k in range(len(step)):
        mine = np.flatnonzero(ring == k)
        if not len(mine):
            continue
        # Two slits with a dark stripe between them look like one wide one, all the way round.
        usual = min(max(middle(width[mine]), frame / UNLIKE), frame * UNLIKE)
        turn = 2.0 * math.pi / directions * direction
        harmonic = np.stack([np.ones(len(ring)), np.cos(turn), np.sin(turn)], axis=1)
        shape, spread = usual_width(width[mine[::WIDTH_EVERY]] / usual, harmonic[mine[::WIDTH_EVERY]])
        slack = min(max(1.0, WIDTH_NOISE * spread / (WIDE - 1.0)), 2.0)
        expected = np.clip(harmonic[mine] @ shape, NARROW, WIDE)
        part = width[mine] / usual / expected
        wider[mine] = width[mine] - usual * expected
        unlike = (part < 1.0 - (1.0 - NARROW) * slack) | (part > 1.0 + (WIDE - 1.0) * slack)
        ring[mine[unlike]] = NONE
        counts[0] += int(unlike.sum())

        slit = np.full(directions, NONE)  # of the ring, by direction
        slit[direction[mine[~unlike]]] = mine[~unlike]
        lit = np.where(slit == NONE, 0.0, bright[slit])
        near = [np.roll(lit, d) for d in range(-SHADE_REACH, SHADE_REACH + 1)]
        shaded = (slit != NONE) & (lit < SHADE * np.max(near, axis=0))
        ring[slit[shaded]] = NONE
        slit[shaded] = NONE
        counts[1] += int(shaded.sum())

        place = np.where(slit == NONE, math.nan, radius[slit])
        beside = [np.roll(place, d) for d in range(-NEIGHBOURS, NEIGHBOURS + 1) if d]
        alone = (slit != NONE) & ((np.abs(np.array(beside) - place) <= step[k]).sum(axis=0) < COMPANY)
        ring[slit[alone]] = NONE
        counts[2] += int(alone.sum())
    return ring, counts, wider


def usual_width(ratio, harmonic):
    """A ring's width over its median as mean, cosine and sine of the direction (3,), and the robust spread it."""
    shape, spread = np.array([1.0, 0.0, 0.0]), 0.2
    for _ in range(3):
        used = np.abs(ratio - harmonic @ shape) < max(2.5 * spread, 0.05)
        if used.sum() < 0.5 * len(ratio):
            break
        rows = harmonic[used]  # a trace of ridge, for an arc alone does not tell the three apart
        shape = np.linalg.solve(rows.T @ rows + 1e-6 * np.eye(3), rows.T @ ratio[used])
        spread = SIGMA_OF_MAD * middle(np.abs(ratio - harmonic @ shape))
    return shape, spread


def usual_widths(ring, width, rings, fewest):
    """(K,) the median width of each ring's slits; 0 of fewer than `fewest`."""
    own = [width[ring == k] for k in range(rings)]
    return np.array([np.median(one) if len(one) >= fewest else 0.0 for one in own])


def sigma(ring, direction, points, blur, wider, clipped, placed, mm_per_px, calibrated, bias):
    """(N,) the sigma of each point (3, N), mm, and (K,) how far each ring's edges seem drawn. placed : rotation, shift,
    covariance (4, 4) of the pose. rings.uncertainty.point_sigma has the theory, term by term."""
    rotation, shift, covariance = placed
    rings, directions = calibrated.shape
    u, v, ahead = across(points, rotation, np.append(shift[:2], 0.0))
    r = np.hypot(u, v)
    # A lean turns the point about the camera; leans are small, so x and y of the two frames are alike here.
    pull = np.stack([ahead * v, -ahead * u, -u, -v]) / r
    pose = np.einsum("an,ab,bn->n", pull, covariance, pull)

    table = np.zeros((rings, directions))  # 0: no point
    table[ring, direction] = r
    scatter, usual, median = UNKNOWN_PX * mm_per_px, np.ones(rings), np.zeros(rings)
    for k, line in enumerate(table):
        four = np.stack([np.roll(line, -LAG * i) for i in range(4)])
        third = np.abs(four[3] - four[0] - 3.0 * (four[2] - four[1]))[(four > 0.0).all(axis=0)]
        if len(third) >= LEAST:
            scatter[k] = SIGMA_OF_MAD / math.sqrt(20.0) * middle(third)
        if (line > 0.0).sum() >= LEAST:
            median[k] = middle(line[line > 0.0])
        usual[k] = max(middle(blur[ring == k]), 1e-9)

    known, common, apart = median > 0.0, bias, np.zeros(rings)
    if known.sum() > 1:
        apart[known] = np.abs(median[known] - middle(median[known])) / mm_per_px[known]
        common = min(max(SIGMA_OF_MAD * middle(apart[known]), bias), DRAWN_PX)
    share = np.where((common < apart) & (apart < DRAWN_PX), apart, common)  # px

    place = (scatter[ring] * np.clip(blur / usual[ring], BLUR_LEAST, BLUR_MOST)) ** 2
    shared = np.where(clipped, np.maximum(share, CLIPPED_PX)[ring], share[ring]) * mm_per_px[ring]
    # the width scatters by twice what the middle does; only what is more is not noise
    other = np.maximum((0.5 * wider * mm_per_px[ring]) ** 2 - 4.0 * place, 0.0) / 3.0
    out = np.sqrt(place + shared**2 + other + pose + calibrated[ring, direction] ** 2)
    return out, np.sqrt(np.maximum(share**2 - bias**2, 0.0)) * mm_per_px
