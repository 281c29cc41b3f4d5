"""The loops over observations, compiled: what an error is, how it moves with every unknown, and the normal equations.

An error is found along the observation's line, in pixels: Newton's method finds where the line crosses the image of the
ring on the wall; nothing is linearised about the place where the slit was seen.
"""

import math
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray, IntArray
from annulus_pipe.numeric.jit import jit
from annulus_pipe.rings.calibration.observations import RAY_STEP_PX

PROBE_PX = 4.0  # topic calibrate_scene: step of the finite differences for a slit's middle, as in triangulate
REACH_PX = 60.0  # a ring farther from a slit than this pulls no harder; topic autocalibration, cold starts


class Lines(NamedTuple):
    """N observations, each on its line, as `errors` takes them."""

    frame: IntArray  # (N,)
    ring: IntArray  # (N,)
    rays: FloatArray  # (N, 3, 3) of the slit and RAY_STEP_PX to either side of it, as `Observations` has them
    origins: FloatArray  # (N, 3, 3) mm, likewise
    width: FloatArray  # (N,) px of each slit, or (0,) where its middle is not to be found again


class Guess(NamedTuple):
    """What is tried: the unknowns, and what is held."""

    cones: FloatArray  # (K, 6) half-angle, axis x y, vertex x y z
    poses: FloatArray  # (F, 4) rx, ry, tx, ty
    turns: FloatArray  # (F, 4) cosine and sine of rx, of ry
    radius: float  # mm
    correction: FloatArray  # (K, 2, n) offset and shift by sector


class Residuals(NamedTuple):
    """What is written."""

    places: FloatArray  # (N,) px, where the ring's image crosses the line; kept from call to call
    middles: FloatArray  # (N,) px, how far beyond its slit's middle that is; kept likewise
    error: FloatArray  # (N,) px, seen less expected place along the line, NaN where ray, wall and cone do not meet
    rows: FloatArray  # (N, 17 ..) how the expected place moves with half-angle, axis x y, vertex x y z, rx, ry, tx, ty,
    # radius, and with the camera: its turn about its centre and its centre, x y z each


@jit
def errors(lines, guess, residuals):  # type: ignore[no-untyped-def]
    """`Lines` and `Guess` in, `Residuals` out."""
    frame, ring, rays, origins, width = lines.frame, lines.ring, lines.rays, lines.origins, lines.width
    cones, poses, turns, radius, correction = guess.cones, guess.poses, guess.turns, guess.radius, guess.correction
    places, middles, error, rows = residuals.places, residuals.middles, residuals.error, residuals.rows
    more = np.empty(16)
    for n in range(len(frame)):
        cone, pose, turn, own = cones[ring[n]], poses[frame[n]], turns[frame[n]], correction[ring[n]]
        at = places[n]  # px from the slit, outwards positive
        good = True
        for _ in range(6):
            value, slope = _off(rays[n], origins[n], at, cone, pose, turn, radius, own, more, False)
            if not abs(slope) > 1e-9:
                good = False
                break
            step = value / slope
            at -= min(max(step, -20.0), 20.0)
            if abs(at) > REACH_PX or abs(step) < 1e-4:
                break
        if not good or not abs(at) < REACH_PX:
            error[n] = np.nan
            places[n] = 0.0
            continue
        places[n] = at
        if len(width) > 0:
            middles[n] = 0.0
            if width[n] > 0.0:
                # the cone lies at the middle of the edges' angles, not of their pixels (see triangulate.ring_optics)
                before, s0 = _off(rays[n], origins[n], at - PROBE_PX, cone, pose, turn, radius, own, more, False)
                after, s1 = _off(rays[n], origins[n], at + PROBE_PX, cone, pose, turn, radius, own, more, False)
                middles[n] = (s1 - s0) / (after - before) * width[n] * width[n] / 8.0
        value, slope = _off(rays[n], origins[n], at, cone, pose, turn, radius, own, more, True)
        error[n] = middles[n] - at
        if not abs(error[n]) < REACH_PX:
            error[n] = np.nan
            continue
        rows[n, 0] = 1.0 / slope
        for a in range(16):
            rows[n, a + 1] = -more[a] / slope


@jit
def _off(rays, origins, at, cone, pose, turn, radius, correction, more, wanted):  # type: ignore[no-untyped-def]
    """Angle about the cone's axis of the wall's point seen at `at`, less the cone's half-angle there; its slope along
    the line. In `more`, if wanted, its gradient: axis x y, vertex x y z, rx, ry, tx, ty, radius, the camera's turn and
    its centre."""
    part = at / RAY_STEP_PX
    wx, wy, wz, ux, uy, uz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ox, oy, oz, vx, vy, vz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):  # Lagrange's parabola and its slope
        if i == 0:
            c, d = 0.5 * part * (part - 1.0), (part - 0.5) / RAY_STEP_PX
        elif i == 1:
            c, d = 1.0 - part * part, -2.0 * part / RAY_STEP_PX
        else:
            c, d = 0.5 * part * (part + 1.0), (part + 0.5) / RAY_STEP_PX
        wx += c * rays[i, 0]
        wy += c * rays[i, 1]
        wz += c * rays[i, 2]
        ux += d * rays[i, 0]
        uy += d * rays[i, 1]
        uz += d * rays[i, 2]
        ox += c * origins[i, 0]
        oy += c * origins[i, 1]
        oz += c * origins[i, 2]
        vx += d * origins[i, 0]
        vy += d * origins[i, 1]
        vz += d * origins[i, 2]
    # the wall: rows 0 and 1 of R^T are what counts across the pipe
    ca, sa, cb, sb = turn[0], turn[1], turn[2], turn[3]
    r00, r01, r02 = cb, sb * sa, -sb * ca
    r11, r12 = ca, sa
    qx, qy = ox - pose[2], oy - pose[3]
    qu, qv = r00 * qx + r01 * qy + r02 * oz, r11 * qy + r12 * oz
    wu, wv = r00 * wx + r01 * wy + r02 * wz, r11 * wy + r12 * wz
    a, b, c = wu * wu + wv * wv, qu * wu + qv * wv, qu * qu + qv * qv - radius * radius
    under = b * b - a * c
    if not under > 0.0 or not a > 0.0:
        return np.nan, np.nan
    s = (math.sqrt(under) - b) / a
    if not s > 0.0:
        return np.nan, np.nan
    x, y, z = ox + s * wx, oy + s * wy, oz + s * wz
    cu, cv = (qu + s * wu) / radius, (qv + s * wv) / radius
    nx, ny, nz = r00 * cu, r01 * cu + r11 * cv, r02 * cu + r12 * cv  # outwards, across the wall
    against = nx * wx + ny * wy + nz * wz
    # the cone
    ax, ay = cone[1], cone[2]
    az = math.sqrt(max(1.0 - ax * ax - ay * ay, 1e-12))
    dx, dy, dz = x - cone[3], y - cone[4], z - cone[5]
    far = math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / far, dy / far, dz / far
    cosine = dx * ax + dy * ay + dz * az
    mx, my, mz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    sine = math.sqrt(mx * mx + my * my + mz * mz)
    if not sine > 1e-9:
        return np.nan, np.nan
    value = math.atan2(sine, cosine) - cone[0]
    if correction.shape[1] > 0:
        offset, shift = correction_at(correction, dx, dy, dz, ax, ay, az)
        value = math.atan2(sine * far, cosine * far - shift) - cone[0] - offset
    # how the angle turns when the wall's point moves
    gx, gy, gz = (cosine * dx - ax) / (far * sine), (cosine * dy - ay) / (far * sine), (cosine * dz - az) / (far * sine)
    along = gx * wx + gy * wy + gz * wz
    # how the point moves with the place on the line: its ray turns, and it stays on the wall
    px, py, pz = vx + s * ux, vy + s * uy, vz + s * uz
    slide = -(nx * px + ny * py + nz * pz) / against
    slope = gx * px + gy * py + gz * pz + along * slide
    if wanted:
        more[0] = -(dx - dz * ax / az) / sine
        more[1] = -(dy - dz * ay / az) / sine
        more[2], more[3], more[4] = -gx, -gy, -gz
        tx, ty = x - pose[2], y - pose[3]
        turned = sa * ty - ca * z
        v = ca * ty + sa * z
        push = along / against  # mm across the wall -> angle
        more[5] = -push * (cu * sb * v + cv * (ca * z - sa * ty))
        more[6] = -push * (cu * (cb * turned - sb * tx))
        more[7] = push * nx
        more[8] = push * ny
        more[9] = push
        # the ray moves with its camera, and its point stays on the wall
        hx, hy, hz = gx - push * nx, gy - push * ny, gz - push * nz
        more[10], more[11], more[12] = s * (wy * hz - wz * hy), s * (wz * hx - wx * hz), s * (wx * hy - wy * hx)
        more[13], more[14], more[15] = hx, hy, hz
    return value, slope


@jit
def correction_at(correction, dx, dy, dz, ax, ay, az):  # type: ignore[no-untyped-def]
    """One ring's offset (rad) and shift (mm), (2, n), where direction d runs from its vertex: see RingCorrection."""
    # along e1 = camera x less its part along the axis, and e2 = axis x e1; both of length sqrt(1 - ax^2)
    first = dx - ax * (dx * ax + dy * ay + dz * az)
    second = az * dy - ay * dz
    turn = math.atan2(second, first) / (2.0 * math.pi)
    at = (turn - math.floor(turn)) * correction.shape[1]
    i = min(int(at), correction.shape[1] - 1)
    part = at - i
    j = (i + 1) % correction.shape[1]
    return correction[0, i] + part * (correction[0, j] - correction[0, i]), correction[1, i] + part * (
        correction[1, j] - correction[1, i]
    )


@jit
def gather(frame, ring, camera, weight, error, rows, blocks, right):  # type: ignore[no-untyped-def]
    for n in range(len(frame)):
        w = weight[n]
        if w == 0.0:
            continue
        block, vector = blocks[camera[n], ring[n], frame[n]], right[camera[n], ring[n], frame[n]]
        for a in range(rows.shape[1]):
            scaled = w * rows[n, a]
            if scaled == 0.0:
                continue
            vector[a] += scaled * error[n]
            for b in range(a, rows.shape[1]):
                block[a, b] += scaled * rows[n, b]


@jit
def gather_sectors(frame, sector, weight, rows, shared):  # type: ignore[no-untyped-def]
    """(K n, 6 + 4 F + 1): each sector's angle against its ring, all poses and the radius."""
    last = shared.shape[1] - 1
    for n in range(len(frame)):
        w = weight[n] * rows[n, 0]
        if w == 0.0:
            continue
        row = shared[sector[n]]
        for a in range(6):
            row[a] += w * rows[n, a]
        for a in range(4):
            row[6 + 4 * frame[n] + a] += w * rows[n, 6 + a]
        row[last] += w * rows[n, 10]


@jit
def of_head(camera, turns, tint, shift, error, rows):  # type: ignore[no-untyped-def]
    """What several cameras and their colours add to `errors`: of the rows no camera's for the first, from which all is
    measured, and of the others the turn as their rotation vector's, by `turns` (C, 3, 3); colours' shifts (T,) px.
    Compiled: for so many rows BLAS wakes all its threads, and they spin."""
    for n in range(len(camera)):
        row = rows[n]
        if camera[n] == 0:
            row[11:17] = 0.0
        else:
            by, x, y, z = turns[camera[n]], row[11], row[12], row[13]
            for a in range(3):
                row[11 + a] = x * by[0, a] + y * by[1, a] + z * by[2, a]
        for a in range(tint.shape[1]):
            row[17 + a] = tint[n, a]
            error[n] -= tint[n, a] * shift[a]
