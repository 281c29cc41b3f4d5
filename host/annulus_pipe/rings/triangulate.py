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
from annulus_pipe.numeric.jit import jit
from annulus_pipe.rings.polar import RAY_STEP_PX, PolarGrid, ring_pixels
from annulus_pipe.rings.slits import Slits

# sine of the least angle between ray and cone that still makes a point; test_a_plane_is_no_grazing_cone
GRAZING = 0.008
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
        usual = float(np.partition(slits.width, len(slits.width) // 2)[len(slits.width) // 2])
        width = np.minimum(slits.width, 1.3 * usual)  # a slit in a shadow's edge must not shift itself
        _all_rings(
            slits.direction,
            slits.position,
            width,
            grid.rays,
            grid.origins,
            RAY_STEP_PX,
            optics.cones,
            optics.bend,
            optics.corrections,
            wanted,
            out,
        )
    return out


def meet_rings(origins: FloatArray, rays: FloatArray, cones: FloatArray) -> FloatArray:
    """(N, 3) mm starts of (N, 3) unit rays, (K, 7) cones -> (N, K, 3) points; the same roots as geometry.cone."""
    out = np.empty((len(rays), len(cones), 3))
    for n in range(len(rays)):
        for k in range(len(cones)):
            far = _meet(*origins[n], *rays[n], cones[k], math.cos(cones[k, 6]) ** 2)
            out[n, k] = origins[n] + far * rays[n]
    return out


def deviations(points: FloatArray, pose: Pose, radius_mm: float) -> FloatArray:
    """(N, K, 3) camera frame -> (N, K) distance from the pipe's axis over its radius, less one; NaN stays NaN."""
    out = np.empty(points.shape[:2])
    _deviations(points, pose.rotation, pose.translation, radius_mm, out)
    return out


@jit
def _deviations(points, rotation, shift, radius, out):  # type: ignore[no-untyped-def]
    for n in range(points.shape[0]):
        for k in range(points.shape[1]):
            x, y, z = points[n, k, 0] - shift[0], points[n, k, 1] - shift[1], points[n, k, 2]
            if x != x:
                out[n, k] = np.nan
                continue
            u = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]  # Eq. 4.6
            v = x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]
            out[n, k] = math.sqrt(u * u + v * v) / radius - 1.0


@jit
def _all_rings(direction, position, width, rays, origins, step, cones, bend, corrections, wanted, out):  # type: ignore[no-untyped-def]
    own = np.empty(7)
    squares = np.cos(cones[:, 6]) ** 2
    ox, oy, oz = 0.0, 0.0, 0.0
    for n in range(len(position)):
        j = direction[n]
        for k in range(len(cones)):
            if not wanted[n, k]:
                out[n, k] = np.nan
                continue
            at = (position[n] + bend[k, j] * width[n] * width[n] / 8.0) / step
            i = min(max(int(at), 0), rays.shape[1] - 2)
            part = at - i
            x = rays[j, i, 0] + part * (rays[j, i + 1, 0] - rays[j, i, 0])
            y = rays[j, i, 1] + part * (rays[j, i + 1, 1] - rays[j, i, 1])
            z = rays[j, i, 2] + part * (rays[j, i + 1, 2] - rays[j, i, 2])
            scale = 1.0 / math.sqrt(x * x + y * y + z * z)
            x, y, z = x * scale, y * scale, z * scale
            if origins is not None:  # decided when compiled: a camera with one centre does not pay for it
                ox = origins[j, i, 0] + part * (origins[j, i + 1, 0] - origins[j, i, 0])
                oy = origins[j, i, 1] + part * (origins[j, i + 1, 1] - origins[j, i, 1])
                oz = origins[j, i, 2] + part * (origins[j, i + 1, 2] - origins[j, i, 2])
            far = _meet(ox, oy, oz, x, y, z, cones[k], squares[k])
            if corrections is not None:  # once more with the cone that was measured at this azimuth
                _corrected((ox + far * x, oy + far * y, oz + far * z), cones[k], corrections[k], own)
                far = _meet(ox, oy, oz, x, y, z, own, math.cos(own[6]) ** 2)
            out[n, k, 0], out[n, k, 1], out[n, k, 2] = ox + far * x, oy + far * y, oz + far * z


@jit
def _corrected(point, cone, correction, out):  # type: ignore[no-untyped-def]
    """The ring's cone as it is at the azimuth of a point, between the samples of `correction` (n, 2)."""
    ax, ay, az = cone[3], cone[4], cone[5]
    across = math.sqrt(1.0 - ax * ax)
    x, y, z = point[0] - cone[0], point[1] - cone[1], point[2] - cone[2]
    first = x * across - (y * ay + z * az) * ax / across  # along the part of the camera's x across the axis
    second = (y * az - z * ay) / across
    turn = math.atan2(second, first) / (2.0 * math.pi) * len(correction)
    turn = 0.0 if turn != turn else turn
    i = math.floor(turn)
    part = turn - i
    i = int(i) % len(correction)
    j = (i + 1) % len(correction)
    shift = correction[i, 1] + part * (correction[j, 1] - correction[i, 1])
    out[0], out[1], out[2] = cone[0] + shift * ax, cone[1] + shift * ay, cone[2] + shift * az  # Eq. 4.12
    out[3], out[4], out[5] = ax, ay, az
    out[6] = cone[6] + correction[i, 0] + part * (correction[j, 0] - correction[i, 0])


@jit
def _meet(ox, oy, oz, x, y, z, cone, cos2):  # type: ignore[no-untyped-def]
    """How far along its unit way x, y, z a ray from o meets a cone, NaN if nowhere: Alzuhiri 2022, App. A.2; of two
    forward roots the farther, §5.2."""
    vx, vy, vz, ax, ay, az = cone[0] - ox, cone[1] - oy, cone[2] - oz, cone[3], cone[4], cone[5]
    along = x * ax + y * ay + z * az
    va = -(vx * ax + vy * ay + vz * az)
    wv = -(x * vx + y * vy + z * vz)
    vv = vx * vx + vy * vy + vz * vz
    if cos2 < FLAT:
        return -va / along if abs(along) > GRAZING and -va / along > 0.0 else np.nan
    a = along * along - cos2  # Eq. 5.3
    b = 2.0 * (along * va - wv * cos2)  # Eq. 5.4
    c = va * va - vv * cos2  # Eq. 5.5
    # delta^2, Eq. 5.7: b b - 4 a c with what cancels taken out, for a cone that is nearly flat
    inside = 4.0 * cos2 * (along * along * vv - 2.0 * along * va * wv + va * va + cos2 * (wv * wv - vv))
    if inside <= 0.0:
        return np.nan
    q = -0.5 * (b + math.copysign(math.sqrt(inside), b))  # both roots of Eq. 5.6 are q / a and c / q: nothing cancels
    best = 0.0
    if a != 0.0:
        s = q / a
        if s > best and va + s * along > 0.0:
            best = s
    if q != 0.0:
        s = c / q
        if s > best and va + s * along > 0.0:
            best = s
    # delta over the length of the cone's gradient there is the sine of the angle between ray and cone
    away2 = vv + 2.0 * best * wv + best * best
    return best if best > 0.0 and inside > GRAZING * GRAZING * 4.0 * cos2 * (1.0 - cos2) * away2 else np.nan
