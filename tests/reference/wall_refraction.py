"""What host/native/wall_refraction.c solves, one point after the other: Snell's law by scipy's root finder."""

import math

import numpy as np
from scipy.optimize import brentq

from annulus_pipe.numeric.arrays import FloatArray


def cosine(
    height: float, eye: FloatArray, way: FloatArray, lamp: FloatArray, axis: FloatArray, radius: float, index: float
) -> float:
    """Of the angle between a cone's axis and the light, as it leaves the lamp, that lights what a ray sees."""
    at = eye + (height - eye[1]) / way[1] * way  # where the ray enters the water
    down = np.array([way[0] / index, 0.0, way[2] / index])
    down[1] = math.sqrt(1.0 - down @ down)
    a, b = down[0] ** 2 + down[1] ** 2, at[0] * down[0] + at[1] * down[1]
    inside = b * b - a * (at[0] ** 2 + at[1] ** 2 - radius**2)
    if inside < 0.0:
        return math.nan
    bottom = at + (math.sqrt(inside) - b) / a * down
    far = math.hypot(bottom[0] - lamp[0], bottom[2] - lamp[2])
    above, below = height - lamp[1], bottom[1] - height

    def snell(u: float) -> float:
        """sin of the angle in air less index times that in water, for light that enters at u along the surface."""
        return u / math.hypot(u, above) - index * (far - u) / math.hypot(far - u, below)

    part = brentq(snell, 0.0, far, xtol=1e-13) / far
    light = np.array([(bottom[0] - lamp[0]) * part, above, (bottom[2] - lamp[2]) * part])
    return float(light @ axis / np.linalg.norm(light))
