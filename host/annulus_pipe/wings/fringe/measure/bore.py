"""What the loops over a pipe's wall see: light, phase and place of wall points in every frame of a head in a pipe.

Light in a pipe is no constant along a track: it falls off with distance and angle, and fringes that the lens sees
aslant are blurred more the farther ahead. Both belong to the head and are smooth there, so for each of its eyes a
polynomial in the point's place in the head's frame says both, a level and a modulation relative to their middle
(`shading`):

    I_n = gain_n (A + B depth_n w(phase_n(h) + texture q_n blur^2)) (1 + g t_n)

The blur is of the lens, px, and grows on the wall with the distance ahead. q_n is what a slope of albedo along the pipe
does to the phase (see `texture`), in each frame by its own blur.
"""

import math
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.jit import jit
from annulus_pipe.wings.fringe.measure.projector import phase_and_slope, wave
from annulus_pipe.wings.fringe.measure.track import (
    GOOD,
    MODULATED,
    PIVOT_MIN,
    ROBUST_FROM,
    ROUNDS_MAX,
    STEP_MAX_RAD,
    TOO_FEW,
    TUKEY_SQUARED,
    UNDETERMINED,
    UNMODULATED,
    UNSETTLED,
    sample,
    see,
)

DEGREE = 3  # of the shading along the pipe; times 1, cos, sin of the direction
TERMS = 3 * (DEGREE + 1)
SPAN_LEAST = 0.99 * 4 * math.pi / 3  # rad, of the frames' phases: what three steps of a third of a period cover
FULL_MOST = 1.5  # AC over DC: light is not negative; what is above 1 a slide's harmonics and noise may do
AHEAD_MM = 0.01  # a difference in place of the lens's derivative


@jit
def solve4(m, b, size):  # type: ignore[no-untyped-def]
    """Solves the symmetric m x = b in place (x in b) by Cholesky; returns the last unknown's variance, or -1 if m does
    not determine it."""
    for j in range(size):
        d = m[j, j]
        least = PIVOT_MIN * d
        for k in range(j):
            d -= m[j, k] * m[j, k]
        if not d > least:
            return -1.0
        d = math.sqrt(d)
        m[j, j] = d
        for i in range(j + 1, size):
            s = m[i, j]
            for k in range(j):
                s -= m[i, k] * m[j, k]
            m[i, j] = s / d
    for i in range(size):
        s = b[i]
        for k in range(i):
            s -= m[i, k] * b[k]
        b[i] = s / m[i, i]
    last = 1.0 / (m[size - 1, size - 1] * m[size - 1, size - 1])
    for i in range(size - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, size):
            s -= m[k, i] * b[k]
        b[i] = s / m[i, i]
    return last


@jit
def terms(shading, x, y, z, row):  # type: ignore[no-untyped-def]
    """The polynomial's terms at a place of the head's frame, into row (TERMS,). shading[0] : middle and half-length
    of the seen wall, mm along z; least cosine of what is seen to the camera's axis."""
    t = (z - shading[0, 0]) / shading[0, 1]
    rho = math.sqrt(x * x + y * y)
    c, s = x / rho, y / rho
    power = 1.0
    for k in range(DEGREE + 1):
        row[3 * k], row[3 * k + 1], row[3 * k + 2] = power, power * c, power * s
        power *= t


@jit
def shade(shading, x, y, z, row):  # type: ignore[no-untyped-def]
    """Gain of the light and of its modulation there. shading : (3, TERMS): extent, logarithm of gain, of modulation."""
    terms(shading, x, y, z, row)
    gain, depth = 0.0, 0.0
    for i in range(TERMS):
        gain += shading[1, i] * row[i]
        depth += shading[2, i] * row[i]
    return math.exp(gain), math.exp(depth)


@jit
def place(pose, x, y, z):  # type: ignore[no-untyped-def]
    """A world point in a frame (3, 4)."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


class HeadFrames(NamedTuple):
    """N frames of a head of several eyes, as the loops here and in `groove` take them."""

    images: Float32Array  # (N, H, W) coefficients of splines
    lens: FloatArray  # (N, 10) as `see` takes it
    cameras: FloatArray  # (N, 3, 4) world to camera
    heads: FloatArray  # (N, 3, 4) world to head
    eyes: FloatArray  # (N, 3) camera centres, world
    projectors: FloatArray  # (N, 3, 4) world to projector
    slide: FloatArray  # (N, S) as `wave` takes it
    drift: FloatArray  # (N,) t_n
    eye: IntArray  # (N,) whose frame each is


class HeadLight(NamedTuple):
    """What is known of a head's light and lens."""

    shading: FloatArray  # (E, 3, TERMS) by eye
    blur_squared: float  # px^2; 0: none is reckoned with
    drift_sigma: float  # what is believed of g, 0: none
    noise: FloatArray  # (3,) variance of a grey level I is noise . (1, I, I^2)


class BorePoints(NamedTuple):
    """P points of the wall."""

    base: FloatArray  # (P, 3)
    path: FloatArray  # (P, 3) outwards
    texture: FloatArray  # (P,) slope of the albedo along the pipe over itself, 1 / mm
    start: FloatArray  # (P,) height that is begun with


@jit
def look_around(frames, points, normal, grey, phase, slope, pull, seen):  # type: ignore[no-untyped-def]
    """(P, 3) points of a wall that stands across normal (P, 3), in every frame of `HeadFrames`: grey level, phase, its
    slope along the frame's ray per mm of height, and q, each written (N, P), and where the points stand in the head's
    frame, (N, P, 3); NaN where not seen."""
    images, lens, cameras, heads = frames.images, frames.lens, frames.cameras, frames.heads
    eyes, projectors, slide = frames.eyes, frames.projectors, frames.slide
    for k in range(len(cameras)):
        for p in range(len(points)):
            x, y, z = points[p, 0], points[p, 1], points[p, 2]
            cx, cy, cz = place(cameras[k], x, y, z)
            u, v = see(lens[k], cx, cy, cz)
            grey[k, p] = sample(images, k, u, v)
            seen[k, p, 0], seen[k, p, 1], seen[k, p, 2] = place(heads[k], x, y, z)
            ux, vx = see(
                lens[k],
                cx + AHEAD_MM * cameras[k, 0, 2],
                cy + AHEAD_MM * cameras[k, 1, 2],
                cz + AHEAD_MM * cameras[k, 2, 2],
            )
            px, py, pz = place(projectors[k], x, y, z)
            dx, dy, dz = x - eyes[k, 0], y - eyes[k, 1], z - eyes[k, 2]
            scaled = 1.0 / (dx * normal[p, 0] + dy * normal[p, 1] + dz * normal[p, 2])
            dx, dy, dz = dx * scaled, dy * scaled, dz * scaled
            phase[k, p], slope[k, p] = phase_and_slope(
                slide[k],
                px,
                py,
                pz,
                projectors[k, 0, 0] * dx + projectors[k, 0, 1] * dy + projectors[k, 0, 2] * dz,
                projectors[k, 1, 0] * dx + projectors[k, 1, 1] * dy + projectors[k, 1, 2] * dz,
                projectors[k, 2, 0] * dx + projectors[k, 2, 1] * dy + projectors[k, 2, 2] * dz,
            )
            along = phase_and_slope(
                slide[k], px, py, pz, projectors[k, 0, 2], projectors[k, 1, 2], projectors[k, 2, 2]
            )[1]
            pull[k, p] = along * AHEAD_MM * AHEAD_MM / ((ux - u) ** 2 + (vx - v) ** 2)


@jit
def follow_wall(frames, light, points, tolerance, outcome, who):  # type: ignore[no-untyped-def]
    """Every wall point's height outwards, in a pipe's light (module docstring): `HeadFrames`, `HeadLight` and
    `BorePoints` in, `track.Outcome` out.

    tolerance : of the height, where rounds end. who : (P,) written: the eye whose frames told it, the number of eyes
    where several did, -1 where none.

    A height is begun by one eye alone, for two on either side of a lamp see its light move in opposite ways.
    """
    images, lens, cameras, heads = frames.images, frames.lens, frames.cameras, frames.heads
    eyes, projectors, slide = frames.eyes, frames.projectors, frames.slide
    drift, eye = frames.drift, frames.eye
    shading, blur_squared, drift_sigma, noise = light.shading, light.blur_squared, light.drift_sigma, light.noise
    base, path, texture, start = points.base, points.path, points.texture, points.start
    height, sigma, dc, ac = outcome.height, outcome.sigma, outcome.dc, outcome.ac
    misfit, used, flag = outcome.misfit, outcome.used, outcome.flag
    count, eye_count = len(cameras), len(shading)
    seen, bend_of, low, high = (
        np.empty(eye_count, np.int64),
        np.empty(eye_count),
        np.empty(eye_count),
        np.empty(eye_count),
    )
    value, phase, slope, weight = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    crest, change, sine, gain = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    wide = np.zeros(count)
    m, b, row, powers = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(TERMS)
    size = 4 if drift_sigma > 0.0 else 3
    for p in range(len(base)):
        h, level, swing, tilt = start[p], 0.0, 0.0, 0.0
        state, variance, scale, free, n = UNSETTLED, -1.0, 1.0, 1, 0
        for turn in range(ROUNDS_MAX):
            n, bend = 0, 0.0
            seen[:], bend_of[:], low[:], high[:] = 0, 0.0, math.inf, -math.inf
            x, y, z = base[p, 0] + h * path[p, 0], base[p, 1] + h * path[p, 1], base[p, 2] + h * path[p, 2]
            for k in range(count):
                value[k] = math.nan
                cx, cy, cz = place(cameras[k], x, y, z)
                edge = shading[eye[k], 0, 2]
                if cz * abs(cz) < edge * abs(edge) * (cx * cx + cy * cy + cz * cz):
                    continue
                u, v = see(lens[k], cx, cy, cz)
                grey = sample(images, k, u, v)
                if not math.isfinite(grey):
                    continue
                hx, hy, hz = place(heads[k], x, y, z)
                level_there, depth = shade(shading[eye[k]], hx, hy, hz, powers)
                dx, dy, dz = x - eyes[k, 0], y - eyes[k, 1], z - eyes[k, 2]
                scaled = 1.0 / (dx * path[p, 0] + dy * path[p, 1] + dz * path[p, 2])
                dx, dy, dz = dx * scaled, dy * scaled, dz * scaled
                px, py, pz = place(projectors[k], x, y, z)
                phase[k], slope[k] = phase_and_slope(
                    slide[k],
                    px,
                    py,
                    pz,
                    projectors[k, 0, 0] * dx + projectors[k, 0, 1] * dy + projectors[k, 0, 2] * dz,
                    projectors[k, 1, 0] * dx + projectors[k, 1, 1] * dy + projectors[k, 1, 2] * dz,
                    projectors[k, 2, 0] * dx + projectors[k, 2, 1] * dy + projectors[k, 2, 2] * dz,
                )
                if blur_squared > 0.0:
                    if turn == 0:  # a height changes it little
                        ux, vx = see(
                            lens[k],
                            cx + AHEAD_MM * cameras[k, 0, 2],
                            cy + AHEAD_MM * cameras[k, 1, 2],
                            cz + AHEAD_MM * cameras[k, 2, 2],
                        )
                        wide[k] = blur_squared * AHEAD_MM * AHEAD_MM / ((ux - u) ** 2 + (vx - v) ** 2)
                    along = phase_and_slope(
                        slide[k], px, py, pz, projectors[k, 0, 2], projectors[k, 1, 2], projectors[k, 2, 2]
                    )[1]
                    phase[k] += texture[p] * along * wide[k]
                value[k], gain[k] = grey, level_there
                crest[k], change[k], sine[k] = wave(slide[k], phase[k])
                crest[k] *= depth
                change[k] *= depth
                sine[k] *= depth
                weight[k] = 1.0 / (noise[0] + max(grey, 0.0) * (noise[1] + max(grey, 0.0) * noise[2]))
                bend += abs(slope[k])
                e = eye[k]
                bend_of[e] += slope[k]
                low[e], high[e] = min(low[e], phase[k]), max(high[e], phase[k])
                seen[e] += 1
                n += 1
            first = 0
            for e in range(eye_count):
                if seen[e] >= 3 and not (seen[first] >= 3 and high[first] - low[first] >= high[e] - low[e]):
                    first = e
            if seen[first] < 3:
                state = TOO_FEW
                break
            if high[first] - low[first] < SPAN_LEAST:
                state = UNDETERMINED
                break
            bend /= n
            m[:] = 0.0
            b[:] = 0.0
            if turn == 0:
                # Eq. 6.11: I = V1 + V2 cos phase - V3 sin phase; harmonics are small beside half a period
                for k in range(count):
                    if eye[k] == first and math.isfinite(value[k]):
                        row[0], row[1], row[2] = gain[k], gain[k] * crest[k], -gain[k] * sine[k]
                        for i in range(3):
                            b[i] += weight[k] * row[i] * value[k]
                            for j in range(i + 1):
                                m[i, j] += weight[k] * row[i] * row[j]
                if solve4(m, b, 3) < 0.0:  # Eq. 6.13
                    state = UNDETERMINED
                    break
                level, swing = b[0], math.hypot(b[1], b[2])
                h += math.atan2(b[2], b[1]) * seen[first] / bend_of[first]  # Eq. 6.14
                continue
            total, cost, robust = 0.0, 0.0, n >= ROBUST_FROM and turn > 1
            free = n - size
            for k in range(count):
                if not math.isfinite(value[k]):
                    continue
                over = gain[k] * (1.0 + tilt * drift[k])
                bright = level + swing * crest[k]
                off = value[k] - bright * over
                w = weight[k]
                if robust:
                    far = off * off * w / (scale * TUKEY_SQUARED)
                    w = w * (1.0 - far) ** 2 if far < 1.0 else 0.0
                total += w * off * off
                cost += min(off * off * weight[k], TUKEY_SQUARED)
                row[0], row[1], row[size - 1] = over, crest[k] * over, swing * change[k] * slope[k] * over
                if size == 4:
                    row[2] = bright * drift[k] * gain[k]
                for i in range(size):
                    b[i] += w * row[i] * off
                    for j in range(i + 1):
                        m[i, j] += w * row[i] * row[j]
            if size == 4:
                m[2, 2] += 1.0 / (drift_sigma * drift_sigma)
                b[2] -= tilt / (drift_sigma * drift_sigma)
                free = max(n - 3, 1)
            scale = max(total / free, 1.0) if free > 0 else 1.0
            ac_information = m[1, 1]
            variance = solve4(m, b, size)
            if variance < 0.0:
                state = UNDETERMINED
                break
            level += b[0]
            swing += b[1]
            if size == 4:
                tilt += b[2]
            step = b[size - 1]
            most = STEP_MAX_RAD / bend
            h += min(max(step, -most), most)
            misfit[p] = cost
            if abs(step) < tolerance and turn > 1:
                modulated = swing > 0.0 and swing * swing * ac_information > MODULATED * MODULATED
                state = GOOD if modulated and swing < FULL_MOST * level else UNMODULATED
                break
        height[p], dc[p], ac[p], used[p], flag[p] = h, level, swing, n, state
        who[p] = -1
        for e in range(eye_count):
            if seen[e] > 0:
                who[p] = e if who[p] < 0 else eye_count
        sigma[p] = math.sqrt(variance * scale) if variance > 0.0 else math.nan
        if state != GOOD:
            height[p], sigma[p] = math.nan, math.nan
