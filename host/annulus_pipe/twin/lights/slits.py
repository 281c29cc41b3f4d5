"""A slide with circular slits: coloured stripes with black rings between them.

Lens blur is not a filter over the image: a slit's edge is a step in projected angle, smoothed by what the blur subtends
in that angle at that pixel.
"""

import math

import numpy as np

from annulus_pipe.geometry.translucency import Translucency, incidence_rad, leaving
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.twin.lights.projector import in_pipe
from annulus_pipe.twin.rays import HeadPosition
from annulus_pipe.twin.worlds.sensor_head import Projector

_BINS = 2048  # of the table from cos(projected angle) to the nearest slit


class SlitLight:
    """The light of a world's `Projector`. `axis` is that of the mean cone, `rims` end the pattern (rad)."""

    kind = 0
    by_coordinate = False

    def __init__(self, projector: Projector, radius_mm: float, wall: Translucency | None = None) -> None:
        cones = projector.cones
        vertex = np.mean([c.vertex_mm for c in cones], axis=0)
        axis = np.mean([c.axis for c in cones], axis=0)
        self.axis = np.concatenate([vertex, axis / np.linalg.norm(axis)])
        self.rims = (
            cones[0].half_angle - math.radians(projector.margin_deg[0]),
            cones[-1].half_angle + math.radians(projector.margin_deg[1]),
        )
        self.brightest = math.sin(cones[-1].half_angle) ** 3 / radius_mm**2
        angles = [self.rims[0], *(c.half_angle for c in cones), self.rims[1]]
        halves = [0.0, *(math.radians(h) for h in projector.slit_half_deg), 0.0]
        ends = [cones[0], *cones, cones[-1]]
        self._slits = np.array(
            [[*c.vertex_mm, *c.axis, math.cos(a), math.sin(a), h] for c, a, h in zip(ends, angles, halves, strict=True)]
        )
        response = np.array(projector.response)
        stripes = np.array([response["RGB".index(c)] for c in projector.colours])
        colours = np.concatenate([np.zeros((1, 3)), stripes, np.zeros((1, 3))])
        # nearest slit by projected angle, uniform in its cosine so that no pixel needs an arc cosine
        cos0, cos1 = math.cos(self.rims[1] + 0.02), math.cos(max(self.rims[0] - 0.02, 0.0))
        middle = np.arccos(cos0 + (np.arange(_BINS) + 0.5) * (cos1 - cos0) / _BINS)
        bounds = (np.array(angles[1:]) + np.array(angles[:-1])) / 2
        nearest = np.searchsorted(bounds, middle)
        line = projector.line or (0.0, 0.0, 0.0)
        if projector.line is not None:
            colours[:] = 0.0
        leaves = np.zeros((len(ends), 2, 0, 3))
        if wall is not None:
            letters = projector.colours[0] + projector.colours + projector.colours[-1]
            parts = [leaving(wall, incidence_rad(angle)) for angle in angles]
            of = [["RGB".index(letter) for letter in letters[k : k + 2]] for k in range(len(ends))]
            leaves = np.array([one[edges] for one, edges in zip(parts, of, strict=True)])
        self._head = np.array(
            [len(ends), leaves.shape[2], cos0, _BINS / (cos1 - cos0), projector.leak, *line], np.float32
        )
        self._rest = np.concatenate([colours.ravel(), leaves.ravel(), nearest], dtype=np.float32)

    def coordinate(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm in the head's frame -> (N,) cot of the angle to the axis."""
        away = points - self.axis[:3]
        forward = away @ self.axis[3:]
        return np.asarray(forward / np.linalg.norm(away - forward[:, None] * self.axis[3:], axis=1))

    def table(self, pose: HeadPosition, z_mm: float) -> Float32Array:
        """The slide in one frame, as host/native/twin_slits.c lists it."""
        return np.concatenate([self._head, in_pipe(self._slits, pose, z_mm).ravel(), self._rest])
