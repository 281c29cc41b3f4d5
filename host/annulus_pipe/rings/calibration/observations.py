"""Slits of known ring in several frames, as rays: what autocalibration starts from."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone, intersect_cylinder
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door

RAY_STEP_PX = 4.0  # rays of an observation: at its place and so far to both sides of it; between them a parabola

# turns and shifts the vectors of one camera in place: BLAS wakes all its threads for so many, and they spin
_place = door("place_vectors", "i8[n] camera", "i8 number", "f8[3,3] turn", "f8[3] shift", "f8[n,3,3]! vectors")


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a camera stands in the first one's frame: x = rotation x_own + centre_mm."""

    rotation: FloatArray  # (3, 3)
    centre_mm: FloatArray  # (3,)


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Slits of known ring, seen in several frames. One row a slit."""

    frame: NDArray[np.int64]  # (N,) 0..F-1
    ring: NDArray[np.int64]  # (N,) 0..K-1, innermost first
    rays: FloatArray  # (N, 3, 3) unit vectors, camera frame: RAY_STEP_PX nearer, at the slit, RAY_STEP_PX farther out
    origins: FloatArray  # (N, 3, 3) mm, where those rays start; zeros for a camera with one centre
    width: FloatArray  # (N,) px between the slit's edges; 0 where the place is that of the cone itself
    camera: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))  # (N,) whose frame; 0, the first

    tint: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # (N, 12) how its place moves with the numbers
    # of `ColourShift`, red, green, blue; (N, 0) where colours are taken to lie where the lens says

    def __post_init__(self) -> None:
        if len(self.camera) != len(self.frame):
            object.__setattr__(self, "camera", np.zeros(len(self.frame), np.int64))
        if len(self.tint) != len(self.frame):
            object.__setattr__(self, "tint", np.zeros((len(self.frame), 0)))

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, which: NDArray[np.int64]) -> "Observations":
        return Observations(
            self.frame[which],
            self.ring[which],
            self.rays[which],
            self.origins[which],
            self.width[which],
            self.camera[which],
            self.tint[which],
        )

    def in_head(self, cameras: Sequence[Placement]) -> "Observations":
        """The same with every ray in the first camera's frame. cameras : of those after the first."""
        rays, origins = self.rays.copy(), self.origins.copy()
        for number, placement in enumerate(cameras, start=1):
            turn = np.ascontiguousarray(placement.rotation)
            _place(self.camera, number, turn, np.zeros(3), rays)
            _place(self.camera, number, turn, placement.centre_mm, origins)
        return replace(self, rays=rays, origins=origins)


def joined(parts: Sequence[Observations]) -> Observations:
    """What several cameras saw, one after the other, each numbered by its place in `parts`."""
    return Observations(
        np.concatenate([p.frame for p in parts]),
        np.concatenate([p.ring for p in parts]),
        np.concatenate([p.rays for p in parts]),
        np.concatenate([p.origins for p in parts]),
        np.concatenate([p.width for p in parts]),
        np.repeat(np.arange(len(parts)), [len(p) for p in parts]),
        np.concatenate([p.tint for p in parts]),
    )


def observe(
    camera: Camera,
    frame: NDArray[np.int64],
    ring: NDArray[np.int64],
    pixels: FloatArray,
    centre: FloatArray,
    width: FloatArray | None = None,
    colours: str = "",
) -> Observations:
    """Slits at (N, 2) pixels on lines through `centre` (2,) px, without those that the lens model cannot invert.

    colours : the pattern's, where each colour's image may be off by its own; see `Observations.tint`."""
    way = pixels - centre
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    places = np.stack([pixels - RAY_STEP_PX * way, pixels, pixels + RAY_STEP_PX * way], axis=1)
    origins, rays = camera.lines(places.reshape(-1, 2))
    seen = Observations(
        np.asarray(frame, np.int64),
        np.asarray(ring, np.int64),
        rays.reshape(-1, 3, 3),
        origins.reshape(-1, 3, 3),
        np.zeros(len(pixels)) if width is None else np.asarray(width, float),
        tint=_tints(np.asarray(ring, np.int64), way, colours),
    )
    good = np.isfinite(seen.rays).all(axis=(1, 2)) & np.isfinite(seen.origins).all(axis=(1, 2))
    return seen.take(np.flatnonzero(good))


def _tints(ring: NDArray[np.int64], way: FloatArray, colours: str) -> FloatArray:
    """(N, 12) each edge of a slit is the image of its own stripe's colour; `way` (N, 2) along the lines."""
    if not colours:
        return np.zeros((len(ring), 0))
    c, s = way.T
    waves = np.stack([c, s, c * (4 * c * c - 3), s * (3 - 4 * s * s)], axis=1)
    of = np.zeros((len(colours) - 1, 3))
    for k in range(len(of)):
        for colour in colours[k : k + 2]:
            of[k, "RGB".index(colour)] += 0.5
    return np.asarray((of[ring][:, :, None] * waves[:, None, :]).reshape(len(ring), 12))


def azimuths(seen: Observations, rings: Sequence[Cone], poses: Sequence[Pose], radius_mm: float) -> FloatArray:
    """(N,) 0..1: where round its cone's axis the light of each slit runs, see RingCorrection."""
    points = _wall_points(seen, poses, radius_mm)
    axis = np.array([ring.axis for ring in rings])[seen.ring]
    away = points - np.array([ring.vertex_mm for ring in rings])[seen.ring]
    first = away[:, 0] - axis[:, 0] * (away * axis).sum(axis=1)
    second = axis[:, 2] * away[:, 1] - axis[:, 1] * away[:, 2]
    return np.asarray(np.nan_to_num(np.arctan2(second, first)) / (2 * math.pi) % 1.0)


def _wall_points(seen: Observations, poses: Sequence[Pose], radius_mm: float) -> FloatArray:
    """(N, 3) mm, camera frame: where each slit's ray meets the wall of the pipe in its frame's pose."""
    out = np.empty((len(seen), 3))
    for j, pose in enumerate(poses):
        mine = np.flatnonzero(seen.frame == j)
        axis = pose.rotation[:, 2]
        out[mine] = intersect_cylinder(seen.rays[mine, 1], pose.translation, axis, radius_mm, seen.origins[mine, 1])
    return out
