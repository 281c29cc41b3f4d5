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
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.jit import cos_sin, jit
from annulus_pipe.wings.fringe.measure.projector import phase_and_slope, rings, stripes, wave

GOOD, TOO_FEW, UNMODULATED, UNDETERMINED, UNSETTLED, AMBIGUOUS = range(6)
ROUNDS_MAX = 12
ROBUST_FROM = 6  # frames: fewer cannot outvote one that is wrong
TUKEY_SQUARED = 4.685**2
STEP_MAX_RAD = 1.0  # of one Gauss-Newton step: its tangent is good for about a radian
EXCESS = 3.0  # sigma of chi^2: more misfit than that is no chance, and makes the height's sigma larger
MODULATED = 4.0  # sigma of AC: below it phase is noise (its sigma a quarter of a radian, no longer normal)
BLOCK = 64  # points
PIVOT_MIN = 1e-7  # of a diagonal element: rounding of float32 images


@jit
def pinhole(fx, fy, cx, cy, k1, k2, p1, p2, k3, x, y, z):  # type: ignore[no-untyped-def]
    """Pixel of a point in the camera's frame, OpenCV's coefficients; NaN behind it."""
    over = 1.0 / z if z > 0.0 else math.nan
    u, v = x * over, y * over
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        fx * (u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)) + cx,
        fy * (v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v) + cy,
    )


@jit
def see(lens, x, y, z):  # type: ignore[no-untyped-def]
    """Pixel of a point in the camera's frame; NaN behind a pinhole. lens: kind (0 pinhole, 1 fisheye), fx, fy, cx, cy,
    and OpenCV's k1 k2 p1 p2 k3, or k1..k4."""
    if lens[0] == 0.0:
        return pinhole(lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7], lens[8], lens[9], x, y, z)
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
    n, row, i0, step = np.uint64(k), np.uint64(j - 1), np.uint64(i - 1), np.uint64(1)  # signed ones ask each time: < 0?
    i1, i2, i3 = i0 + step, i0 + step + step, i0 + step + step + step
    total = np.float32(0.0)
    for weight in (b0, b1, b2, b3):
        across = a0 * images[n, row, i0] + a1 * images[n, row, i1] + a2 * images[n, row, i2] + a3 * images[n, row, i3]
        total += weight * across
        row += step
    return np.float64(total)


@jit
def see_row(lens, camera, x, y, z, count, u, v):  # type: ignore[no-untyped-def]
    """`see` of the first `count` world points by a camera (3, 4). Scalars out of arrays first: it vectorises."""
    r00, r01, r02, tx = camera[0, 0], camera[0, 1], camera[0, 2], camera[0, 3]
    r10, r11, r12, ty = camera[1, 0], camera[1, 1], camera[1, 2], camera[1, 3]
    r20, r21, r22, tz = camera[2, 0], camera[2, 1], camera[2, 2], camera[2, 3]
    if lens[0] == 0.0:
        fx, fy, cx, cy, k1, k2 = lens[1], lens[2], lens[3], lens[4], lens[5], lens[6]
        p1, p2, k3 = lens[7], lens[8], lens[9]
        for i in range(count):
            u[i], v[i] = pinhole(
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                p1,
                p2,
                k3,
                r00 * x[i] + r01 * y[i] + r02 * z[i] + tx,
                r10 * x[i] + r11 * y[i] + r12 * z[i] + ty,
                r20 * x[i] + r21 * y[i] + r22 * z[i] + tz,
            )
        return
    for i in range(count):
        u[i], v[i] = see(
            lens,
            r00 * x[i] + r01 * y[i] + r02 * z[i] + tx,
            r10 * x[i] + r11 * y[i] + r12 * z[i] + ty,
            r20 * x[i] + r21 * y[i] + r22 * z[i] + tz,
        )


@jit
def light_row(slide, projector, eye, x, y, z, count, scale, phase):  # type: ignore[no-untyped-def]
    """Phase of the first `count` world points, and in `scale` its change along the eye's ray: on entry the inverse of
    the ray's way along the normal. The ray in the projector's frame is the point less the eye, both in it."""
    r00, r01, r02, tx = projector[0, 0], projector[0, 1], projector[0, 2], projector[0, 3]
    r10, r11, r12, ty = projector[1, 0], projector[1, 1], projector[1, 2], projector[1, 3]
    r20, r21, r22, tz = projector[2, 0], projector[2, 1], projector[2, 2], projector[2, 3]
    ex = r00 * eye[0] + r01 * eye[1] + r02 * eye[2] + tx
    ey = r10 * eye[0] + r11 * eye[1] + r12 * eye[2] + ty
    ez = r20 * eye[0] + r21 * eye[1] + r22 * eye[2] + tz
    a, b, phase0 = slide[1], slide[2], slide[3]
    if slide[0] == 0.0:
        for i in range(count):
            qx = r00 * x[i] + r01 * y[i] + r02 * z[i] + tx
            qy = r10 * x[i] + r11 * y[i] + r12 * z[i] + ty
            qz = r20 * x[i] + r21 * y[i] + r22 * z[i] + tz
            radians, slope = stripes(a, b, phase0, qx, qy, qz, qx - ex, qy - ey, qz - ez)
            phase[i] = radians
            scale[i] *= slope
        return
    for i in range(count):
        qx = r00 * x[i] + r01 * y[i] + r02 * z[i] + tx
        qy = r10 * x[i] + r11 * y[i] + r12 * z[i] + ty
        qz = r20 * x[i] + r21 * y[i] + r22 * z[i] + tz
        radians, slope = rings(a, phase0, qx, qy, qz, qx - ex, qy - ey, qz - ez)
        phase[i] = radians
        scale[i] *= slope


@jit
def wave_row(slide, phase, count, crest, steep, sine):  # type: ignore[no-untyped-def]
    """`wave` of the first `count` phases."""
    if slide.size > 4:
        for i in range(count):
            crest[i], steep[i], sine[i] = wave(slide, phase[i])
        return
    for i in range(count):
        c, s = cos_sin(phase[i])
        crest[i] = c
        steep[i] = -s
        sine[i] = s


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
def solve3(a, b, c, d, e, f, x, y, z, least_a, least_c, least_f):  # type: ignore[no-untyped-def]
    """Solves the symmetric [[a b d] [b c e] [d e f]] by (x, y, z); the solution and the last unknown's variance, which
    is -1 if a pivot is below its least: the matrix does not determine them."""
    if not a > least_a:
        return 0.0, 0.0, 0.0, -1.0
    over_a = 1.0 / a
    l10, l20 = b * over_a, d * over_a
    c -= l10 * b
    if not c > least_c:
        return 0.0, 0.0, 0.0, -1.0
    over_c = 1.0 / c
    e -= l20 * b
    l21 = e * over_c
    f -= l20 * d + l21 * e
    if not f > least_f:
        return 0.0, 0.0, 0.0, -1.0
    variance = 1.0 / f
    y -= l10 * x
    z = (z - l20 * x - l21 * y) * variance
    y = y * over_c - l21 * z
    return x * over_a - l10 * y - l20 * z, y, z, variance


@jit
def lit_along(slide, projector, x, y, z, way):  # type: ignore[no-untyped-def]
    """`phase_and_slope` of a world point and a way from it."""
    return phase_and_slope(
        slide,
        projector[0, 0] * x + projector[0, 1] * y + projector[0, 2] * z + projector[0, 3],
        projector[1, 0] * x + projector[1, 1] * y + projector[1, 2] * z + projector[1, 3],
        projector[2, 0] * x + projector[2, 1] * y + projector[2, 2] * z + projector[2, 3],
        projector[0, 0] * way[0] + projector[0, 1] * way[1] + projector[0, 2] * way[2],
        projector[1, 0] * way[0] + projector[1, 1] * way[1] + projector[1, 2] * way[2],
        projector[2, 0] * way[0] + projector[2, 1] * way[1] + projector[2, 2] * way[2],
    )


class TrackFrames(NamedTuple):
    """N frames of one eye, as `follow` takes them."""

    images: Float32Array  # (N, H, W) coefficients of splines, or (0, 0, 0) where there are samples
    samples: FloatArray  # (N, P) grey levels where the pixels are the points' own, or (0, 0)
    lens: FloatArray  # as `see` takes it
    cameras: FloatArray  # (N, 3, 4) world to camera
    eyes: FloatArray  # (N, 3) camera centres, world
    projectors: FloatArray  # (N, 3, 4) world to projector
    slide: FloatArray  # as `wave` takes it
    drift: FloatArray  # (N,) t_n


class Tracks(NamedTuple):
    """P points, each somewhere on its own line: X(h) = base + h * path."""

    base: FloatArray  # (P, 3)
    path: FloatArray  # (P, 3), or (1, 3) for all
    normal: FloatArray  # (P, 3), or (1, 3) for all; path . normal = 1
    start: FloatArray  # (P,) h that is begun with


class Outcome(NamedTuple):
    """What is written, all (P,)."""

    height: FloatArray  # mm, NaN unless the flag is GOOD
    sigma: FloatArray  # mm, likewise
    dc: FloatArray
    ac: FloatArray
    misfit: FloatArray  # chi^2, each frame's share at most Tukey's
    used: FloatArray  # frames
    flag: FloatArray  # GOOD, or why there is no height

    @staticmethod
    def of(count: int) -> "Outcome":
        return Outcome(*(np.full(count, np.nan) for _ in range(7)))


@jit
def follow(frames, tracks, drift_sigma, noise, tolerance, outcome, residual):  # type: ignore[no-untyped-def]
    """Every point's height: `TrackFrames` and `Tracks` in, `Outcome` out.

    drift_sigma : what is believed of g, 0 for none. noise : (3,) variance of a grey level I is noise . (1, I, I^2).
    tolerance : of h, where rounds end. residual : (N, P) grey levels, written, or (0, 0).
    """
    images, samples, lens, cameras = frames.images, frames.samples, frames.lens, frames.cameras
    eyes, projectors, slide, drift = frames.eyes, frames.projectors, frames.slide, frames.drift
    base, path, normal, start = tracks.base, tracks.path, tracks.normal, tracks.start
    height, sigma, dc, ac = outcome.height, outcome.sigma, outcome.dc, outcome.ac
    misfit, used, flag = outcome.misfit, outcome.used, outcome.flag
    tracked, count = samples.size == 0, len(cameras)
    # a block of points at a time: rows over points vectorise, and what a round needs stays in the nearest cache
    value, weight, slope = np.empty((count, BLOCK)), np.empty((count, BLOCK)), np.empty((count, BLOCK))
    crest, steep, sine = np.empty((count, BLOCK)), np.empty((count, BLOCK)), np.empty((count, BLOCK))
    x, y, z, u, v = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    nx, ny, nz, out = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    which, h = np.empty(BLOCK, np.int64), np.empty(BLOCK)
    level, swing, tilt, scale = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    own_path, own_normal = int(len(path) > 1), int(len(normal) > 1)
    drifting, keep = drift_sigma > 0.0, residual.size > 0
    stiff = 1.0 / (drift_sigma * drift_sigma) if drifting else 0.0
    for first in range(0, len(base), BLOCK):
        live = min(BLOCK, len(base) - first)
        for i in range(live):
            which[i], h[i], level[i], swing[i], tilt[i], scale[i] = first + i, start[first + i], 0.0, 0.0, 0.0, 1.0
        for turn in range(ROUNDS_MAX):
            for i in range(live):
                p, q, r = which[i], which[i] * own_path, which[i] * own_normal
                x[i], y[i] = base[p, 0] + h[i] * path[q, 0], base[p, 1] + h[i] * path[q, 1]
                z[i] = base[p, 2] + h[i] * path[q, 2]
                nx[i], ny[i], nz[i] = normal[r, 0], normal[r, 1], normal[r, 2]
                out[i] = x[i] * nx[i] + y[i] * ny[i] + z[i] * nz[i]
            for k in range(count):
                if tracked:
                    see_row(lens, cameras[k], x, y, z, live, u, v)
                    for i in range(live):
                        value[k, i] = sample(images, k, u[i], v[i])
                    ex, ey, ez, bent = eyes[k, 0], eyes[k, 1], eyes[k, 2], slope[k]
                    for i in range(live):
                        bent[i] = 1.0 / (out[i] - ex * nx[i] - ey * ny[i] - ez * nz[i])
                    light_row(slide, projectors[k], eyes[k], x, y, z, live, slope[k], u)
                else:
                    for i in range(live):
                        p = which[i]
                        value[k, i] = samples[k, p]
                        u[i], slope[k, i] = lit_along(slide, projectors[k], x[i], y[i], z[i], path[p * own_path])
                wave_row(slide, u, live, crest[k], steep[k], sine[k])
                for i in range(live):
                    grey = max(value[k, i], 0.0)
                    weight[k, i] = 1.0 / (noise[0] + grey * (noise[1] + grey * noise[2]))
            left = 0
            for i in range(live):
                p, n, bend = which[i], 0, 0.0
                m00 = m10 = m11 = m20 = m21 = m22 = b0 = b1 = b2 = 0.0
                state, variance = UNSETTLED, -1.0
                if turn == 0:
                    # Eq. 6.11: I = V1 + V2 cos phase - V3 sin phase; harmonics are small beside half a period
                    for k in range(count):
                        grey, w, c = value[k, i], weight[k, i], crest[k, i]
                        if math.isfinite(grey):
                            wc, ws = w * c, w * sine[k, i]
                            m00 += w
                            m10 += wc
                            m11 += wc * c
                            m20 -= ws
                            m21 -= ws * c
                            m22 += ws * sine[k, i]
                            b0 += w * grey
                            b1 += wc * grey
                            b2 -= ws * grey
                            bend += slope[k, i]
                            n += 1
                    b0, b1, b2, variance = solve3(  # Eq. 6.13
                        m00, m10, m11, m20, m21, m22, b0, b1, b2, PIVOT_MIN * m00, PIVOT_MIN * m11, PIVOT_MIN * m22
                    )
                    if n < 3 or variance < 0.0:
                        state = TOO_FEW if n < 3 else UNDETERMINED
                    else:
                        level[i], swing[i] = b0, math.sqrt(b1 * b1 + b2 * b2)
                        h[i] += math.atan2(b2, b1) * n / bend  # Eq. 6.14: the phase that is left, as a height
                else:
                    robust, total, cost = turn > 2, 0.0, 0.0
                    t0, t1, t2, t3, bt = 0.0, 0.0, 0.0, stiff, -tilt[i] * stiff
                    if robust:
                        for k in range(count):
                            n += math.isfinite(value[k, i])
                        robust, n = n >= ROBUST_FROM, 0
                    for k in range(count):
                        if not math.isfinite(value[k, i]):
                            continue
                        gain = 1.0 + tilt[i] * drift[k]
                        lit = level[i] + swing[i] * crest[k, i]
                        off = value[k, i] - lit * gain
                        w = weight[k, i]
                        cost += min(off * off * w, TUKEY_SQUARED)
                        if robust:
                            far = off * off * w / (scale[i] * TUKEY_SQUARED)
                            w = w * (1.0 - far) ** 2 if far < 1.0 else 0.0
                        total += w * off * off
                        # the height stands last: its variance is then what the elimination leaves
                        r1, r2 = crest[k, i] * gain, swing[i] * steep[k, i] * slope[k, i] * gain
                        w0, w1, w2 = w * gain, w * r1, w * r2
                        m00 += w0 * gain
                        m10 += w1 * gain
                        m11 += w1 * r1
                        m20 += w2 * gain
                        m21 += w2 * r1
                        m22 += w2 * r2
                        b0 += w0 * off
                        b1 += w1 * off
                        b2 += w2 * off
                        bend += slope[k, i]
                        n += 1
                        if drifting:
                            r3 = lit * drift[k]
                            t0 += w0 * r3
                            t1 += w1 * r3
                            t2 += w2 * r3
                            t3 += w * r3 * r3
                            bt += w * r3 * off
                    free = max(n - 3, 1) if drifting else n - 3
                    scale[i] = total / free if free > 0 and total > free + EXCESS * math.sqrt(2.0 * free) else 1.0
                    pivot, least0, least1, least2 = m11, PIVOT_MIN * m00, PIVOT_MIN * m11, PIVOT_MIN * m22
                    if drifting:  # the light's drift is eliminated first: what is believed of it keeps its pivot
                        q = 1.0 / t3
                        m00, m10, m11 = m00 - t0 * t0 * q, m10 - t1 * t0 * q, m11 - t1 * t1 * q
                        m20, m21, m22 = m20 - t2 * t0 * q, m21 - t2 * t1 * q, m22 - t2 * t2 * q
                        b0, b1, b2 = b0 - t0 * bt * q, b1 - t1 * bt * q, b2 - t2 * bt * q
                    b0, b1, step, variance = solve3(m00, m10, m11, m20, m21, m22, b0, b1, b2, least0, least1, least2)
                    if n < 3 or variance < 0.0:
                        state = TOO_FEW if n < 3 else UNDETERMINED
                    else:
                        level[i] += b0
                        swing[i] += b1
                        if drifting:
                            tilt[i] += (bt - t0 * b0 - t1 * b1 - t2 * step) / t3
                        most = STEP_MAX_RAD * n / abs(bend)
                        h[i] += min(max(step, -most), most)
                        misfit[p] = cost
                        if abs(step) < tolerance:
                            modulated = swing[i] > 0.0 and swing[i] * swing[i] * pivot > MODULATED * MODULATED
                            state = GOOD if modulated else UNMODULATED
                if state == UNSETTLED and turn + 1 < ROUNDS_MAX:  # on to the next round, closed up
                    which[left], h[left], level[left] = p, h[i], level[i]
                    swing[left], tilt[left], scale[left] = swing[i], tilt[i], scale[i]
                    left += 1
                    continue
                height[p], sigma[p] = math.nan, math.nan
                dc[p], ac[p], used[p], flag[p] = level[i], swing[i], n, state
                if state == GOOD:
                    height[p], sigma[p] = h[i], math.sqrt(variance * scale[i])
                if keep:
                    for k in range(count):
                        residual[k, p] = math.nan
                        if state == GOOD and math.isfinite(value[k, i]):
                            predicted = (level[i] + swing[i] * crest[k, i]) * (1.0 + tilt[i] * drift[k])
                            residual[k, p] = value[k, i] - predicted
            live = left
            if live == 0:
                break
