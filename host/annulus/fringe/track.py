"""The loop over points: what the frames say along a point's own track through the images.

A point X(h) = base + h * path is carried past the head. In frame n it is seen at one pixel and lit at one phase of the
slide, both following from h, so both move while h is sought:

    I_n = (A + B w(phase_n(h))) (1 + g t_n)           A: DC, B: AC of the point, g: its light's drift along the track

First the source's linear least squares (Eq. 6.9 to 6.14) on the point's own phases: it knows no local minimum within
half a period. Then Gauss-Newton in A, B, h and g, weighted by the noise a grey level has. The step in h is judged
along each frame's ray: a wrong h samples the wall beside the point, and the phase found there is the phase of that
place. The wall there is taken to stand across `normal`, which costs rounds where it does not, and no accuracy: at the
end the samples are the point's own.
"""

import math

import numpy as np

from annulus.fringe.projector import phase_and_slope, wave
from annulus.numeric.jit import jit

GOOD, TOO_FEW, UNMODULATED, UNDETERMINED, UNSETTLED, AMBIGUOUS = range(6)
ROUNDS_MAX = 12
ROBUST_FROM = 6  # frames: fewer cannot outvote one that is wrong
TUKEY_SQUARED = 4.685**2
STEP_MAX_RAD = 1.0  # of one Gauss-Newton step: its tangent is good for about a radian
EXCESS = 3.0  # sigma of chi^2: more misfit than that is no chance, and makes the height's sigma larger
MODULATED = 4.0  # sigma of AC: below it phase is noise (its sigma a quarter of a radian, no longer normal)
PIVOT_MIN = 1e-7  # of a diagonal element: rounding of float32 images


@jit
def see(lens, x, y, z):  # type: ignore[no-untyped-def]
    """Pixel of a point in the camera's frame; NaN behind a pinhole. lens: kind (0 pinhole, 1 fisheye), fx, fy, cx, cy,
    and OpenCV's k1 k2 p1 p2 k3, or k1..k4."""
    if lens[0] == 0.0:
        if z <= 0.0:
            return math.nan, math.nan
        u, v = x / z, y / z
        r2 = u * u + v * v
        radial = 1.0 + r2 * (lens[5] + r2 * (lens[6] + r2 * lens[9]))
        p, q = lens[7], lens[8]
        return (
            lens[1] * (u * radial + 2.0 * p * u * v + q * (r2 + 2.0 * u * u)) + lens[3],
            lens[2] * (v * radial + p * (r2 + 2.0 * v * v) + 2.0 * q * u * v) + lens[4],
        )
    rho = math.sqrt(x * x + y * y)
    theta = math.atan2(rho, z)
    t2 = theta * theta
    scale = theta * (1.0 + t2 * (lens[5] + t2 * (lens[6] + t2 * (lens[7] + t2 * lens[8])))) / max(rho, 1e-12)
    return lens[1] * scale * x + lens[3], lens[2] * scale * y + lens[4]


@jit
def sample(images, k, u, v):  # type: ignore[no-untyped-def]
    """Cubic B-spline from its 4 x 4 coefficients; NaN outside, and beside one that is NaN."""
    height, width = images.shape[1], images.shape[2]
    if not (u >= 1.0 and v >= 1.0 and u < width - 2 and v < height - 2):
        return math.nan
    i, j = int(u), int(v)
    a, b = np.float32(u - i), np.float32(v - j)
    one, two, four, six = np.float32(1.0), np.float32(2.0), np.float32(4.0), np.float32(1.0 / 6.0)
    three = np.float32(3.0)
    a3, b3 = six * a * a * a, six * b * b * b
    a0, b0 = six * (one - a) * (one - a) * (one - a), six * (one - b) * (one - b) * (one - b)
    a1, b1 = six * (four + three * a * a * (a - two)), six * (four + three * b * b * (b - two))
    a2, b2 = one - a0 - a1 - a3, one - b0 - b1 - b3
    total = np.float32(0.0)
    for r in range(4):
        across = a0 * images[k, j + r - 1, i - 1] + a1 * images[k, j + r - 1, i]
        across += a2 * images[k, j + r - 1, i + 1] + a3 * images[k, j + r - 1, i + 2]
        total += (b0 if r == 0 else b1 if r == 1 else b2 if r == 2 else b3) * across
    return np.float64(total)


@jit
def look(lens, camera, points, u, v):  # type: ignore[no-untyped-def]
    """`see` of (P, 3) world points by a camera (3, 4), into u and v."""
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        u[p], v[p] = see(
            lens,
            camera[0, 0] * x + camera[0, 1] * y + camera[0, 2] * z + camera[0, 3],
            camera[1, 0] * x + camera[1, 1] * y + camera[1, 2] * z + camera[1, 3],
            camera[2, 0] * x + camera[2, 1] * y + camera[2, 2] * z + camera[2, 3],
        )


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
def follow(  # type: ignore[no-untyped-def]
    images, samples, lens, cameras, eyes, projectors, slide, drift, drift_sigma, noise, base, path, normal, start,
    tolerance, height, sigma, dc, ac, misfit, used, flag, residual,
):  # fmt: skip
    """Every point's height, from its `start`.

    images : (N, H, W) float32, coefficients of splines. samples : (N, P) float64 in their place, or (0, 0).
    lens : as `see` takes it. cameras, projectors : (N, 3, 4) world to camera and to projector in each frame.
    eyes : (N, 3) camera centres, world. slide : as `wave` takes it. drift : (N,) t_n; drift_sigma: what is believed of
    g, 0 for none. noise : (3,) variance of a grey level I is noise . (1, I, I^2).
    base, path : (P, 3). normal : (P, 3), path . normal = 1. start : (P,). tolerance : of h, where rounds end.
    Written: height, sigma (mm), dc, ac, misfit (chi^2, each frame's share at most Tukey's), used (frames), flag : (P,);
    residual : (N, P) grey levels, or (0, 0).
    """
    tracked, frames = samples.size == 0, len(cameras)
    value, phase, slope, weight = np.empty(frames), np.empty(frames), np.empty(frames), np.empty(frames)
    crest, change, sine = np.empty(frames), np.empty(frames), np.empty(frames)
    m, b, row = np.empty((4, 4)), np.empty(4), np.empty(4)
    size = 4 if drift_sigma > 0.0 else 3
    keep = residual.size > 0
    for p in range(len(base)):
        h, level, swing, tilt = start[p], 0.0, 0.0, 0.0
        state, variance, scale, free, n = UNSETTLED, -1.0, 1.0, 1, 0
        for turn in range(ROUNDS_MAX):
            n, bend = 0, 0.0
            x, y, z = base[p, 0] + h * path[p, 0], base[p, 1] + h * path[p, 1], base[p, 2] + h * path[p, 2]
            for k in range(frames):
                value[k] = math.nan
                if tracked:
                    u, v = see(
                        lens,
                        cameras[k, 0, 0] * x + cameras[k, 0, 1] * y + cameras[k, 0, 2] * z + cameras[k, 0, 3],
                        cameras[k, 1, 0] * x + cameras[k, 1, 1] * y + cameras[k, 1, 2] * z + cameras[k, 1, 3],
                        cameras[k, 2, 0] * x + cameras[k, 2, 1] * y + cameras[k, 2, 2] * z + cameras[k, 2, 3],
                    )
                    grey = sample(images, k, u, v)
                else:
                    grey = samples[k, p]
                if not math.isfinite(grey):
                    continue
                dx, dy, dz = path[p, 0], path[p, 1], path[p, 2]
                if tracked:
                    dx, dy, dz = x - eyes[k, 0], y - eyes[k, 1], z - eyes[k, 2]
                    scaled = 1.0 / (dx * normal[p, 0] + dy * normal[p, 1] + dz * normal[p, 2])
                    dx, dy, dz = dx * scaled, dy * scaled, dz * scaled
                phase[k], slope[k] = phase_and_slope(
                    slide,
                    projectors[k, 0, 0] * x + projectors[k, 0, 1] * y + projectors[k, 0, 2] * z + projectors[k, 0, 3],
                    projectors[k, 1, 0] * x + projectors[k, 1, 1] * y + projectors[k, 1, 2] * z + projectors[k, 1, 3],
                    projectors[k, 2, 0] * x + projectors[k, 2, 1] * y + projectors[k, 2, 2] * z + projectors[k, 2, 3],
                    projectors[k, 0, 0] * dx + projectors[k, 0, 1] * dy + projectors[k, 0, 2] * dz,
                    projectors[k, 1, 0] * dx + projectors[k, 1, 1] * dy + projectors[k, 1, 2] * dz,
                    projectors[k, 2, 0] * dx + projectors[k, 2, 1] * dy + projectors[k, 2, 2] * dz,
                )
                value[k] = grey
                crest[k], change[k], sine[k] = wave(slide, phase[k])
                weight[k] = 1.0 / (noise[0] + max(grey, 0.0) * (noise[1] + max(grey, 0.0) * noise[2]))
                bend += slope[k]
                n += 1
            if n < 3:
                state = TOO_FEW
                break
            bend /= n
            m[:] = 0.0
            b[:] = 0.0
            if turn == 0:  # I = V1 + V2 cos phase - V3 sin phase; the sine's harmonics are small beside half a period
                for k in range(frames):
                    if math.isfinite(value[k]):
                        row[0], row[1], row[2] = 1.0, crest[k], -sine[k]
                        for i in range(3):
                            b[i] += weight[k] * row[i] * value[k]
                            for j in range(i + 1):
                                m[i, j] += weight[k] * row[i] * row[j]
                if solve4(m, b, 3) < 0.0:
                    state = UNDETERMINED
                    break
                level, swing = b[0], math.hypot(b[1], b[2])
                step = math.atan2(b[2], b[1]) / bend
                h += step
                continue
            total, cost, robust = 0.0, 0.0, n >= ROBUST_FROM and turn > 2
            free = n - size
            for k in range(frames):
                if not math.isfinite(value[k]):
                    continue
                gain = 1.0 + tilt * drift[k]
                lit = level + swing * crest[k]
                off = value[k] - lit * gain
                w = weight[k]
                if robust:
                    far = off * off * w / (scale * TUKEY_SQUARED)
                    w = w * (1.0 - far) ** 2 if far < 1.0 else 0.0
                total += w * off * off
                cost += min(off * off * weight[k], TUKEY_SQUARED)
                # the height stands last: its variance is then what the elimination leaves
                row[0], row[1], row[size - 1] = gain, crest[k] * gain, swing * change[k] * slope[k] * gain
                if size == 4:
                    row[2] = lit * drift[k]
                for i in range(size):
                    b[i] += w * row[i] * off
                    for j in range(i + 1):
                        m[i, j] += w * row[i] * row[j]
            if size == 4:
                m[2, 2] += 1.0 / (drift_sigma * drift_sigma)
                b[2] -= tilt / (drift_sigma * drift_sigma)
                free = max(n - 3, 1)
            scale = total / free if free > 0 and total > free + EXCESS * math.sqrt(2.0 * free) else 1.0
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
            most = STEP_MAX_RAD / abs(bend)
            h += min(max(step, -most), most)
            misfit[p] = cost
            if abs(step) < tolerance:
                modulated = swing > 0.0 and swing * swing * ac_information > MODULATED * MODULATED
                state = GOOD if modulated else UNMODULATED
                break
        height[p], dc[p], ac[p], used[p], flag[p] = h, level, swing, n, state
        sigma[p] = math.sqrt(variance * scale) if variance > 0.0 else math.nan
        if state != GOOD:
            height[p], sigma[p] = math.nan, math.nan
        if keep:
            for k in range(frames):
                residual[k, p] = math.nan
                if state == GOOD and math.isfinite(value[k]):
                    residual[k, p] = value[k] - (level + swing * crest[k]) * (1.0 + tilt * drift[k])
