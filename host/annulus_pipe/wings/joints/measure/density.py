"""The wall's density relative to plain wall, with what the machine adds taken out.

What grey says besides density: each slice's own air level (scatter: an offset that falls as plastic in the slice grows,
and differs a little round it), hardening of the beam towards the middle of the wall, brightness along y, drift along z,
rings. All but the first are told from plain wall only, at every angle and depth a line along z and over all one slow
curve: the joint has no part in it, so it is not shrunk.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.jit import jit

DRIFT_ORDER = 4  # of the slow curve along z; noise of a whole plane is a thousandth
AIR_ROUND_DEG = 10.0  # standard deviation of what the air level is smoothed with round the pipe
WILD = 4.0  # sigma at which a plain voxel is no part of the background
ROUNDS = 2


@jit
def wall_samples(block, rho, inner, outer, out):  # type: ignore[no-untyped-def]
    """out[plane, phi, depth]: grey at evenly spaced depths, centres of equal parts of the wall from inner to outer."""
    step, n, parts = rho[1] - rho[0], len(rho), out.shape[2]
    for p in range(block.shape[0]):
        for j in range(block.shape[1]):
            for u in range(parts):
                r = inner[p, j] + (u + 0.5) / parts * (outer[p, j] - inner[p, j])
                s = min(max((r - rho[0]) / step, 0.0), n - 1.001)
                k = int(s)
                out[p, j, u] = block[p, j, k] + (s - k) * (block[p, j, k + 1] - block[p, j, k])


def air_level(air: FloatArray, plain: BoolArray) -> FloatArray:
    """(Z, P) how far each place's air lies over that of plain planes, smoothed. air : (Z, P) grey of the bore."""
    sigma = AIR_ROUND_DEG / 360 * air.shape[1]
    smooth = gaussian_filter1d(np.nan_to_num(air, nan=float(np.nanmean(air))), sigma, axis=1, mode="wrap")
    return np.asarray(smooth - np.median(smooth[plain], axis=0))


@jit
def _background(block, z, plain, spread, base, slope):  # type: ignore[no-untyped-def]
    """base, slope [phi, depth]: a robust line along z through the plain planes of block[z, phi, depth]."""
    count = len(z)
    for j in range(block.shape[1]):
        for u in range(block.shape[2]):
            a, b = 0.0, 0.0
            for turn in range(3):
                n, t, tt, v, tv = 0.0, 0.0, 0.0, 0.0, 0.0
                for p in range(count):
                    if not plain[p]:
                        continue
                    value = block[p, j, u]
                    if turn > 0 and abs(value - a - b * z[p]) > spread:
                        continue
                    n += 1
                    t += z[p]
                    tt += z[p] * z[p]
                    v += value
                    tv += value * z[p]
                det = n * tt - t * t
                if n < 4 or det <= 0:
                    continue
                a, b = (tt * v - t * tv) / det, (n * tv - t * v) / det
            base[j, u], slope[j, u] = a, b


@jit
def _relative(block, z, base, slope):  # type: ignore[no-untyped-def]
    for p in range(block.shape[0]):
        for j in range(block.shape[1]):
            for u in range(block.shape[2]):
                block[p, j, u] = block[p, j, u] / (base[j, u] + slope[j, u] * z[p]) - 1.0


def relative_density(
    block: Float32Array, air: FloatArray, air_grey: float, z_mm: FloatArray, plain: BoolArray, joint_mm: float
) -> None:
    """In place: grey of the wall (Z, P, U) becomes density over plain wall's, less one.

    air : (Z, P) from `air_level`; air_grey : the grey of air in plain planes.
    """
    z = z_mm - joint_mm
    block -= (air_grey + air).astype(np.float32)[:, :, None]
    whole = block.mean(axis=(1, 2), dtype=np.float64)
    scale = max(float(np.abs(z).max()), 1e-6)
    curve = np.polynomial.polynomial.polyfit(z[plain] / scale, whole[plain] / whole[plain].mean(), DRIFT_ORDER)
    curve[1] = 0.0  # slopes are taken out place by place
    block /= np.polynomial.polynomial.polyval(z / scale, curve).astype(np.float32)[:, None, None]
    few = block[plain][::4]
    spread = WILD * 1.4826 * float(np.median(np.abs(few - np.median(few, axis=0))))
    base, slope = np.empty(block.shape[1:]), np.empty(block.shape[1:])
    _background(block, z, plain, spread, base, slope)
    _relative(block, z, base, slope)


def density_map(relative: Float32Array, start: float, stop: float, left_out: BoolArray) -> FloatArray:
    """(Z, P) mean over depths start to stop, parts of the wall; voxels `left_out` (same shape) are passed over."""
    parts = relative.shape[2]
    low, high = round(start * parts), max(round(stop * parts), round(start * parts) + 1)
    kept, weight = relative[:, :, low:high], ~left_out[:, :, low:high]
    count = weight.sum(axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, (kept * weight).sum(axis=2, dtype=np.float64) / count, np.nan)
