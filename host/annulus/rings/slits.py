"""Dark slits along every polar line, to a fraction of a pixel, with the light on both sides of each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus.rings.compiled import compiled
from annulus.rings.polar import PolarGrid

PER_LINE = 48  # slits kept of one line; a wall that shows more is not a wall
FALL = 0.72  # a slit is darker than this part of the light before it and after it
SHALLOW = 0.65  # a slit is at least this part as deep as the frame's usual one
HALFWAY, LEVEL = 0.5, 0.4  # an edge ends where that part of the light is back and the slope is down to that part
FAINT = 0.03  # stripes dimmer than this part of the frame's bright level are darkness
WEAK, NOISY = 2.5, 0.015  # a channel so many times weaker than the strongest is raised; of that one's light in noise


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
    light beside the slit and of the frame's own bright level and noise. A channel that the wall's paint swallows
    (blue, on a yellow pipe) is raised for this, black taken off, or its stripes would be darkness beside the others.
    """
    # a smoothing that stripes of the densest ring survive
    sigma = min(1.4, max(0.6, grid.spacing_px / 16.0))
    taps = np.exp(-0.5 * (np.arange(5) / sigma) ** 2)
    taps = (taps / (taps[0] + 2 * taps[1:].sum())).astype(np.float32)
    blue, green, red = _raised(cv2.split(polar), grid)
    top = np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)
    bright, noise = _level(top, grid)
    floor = max(FAINT * bright, 4.0 * noise, 2.0)
    out = np.empty((len(grid.cosine) * PER_LINE, 10), np.float32)
    n, crowded = _scan(polar, top, grid.stop, taps, np.float32(floor), np.float32(grid.spacing_px), out)
    found = out[:n].astype(np.float64)
    dark = found[:, 9] >= SHALLOW * np.median(found[:, 9]) if n else np.zeros(0, bool)
    kept = found[dark]
    return Slits(
        kept[:, 0].astype(np.int64), kept[:, 1], kept[:, 2], kept[:, 3:6], kept[:, 6:9],
        int(np.count_nonzero(~dark)), int(crowded),
    )  # fmt: skip


def _raised(channels: Sequence[cv2.typing.MatLike], grid: PolarGrid) -> list[cv2.typing.MatLike]:
    """The channels, those that are weak all over the frame brought up towards the strongest, short of their noise."""
    inside = np.arange(1, channels[0].shape[1], 3) < grid.stop[::24, None]
    values = [np.asarray(channel[::24, 1::3][inside], np.uint8) for channel in channels]
    counted = [np.cumsum(np.bincount(value, minlength=256)) for value in values]
    black, full = (
        np.array([int(np.searchsorted(count, part * count[-1])) for count in counted]) for part in (0.02, 0.97)
    )
    light = np.maximum(full - black, 1)
    out = list(channels)
    for c, channel in enumerate(channels):
        if WEAK * light[c] >= light.max():
            continue
        before = np.asarray(channel[::24, 0:-1:3][:, : inside.shape[1]][inside], np.int16)
        darker = values[c] <= np.percentile(values[c], 50)  # holds few edges
        noise = float(np.abs(values[c][darker] - before[darker]).mean())
        gain = min(light.max() / light[c], NOISY * light.max() / max(noise, 1.0))
        if gain > 1.0:
            table = np.clip((np.arange(256) - black[c]) * gain, 0, 255)
            out[c] = cv2.LUT(channel, table.astype(np.uint8))
    return out


def _level(top: NDArray[np.uint8], grid: PolarGrid) -> tuple[float, float]:
    """The frame's bright level and noise in grey levels, from every 24th line and every third sample along it."""
    inside = np.arange(1, top.shape[1], 3) < grid.stop[::24, None]
    values = top[::24, 1::3][inside].astype(np.int16)
    if not values.size:
        return 0.0, 0.0
    before = top[::24, 0:-1:3][:, : inside.shape[1]][inside].astype(np.int16)
    half, bright = np.percentile(values, [50, 95])
    # the darker half of the samples holds few edges
    noise = 1.4826 / math.sqrt(2) * float(np.median(np.abs(values - before)[values <= half]))
    return float(bright), noise


@compiled
def _scan(polar, bright, stop, taps, floor, spacing, out):  # type: ignore[no-untyped-def]
    longest = polar.shape[1]
    top = np.empty(longest, np.float32)
    smooth = np.zeros(longest, np.float32)
    slope = np.zeros(longest, np.float32)
    low = np.empty(PER_LINE + 1, np.int64)  # bottoms and the stripes' tops between them: high[k] low[k] high[k + 1]
    high = np.empty(PER_LINE + 2, np.int64)
    fall = np.float32(FALL)
    t0, t1, t2, t3, t4 = taps[0], taps[1], taps[2], taps[3], taps[4]
    n = 0
    crowded = 0
    for j in range(len(stop)):
        length = stop[j]
        if length < 16:
            continue
        line = polar[j]
        top[:length] = bright[j, :length]
        # Shifted views, not shifted indices: the compiler then knows that nothing wraps and uses vectors (8 times).
        m = length - 8
        b4, b3, b2, b1, at = top[0:m], top[1 : m + 1], top[2 : m + 2], top[3 : m + 3], top[4 : m + 4]
        a1, a2, a3, a4, into = top[5 : m + 5], top[6 : m + 6], top[7 : m + 7], top[8 : m + 8], smooth[4 : m + 4]
        for i in range(m):
            into[i] = (
                t0 * at[i] + t1 * (b1[i] + a1[i]) + t2 * (b2[i] + a2[i]) + t3 * (b3[i] + a3[i]) + t4 * (b4[i] + a4[i])
            )
        before, after, into = smooth[4 : m + 2], smooth[6 : m + 4], slope[5 : m + 3]
        for i in range(m - 2):
            into[i] = after[i] - before[i]

        # Alternate tops and bottoms: one is confirmed when the next has clearly begun.
        k = 0
        rising = True
        best, value = 5, smooth[5]
        inner = smooth[: length - 5]
        for i in range(6, len(inner)):
            s = inner[i]
            if rising:
                if s > value:
                    best, value = i, s
                elif s < fall * value and value > floor and value - s > np.float32(0.5) * floor:
                    high[k] = best
                    rising = False
                    best, value = i, s
            elif s < value:
                best, value = i, s
            elif fall * s > value and s - value > floor:
                if k == PER_LINE:
                    crowded += 1
                    break
                low[k] = best
                k += 1
                rising = True
                best, value = i, s
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
            previous = low[q - 1] if q > 0 else 0
            following = low[q + 1] if q + 1 < k else length - 1
            p1 = np.int64(left - blur)
            p0 = max(np.int64(left - blur - reach), (p1 + previous) // 2)
            p2 = np.int64(right + blur) + 1
            p3 = min(np.int64(right + blur + reach) + 1, (p2 + following) // 2)
            for c in range(3):
                dark = np.float32(min(line[bottom, c], min(line[bottom - 1, c], line[bottom + 1, c])))
                out[n, 3 + c] = max(_mean(line[:, c], p0, p1) - dark, np.float32(0.0))
                out[n, 6 + c] = max(_mean(line[:, c], p2, p3) - dark, np.float32(0.0))
            beside = min(_mean(smooth, p0, p1), _mean(smooth, p2, p3))
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
