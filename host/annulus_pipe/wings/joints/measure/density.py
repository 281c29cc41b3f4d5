"""The wall's density relative to plain wall, with what the machine adds taken out.

What grey says besides density: each slice's own air level (scatter: an offset that falls as plastic in the slice grows,
and differs a little round it), hardening of the beam towards the middle of the wall, brightness along y, drift along z,
rings. All but the first are told from plain wall only, at every angle and depth a line along z and over all one slow
curve: the joint has no part in it, so it is not shrunk.
"""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.native import door

DRIFT_ORDER = 4  # of the slow curve along z; noise of a whole plane is a thousandth
AIR_ROUND_DEG = 10.0  # standard deviation of what the air level is smoothed with round the pipe
WILD = 4.0  # sigma at which a plain voxel is no part of the background

_wall = door("joints_wall", "f4[p,j,n] block", "f8[n] rho", "f8[p,j] inner", "f8[p,j] outer", "f4[p,j,u]! out")
_background = door(
    "joints_background", "f4[p,j,u] block", "f8[p] z", "b1[p] plain", "f8 spread", "f8[j,u]! base", "f8[j,u]! slope"
)
_relative = door("joints_relative", "f4[p,j,u]! block", "f8[p] z", "f8[j,u] base", "f8[j,u] slope")


def wall_samples(
    block: Float32Array, rho: FloatArray, inner: FloatArray, outer: FloatArray, depths: int
) -> Float32Array:
    """(Z, P, depths) grey in the middles of equal parts of the wall from inner to outer (Z, P). block : (Z, P, R)."""
    out = np.empty((*block.shape[:2], depths), np.float32)
    _wall(block, rho, inner, outer, out)
    return out


def air_level(air: FloatArray, plain: BoolArray) -> FloatArray:
    """(Z, P) how far each place's air lies over that of plain planes, smoothed. air : (Z, P) grey of the bore."""
    sigma = AIR_ROUND_DEG / 360 * air.shape[1]
    smooth = ndimage.gaussian_filter1d(np.nan_to_num(air, nan=float(np.nanmean(air))), sigma, axis=1, mode="wrap")
    return np.asarray(smooth - np.median(smooth[plain], axis=0))


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
