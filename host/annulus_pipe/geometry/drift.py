"""What an optical head may have drifted by since it was calibrated, and where its points lie then.

On its axis a head sees ring k of a pipe of radius R at f s T_k / (1 - s T_k (d - m) / R): T_k the tangent of its
half-angle, f the focal length, s the slide's scale, d how far the projector stands behind the camera, m how far light
goes on inside the wall. Rings alone therefore give f s and s (d - m) / R, however many there are; only something of
known size tells R from s (d - m). A head that leans adds terms of second order, which the errors of edges outweigh.
"""

import math
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.cone import Cone, intersect_cone
from annulus_pipe.numeric.arrays import FloatArray

COLOURS = "RGB"


@dataclass(frozen=True, slots=True)
class Drift:
    """focal, slide, anamorphic : parts of one, by which the focal length and the tangents of the rings' half-angles
    have grown, and fy more than fx. tube_mm : the projector has moved back along its axis by so much. red_mm, green_mm,
    blue_mm : light of that colour leaves the wall so much farther down the pipe than where it was calibrated."""

    focal: float = 0.0
    slide: float = 0.0
    tube_mm: float = 0.0
    anamorphic: float = 0.0
    red_mm: float = 0.0
    green_mm: float = 0.0
    blue_mm: float = 0.0

    @classmethod
    def of(cls, values: FloatArray) -> "Drift":
        return cls(*np.asarray(values, dtype=float).tolist())

    @property
    def values(self) -> FloatArray:
        """(7,) in the order of the fields."""
        return np.array(astuple(self))


SMALL = Drift(1e-4, 1e-4, 1e-2, 1e-4, 1e-2, 1e-2, 1e-2)  # steps of finite differences: linear, and far above rounding


def drifted(calibration: Calibration, drift: Drift) -> Calibration:
    """The head as it is now. The first camera only; a ring's colour is the mean of its two stripes'."""
    camera = calibration.camera
    wider = 1.0 + drift.focal
    now = replace(camera, fx=camera.fx * wider, fy=camera.fy * (wider + drift.anamorphic))
    rings = []
    for k, ring in enumerate(calibration.rings):
        axis = np.array(ring.axis)
        inside = calibration.colours[k : k + 2] or COLOURS  # bright lines have no stripes: white
        ahead = np.mean([drift.values[4 + COLOURS.index(colour)] for colour in inside])
        x, y, z = np.array(ring.vertex_mm) + (ahead - drift.tube_mm) * axis
        half_angle = math.atan(math.tan(ring.half_angle) * (1.0 + drift.slide))
        rings.append(Cone(half_angle, ring.axis, (float(x), float(y), float(z))))
    return replace(calibration, camera=now, rings=tuple(rings))


def seen_with(points: FloatArray, ring: NDArray[np.integer], before: Calibration, now: Calibration) -> FloatArray:
    """(N, 3) mm, camera frame: where points lie that were measured with a calibration when another one is true; NaN
    where a ray and its cone do not meet then. What a ring is off its cone (`RingCorrection`) stays as it was."""
    rays = [one.camera.lines(before.camera.project(points)) for one in (before, now)]
    out = np.full(points.shape, np.nan)
    for k in range(len(before.rings)):
        mine = np.flatnonzero(ring == k)
        if len(mine):
            old, new = (
                _on_cone(origins[mine], ways[mine], one.rings[k])
                for (origins, ways), one in zip(rays, (before, now), strict=True)
            )
            out[mine] = points[mine] + new - old
    return out


def _on_cone(origins: FloatArray, ways: FloatArray, cone: Cone) -> FloatArray:
    """(N, 3) where rays from their own origins meet a cone."""
    if not origins.any():
        return intersect_cone(ways, cone)[0]
    return np.array([intersect_cone(way[None], cone, start)[0][0] for start, way in zip(origins, ways, strict=True)])
