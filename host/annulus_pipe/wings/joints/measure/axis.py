"""Where a pipe's axis runs through a volume, from its outer surface slice by slice.

Of every slice the outer surface's distance from a trial centre is a Fourier series of the angle: its first order is how
far the centre is off, its higher ones are oval and bumps and move nothing. The centres of the plain slices, those whose
section is no thicker than usual, lie on a line; where two pipes do not meet centre to centre the line has a step at the
joint, and the axis runs halfway.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.robust import TUKEY, biweight, robust_sigma
from annulus_pipe.vocabulary import AnnulusError

ANGLES = 360
ORDERS = 4  # of the Fourier series of the radius
ROUNDS = 3  # of moving the centre
SEEN_MIN = 0.9  # of the angles whose surface must be found
ROUND = 0.1  # of the radius: so far may its surface be from a circle, rms


@dataclass(frozen=True, slots=True)
class VolumeAxis:
    """A line: where it crosses the volume's z = 0, mm from the first voxel's centre, and how it leans, mm a mm."""

    x_mm: float
    y_mm: float
    lean_x: float
    lean_y: float
    step_mm: tuple[float, float] = (0.0, 0.0)  # (x, y): how far the second pipe's axis lies aside the first's

    @property
    def lean_deg(self) -> float:
        return math.degrees(math.atan(math.hypot(self.lean_x, self.lean_y)))

    def frame(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Unit vectors (x, y, z of the volume): right, nearest to its x; down; along."""
        along = np.array([self.lean_x, self.lean_y, 1.0])
        along /= np.linalg.norm(along)
        across = np.array([1.0, 0.0, 0.0]) - along[0] * along
        across /= np.linalg.norm(across)
        return across, np.cross(along, across), along


def outer_surface(
    image: Float32Array, centre: tuple[float, float], pixel: tuple[float, float], level: float, reach_mm: float
) -> FloatArray:
    """(ANGLES,) mm from the centre (x, y, mm) to the outermost place where the grey falls below `level`, or NaN."""
    step = 0.5 * min(pixel)
    rho = np.arange(0.0, reach_mm, step)
    phi = np.radians(np.arange(ANGLES) * 360 / ANGLES)
    x = ((centre[0] + rho * np.cos(phi)[:, None]) / pixel[0]).astype(np.float32)
    y = ((centre[1] + rho * np.sin(phi)[:, None]) / pixel[1]).astype(np.float32)
    # Beyond the image nothing is known: NaN is neither inside, nor is a surface found against it.
    ray = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    inside = ray > level
    last = ray.shape[1] - 1 - np.argmax(inside[:, ::-1], axis=1)
    seen = inside.any(axis=1) & (last < ray.shape[1] - 1)
    last = np.minimum(last, ray.shape[1] - 2)
    rows = np.arange(ANGLES)
    here, beyond = ray[rows, last], ray[rows, last + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(seen, (last + (here - level) / (here - beyond)) * step, np.nan)


def circle_of(image: Float32Array, pixel: tuple[float, float], level: float) -> tuple[float, float, float] | None:
    """(x, y, radius) in mm of the one pipe that a slice cuts; None where there is none."""
    mask = image > level
    part = mask.mean()
    if not 0.002 < part < 0.9:
        return None
    ys, xs = np.nonzero(mask)
    x = 0.5 * float(np.sum(np.percentile(xs, (0.5, 99.5)))) * pixel[0]
    y = 0.5 * float(np.sum(np.percentile(ys, (0.5, 99.5)))) * pixel[1]
    reach = 0.75 * math.hypot(image.shape[1] * pixel[0], image.shape[0] * pixel[1])
    phi = np.radians(np.arange(ANGLES) * 360 / ANGLES)
    radius = 0.0
    for _ in range(ROUNDS):
        found = outer_surface(image, (x, y), pixel, level, reach)
        seen = np.isfinite(found)
        if seen.mean() < SEEN_MIN:
            return None
        terms = np.stack([np.ones(ANGLES)] + [f(k * phi) for k in range(1, ORDERS + 1) for f in (np.cos, np.sin)])
        weight = seen.astype(float)
        safe = np.where(seen, found, 0.0)
        for _ in range(4):
            a = (terms * weight) @ terms.T
            series = np.linalg.solve(a, (terms * weight) @ safe)
            residual = safe - series @ terms
            sigma = max(robust_sigma(residual[seen]), 0.02 * min(pixel))
            weight = seen * biweight(residual / (TUKEY * sigma))
            if (weight > 0).sum() < 0.5 * ANGLES:
                return None
        x, y, radius = x + float(series[1]), y + float(series[2]), float(series[0])
        if radius <= 0 or np.sqrt(np.mean((found[seen] - radius) ** 2)) > ROUND * radius:
            return None
    # A pipe is hollow; a rod, or a sample holder, is not what is asked for.
    column, row = round(x / pixel[0]), round(y / pixel[1])
    if not (0 <= column < image.shape[1] and 0 <= row < image.shape[0]) or image[row, column] > level:
        return None
    return x, y, radius


def fit_axis(centres: FloatArray, z_mm: FloatArray, plain: BoolArray, joint_mm: float) -> VolumeAxis:
    """The line through the plain slices' centres, and its step at the joint.

    centres : (N, 2) mm, NaN where no pipe was found; plain : (N,) away from the joint.
    """
    use = plain & np.isfinite(centres).all(axis=1)
    both = (use & (z_mm < joint_mm)).sum() >= 5 and (use & (z_mm > joint_mm)).sum() >= 5
    if use.sum() < 5:
        raise AnnulusError("no plain pipe in the volume: expected a cylinder, with its joint across")
    side = 0.5 * np.sign(z_mm - joint_mm)
    terms = np.stack([np.ones_like(z_mm), z_mm] + ([side] if both else []), axis=1)
    fits = []
    for k in range(2):
        weight = use.astype(float)
        value = np.where(use, centres[:, k], 0.0)
        for _ in range(6):
            fit = np.linalg.lstsq(terms * np.sqrt(weight)[:, None], value * np.sqrt(weight), rcond=None)[0]
            residual = value - terms @ fit
            weight = use * biweight(residual / (TUKEY * max(robust_sigma(residual[use]), 1e-3)))
        fits.append(fit)
    step = (float(fits[0][2]), float(fits[1][2])) if both else (0.0, 0.0)
    return VolumeAxis(float(fits[0][0]), float(fits[1][0]), float(fits[0][1]), float(fits[1][1]), step)
