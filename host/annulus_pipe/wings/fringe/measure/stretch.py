"""Whether a told motion is stretched, by how far the wall's texture moves through the picture.

On a flat wall fringes, lamp and vignetting stand still in the picture, however the head moves; only the wall's own
texture goes by. The mean of the logarithm of the frames is what stands still; less it, two frames differ by the motion
between them, which OpenCV's phase correlation finds as a shift. Light that drifts along a track, which the fit along
tracks cannot tell from a stretch, is in the mean and gone. Carried by: one shift for the whole picture (a flat wall
squarely before a pinhole); elsewhere nothing is told.

What is left wrong, `PULL`, is no law: on fringe-a -0.3 and +0.3 % by its two cameras, -0.2 and 0.0 in its other set,
rightly told or 5 % too long, for a relief of 2 mm at 100 goes by 2 % faster than the wall around it, and one shift
stands for both. On a flat plate in 320 x 120 px, ten even steps, +0.2 to +0.8 % (uneven: 0.1): an Nth of each frame's
texture is in their mean, and pushes the ends outward. Finding texture and what stands still in turns takes that out of
a flat plate and nothing off fringe-a; least squares in place of the peak are 0.25 % off there, and 7 % on fringe-a.
"""

import cv2
import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import fft
from annulus_pipe.numeric.robust import CAUCHY, cauchy, robust_sigma
from annulus_pipe.wings.fringe.measure.heights import FringeView, Points

SPLINE = np.array([[1.0], [4.0], [1.0]], np.float32) / 6  # a cubic spline's coefficients to its values
EVEN = 0.02  # share by which the picture's pixels per mm may differ
SIDE_MIN_PX = 64
FAR_PX = 8.0  # what stands still must lie that far from where the texture is looked for
ROUNDS = 5
NEARER = 2  # rounds: the second with pictures cut to overlap
STANDS_OUT = 12.0  # times the rms: the highest of noise is 8, of a texture of one wave 12, of fringe-a above 100
PEAK_PX = 1.0  # sigma: finer detail is noise as often as texture
PULL = 0.004  # of the motion: measured, see above


def stretch(
    view: FringeView,
    images: Float32Array,
    points: Points,
    height_mm: FloatArray,
    place_mm: FloatArray,
    direction: FloatArray,
) -> tuple[float, float]:
    """(true motion over the told one, its sigma); sigma infinite where the pictures do not tell it.

    images : (N, H, W), as `heights` takes them. place_mm : (N,) as told, in which single steps are right already.
    """
    nothing = 1.0, np.inf
    middle = len(place_mm) // 2
    known = np.isfinite(height_mm)
    if images.shape[2] == 1 or not known.any():
        return nothing
    x = points.at(np.where(known, height_mm, 0.0))[known]
    u, v = view.pixels(x, middle)
    u1, v1 = view.pixels(x - direction, middle)  # the head one mm on: the wall one mm back
    rates = np.stack([u1 - u, v1 - v], axis=1)
    rates = rates[np.isfinite(rates).all(axis=1)]
    if not len(rates):
        return nothing
    rate = np.median(rates, axis=0)
    if np.median(np.abs(rates - rate).max(axis=1)) > EVEN * np.linalg.norm(rate):
        return nothing
    texture = _texture(images)
    offs, spans = [], []
    for n in range(len(images)):
        moved = rate * (place_mm[n] - place_mm[middle])
        whole = np.rint(moved).astype(int)
        if np.linalg.norm(moved) < FAR_PX:
            continue
        found = _shift(texture[middle], texture[n], whole)
        if found is None:
            continue
        offs.append(float((found - moved) @ rate / (rate @ rate)))
        spans.append(place_mm[n] - place_mm[middle])
    if len(offs) < 3:
        return nothing
    off, span = np.array(offs), np.array(spans)
    weight, slope, sigma = np.ones(len(off)), 0.0, np.inf
    for _ in range(ROUNDS):
        below = float((weight * span**2).sum())
        slope = float((weight * span * off).sum()) / below
        spread = max(robust_sigma(off - slope * span), 1e-6)
        sigma = float(spread / np.sqrt(below))
        weight = cauchy((off - slope * span) / (CAUCHY * spread))
    return 1.0 + slope, float(np.hypot(sigma, PULL))


def _texture(images: Float32Array) -> list[Float32Array]:
    """Logarithm of each frame less what stands still in all of them."""
    logs = []
    for one in images:
        grey = cv2.sepFilter2D(np.nan_to_num(one, nan=float(np.nanmedian(one))), cv2.CV_32F, SPLINE, SPLINE)
        logs.append(np.log(np.maximum(grey, 1.0)))
    still = np.mean(logs, axis=0)
    return [np.ascontiguousarray(one - still, np.float32) for one in logs]


def _shift(one: Float32Array, other: Float32Array, whole: IntArray) -> FloatArray | None:
    """(2,) px by which the second picture is shifted, looked for about `whole`; None where they share too little,
    of the picture or of texture.

    Phase correlation, its frequencies weighted by a Gaussian: the peak then is a Gaussian wherever it lies, and its
    logarithm a parabola. OpenCV's, the middle of weight of 5 x 5 pixels, is drawn to whole pixels by 0.1 of one.
    """
    found = whole.astype(float)
    for _ in range(NEARER):
        near = np.rint(found).astype(int)
        first, second = _overlap(one, other, near)
        if min(first.shape, default=0) < SIDE_MIN_PX:
            return None
        window = cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F)
        cross = np.conj(fft.rfft2(first * window)) * fft.rfft2(second * window)
        square = np.add.outer(fft.fftfreq(first.shape[0]) ** 2, fft.rfftfreq(first.shape[1]) ** 2)
        cross = cross / np.maximum(np.abs(cross), 1e-20) * np.exp(-2 * (np.pi * PEAK_PX) ** 2 * square)
        peak = fft.irfft2(cross, s=first.shape)
        if not peak.max() > STANDS_OUT * peak.std():
            return None
        v, u = np.unravel_index(np.argmax(peak), peak.shape)
        more = [_top(np.roll(line, 1 - at)[:3]) + at for line, at in ((peak[v], int(u)), (peak[:, u], int(v)))]
        size = np.array(first.shape[::-1])
        found = near + (np.array(more) + size / 2) % size - size / 2
    return found


def _top(three: FloatArray) -> float:
    """Where a Gaussian through three values has its top, from the middle one, the largest."""
    a, b, c = np.log(np.maximum(three, 1e-20))
    return float(0.5 * (a - c) / (a - 2 * b + c)) if a + c < 2 * b else 0.0


def _overlap(one: Float32Array, other: Float32Array, shift: FloatArray) -> tuple[Float32Array, Float32Array]:
    """The parts of two pictures that show the same wall if the second's is shifted by whole pixels (u, v)."""
    height, width = one.shape
    u, v = int(shift[0]), int(shift[1])
    first = one[max(0, -v) : height - max(0, v), max(0, -u) : width - max(0, u)]
    second = other[max(0, v) : height - max(0, -v), max(0, u) : width - max(0, -u)]
    return np.ascontiguousarray(first), np.ascontiguousarray(second)
