"""Where every ring's light passed the pipe's surface, whether or not it was seen to arrive.

A look is one ring in one frame. A ring is smooth round the pipe, so where it passes a surface is known from the part
of it that was seen. In places of passage nothing throws a shadow: light that passes behind a rim or a bump meets wall
farther on, and is found again. What is missing there was swallowed: by a rod, by dirt, or by a hole.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY, biweight, nan_median
from annulus_pipe.wall.cylinder import points_of, round_clock
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.rests import places_of

COLUMNS = 360  # round the clock
WAVES = 3  # a ring's place along the pipe is a mean and so many waves round the clock: lean, bend, ovality
SEEN_LEAST = 0.4  # part of the circle: of less of a ring its place all round is not known
SCATTER_OF_RADIUS = 0.02  # of the radius: and a ring that is farther from so smooth a line is none to go by
SURFACE_OF_RADIUS = 0.05  # of the radius: points this near the shape tell where a ring runs
DARK = 0.5  # of the usual part of looks that arrive: columns with less are a rod's, a cable's or dead
PLACE_LEAST_OF_RADIUS = 0.0007  # of the radius: a ring's place is not known better (0.05 mm in a 6-inch pipe)

_shape_departures = door(
    "shape_departures", "f4[n,3] points", "f8[z] stations", "f8[z,5] shape", "f8[n]! radius", "f8[n]! departure"
)


@dataclass(frozen=True, slots=True, eq=False)
class LookPoints:
    """Every point of the profiles, (N,): radius_mm, clock_deg, z_mm, departure_mm (radius less the pipe's shape,
    positive outwards), and look, the row of `Looks` it belongs to."""

    radius_mm: FloatArray
    clock_deg: FloatArray
    z_mm: FloatArray
    departure_mm: FloatArray
    look: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """Every ring of every frame, (L, A) over the clock: z_mm, where its light passes the pipe's shape; run, how far it
    goes along the pipe for each mm outwards; departure_mm of what it met, NaN where nothing came back; lit, where
    it ought to have been seen; view (L,), the same number where one ring looks from one place again: frames of a head
    at rest, or nearly, are one look."""

    z_mm: FloatArray
    run: FloatArray
    departure_mm: FloatArray
    lit: BoolArray
    view: NDArray[np.int64]


def looks_of(profiles: Sequence[Profile], wall: Wall, calibration: Calibration) -> tuple[LookPoints, Looks]:
    """Points and looks of all profiles that have a pose and points."""
    used = [p for p in profiles if p.pose is not None and len(p.points_mm)]
    rings = len(calibration.rings)
    every = points_of(used)
    _, clock, z = round_clock(every)
    ring = np.concatenate([p.ring for p in used]).astype(np.int64)
    look = np.repeat(np.arange(len(used)) * rings, [len(p.points_mm) for p in used]) + ring
    radius, departure = np.empty(len(every)), np.empty(len(every))
    _shape_departures(every, wall.z_mm, wall.shape_mm, radius, departure)
    points = LookPoints(radius, clock, z, departure, look)

    vertex = np.array([cone.vertex_mm[2] for cone in calibration.rings])
    source = (np.array([p.z_mm for p in used])[:, None] + vertex).ravel()
    count, size = len(source), wall.mean_radius_mm
    cell = look * COLUMNS + np.minimum(clock.astype(np.int64), COLUMNS - 1)
    hits = np.bincount(cell, minlength=count * COLUMNS)

    def mean(value: FloatArray) -> FloatArray:
        sums = np.bincount(cell, weights=value, minlength=len(hits))
        return np.where(hits > 0, sums / np.maximum(hits, 1), np.nan).reshape(count, COLUMNS)

    met = mean(departure)
    passed, sure = _smooth(
        mean(z - departure * (z - source[look]) / radius), np.abs(met) < SURFACE_OF_RADIUS * size, size
    )
    turned = np.array([np.degrees(p.pose.roll or 0.0) if p.pose is not None else 0.0 for p in used])
    lit = sure[:, None] & ~dark_columns(np.isfinite(met), sure, np.repeat(turned, rings))
    view = (places_of(used, size)[:, None] * rings + np.arange(rings)).ravel()
    return points, Looks(passed, (passed - source[:, None]) / size, met, lit, view)


def _smooth(z: FloatArray, usable: BoolArray, radius: float) -> tuple[FloatArray, BoolArray]:
    """(L, A) the line each ring runs along, from where it was seen, and (L,) whether that is to be believed."""
    t = np.radians(np.arange(COLUMNS) + 0.5)
    waves = [f(k * t) for k in range(1, WAVES + 1) for f in (np.cos, np.sin)]
    basis = np.stack([np.ones(COLUMNS), *waves], axis=1)
    n = basis.shape[1]
    products = (basis[:, :, None] * basis[:, None, :]).reshape(COLUMNS, -1)
    known, value = np.isfinite(z), np.nan_to_num(z)
    weight = (known & usable).astype(np.float64)
    enough = weight.mean(axis=1) > SEEN_LEAST
    line, scatter = value, np.zeros(len(z))
    for _ in range(6):
        normal = (weight @ products).reshape(-1, n, n) + 1e-6 * np.eye(n)
        line = np.linalg.solve(normal, ((weight * value) @ basis)[..., None])[..., 0] @ basis.T
        off = np.where(known, np.abs(value - line), np.nan)
        scatter = np.nan_to_num(SIGMA_OF_MAD * nan_median(off.T), nan=np.inf)
        weight = known * biweight(off / (TUKEY * np.maximum(scatter, PLACE_LEAST_OF_RADIUS * radius))[:, None])
    return line, enough & (scatter < SCATTER_OF_RADIUS * radius)


def dark_columns(found: BoolArray, sure: BoolArray, turned_deg: FloatArray) -> BoolArray:
    """(L, A) columns in which hardly a ring of the scan arrives. What keeps light away there turns with the head."""
    shift = np.rint(turned_deg).astype(np.int64)
    column = (np.arange(COLUMNS) + shift[:, None]) % COLUMNS  # of the pipe, by column of the head
    part = np.take_along_axis(found, column, axis=1)[sure].mean(axis=0) if sure.any() else np.zeros(COLUMNS)
    dark = part < DARK * np.median(part)
    dark = dark | np.roll(dark, 1) | np.roll(dark, -1)
    return np.asarray(dark[(np.arange(COLUMNS) - shift[:, None]) % COLUMNS])
