"""Whether a told motion is stretched, by how far the wall's texture moves through the picture.

On a flat wall fringes, lamp and vignetting stand still in the picture, however the head moves; only the wall's own
texture goes by. The mean of the logarithm of the frames is what stands still; less it, two frames differ by the motion
between them, which OpenCV's phase correlation finds as a shift. Light that drifts along a track, which the fit along
tracks cannot tell from a stretch, is in the mean and gone. Carried by: one shift for the whole picture (a flat wall
squarely before a pinhole); elsewhere nothing is told.
"""

import cv2
import numpy as np

from annulus.fringe.heights import Points, View
from annulus.numeric.arrays import Float32Array, FloatArray
from annulus.numeric.robust import CAUCHY, cauchy, robust_sigma

SPLINE = np.array([[1.0], [4.0], [1.0]], np.float32) / 6  # a cubic spline's coefficients to its values
EVEN = 0.02  # share by which the picture's pixels per mm may differ
SIDE_MIN_PX = 64
FAR_PX = 8.0  # what stands still must lie that far from where the texture is looked for
ROUNDS = 5
PULL = 0.004  # of the motion: what relief leaves of the fringes stands still, and pulls


def stretch(
    view: View, images: Float32Array, points: Points, height_mm: FloatArray, place_mm: FloatArray, direction: FloatArray
) -> tuple[float, float]:
    """(true motion over the told one, its sigma); sigma infinite where the pictures do not tell it.

    images : (N, H, W), as `heights` takes them. place_mm : (N,) as told, in which single steps are right already.
    """
    nothing = 1.0, np.inf
    middle = len(place_mm) // 2
    told = np.isfinite(height_mm)
    if images.shape[2] == 1 or not told.any():
        return nothing
    x = points.at(np.where(told, height_mm, 0.0))[told]
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
        one, other = _overlap(texture[middle], texture[n], whole)
        if min(one.shape) < SIDE_MIN_PX:
            continue
        window = cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
        (du, dv), _ = cv2.phaseCorrelate(one, other, window)
        offs.append(float((whole + np.array([du, dv]) - moved) @ rate / (rate @ rate)))
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


def _overlap(one: Float32Array, other: Float32Array, shift: FloatArray) -> tuple[Float32Array, Float32Array]:
    """The parts of two pictures that show the same wall if the second's is shifted by whole pixels (u, v)."""
    height, width = one.shape
    u, v = int(shift[0]), int(shift[1])
    first = one[max(0, -v) : height - max(0, v), max(0, -u) : width - max(0, u)]
    second = other[max(0, v) : height - max(0, -v), max(0, u) : width - max(0, -u)]
    return np.ascontiguousarray(first), np.ascontiguousarray(second)
