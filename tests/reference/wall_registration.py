"""What host/native/wall_registration.c finds of one frame, in NumPy."""

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.robust import TUKEY, biweight, robust_sigma
from annulus_pipe.wall.grid import NOISE_FLOOR_MM
from annulus_pipe.wall.registration import CONDITION_MOST, POINTS_NEEDED
from annulus_pipe.wall.shape import harmonics

ROUNDS = 8


def correction(points: FloatArray, z_mm: float, stations: FloatArray, shape: FloatArray) -> FloatArray | None:
    """(4,) two shifts, and two tilts in mm a radius, of Eq. 1; None where the frame does not tell them."""
    x, y, z = points.T
    radius, usual = np.hypot(x, y), float(np.median(shape[:, 0]))
    on = (z >= stations[0]) & (z <= stations[-1])
    if on.sum() < POINTS_NEEDED:
        return None
    here = np.stack([np.interp(z, stations, column) for column in shape.T], axis=1)
    excess = radius - (here * harmonics(np.degrees(np.arctan2(x, -y)))).sum(axis=1)
    direction = np.stack([x, y], axis=1) / radius[:, None]
    design = np.concatenate([direction, direction * ((z - z_mm) / usual)[:, None]], axis=1)[on]
    excess, fit = excess[on], np.zeros(4)
    for _ in range(ROUNDS):
        residual = excess - design @ fit
        weight = biweight(residual / (TUKEY * max(robust_sigma(residual), NOISE_FLOOR_MM)))
        normal = (design * weight[:, None]).T @ design
        if not np.linalg.cond(normal) <= CONDITION_MOST:
            return None
        fit = np.linalg.solve(normal, design.T @ (weight * excess))
    return fit if (weight > 0).mean() >= 0.5 else None
