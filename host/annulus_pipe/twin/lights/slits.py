"""A slide with circular slits: coloured stripes with black rings between them.

Lens blur is not a filter over the image: a slit's edge is a step in projected angle, smoothed by what the blur subtends
in that angle at that pixel.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.translucency import Translucency, incidence_rad, leaving
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.twin.lights.projector import Beam, in_pipe
from annulus_pipe.twin.rays import HeadPosition
from annulus_pipe.twin.stretch import AT, F32, LEVEL, LIT, PixelRun, X, Y, Z, jit, step_up
from annulus_pipe.twin.worlds.sensor_head import Projector

_BINS = 2048  # of the table from cos(projected angle) to the nearest slit


class SlitTable(NamedTuple):
    """The slide in one frame. The first and the last "slit" are the pattern's rims."""

    slits: F32  # (slits + 2, 9) vertex, axis (pipe frame), cos, sin of the half-angle, half-width (rad)
    colours: F32  # (slits + 3, 3) [i], [i + 1]: stripes inside and outside of slit i, as red, green, blue pixels see it
    nearest: NDArray[np.int8]  # (BINS,) slit by cosine of the angle to the beam's axis
    cos0: np.float32  # of the first bin
    cos_step: np.float32  # bins a unit
    leak: np.float32
    line: F32  # (3,) what red, green and blue pixels see of light through the slits
    leaving: F32  # (slits + 2, 2, parts, 3) of the edge inside and outside of each slit, see `translucency.leaving`


@jit
def through_slits(part: PixelRun, beam: Beam, table: SlitTable) -> None:
    """Slits by runs of pixels that share their nearest one."""
    scratch, slit_of, spread, n, v, odd = part.scratch, part.marks, part.spread, part.n, part.v, part.odd
    slits, colours, nearest, leak, blur = table.slits, table.colours, table.nearest, table.leak, beam.blur
    line_even, line_odd = table.line[(v & 1) + odd], table.line[(v & 1) + 1 - odd]
    cos0, cos_step = table.cos0, table.cos_step
    one, zero = np.float32(1.0), np.float32(0.0)
    for u in range(n):
        slit_of[u] = np.int32(max(min((scratch[AT + u] - cos0) * cos_step, np.float32(_BINS - 1)), zero))
    u = 0
    while u < n:
        i = nearest[slit_of[u]]
        end = u + 1
        while end < n and nearest[slit_of[end]] == i:
            end += 1
        vx, vy, vz, ax, ay, az = slits[i, 0], slits[i, 1], slits[i, 2], slits[i, 3], slits[i, 4], slits[i, 5]
        cosine0, sine0, wide = slits[i, 6], slits[i, 7], slits[i, 8]
        even, other = (v & 1) + odd, (v & 1) + 1 - odd
        even_in, odd_in = colours[i, even], colours[i, other]
        even_out, odd_out = colours[i + 1, even], colours[i + 1, other]
        if table.leaving.shape[2]:
            _through_wall(part, beam, table, i, u, end)
            u = end
            continue
        for k in range(u, end):
            px, py, pz = scratch[X + k] - vx, scratch[Y + k] - vy, scratch[Z + k] - vz
            cosine = (px * ax + py * ay + pz * az) / np.sqrt(px * px + py * py + pz * pz)
            sine2 = max(one - cosine * cosine, zero)
            off = np.sqrt(sine2) * cosine0 - cosine * sine0  # sin(theta_P - theta), small
            sharp = one / (blur * sine2 * spread[k] + np.float32(1e-9))
            inside = one - step_up((off + wide) * sharp)
            outside = step_up((off - wide) * sharp)
            colour_in = odd_in if k & 1 else even_in
            colour_out = odd_out if k & 1 else even_out
            share = inside * colour_in + outside * colour_out
            share += leak * (one - inside - outside) * (colour_in + colour_out)
            share += (one - inside - outside) * (line_odd if k & 1 else line_even)
            scratch[LEVEL + k] = scratch[LIT + k] * share
        u = end


@jit
def _through_wall(part: PixelRun, beam: Beam, table: SlitTable, i: int, first: int, end: int) -> None:
    """Pixels first..end of one slit on a wall that light enters: each edge is the sum of its light's parts, every one
    farther along the pipe and softer than it came in."""
    scratch, spread, slits, colours, leaving = part.scratch, part.spread, table.slits, table.colours, table.leaving
    vx, vy, vz, ax, ay, az = slits[i, 0], slits[i, 1], slits[i, 2], slits[i, 3], slits[i, 4], slits[i, 5]
    cosine0, sine0, wide = slits[i, 6], slits[i, 7], slits[i, 8]
    one, zero = np.float32(1.0), np.float32(0.0)
    for k in range(first, end):
        px, py, pz = scratch[X + k] - vx, scratch[Y + k] - vy, scratch[Z + k] - vz
        away = np.sqrt(px * px + py * py + pz * pz)
        cosine = (px * ax + py * ay + pz * az) / away
        sine2 = max(one - cosine * cosine, np.float32(1e-9))
        sine = np.sqrt(sine2)
        off = sine * cosine0 - cosine * sine0
        turn = (az - cosine * pz / away) / (away * sine)  # of the light's angle, one mm up the pipe
        lens = beam.blur * sine2 * spread[k]
        inside, outside = zero, zero
        for j in range(leaving.shape[2]):
            near, far = leaving[i, 0, j], leaving[i, 1, j]  # mm down the pipe, share, sigma in mm
            blur = np.sqrt(lens * lens + near[2] * near[2] * turn * turn) + np.float32(1e-9)
            inside += near[1] * (one - step_up((off + near[0] * turn + wide) / blur))
            blur = np.sqrt(lens * lens + far[2] * far[2] * turn * turn) + np.float32(1e-9)
            outside += far[1] * step_up((off + far[0] * turn - wide) / blur)
        channel = (part.v & 1) + ((k & 1) ^ part.odd)
        colour_in, colour_out = colours[i, channel], colours[i + 1, channel]
        share = inside * colour_in + outside * colour_out
        share += table.leak * (one - inside - outside) * (colour_in + colour_out)
        scratch[LEVEL + k] = scratch[LIT + k] * share


class SlitLight:
    """The light of a world's `Projector`. `axis` is that of the mean cone, `rims` end the pattern (rad)."""

    Table = SlitTable
    by_coordinate = False
    kernel = staticmethod(through_slits)

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
        self._colours = np.concatenate([np.zeros((1, 3)), stripes, np.zeros((1, 3))]).astype(np.float32)
        # nearest slit by projected angle, uniform in its cosine so that no pixel needs an arc cosine
        cos0, cos1 = math.cos(self.rims[1] + 0.02), math.cos(max(self.rims[0] - 0.02, 0.0))
        middle = np.arccos(cos0 + (np.arange(_BINS) + 0.5) * (cos1 - cos0) / _BINS)
        bounds = (np.array(angles[1:]) + np.array(angles[:-1])) / 2
        self._nearest = np.searchsorted(bounds, middle).astype(np.int8)
        self._cos0, self._cos_step = np.float32(cos0), np.float32(_BINS / (cos1 - cos0))
        self._leak = np.float32(projector.leak)
        self._line = np.array(projector.line or (0.0, 0.0, 0.0), np.float32)
        if projector.line is not None:
            self._colours[:] = 0.0
        self._leaving = np.zeros((len(ends), 2, 0, 3), np.float32)
        if wall is not None:
            letters = projector.colours[0] + projector.colours + projector.colours[-1]
            parts = [leaving(wall, incidence_rad(angle)) for angle in angles]
            of = [["RGB".index(letter) for letter in letters[k : k + 2]] for k in range(len(ends))]
            self._leaving = np.array([one[edges] for one, edges in zip(parts, of, strict=True)], np.float32)

    def coordinate(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm in the head's frame -> (N,) cot of the angle to the axis."""
        away = points - self.axis[:3]
        forward = away @ self.axis[3:]
        return np.asarray(forward / np.linalg.norm(away - forward[:, None] * self.axis[3:], axis=1))

    def table(self, pose: HeadPosition, z_mm: float) -> SlitTable:
        slits = in_pipe(self._slits, pose, z_mm)
        return SlitTable(
            slits, self._colours, self._nearest, self._cos0, self._cos_step, self._leak, self._line, self._leaving
        )
