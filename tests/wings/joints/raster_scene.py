"""Joints and rasters of them, drawn here: no code of the product makes them.

A raster is the average under an aperture with sharp edges (the product takes a Gaussian) of a probe's reading, which
falls exponentially with its distance (the product: linearly, with one cross term).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wings.joints.measure.raster import Raster, Surface

RADIUS, JOINT, ANGLES, STEP = 30.0, 26.0, 240, 0.4


def waves(rng: np.random.Generator, orders: tuple[int, ...], size: float) -> FloatArray:
    phi = np.arange(ANGLES) * 2 * math.pi / ANGLES
    return sum((size * rng.normal() / k**0.5 * np.cos(k * (phi - rng.uniform(0, 7))) for k in orders), np.zeros(ANGLES))


def sector(at: float, wide: float) -> FloatArray:
    phi = np.degrees(np.arange(ANGLES) * 2 * math.pi / ANGLES)
    return np.exp(-0.5 * (((phi - at + 180) % 360 - 180) / wide) ** 2)


def joint(rng: np.random.Generator, waviness: float = 0.08) -> Surface:
    """A double-rolled bead of 2.3 mm on a tilted plane, one cold sector 20 to 40 degrees wide, and waviness."""
    z = np.arange(0, 52, STEP)
    cold = sector(rng.uniform(0, 360), rng.uniform(20, 40)) * (waviness > 0)
    height = 2.3 * (1 + waves(rng, (1, 2, 3, 4, 5), waviness) - 0.3 * cold)
    wide = 4.5 * (1 + waves(rng, (1, 2, 3), waviness / 2) - 0.2 * cold)
    plane = JOINT + waves(rng, (1,), 0.3) * (waviness > 0)
    u = (z[:, None] - plane) / wide
    bead = height * np.sqrt(np.clip(1 - (2 * np.abs(u) - 0.9) ** 2 / 1.21, 0, None)) * (np.abs(u) < 1)
    drop = 0.015 * (1 + 0.8 * cold + waves(rng, (1, 2, 3), waviness))
    return Surface(z, bead, 1 - drop * np.exp(-0.5 * ((z[:, None] - plane) / 2.2) ** 2), RADIUS, JOINT)


@dataclass(frozen=True)
class Truth:
    shift_deg: float
    sense: int
    along: int
    joint_mm: float


def scan(surface: Surface, rng: np.random.Generator, noise: float = 0.3, angles: int = 90) -> tuple[Raster, Truth]:
    truth = Truth(rng.uniform(0, 360), int(rng.choice([1, -1])), int(rng.choice([1, -1])), rng.uniform(37, 43))
    round_mm, along_mm = rng.uniform(5, 9, 2)
    size = [2 * round(mm / step / 2) + 1 for mm, step in ((along_mm, STEP), (round_mm, 2 * math.pi * RADIUS / ANGLES))]
    lift = waves(rng, (1, 2, 3), 0.15) + 0.01 * rng.normal(size=ANGLES)
    gap = lift - surface.bead_mm + rng.normal(0, 0.002) * (surface.z_mm[:, None] - JOINT)
    channels = []
    for gain, drop in ((30.0, 250.0), (15.0, -300.0)):
        read = gain * np.exp(-gap / 9.0) + drop * (surface.density - 1)
        channels.append(uniform_filter(read, size, mode=("nearest", "wrap")))
    z = np.arange(20, 60, 0.5)
    angle = np.arange(angles) * 2 * math.pi / angles
    rows, columns = np.meshgrid(
        (JOINT + truth.along * (z - truth.joint_mm)) / STEP,
        np.degrees(truth.sense * angle) + truth.shift_deg,
        indexing="ij",
    )
    at = [rows, columns % 360 * ANGLES / 360]
    values = np.stack(
        [map_coordinates(np.pad(one, ((0, 0), (0, 2)), mode="wrap"), at, order=1, mode="nearest") for one in channels]
    )
    return Raster(angle, z, values + noise * rng.normal(size=values.shape)), truth
