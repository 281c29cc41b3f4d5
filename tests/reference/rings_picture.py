"""From a frame to what is looked at along the polar lines, to be read: host/native/rings_plane.c, rings_unroll.c,
rings_picture.h and rings_pedestal.c. Whole numbers nearly all through: nothing may differ by a bit."""

import numpy as np

from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.polar import LEAST_SAMPLES, LIT, LIT_MARGIN, PROBE_LINES, PROBE_PX, RAISED_MOST, WEAK, PolarGrid

PARTS = 32  # of a pixel, that a sample's place is known to


def colours(cells, order):
    """(H, W, 3) BGR of a mosaic (H, W): a colour that a cell has not is the mean of those of its eight neighbours that
    have it; the margin repeats what is beside it."""
    height, width = cells.shape
    row, column = np.mgrid[0:height, 0:width] % 2
    whose = np.array(list(order))[2 * row + column]
    out = np.zeros((height, width, 3), np.int64)
    for channel, letter in enumerate("bgr"):
        has = np.pad(whose == letter, 1).astype(np.int64)
        value = np.pad(cells, 1) * has
        count, total = (
            sum(np.roll(part, (y, x), (0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1))[1:-1, 1:-1]
            for part in (has, value)
        )
        out[..., channel] = np.where(whose == letter, cells, (total + count // 2) // np.maximum(count, 1))
    return np.pad(out[1:-1, 1:-1], ((1, 1), (1, 1), (0, 0)), "edge").astype(np.uint8)


def rank(values, part):
    """The level below or at which that part of the values (bytes) lies."""
    counted = np.cumsum(np.bincount(np.ravel(values), minlength=256))
    return int(np.searchsorted(counted, part * counted[-1]))


def places(grid: PolarGrid):
    """(J, L, 2) x, y of every sample in 1/32 px."""
    away = grid.first + grid.step * np.arange(grid.address.shape[1])
    ways = np.stack([grid.cosine, grid.sine], axis=1)
    return np.rint((np.array(grid.centre) + away[:, None] * ways[:, None]).astype(np.float32) * PARTS).astype(np.int64)


def inside(at, shape):
    """(J, L): whether the pixels right and below of these (J, L, 2) are in an image (H, W), too."""
    return ((at >= 0) & (at < np.array(shape[1::-1]) - 1)).all(axis=2)


def look(image, grid: PolarGrid):
    """Levels of black (3,), gains in 1/64 (3,), and the samples from where to where there is light."""
    at, length = places(grid)[::PROBE_LINES, ::PROBE_PX] // PARTS, grid.address.shape[1]
    there = inside(at, image.shape)
    seen = np.where(there[..., None], image[at[..., 1] * there, at[..., 0] * there], 0)
    looked = PROBE_PX * np.arange(seen.shape[1]) < grid.stop[::PROBE_LINES, None]
    black = np.array([rank(seen[looked, c], 0.02) for c in range(3)])
    light = np.maximum([rank(seen[looked, c], 0.97) for c in range(3)] - black, 1)
    weaker = light.max() / light
    gain = np.where(weaker > WEAK, np.rint(64 * np.minimum(weaker, RAISED_MOST)), 64).astype(np.int64)
    black[weaker <= WEAK] = 0
    # one sample brighter than the limit is noise, one together with the next is light
    lit = (((seen - black) * gain) > int(64 * max(LIT * light.max(), 2.0))).any(axis=2) & looked
    both = np.flatnonzero((lit[:, 1:] & lit[:, :-1]).any(axis=0)) * PROBE_PX
    first, last = (both[0], both[-1] + PROBE_PX) if len(both) else (length, 0)
    start = max(min(first - LIT_MARGIN, length - LEAST_SAMPLES), 0)
    return black, gain, start, min(max(min(last + LIT_MARGIN, length), start + LEAST_SAMPLES), length)


def strongest(image, black, gain):
    """(H, W): the strongest channel of every pixel, black taken off and weak ones raised."""
    return np.clip(((image - black) * gain).max(axis=2) >> 6, 0, 255).astype(np.uint8)


def sampled(plane, grid: PolarGrid):
    """(J, L) between four pixels; 0 where they are not all in the image."""
    at, part = np.divmod(places(grid), PARTS)
    there = inside(at, plane.shape)
    x, y, fx, fy = (np.where(there, one, 0) for one in (*np.moveaxis(at, 2, 0), *np.moveaxis(part, 2, 0)))
    four = plane.astype(np.int64)
    above = four[y, x] * (PARTS - fx) + four[y, x + 1] * fx
    below = four[y + 1, x] * (PARTS - fx) + four[y + 1, x + 1] * fx
    return np.where(there, (above * (PARTS - fy) + below * fy + PARTS**2 // 2) // PARTS**2, 0)


def averaged(lines):
    """(J, L) of every line and its two neighbours, weights 1, 2, 1; lines go all round."""
    return (np.roll(lines, 1, 0) + 2 * lines + np.roll(lines, -1, 0) + 2) // 4


def level(top, stop):
    """The bright level and the noise, from every 24th line and every third sample along it."""
    levels, steps = [], []
    for line, end in zip(top[::24].astype(int), stop[::24], strict=True):
        at = np.arange(1, min(end, len(line)), 3)
        levels += line[at].tolist()
        steps += np.abs(line[at] - line[at - 1]).tolist()
    if not levels:
        return 0.0, 0.0
    # the darker half of the samples holds few edges; a step of n is anything up to n
    dark = np.array(steps)[np.array(levels) <= rank(levels, 0.5)]
    at = rank(dark, 0.5)
    middle = at - 0.5 + (0.5 * len(dark) - (dark < at).sum()) / (dark == at).sum()
    return float(rank(levels, 0.95)), SIGMA_OF_MAD / np.sqrt(2.0) * max(middle, 0.0)


def pedestal(image, step, half, lit):
    """How bright it is under the stripes, and the frame's bright level, by every step-th pixel."""
    few = image[step // 4 :: step, step // 4 :: step].max(axis=2)
    bright = quantile(few[::2, ::2].ravel(), 0.97)
    return quantile(least_around(few, half)[few > lit * bright], 0.5), bright


def least_around(values, half):
    """(A, B, ..) the least in a square of 2 half + 1 places, as far as there are any."""
    for _axis in (0, 1):
        wide = np.pad(values, ((half, half), *[(0, 0)] * (values.ndim - 1)), constant_values=255)
        least = np.lib.stride_tricks.sliding_window_view(wide, 2 * half + 1, 0).min(axis=-1)
        values = np.swapaxes(least, 0, 1)
    return values


def mean_around(values, half):
    """(A, B, 3) the mean over such a square; beyond the margin the picture is mirrored in its last row, or column."""
    wide = np.pad(values, ((half, half), (half, half), (0, 0)), "reflect")
    return np.rint(np.lib.stride_tricks.sliding_window_view(wide, (2 * half + 1,) * 2, (0, 1)).mean(axis=(-2, -1)))


def without_veil(image, step, half, smooth):
    """(H, W, 3) less the light that is no stripe's."""
    least = least_around(image[step // 2 :: step, step // 2 :: step], half)
    # no more than the least: a stripe that goes on beyond the last slit must not smooth its own light onto that
    veil = mean_around(np.minimum(mean_around(least, half), least), smooth)
    for axis in (0, 1):
        size, few = image.shape[axis], veil.shape[axis]
        at = np.clip((np.arange(size) + 0.5) * few / size - 0.5, 0, few - 1)
        near = np.minimum(at.astype(int), max(few - 2, 0))
        part = (at - near).reshape(-1, *[1] * (2 - axis))
        near_row, far_row = (np.take(veil, np.minimum(near + k, few - 1), axis) for k in (0, 1))
        veil = near_row + part * (far_row - near_row)
    return np.maximum(image - veil, 0.0)


def quantile(values, part):
    """Linear between two ranks; 0 of nothing."""
    if not len(values):
        return 0.0
    values, at = np.sort(values).astype(float), part * (len(values) - 1)
    below = values[int(at)]
    return below + (at - int(at)) * (values[min(int(at) + 1, len(values) - 1)] - below)
