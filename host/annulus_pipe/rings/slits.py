"""Dark slits along every polar line, to a fraction of a pixel, with the light on both sides of each.

Assumed: a slit is dark between two lit stripes, wider than its blur; light along a stripe changes slowly.

What carries it: an edge is where the strongest channel's slope is steepest, which neither the stripes' unequal
brightness nor their slope moves; a slit is halfway between its two edges, so blur moves it only as far as it blurs the
two unlike. All thresholds are parts of the light beside the slit or of the frame's own bright level and noise.

When it breaks: noise scatters places, which `uncertainty` measures in the frame itself; light at full scale
cuts half an edge away, which `uncertainty` counts; what is merely dim (a shadow, a groove) is `shallow`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.jit import around, jit, middle
from annulus_pipe.rings.polar import PolarGrid, Unrolled

# Parts of light unless named. What is found at all is measured by topic colour (share of visible points read) and
# test_slits; where an edge lies by topics uncertainty and diameter. PER_LINE: unguarded.
PER_LINE = 48  # slits kept of one line; a wall that shows more is not a wall
FALL = 0.72  # a slit is darker than this part of the light before it and after it
SHALLOW = 0.65  # a slit is at least this part as deep as the frame's usual one
HALFWAY = 0.5  # an edge ends where this part of the light is back ..
LEVEL = 0.4  # .. and the slope is down to this part of its steepest
CLEAR = 5  # samples from an edge, where its blur has ended
BESIDE = 8  # .. and over how many more the light's slope is read
STEEPEST = 4.0  # a power of the distance from the centre: light that changes faster is another edge
BLUR_MOST = 9.0  # samples: no edge is taken for softer
FAINT = 0.03  # stripes dimmer than this part of the frame's bright level are darkness


@dataclass(frozen=True, slots=True, eq=False)
class Slits:
    """What was found, sorted by direction, then outwards. Positions in samples of the grid's lines."""

    direction: NDArray[np.int64]  # (N,)
    position: NDArray[np.float64]  # (N,) halfway between the two edges
    width: NDArray[np.float64]  # (N,) between the edges
    inside: NDArray[np.float64]  # (N, 3) BGR of the stripe on the inner side, the slit's own darkness taken off
    outside: NDArray[np.float64]  # (N, 3)
    edge_blur: NDArray[np.float64]  # (N,) of both edges: root of the sum of squares of 1 / curvature of the slope there
    shallow: int  # dips left out because they were not nearly as dark as this frame's slits are
    crowded: int  # slits left out because a line had more than PER_LINE


def find_slits(unrolled: Unrolled, grid: PolarGrid) -> Slits:
    """Slits of one frame laid out by `polar.unroll`.

    Each edge is the steepest place of the strongest channel between a slit's bottom and its stripe, so neither the
    stripes' unequal brightness nor their slope moves it (raw luma does, by up to a millimetre). Thresholds are parts of
    the light beside the slit and of the frame's own bright level and noise.
    """
    taps = smoothing(grid.spacing_px)
    floor = max(FAINT * unrolled.bright, 4.0 * unrolled.noise, 2.0)
    found = np.empty((len(grid.cosine) * PER_LINE, 10), np.float32)
    stop = np.minimum(grid.stop - unrolled.first, unrolled.top.shape[1])
    away = (grid.first + grid.step * unrolled.first, grid.step)
    n, crowded = _scan(unrolled.top, stop, away, taps, np.float32(floor), np.float32(grid.spacing_px), found)
    dark = _dark_ones(found, n)
    kept = len(dark)
    direction, place, light = np.empty(kept, np.int64), np.empty((3, kept)), np.empty((2, kept, 3))
    _sides(unrolled.image, grid.centre, away, grid.cosine, grid.sine, found, dark, direction, place, light)
    return Slits(direction, unrolled.first + place[0], place[1], light[0], light[1], place[2], n - kept, crowded)


def smoothing(spacing_px: float) -> NDArray[np.float32]:
    """Middle and one side of the taps that lines are smoothed with: the stripes of the densest ring survive it."""
    sigma = min(1.4, max(0.6, spacing_px / 16.0))
    taps = np.exp(-0.5 * (np.arange(5) / sigma) ** 2)
    return np.asarray(taps / (taps[0] + 2 * taps[1:].sum()), np.float32)


@jit
def _scan(bright, stop, away, taps, floor, spacing, out):  # type: ignore[no-untyped-def]
    """Rows of `out`: direction, position, width, bottom, how dark, and the stripes' samples beside: first and last of
    the inner side, first and last of the outer; the edges' blur."""
    longest = bright.shape[1]
    top = np.empty(longest, np.float32)
    smooth = np.zeros(longest, np.float32)
    slope = np.zeros(longest, np.float32)
    low = np.empty(PER_LINE + 1, np.int64)  # bottoms and the stripes' tops between them: high[k] low[k] high[k + 1]
    high = np.empty(PER_LINE + 2, np.int64)
    fall = np.float32(FALL)
    half = np.float32(0.5)
    t0, t1, t2, t3, t4 = taps[0], taps[1], taps[2], taps[3], taps[4]
    n = 0
    crowded = 0
    for j in range(len(stop)):
        length = stop[j]
        if length < 16:
            continue
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

        # Alternate tops and bottoms: one is confirmed when the next has clearly begun. Every other sample will do: the
        # line is smooth, and edges are looked for between tops and bottoms sample by sample.
        k = 0
        rising = True
        best, value = 5, smooth[5]
        for i in range(7, length - 5, 2):
            s = smooth[i]
            if rising:
                if s > value:
                    best, value = i, s
                elif s < fall * value and value > floor and value - s > half * floor:
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
            back = smooth[bottom] + np.float32(HALFWAY) * (min(smooth[high[q]], smooth[last]) - smooth[bottom])
            a = bottom
            for i in range(bottom, high[q] - 1, -1):
                if slope[i] < slope[a]:
                    a = i
                elif smooth[i] > back and slope[i] > np.float32(LEVEL) * slope[a]:
                    break
            e = bottom
            for i in range(bottom, last + 1):
                if slope[i] > slope[e]:
                    e = i
                elif smooth[i] > back and slope[i] < np.float32(LEVEL) * slope[e]:
                    break
            if a < 6 or e > length - 7 or e <= a:
                continue
            fall_bend = slope[a - 1] - 2 * slope[a] + slope[a + 1]
            rise_bend = slope[e - 1] - 2 * slope[e] + slope[e + 1]
            left = _extremum(slope[a - 1], slope[a], slope[a + 1]) + a
            right = _extremum(slope[e - 1], slope[e], slope[e + 1]) + e
            most = np.float32(STEEPEST) / abs(away[0] + away[1] * bottom)
            inner = max((bottom + (low[q - 1] if q > 0 else 0)) // 2, 4)
            outer = min((bottom + (low[q + 1] if q + 1 < k else length)) // 2, length - 5)
            left -= _drawn(smooth, a, inner, slope[a], fall_bend, most)
            right -= _drawn(smooth, e, outer, slope[e], rise_bend, most)
            # the stripes' light just beyond the edges, but not beyond half way to the next slit
            blur = np.float32(1.5)
            reach = max(np.float32(2.0), np.float32(0.12) * spacing)
            previous = low[q - 1] if q > 0 else 0
            following = low[q + 1] if q + 1 < k else length - 1
            p1 = np.int64(left - blur)
            p0 = max(np.int64(left - blur - reach), (p1 + previous) // 2)
            p2 = np.int64(right + blur) + 1
            p3 = min(np.int64(right + blur + reach) + 1, (p2 + following) // 2)
            beside = min(_mean(smooth, p0, p1), _mean(smooth, p2, p3))
            row = out[n]
            row[0] = j
            row[1] = half * (left + right)
            row[2] = right - left
            row[3] = bottom
            row[4] = np.float32(1.0) - min(smooth[bottom] / max(beside, np.float32(1.0)), np.float32(1.0))
            row[5], row[6], row[7], row[8] = p0, p1, p2, p3
            row[9] = math.sqrt(1 / max(fall_bend * fall_bend, 1e-6) + 1 / max(rise_bend * rise_bend, 1e-6))
            n += 1
    return n, crowded


@jit
def _dark_ones(found, size):  # type: ignore[no-untyped-def]
    """Which of the rows are nearly as dark as the usual one."""
    depth = found[:size, 4].copy()
    usual = np.float32(SHALLOW) * middle(depth, size)
    dark, kept = np.empty(size, np.int64), 0
    for n in range(size):
        if found[n, 4] >= usual:
            dark[kept] = n
            kept += 1
    return dark[:kept]


@jit
def _sides(image, centre, away, cosine, sine, found, dark_ones, direction, place, light):  # type: ignore[no-untyped-def]
    """The light beside each slit, (2, N, 3): BGR of the inner side, of the outer, the slit's own darkness taken off.

    Nearest pixels at every other sample, half of them the line's own, the rest of its two neighbours."""
    width, right, low, lines = image.shape[1], image.shape[1] - 1, image.shape[0] - 1, len(cosine)
    run = image.reshape(-1)
    for n in range(len(direction)):
        row = found[dark_ones[n]]
        j = int(row[0])
        direction[n], place[0, n], place[1, n], place[2, n] = j, row[1], row[2], row[9]
        dark = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        before, after = around(j - 1, lines), around(j + 1, lines)
        for part in range(3):
            a = int(row[3]) - 1 if part == 0 else int(row[3 + 2 * part])
            b = a + 2 if part == 0 else max(a, int(row[4 + 2 * part]))
            blue, green, red = 0, 0, 0
            for i in range(a, b + 1, 2):
                way = j if not (i - a) & 2 else after if (i - a) & 4 else before
                far = away[0] + away[1] * i
                x = min(max(int(centre[0] + far * cosine[way] + 0.5), 0), right)
                y = min(max(int(centre[1] + far * sine[way] + 0.5), 0), low)
                at = np.uint64(3 * (y * width + x))  # unsigned: nothing to look after below zero
                blue += run[at]
                green += run[at + np.uint64(1)]
                red += run[at + np.uint64(2)]
            scale = np.float32(1.0 / ((b - a) // 2 + 1))
            if part == 0:
                dark = blue * scale, green * scale, red * scale
                continue
            light[part - 1, n, 0] = max(blue * scale - dark[0], np.float32(0.0))
            light[part - 1, n, 1] = max(green * scale - dark[1], np.float32(0.0))
            light[part - 1, n, 2] = max(red * scale - dark[2], np.float32(0.0))


@jit
def _drawn(smooth, edge, last, steepest, bend, most):  # type: ignore[no-untyped-def]
    """How far an edge is drawn towards the light, in samples: a stripe that brightens by a part g of itself a sample
    moves the steepest place of its edge, blurred by sigma, by g sigma^2; sigma^2 is the slope there over its bend."""
    way = 1 if last > edge else -1
    near, far = edge + way * CLEAR, edge + way * min(abs(last - edge), CLEAR + BESIDE)
    reach = abs(far - near)
    if abs(last - edge) < CLEAR + 2 or smooth[near] <= 0 or bend == 0:
        return np.float32(0.0)
    growth = way * (smooth[far] - smooth[near]) / (reach * np.float32(0.5) * (smooth[near] + smooth[far]))
    growth = min(max(growth, -most), most)
    return growth * min(max(-steepest / bend, np.float32(0.0)), np.float32(BLUR_MOST))


@jit
def _extremum(before, at, after):  # type: ignore[no-untyped-def]
    """Offset of the top of the parabola through three samples, within half a sample."""
    bend = before - 2 * at + after
    if bend == 0:
        return np.float32(0.0)
    return min(max(np.float32(0.5) * (before - after) / bend, np.float32(-0.5)), np.float32(0.5))


@jit
def _mean(values, start, stop):  # type: ignore[no-untyped-def]
    start, stop = max(start, 0), min(max(stop, start), len(values) - 1)
    total = np.float32(0.0)
    for i in range(start, stop + 1):
        total += np.float32(values[i])
    return total / np.float32(stop + 1 - start)
