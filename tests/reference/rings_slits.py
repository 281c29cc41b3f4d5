"""Dark slits along the polar lines and the light beside them, to be read: host/native/rings_slits.c and rings_light.c.

Single precision and the C's order of sums: on a frame of noise or of equal steps every comparison is a close one.
"""

from typing import NamedTuple

import numpy as np

from annulus_pipe.rings.slits import BESIDE, BLUR_MOST, CLEAR, FALL, HALFWAY, LEVEL, PER_LINE, SHALLOW, STEEPEST

F = np.float32
MARGIN = 5  # samples at both ends of a line that nothing is looked for in
BLUR = 1.5  # samples from an edge, where its stripe begins


class Slit(NamedTuple):
    """One slit of a line: place and width, samples; its edges' blur; how dark it is, a part; samples: its bottom, the
    first and last of the stripe inside and of that outside."""

    direction: int
    place: float
    width: float
    blur: float
    depth: float
    samples: tuple[int, int, int, int, int]


def scan(top, stop, away, taps, floor, spacing):
    """Slits of lines (J, L), from line to line and outwards, and how many lines had too many. away : px from the
    centre, of the first sample, and of each step."""
    slits, crowded = [], 0
    for j, line in enumerate(top):
        line = line[: max(min(stop[j], len(line)), 0)]
        if len(line) < 16:
            continue
        smooth, slope = smoothed(line, taps)
        low, high, full = turning_points(smooth, floor)
        crowded += full
        found = (slit_of(j, smooth, slope, low, high, k, away, spacing) for k in range(len(low)))
        slits += [slit for slit in found if slit is not None]
    return slits, crowded


def smoothed(line, taps):
    """Nine taps along a line, and the step from each sample to the next but one."""
    light = line.astype(F)
    at = [light[4 + k : len(light) - 4 + k] for k in range(-4, 5)]
    one, two, three, four = (at[4 - k] + at[4 + k] for k in range(1, 5))
    smooth, slope = np.zeros(len(light), F), np.zeros(len(light), F)
    smooth[4:-4] = (taps[0] * at[4] + taps[1] * one) + (taps[2] * two + (taps[3] * three + taps[4] * four))
    slope[MARGIN:-MARGIN] = smooth[MARGIN + 1 : 1 - MARGIN] - smooth[MARGIN - 1 : -MARGIN - 1]
    return smooth, slope


def turning_points(smooth, floor):
    """Alternating tops and bottoms, high[k] low[k] high[k + 1]: one is confirmed when the next has clearly begun. Of
    every other sample, for the line is smooth."""
    low, high, rising = [], [], True
    best = MARGIN
    for i in range(MARGIN + 2, len(smooth) - MARGIN, 2):
        s, value = smooth[i], smooth[best]
        if rising:
            if s > value:
                best = i
            elif s < F(FALL) * value and value > floor and value - s > F(0.5) * floor:
                high.append(best)
                rising, best = False, i
        elif s < value:
            best = i
        elif F(FALL) * s > value and s - value > floor:
            if len(low) == PER_LINE:
                return low, high, True
            low.append(best)
            rising, best = True, i
    return low, [*high, best] if rising else high, False


def slit_of(j, smooth, slope, low, high, k, away, spacing):
    """Halfway between the two edges around a bottom, or None."""
    bottom, end = low[k], len(smooth)
    before, after = low[k - 1] if k else 0, low[k + 1] if k + 1 < len(low) else end
    back = smooth[bottom] + F(HALFWAY) * (min(smooth[high[k]], smooth[high[k + 1]]) - smooth[bottom])
    a, e = edge(smooth, slope, bottom, high[k], back), edge(smooth, slope, bottom, high[k + 1], back)
    if a < 6 or e > end - 7 or e <= a:
        return None
    greatest = F(STEEPEST) / max(abs(F(away[0]) + F(away[1]) * bottom), F(1e-3))
    fall, rise = (slope[i - 1] - F(2.0) * slope[i] + slope[i + 1] for i in (a, e))
    inner, outer = max((bottom + before) // 2, 4), min((bottom + after) // 2, end - 5)
    left = extremum(slope, a) + F(a) - drawn(smooth, a, inner, slope[a], fall, greatest)
    right = extremum(slope, e) + F(e) - drawn(smooth, e, outer, slope[e], rise, greatest)
    # the stripes' light just beyond the edges, but not beyond half way to the next slit
    reach, following = max(F(0.12) * F(spacing), F(2.0)), after if k + 1 < len(low) else end - 1
    p1, p2 = int(left - F(BLUR)), int(right + F(BLUR)) + 1
    p0 = max(int(left - F(BLUR) - reach), int((p1 + before) / 2))
    p3 = min(int(right + F(BLUR) + reach) + 1, int((p2 + following) / 2))
    inside, outside = mean(smooth, p0, p1), mean(smooth, p2, p3)
    stripe = max(inside if inside < outside else outside, F(1.0))
    depth = F(1.0) - min(smooth[bottom] / stripe, F(1.0))
    blur = np.sqrt(F(1.0) / max(fall * fall, F(1e-6)) + F(1.0) / max(rise * rise, F(1e-6)))
    return Slit(j, F(0.5) * (left + right), right - left, blur, depth, (bottom, p0, p1, p2, p3))


def edge(smooth, slope, bottom, end, back):
    """The nearest edge: the steepest place up to where the light is back and level again."""
    way = 1 if end > bottom else -1
    found = bottom
    for i in range(bottom, end + way, way):
        if way * slope[i] > way * slope[found]:
            found = i
        elif smooth[i] > back and way * slope[i] < F(LEVEL) * (way * slope[found]):
            break
    return found


def extremum(slope, i):
    """Offset of the top of the parabola through three samples, within half a sample."""
    bend = slope[i - 1] - F(2.0) * slope[i] + slope[i + 1]
    return np.clip(F(0.5) * (slope[i - 1] - slope[i + 1]) / bend, F(-0.5), F(0.5)) if bend else F(0.0)


def drawn(smooth, at, last, steepest, bend, greatest):
    """How far an edge is drawn towards the light: a stripe that brightens by a part g of itself a sample moves the
    steepest place of its edge, blurred by sigma, by g sigma^2; sigma^2 is the slope there over its bend."""
    way = 1 if last > at else -1
    near, far = at + way * CLEAR, at + way * min(abs(last - at), CLEAR + BESIDE)
    if abs(last - at) < CLEAR + 2 or smooth[near] <= 0 or bend == 0:
        return F(0.0)
    growth = F(way) * (smooth[far] - smooth[near]) / (F(abs(far - near)) * F(0.5) * (smooth[near] + smooth[far]))
    return np.clip(growth, -greatest, greatest) * np.clip(-steepest / bend, F(0.0), F(BLUR_MOST))


def mean(smooth, first, last):
    first = max(first, 0)
    last = min(max(last, first), len(smooth) - 1)
    total = F(0.0)
    for value in smooth[first : last + 1]:
        total += value
    with np.errstate(invalid="ignore"):
        return total / F(last + 1 - first)  # of a stripe outside of the line none, NaN


def dark_ones(slits):
    """Those at least a part as deep as the usual one."""
    depths = sorted(slit.depth for slit in slits)
    return [slit for slit in slits if slit.depth >= F(SHALLOW) * depths[len(depths) // 2]]


def light(image, centre, away, ways, slits):
    """(2, N, 3) BGR of the stripes inside and outside, the slit's own darkness taken off: of nearest pixels at every
    other sample, half of them the line's own, the rest of its two neighbours. ways (J, 2) of the lines."""
    out = np.zeros((2, len(slits), 3))
    for n, slit in enumerate(slits):
        bottom, p0, p1, p2, p3 = slit.samples
        runs = (bottom - 1, bottom + 1), (p0, max(p0, p1)), (p2, max(p2, p3))
        dark, *sides = (seen(image, centre, away, ways, slit.direction, a, b) for a, b in runs)
        out[:, n] = np.maximum(np.array(sides) - dark, 0.0)
    return out


def seen(image, centre, away, ways, line, first, last):
    size, total = np.array(image.shape[1::-1]), []
    for i in range(first, last + 1, 2):
        beside = (0, -1, 0, 1)[(i - first) // 2 % 4]
        at = np.asarray(centre) + (away[0] + away[1] * i) * ways[(line + beside) % len(ways)] + 0.5
        x, y = np.clip(at, 0, size - 1).astype(int)
        total.append(image[y, x])
    return np.mean(total, axis=0)
