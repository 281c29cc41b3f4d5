"""The heat-affected zone: how wide, how far less dense, by angle.

Two edges: along z the density falls from a line of plain wall to a floor and comes back, each edge blurred alike (an
error function). Columns round an angle are averaged first, for one alone is all noise. Fitted robustly, so that a gap
in the fusion plane, which is narrow, is no floor. Sigma is the fit's own, times what plain wall beside it really
differs by, neighbouring planes being alike.

Beads shade: the scatter of their plastic lowers wall and air alike, and hardening lowers the wall more, by how much
plastic their slice has besides the wall. What the air shows is taken out before (`density`); how much of the second is
in the wall is fitted here, one number for the volume: the rolls' shape, with its valley, tells it from the zone. How
well it does is a part of every width's and depth's sigma, alike at all angles.
"""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import ndimage, optimize, special
from annulus_pipe.numeric.robust import robust_sigma

ROUND_DEG = 6.0  # standard deviation of what columns are averaged with round the pipe
EVERY_DEG = 3.0  # an angle is fitted: half of that deviation loses nothing
BESIDE = 0.9  # of the wall's thickness: plain wall fitted with the zone, on either side of the beads
SHADE_MAX = 1.0  # of the shade that is handed in, which is the most there may be
RIM_MAX = 1.0  # of the drop
TOLD = 3.0  # sigma: a shallower zone is not told from plain wall


@dataclass(frozen=True, slots=True)
class Zone:
    """By angle, each (P,), NaN where no zone is told: width, its sigma and centre along z, mm; depth, part of one."""

    width: FloatArray
    width_sigma: FloatArray
    centre: FloatArray
    drop: FloatArray
    drop_sigma: FloatArray


@dataclass(frozen=True, slots=True)
class Shape:
    """What all angles share: each depth's width over the mean, the rim's height over the drop, the shade's part."""

    flare: FloatArray  # (B,) about 1
    rim: float
    share: float
    share_sigma: float = 0.0


def _model(p: FloatArray, z: FloatArray, shape: Shape) -> tuple[FloatArray, FloatArray]:
    """(T,) model and (T, 6) slopes. p: low edge, high edge, log of the edges' blur, drop, level, slope."""
    blur, middle, half = math.exp(p[2]), 0.5 * (p[0] + p[1]), 0.5 * (p[1] - p[0])
    a = (z[:, None] - middle + half * shape.flare) / blur
    b = (z[:, None] - middle - half * shape.flare) / blur
    bell_a, bell_b = (np.exp(-0.5 * t * t) / math.sqrt(2 * math.pi) for t in (a, b))
    # What lies within, less a rim on each edge: a bell as wide as the blur and `rim` high.
    rim = shape.rim * math.sqrt(2 * math.pi)
    inside = np.mean(
        0.5 * (special.erf(a / math.sqrt(2)) - special.erf(b / math.sqrt(2))) - rim * (bell_a + bell_b), axis=1
    )
    by_a, by_b = bell_a * (1 + rim * a), -bell_b * (1 - rim * b)
    low, high = 0.5 * (1 + shape.flare), 0.5 * (1 - shape.flare)
    d_low = -np.mean(by_a * low + by_b * high, axis=1) / blur
    d_high = -np.mean(by_a * high + by_b * low, axis=1) / blur
    d_blur = -np.mean(by_a * a + by_b * b, axis=1)
    return p[4] + p[5] * z - p[3] * inside, np.stack(
        [-p[3] * d_low, -p[3] * d_high, -p[3] * d_blur, -inside, np.ones_like(z), z], axis=1
    )


def _shape_of(bands: FloatArray, dark: FloatArray, t: FloatArray, start: FloatArray, noise: float) -> Shape:
    """From the bands' means round the pipe, (B, T): each its own width, all else in common."""
    count = len(bands)

    def model(q: FloatArray) -> FloatArray:
        rows = []
        for k in range(count):
            one = Shape(np.ones(1), q[5], 0.0)
            p = np.array([q[0] - 0.5 * q[7 + k], q[0] + 0.5 * q[7 + k], q[1], q[2], q[3], q[4]])
            rows.append(_model(p, t, one)[0] + q[6] * dark)
        return np.asarray((np.stack(rows) - bands) / noise).ravel()

    wide = start[1] - start[0]
    q = np.concatenate([[0.5 * (start[0] + start[1]), start[2], start[3], 0.0, 0.0, 0.0, 0.0], np.full(count, wide)])
    low = np.concatenate([[t[0], start[2] - 2, -1, -1, -1, 0.0, -SHADE_MAX], np.full(count, 0.3 * wide)])
    high = np.concatenate([[t[-1], start[2] + 2, 1, 1, 1, RIM_MAX, SHADE_MAX], np.full(count, 3 * wide)])
    q[5] = 0.01
    scale = np.concatenate([[1, 0.5, 0.01, 0.01, 0.001, 0.1, 1], np.ones(count)])
    done = optimize.least_squares(model, q, bounds=(low, high), loss="cauchy", f_scale=2.5, x_scale=scale, max_nfev=100)
    q = done.x
    spread = _spread(model(q).reshape(bands.shape))
    share_sigma = spread * math.sqrt(max(float(np.linalg.pinv(done.jac.T @ done.jac)[6, 6]), 0.0))
    return Shape(q[7:] / q[7:].mean(), float(q[5]), float(q[6]), share_sigma)


def _spread(residual: FloatArray) -> float:
    """Standard deviation of residuals along the last axis, enlarged by how alike neighbours are: they share voxels."""
    alike = float(np.sum(residual[..., 1:] * residual[..., :-1]) / max(np.sum(residual**2), 1e-20))
    return robust_sigma(residual) * math.sqrt((1 + max(alike, 0)) / max(1 - max(alike, 0), 0.1))


def zone_of(
    density: FloatArray,
    bands: FloatArray | None,
    shade: FloatArray,
    z_mm: FloatArray,
    centre_mm: FloatArray,
    beads: tuple[float, float],
    wall_mm: float,
    voxel_mm: float,
) -> tuple[Zone, float]:
    """The zone at every angle, and how much of `shade` the density has.

    density : (Z, P) relative to plain wall, less one; NaN where not known. bands : (Z, P, B) the same at B depths;
    without them an edge has no flare, no rim and no shade. shade : (Z, P) the most that beads may shade, in the
    same unit. centre_mm : (P,) where the fusion plane is believed; columns are brought to it before they are
    averaged. beads : where along z they begin and end.
    """
    count = density.shape[1]
    reach = 0.5 * (beads[1] - beads[0]) + BESIDE * wall_mm
    step = abs(z_mm[1] - z_mm[0])
    reach = min(reach, float(np.min(centre_mm)) - z_mm[0], z_mm[-1] - float(np.max(centre_mm)))
    t = np.arange(-int(reach / step), int(reach / step) + 1) * step
    mean, dark = _brought(density, z_mm, centre_mm, t), _brought(shade, z_mm, centre_mm, t)
    fitted = np.arange(0, count, max(1, round(EVERY_DEG / 360 * count)))
    found = np.full((5, len(fitted)), np.nan)
    half = 0.25 * (beads[1] - beads[0])
    # Where to begin: the mean of all angles has the zone plainest.
    start = np.array([-half, half, math.log(max(voxel_mm, 0.2)), 0.01, 0.0, 0.0])
    low = np.array([t[0], t[0], math.log(0.3 * voxel_mm), -1, -1, -1])
    high = np.array([t[-1], t[-1], math.log(max(6 * voxel_mm, 0.3 * wall_mm)), 1, 1, 1])
    noise = max(robust_sigma(np.diff(mean, axis=0)) / math.sqrt(2), 1e-5)
    plainest = np.median(mean, axis=1)
    start = _fit(start, t, plainest, Shape(np.ones(1), 0.0, 0.0), noise, low, high)
    shape = Shape(np.ones(1), 0.0, 0.0)
    if bands is not None and start[1] - start[0] > 2 * voxel_mm and start[3] > 0:
        turned = np.stack([np.median(_brought(band, z_mm, centre_mm, t), axis=1) for band in np.moveaxis(bands, 2, 0)])
        least = max(robust_sigma(np.diff(turned, axis=1)) / math.sqrt(2), 1e-5)
        shape = _shape_of(turned, np.median(dark, axis=1), t, start, least)
    mean = mean - shape.share * dark
    by_shade = _by_shade(np.median(mean, axis=1), np.median(dark, axis=1), t, start, shape, noise, low, high)
    for i, j in enumerate(fitted):
        p = _fit(start, t, mean[:, j], shape, noise, low, high)
        model, jac = _model(p, t, shape)
        residual = mean[:, j] - model
        covariance = np.linalg.pinv(jac.T @ jac) * _spread(residual) ** 2
        drop_sigma = math.hypot(math.sqrt(max(covariance[3, 3], 0)), by_shade[1])
        if p[3] < TOLD * drop_sigma or p[1] - p[0] < voxel_mm:
            continue
        variance = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
        width_sigma = math.hypot(math.sqrt(max(variance, 0)), by_shade[0])
        found[:, i] = p[1] - p[0], width_sigma, 0.5 * (p[0] + p[1]) + centre_mm[j], p[3], drop_sigma
    return Zone(*(_round_again(row, fitted, count) for row in found)), shape.share


def _by_shade(
    mean: FloatArray,
    dark: FloatArray,
    t: FloatArray,
    start: FloatArray,
    shape: Shape,
    noise: float,
    low: FloatArray,
    high: FloatArray,
) -> tuple[float, float]:
    """What the shade's sigma makes of a width, mm, and of a drop: alike at all angles."""
    more, less = (_fit(start, t, mean + way * shape.share_sigma * dark, shape, noise, low, high) for way in (1.0, -1.0))
    return 0.5 * abs(float(more[1] - more[0] - less[1] + less[0])), 0.5 * abs(float(more[3] - less[3]))


def _brought(values: FloatArray, z_mm: FloatArray, centre_mm: FloatArray, t: FloatArray) -> FloatArray:
    """(T, P) of (Z, P): at distances t from each angle's plane, averaged round the pipe; what is NaN has no weight."""
    value, weight = np.zeros((len(t), values.shape[1])), np.zeros((len(t), values.shape[1]))
    for j in range(values.shape[1]):
        good = np.isfinite(values[:, j])
        if good.sum() > 3:
            value[:, j] = np.interp(t + centre_mm[j], z_mm[good], values[good, j])
            weight[:, j] = np.interp(t + centre_mm[j], z_mm, good.astype(float)) + 1e-3
    sigma = ROUND_DEG / 360 * values.shape[1]
    total = ndimage.gaussian_filter1d(weight, sigma, axis=1, mode="wrap")
    return np.asarray(ndimage.gaussian_filter1d(value * weight, sigma, axis=1, mode="wrap") / np.maximum(total, 1e-9))


def _fit(
    start: FloatArray, t: FloatArray, value: FloatArray, shape: Shape, noise: float, low: FloatArray, high: FloatArray
) -> FloatArray:
    done = optimize.least_squares(
        lambda p: (_model(p, t, shape)[0] - value) / noise,
        np.clip(start, low + 1e-9, high - 1e-9),
        lambda p: _model(p, t, shape)[1] / noise,
        bounds=(low, high),
        loss="cauchy",
        f_scale=2.5,
        max_nfev=60,
        x_scale=np.array([1.0, 1.0, 0.5, 0.01, 0.01, 0.001]),
    )
    return np.asarray(done.x)


def _round_again(row: FloatArray, at: np.ndarray, count: int) -> FloatArray:
    """Fitted angles to all, a full turn; an angle next to an unfitted one stays unknown."""
    return np.asarray(np.interp(np.arange(count), np.append(at, count), np.append(row, row[0])))
