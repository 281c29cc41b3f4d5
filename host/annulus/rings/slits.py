"""Dark slits along every polar line, to a fraction of a pixel, with the light on both sides of each."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus.rings.compiled import compiled
from annulus.rings.polar import PolarGrid

PER_LINE = 48  # slits kept of one line; a wall that shows more is not a wall
FALL = 0.72  # a slit is darker than this part of the light before it and after it
SHALLOW = 0.65  # a slit is at least this part as deep as the frame's usual one
HALFWAY, LEVEL = 0.5, 0.4  # an edge ends where that part of the light is back and the slope is down to that part
FAINT = 0.03  # stripes dimmer than this part of the frame's bright level are darkness


@dataclass(frozen=True, slots=True, eq=False)
class Slits:
    """What was found, sorted by direction, then outwards. Positions in samples of the grid's lines."""

    direction: NDArray[np.int64]  # (N,)
    position: NDArray[np.float64]  # (N,) halfway between the two edges
    width: NDArray[np.float64]  # (N,) between the edges
    inside: NDArray[np.float64]  # (N, 3) BGR of the stripe on the inner side, the slit's own darkness taken off
    outside: NDArray[np.float64]  # (N, 3)
    shallow: int  # dips left out because they were not nearly as dark as this frame's slits are
    crowded: int  # slits left out because a line had more than PER_LINE


def find_slits(polar: NDArray[np.uint8], grid: PolarGrid) -> Slits:
    """Slits of one frame laid out by `polar.unroll`, (J, L, 3) BGR.

    Each edge is the steepest place of max(B, G, R) between a slit's bottom and its stripe, so neither the stripes'
    unequal brightness nor their slope moves it (raw luma does, by up to a millimetre). Thresholds are parts of the
    light beside the slit and of the frame's own bright level and noise.
    """
    # a smoothing that stripes of the densest ring survive
    sigma = min(1.4, max(0.6, grid.spacing_px / 16.0))
    taps = np.exp(-0.5 * (np.arange(5) / sigma) ** 2)
    taps = (taps / (taps[0] + 2 * taps[1:].sum())).astype(np.float32)
    bright, noise = _level(polar, grid)
    floor = max(FAINT * bright, 4.0 * noise, 2.0)
    out = np.empty((len(grid.cosine) * PER_LINE, 10), np.float32)
    n, crowded = _scan(polar, grid.stop, taps, np.float32(floor), np.float32(grid.spacing_px), out)
    found = out[:n].astype(np.float64)
    dark = found[:, 9] >= SHALLOW * np.median(found[:, 9]) if n else np.zeros(0, bool)
    kept = found[dark]
    return Slits(
        kept[:, 0].astype(np.int64), kept[:, 1], kept[:, 2], kept[:, 3:6], kept[:, 6:9],
        int(np.count_nonzero(~dark)), int(crowded),
    )  # fmt: skip


def _level(polar: NDArray[np.uint8], grid: PolarGrid) -> tuple[float, float]:
    """The frame's bright level and noise in grey levels, from every 16th line and every third sample along it."""
    inside = np.arange(1, polar.shape[1], 3) < grid.stop[::16, None]
    values = polar[::16, 1::3].max(axis=2)[inside].astype(np.float32)
    if not values.size:
        return 0.0, 0.0
    before = polar[::16, 0:-1:3][:, : inside.shape[1]].max(axis=2)[inside].astype(np.float32)
    dim = values <= np.percentile(values, 50)  # half the samples or more are dark or plain stripe
    noise = 1.4826 / math.sqrt(2) * float(np.median(np.abs(values - before)[dim]))
    return float(np.percentile(values, 95)), noise


@compiled
def _scan(polar, stop, taps, floor, spacing, out):  # type: ignore[no-untyped-def]
    longest = polar.shape[1]
    top = np.empty(longest, np.float32)
    smooth = np.zeros(longest, np.float32)
    slope = np.zeros(longest, np.float32)
    low = np.empty(PER_LINE + 1, np.int64)  # bottoms and the stripes' tops between them: high[k] low[k] high[k + 1]
    high = np.empty(PER_LINE + 2, np.int64)
    n = 0
    crowded = 0
    for j in range(len(stop)):
        length = stop[j]
        if length < 16:
            continue
        line = polar[j]
        for i in range(length):
            top[i] = np.float32(max(line[i, 0], max(line[i, 1], line[i, 2])))
        for i in range(4, length - 4):
            smooth[i] = (
                taps[0] * top[i] + taps[1] * (top[i - 1] + top[i + 1]) + taps[2] * (top[i - 2] + top[i + 2])
                + taps[3] * (top[i - 3] + top[i + 3]) + taps[4] * (top[i - 4] + top[i + 4])
            )  # fmt: skip
        for i in range(5, length - 5):
            slope[i] = smooth[i + 1] - smooth[i - 1]

        # Alternate tops and bottoms: one is confirmed when the next has clearly begun.
        k = 0
        rising = True
        high[0] = 5
        best = 5
        for i in range(6, length - 5):
            s = smooth[i]
            if rising:
                if s > smooth[best]:
                    best = i
                elif smooth[best] > floor and s < FALL * smooth[best] and smooth[best] - s > np.float32(0.5) * floor:
                    high[k] = best
                    rising = False
                    best = i
            elif s < smooth[best]:
                best = i
            elif FALL * s > smooth[best] and s - smooth[best] > floor:
                if k == PER_LINE:
                    crowded += 1
                    break
                low[k] = best
                k += 1
                rising = True
                best = i
        if rising:
            high[k] = best

        for q in range(k):
            # The nearest edge on each side: the steepest place up to where the light is back and level again. The
            # steepest of the whole stripe could be the rim of a pocket farther on.
            bottom = low[q]
            last = high[q + 1]
            back = smooth[bottom] + HALFWAY * (min(smooth[high[q]], smooth[last]) - smooth[bottom])
            a = bottom
            for i in range(bottom, high[q] - 1, -1):
                if slope[i] < slope[a]:
                    a = i
                elif smooth[i] > back and slope[i] > LEVEL * slope[a]:
                    break
            e = bottom
            for i in range(bottom, last + 1):
                if slope[i] > slope[e]:
                    e = i
                elif smooth[i] > back and slope[i] < LEVEL * slope[e]:
                    break
            if a < 6 or e > length - 7 or e <= a:
                continue
            left = _extremum(slope[a - 1], slope[a], slope[a + 1]) + a
            right = _extremum(slope[e - 1], slope[e], slope[e + 1]) + e
            out[n, 0] = j
            out[n, 1] = np.float32(0.5) * (left + right)
            out[n, 2] = right - left
            # the stripes' light just beyond the edges, but not beyond half way to the next slit
            blur = np.float32(1.5)
            reach = max(np.float32(2.0), np.float32(0.12) * spacing)
            before = low[q - 1] if q > 0 else 0
            after = low[q + 1] if q + 1 < k else length - 1
            a1 = np.int64(left - blur)
            a0 = max(np.int64(left - blur - reach), (a1 + before) // 2)
            e0 = np.int64(right + blur) + 1
            e1 = min(np.int64(right + blur + reach) + 1, (e0 + after) // 2)
            for c in range(3):
                dark = np.float32(min(line[bottom, c], min(line[bottom - 1, c], line[bottom + 1, c])))
                out[n, 3 + c] = max(_mean(line[:, c], a0, a1) - dark, np.float32(0.0))
                out[n, 6 + c] = max(_mean(line[:, c], e0, e1) - dark, np.float32(0.0))
            beside = min(_mean(smooth, a0, a1), _mean(smooth, e0, e1))
            out[n, 9] = np.float32(1.0) - min(smooth[bottom] / max(beside, np.float32(1.0)), np.float32(1.0))
            n += 1
    return n, crowded


@compiled
def _extremum(before, at, after):  # type: ignore[no-untyped-def]
    """Offset of the top of the parabola through three samples, within half a sample."""
    bend = before - 2 * at + after
    if bend == 0:
        return np.float32(0.0)
    return min(max(np.float32(0.5) * (before - after) / bend, np.float32(-0.5)), np.float32(0.5))


@compiled
def _mean(values, start, stop):  # type: ignore[no-untyped-def]
    start, stop = max(start, 0), min(max(stop, start), len(values) - 1)
    total = np.float32(0.0)
    for i in range(start, stop + 1):
        total += np.float32(values[i])
    return total / np.float32(stop + 1 - start)
