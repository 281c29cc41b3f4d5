"""Which ring each slit is, to be read: host/native/rings_colour.c, rings_decode.c and rings_choose.h."""

import math

import numpy as np

from annulus_pipe.rings.decode import BRIGHT, LEARNT_FROM, LIKENESS, MARGIN, NONE, PLACE, SHARE, SKIP, UNKNOWN


def learnt(stripes, used):
    """Gains (3,) of red, green, blue and references (U, 3) of the colours `used`, of this frame's own stripes (N, 3),
    red, green, blue."""
    gain, reference = np.zeros(3), np.eye(3)[used]
    some = stripes[:: max(1, len(stripes) // LEARNT_FROM)]
    if not len(some):
        return gain, reference
    for channel in used:
        gain[channel] = 1.0 / max(np.sort(some[:, channel])[min(int(BRIGHT * len(some)), len(some) - 1)], 1e-6)
    scaled = some * gain
    length = np.linalg.norm(scaled, axis=1)
    units = scaled[length > 1e-6] / length[length > 1e-6, None]
    enough = max(8, math.ceil(SHARE * len(units)))
    for _ in range(2):
        nearest = (units @ reference.T).argmax(axis=1)
        for i in range(len(used)):
            own = np.sort(units[nearest == i], axis=0)
            if len(own) >= enough and (median := own[len(own) // 2]).any():
                reference[i] = median / np.linalg.norm(median)
    return gain, reference


def named(stripes, gain, reference, used):
    """(N,) colours of stripes (N, 3), red, green, blue."""
    scaled = stripes * gain
    length = np.linalg.norm(scaled, axis=1)
    like = scaled @ reference.T
    clear = length > 1e-6
    if len(used) > 1:
        second, first = np.sort(like, axis=1)[:, -2:].T
        clear &= first - second > LIKENESS * length
    return np.where(clear, np.array(used)[like.argmax(axis=1)], UNKNOWN).astype(np.uint8)


def fits(inside, outside, pattern):
    """(N, K): how many of ring k's two colours slit n shows; 0 where one is another colour."""
    left, right = inside[:, None] == pattern[None, :-1], outside[:, None] == pattern[None, 1:]
    none_left, none_right = (inside == UNKNOWN)[:, None], (outside == UNKNOWN)[:, None]
    return (left | right) * (left | none_left) * (right | none_right) * (left.astype(int) + right)


def aligned(direction, fit, deviation, tolerance):
    """(N,) ring of each slit by how well colours fit (N, K) and by the wall that it would make (N, K)."""
    with np.errstate(invalid="ignore"):
        worth = fit + SKIP - PLACE * (deviation / tolerance) ** 2
        could_be = (fit > 0) & (np.abs(deviation) <= tolerance) & (worth > 0.0)
    return chosen(direction, np.where(could_be, worth, 0.0), MARGIN)


def chosen(direction, worth, margin):
    """(N,) ring of each slit, or NONE: of every line the alignment that is worth most, slits and rings in order, and of
    it what every other reading of that slit, or that ring, is worse than by `margin`. worth (N, K): 0 where slit n
    cannot be ring k. Alzuhiri 2022, section 3.4.2 slides a window along the line; this is that, with holes."""
    ring = np.full(len(direction), NONE, np.int64)
    for line in np.unique(direction):
        slits = np.flatnonzero(direction == line)
        through = best_through(worth[slits])
        for slit, name in np.argwhere(through > 0.0):
            others = np.concatenate([np.delete(through[slit], name), np.delete(through[:, name], slit)])
            total = through[slit, name]
            if total >= through.max() - 1e-9 and not (others[others > 0.0] > total - margin).any():
                ring[slits[slit]] = name
    return ring


def best_through(worth):
    """(N, K): what the best alignment is worth that reads slit n as ring k; 0 where it cannot be."""
    ahead = best_before(worth)
    behind = best_before(worth[::-1, ::-1])[::-1, ::-1]
    return np.where(worth > 0.0, ahead + worth + behind, 0.0)


def best_before(worth):
    """(N, K): what the best alignment of all slits before n with all rings before k is worth."""
    best = np.zeros((worth.shape[0] + 1, worth.shape[1] + 1))
    for n, k in np.ndindex(worth.shape):
        best[n + 1, k + 1] = max(best[n, k + 1], best[n + 1, k], best[n, k] + worth[n, k])
    return best[:-1, :-1]
