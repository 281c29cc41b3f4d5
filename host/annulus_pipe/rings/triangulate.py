"""From slits to points: each slit's ray meets the cone of every ring it might be.

Assumed: light of a slit is a cone (or a cone with a residual correction of its half-angle and vertex at every azimuth).
What carries it: a pixel is one ray, a ring one surface, so a point needs no neighbour and no wall. When it breaks: a
ray nearly along its cone has no safe point and gets none (GRAZING).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration, RingCorrection
from annulus_pipe.geometry.cone import FLAT, intersect_cylinder
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.rings.decode import Candidates
from annulus_pipe.rings.polar import RAY_STEP_PX, PolarGrid, ring_pixels
from annulus_pipe.rings.slits import FrameSlits, Slits

# sine of the least angle between ray and cone that still makes a point; test_a_plane_is_no_grazing_cone
GRAZING = 0.008
WIDEST = 1.3  # of the frame's usual width: a slit in a shadow's edge must not shift itself; topic uncertainty
LIMITS = np.array([RAY_STEP_PX, FLAT, GRAZING])
PROBE_PX = 4.0  # step of the finite differences along a line; test_slits, the bend


@dataclass(frozen=True, slots=True, eq=False)
class RingOptics:
    """What a clean pipe says of each ring in each direction, once per calibration."""

    cones: FloatArray  # (K, 7) vertex, axis, half-angle
    bend: FloatArray  # (K, J) 1/px, see `ring_optics`
    rad_per_px: FloatArray  # (K,) how far the light's angle turns with one pixel along a line
    mm_per_px: FloatArray  # (K,) how far the wall's radius moves with one pixel along a line
    corrections: FloatArray | None  # (K, n, 2) half-angle and shift over the azimuth; see RingCorrection
    offset_px: FloatArray  # (K, J) along a line: how far a slit's image is off because of its stripes' colours


def ring_optics(calibration: Calibration, grid: PolarGrid, usual: Pose = Pose()) -> RingOptics:  # noqa: B008
    """Tabulate the rings' optics, of a pipe in its usual pose.

    A slit's cone lies at the middle of its two edges' *angles*, which is not the middle of their pixels: on a wall
    the angle t(p) bends along the line, and the true place is `(p1 + p2)/2 + t''/t' (p2 - p1)^2 / 8`, from
    expanding t about the middle. `bend` is that t''/t' (0.08 px on the innermost ring of an 8 px slit).
    """
    pipe = calibration.pipe_radius_mm
    directions = len(grid.cosine)
    lines = np.arange(directions)
    cones = np.array([[*c.vertex_mm, *c.axis, c.half_angle] for c in calibration.rings])
    bend = np.zeros((len(cones), directions))
    slope_mm, slope_rad = np.zeros(len(cones)), np.zeros(len(cones))
    for k, cone in enumerate(calibration.rings):
        pixels = ring_pixels(calibration.camera, cone, usual, pipe)
        pixels = pixels[np.isfinite(pixels).all(axis=1)] - grid.centre
        order = np.argsort(np.arctan2(pixels[:, 1], pixels[:, 0]) % (2 * math.pi))
        turn = (np.arctan2(pixels[:, 1], pixels[:, 0]) % (2 * math.pi))[order]
        far = np.linalg.norm(pixels, axis=1)[order]
        away = np.interp(np.arctan2(grid.sine, grid.cosine), turn, far, period=2 * math.pi)
        at = (away - grid.first) * grid.step
        angles = []
        for step in (-PROBE_PX, 0.0, PROBE_PX):
            start, way = calibration.camera.lines(grid.pixels(lines, at + step))
            wall = intersect_cylinder(way, usual.translation, usual.rotation[:, 2], pipe, start)
            v = wall - np.asarray(cone.vertex_mm)
            angles.append(np.arctan2(np.linalg.norm(np.cross(v, cone.axis), axis=1), v @ np.asarray(cone.axis)))
        with np.errstate(divide="ignore", invalid="ignore"):
            second = (angles[2] - 2 * angles[1] + angles[0]) / PROBE_PX**2
            bend[k] = np.nan_to_num(second / ((angles[2] - angles[0]) / (2 * PROBE_PX)), posinf=0.0, neginf=0.0)
        slope_rad[k] = np.nan_to_num(np.nanmedian(np.abs(angles[2] - angles[0])) / (2 * PROBE_PX))
        near, far = (grid.pixels(lines, at + step) for step in (-1.0, 1.0))
        ends = np.stack([meet_rings(*calibration.camera.lines(at), cones[k : k + 1])[:, 0] for at in (near, far)])
        radii = np.linalg.norm(usual.to_pipe(ends)[..., :2], axis=2)
        slope_mm[k] = np.nanmedian(np.abs(np.diff(radii, axis=0))) / 2
    slope_mm = np.nan_to_num(slope_mm, nan=float(np.nanmax(slope_mm)))
    return RingOptics(
        cones,
        bend,
        slope_rad,
        slope_mm,
        _correction_table(calibration.corrections) if calibration.corrections is not None else None,
        _colour_offsets(calibration, grid),
    )


def _colour_offsets(calibration: Calibration, grid: PolarGrid) -> FloatArray:
    """(K, J) px along each line: a slit's edges are images of its two stripes, each off by its colour's shift."""
    shifts = calibration.camera.colour_shift_px
    out = np.zeros((len(calibration.rings), len(grid.cosine)))
    if not shifts or not calibration.colours:
        return out
    c, s = grid.cosine * grid.step, grid.sine * grid.step
    waves = np.stack([c, s, c * (4 * c * c - 3), s * (3 - 4 * s * s)])
    of = np.array(shifts) @ waves
    for k in range(len(out)):
        out[k] = sum(0.5 * of["RGB".index(colour)] for colour in calibration.colours[k : k + 2])
    return out


def _correction_table(corrections: tuple[RingCorrection, ...]) -> FloatArray:
    """(K, n, 2) half-angle offset (rad) and axial shift (mm) of every ring, all as finely as the finest."""
    n = max(len(ring.offset_rad) for ring in corrections)
    out = np.zeros((len(corrections), n, 2))
    for k, ring in enumerate(corrections):
        for i, values in enumerate((ring.offset_rad, ring.shift_mm)):
            if values is not None:
                out[k, :, i] = np.interp(np.arange(n) / n, np.arange(len(values)) / len(values), values, period=1.0)
    return out


def triangulate(slits: Slits, grid: PolarGrid, optics: RingOptics, wanted: NDArray[np.bool_]) -> FloatArray:
    """(N, K, 3) mm, camera frame: where slit n lies if it is ring k; NaN where that is not `wanted` (N, K), or ray and
    cone do not meet."""
    out = np.empty((len(slits.position), len(optics.cones), 3))
    if len(slits.position):
        half = len(slits.width) // 2
        width = np.minimum(slits.width, WIDEST * np.partition(slits.width, half)[half])
        _all_points(
            slits.direction,
            slits.position,
            width,
            wanted,
            grid.rays,
            grid.origins,
            optics.cones,
            optics.bend,
            optics.corrections,
            LIMITS,
            out,
        )
    return out


def meet_rings(origins: FloatArray, rays: FloatArray, cones: FloatArray) -> FloatArray:
    """(N, 3) mm starts of (N, 3) unit rays, (K, 7) cones -> (N, K, 3) points; the same roots as geometry.cone."""
    far = np.empty((len(rays), len(cones)))
    starts, ways, of = (np.ascontiguousarray(array, np.float64) for array in (origins, rays, cones))
    _meet(starts, ways, of, FLAT, GRAZING, far)
    return np.asarray(starts[:, None] + far[:, :, None] * ways[:, None])


def deviations(points: FloatArray, pose: Pose, radius_mm: float) -> FloatArray:
    """(N, K, 3) camera frame -> (N, K) distance from the pipe's axis over its radius, less one; NaN stays NaN."""
    out = np.empty(points.shape[:2])
    rows = np.array(points.reshape(-1, 3).T, np.float64, order="C")
    _deviations(rows, rows.shape[1], pose.rotation, pose.translation, radius_mm, out.reshape(-1))
    return out


class CandidatePoints:
    """Where listed candidates lie, in memory that is used again for each frame: points (3, C) mm, camera frame; NaN
    where ray and cone do not meet."""

    def __init__(self, table: FrameSlits, candidates: Candidates, grid: PolarGrid, optics: RingOptics) -> None:
        self.points = np.empty((3, len(candidates.slit)))
        self._table, self._candidates = table, candidates
        self._rotation, self._shift = np.empty((3, 3)), np.empty(3)
        slits, listed = (table.direction, table.position, table.width), (candidates.slit, candidates.ring)
        fixed = grid.rays, grid.origins, optics.cones, optics.bend, optics.corrections, LIMITS, self.points
        work = np.empty(len(table.position))
        self._points = _points.held(*slits, ..., WIDEST, work, *listed, ..., *fixed)
        self._deviations = _deviations.held(self.points, ..., self._rotation, self._shift, ..., candidates.deviation)
        candidates.lie_at(self.points, self._rotation, self._shift)

    def place(self) -> None:
        """Of this frame's slits and candidates."""
        self._points(self._table.size, self._candidates.size)

    def deviate(self, pose: Pose, radius_mm: float) -> None:
        """`deviations` of all candidates, of a pipe that lies so."""
        self._rotation[:], self._shift[:] = pose.rotation, pose.translation
        self._deviations(self._candidates.size, radius_mm)

    def read(self, pose: Pose, radius_mm: float, tolerance: float) -> NDArray[np.int64]:
        """`deviate`, and `Candidates.align` by that."""
        self._rotation[:], self._shift[:] = pose.rotation, pose.translation
        return self._candidates.align(self._table.size, tolerance, radius_mm)


_OPTICS = (
    "f4[j,l,3] rays",
    "f4[j,l,3]? origins",
    "f8[k,7] cones",
    "f8[k,j] bend",
    "f8[k,c,2]? corrections",
    "f8[3] limits",
)
_points = door(
    "rings_points",
    "i8[s] direction",
    "f8[s] position",
    "f8[s] width",
    "i8 size",
    "f8 widest_part",
    "f8[s]! work",
    "i4[n] slit",
    "i4[n] name",
    "i8 listed",
    *_OPTICS,
    "f8[3,n]! points",
)
_deviations = door(
    "rings_deviations",
    "f8[3,n] points",
    "i8 listed",
    "f8[3,3] rotation",
    "f8[3] shift",
    "f8 radius",
    "f8[n]! deviation",
)
_all_points = door(
    "rings_all_points",
    "i8[n] direction",
    "f8[n] position",
    "f8[n] width",
    "b1[n,k] wanted",
    *_OPTICS,
    "f8[n,k,3]! points",
)
_meet = door("rings_meet", "f8[n,3] starts", "f8[n,3] ways", "f8[k,7] cones", "f8 flat", "f8 grazing", "f8[n,k]! far")
