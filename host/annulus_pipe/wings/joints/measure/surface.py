"""Both surfaces of the wall, and the beads on them.

A surface is where the grey crosses half way along a ray from the axis: the outermost place and the innermost. Each side
of the joint has its own plain surface, a line along z at every angle; carried on to the fusion plane the two give
hi-lo. What stands over them is bead. A bead is two rolls side by side, each near its foot and crest a half ellipse
standing on the wall: the square of its height is a parabola of z, whose zero is the foot (where the height itself has
a vertical flank that no voxel shows) and whose top is the crest. The valley between them is the notch.
"""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage, special
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import TUKEY, biweight, nan_median
from annulus_pipe.vocabulary import AnnulusError

FOOT = 0.25  # of the crest: below it a flank is blurred into the wall
SMOOTH_MM = 1.0  # along the circumference: standard deviation of the filter that smooths beads
STEP_BLUR = 0.7  # voxels along z: standard deviation of the blur that a step in a surface is seen with
SLOPE_ORDERS = 3  # Fourier orders of the angle in a side's slope along z
# Two planes from a notch's floor its rolls stand so many times as high as one plane from it, or more, where the floor
# is as wide as a voxel; less where the rolls meet in a cusp. Half ellipses and blurs of 0.4 to 0.8 voxels: 3.0 to 10,
# and 1.7 to 2.7.
FLOOR_RATIO, CUSP_RATIO = 3.0, 2.8
CLEAR = 0.35  # of the wall: so far from a bead's foot is the wall plain

_edges = door("joints_edges", "f4[p,j,n] block", "f8[n] rho", "f8 level", "f8[p,j]! outer", "f8[p,j]! inner")


def edges(block: Float32Array, rho: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """(Z, P) mm of the outermost and innermost crossing of `level` along rho, both; NaN where there is none."""
    outer, inner = np.empty(block.shape[:2]), np.empty(block.shape[:2])
    _edges(block, rho, level, outer, inner)
    return outer, inner


@dataclass(frozen=True, slots=True)
class Sides:
    """A surface of the two pipes: (2, P) mm at the joint, before and after it, and their slopes, mm a mm."""

    at_mm: FloatArray
    slope: FloatArray
    sigma_mm: FloatArray  # (2, P) of at_mm
    joint_mm: float

    def along(self, z_mm: FloatArray) -> FloatArray:
        """(Z, P) mm: each z on its own side."""
        side = (z_mm > self.joint_mm).astype(int)
        return np.asarray(self.at_mm[side] + self.slope[side] * (z_mm - self.joint_mm)[:, None])

    def middle(self, z_mm: FloatArray) -> FloatArray:
        """(Z, P) mm: halfway between both sides, each carried on."""
        away = (z_mm - self.joint_mm)[:, None]
        return np.asarray(0.5 * (self.at_mm.sum(axis=0) + self.slope.sum(axis=0) * away))

    def stepped(self, z_mm: FloatArray, fusion_mm: FloatArray) -> FloatArray:
        """(Z, P) mm: each side's own, from one to the other at the fusion plane (P,) as voxels see a step."""
        blur = STEP_BLUR * abs(z_mm[1] - z_mm[0])
        side = special.erf((z_mm[:, None] - fusion_mm) / (math.sqrt(2) * blur))  # -1 .. 1
        half = 0.5 * (self.hilo_mm + (self.slope[1] - self.slope[0]) * (z_mm - self.joint_mm)[:, None])
        return np.asarray(self.middle(z_mm) + side * half)

    @property
    def hilo_mm(self) -> FloatArray:
        """(P,) the second pipe's surface over the first's, mm."""
        return np.asarray(self.at_mm[1] - self.at_mm[0])


def smooth_round(values: FloatArray, sigma: float) -> FloatArray:
    """Gaussian along the last axis, a full turn."""
    return np.asarray(ndimage.gaussian_filter1d(values, sigma, axis=-1, mode="wrap")) if sigma > 0.05 else values


def plain_planes(
    outer: FloatArray, inner: FloatArray, z_mm: FloatArray, joint_mm: float, wall_mm: float, voxel_mm: float
) -> tuple[BoolArray, tuple[float, float]]:
    """(Z,) planes of plain wall only, and where beads begin and end along z, mm. `outer`, `inner` (Z, P), mm."""
    wall = outer - inner
    smooth = ndimage.uniform_filter1d(wall, max(3, wall.shape[1] // 90), axis=1, mode="wrap")
    thick = np.percentile(np.nan_to_num(smooth - nan_median(wall)), 95, axis=1)
    bead = thick > max(0.6 * voxel_mm, 0.03 * wall_mm)
    index = int(np.argmin(np.abs(z_mm - joint_mm)))
    near = np.flatnonzero(bead)
    if not len(near):
        raise AnnulusError("no joint in the volume: no bead stands over the wall")
    index = int(near[np.argmin(np.abs(near - index))])
    # Of one bead with a notch: planes without are bridged where they are fewer than a wall's thickness.
    bridge = int(wall_mm / abs(z_mm[1] - z_mm[0]))
    low = high = index
    while (more := near[(near < low) & (near >= low - bridge)]).size:
        low = int(more.min())
    while (more := near[(near > high) & (near <= high + bridge)]).size:
        high = int(more.max())
    clear = CLEAR * wall_mm
    plain = (z_mm < z_mm[low] - clear) | (z_mm > z_mm[high] + clear)
    if min((plain & (z_mm < joint_mm)).sum(), (plain & (z_mm > joint_mm)).sum()) < 6:
        raise AnnulusError(
            f"beads from {z_mm[low]:.1f} to {z_mm[high]:.1f} mm of {z_mm[0]:.1f} to {z_mm[-1]:.1f}: expected plain "
            "wall on both sides of the joint"
        )
    return plain, (float(z_mm[low]), float(z_mm[high]))


def sides_of(
    surface: FloatArray, z_mm: FloatArray, plain: BoolArray, joint_mm: float, sigma_phi: float, floor_mm: float = 0.0
) -> Sides:
    """The plain surface of each side as a line along z at every angle, robust. surface : (Z, P) mm.

    floor_mm : what a reconstruction's own unevenness, alike in all slices, puts under every sigma.
    """
    at, slope, sigma = (np.empty((2, surface.shape[1])) for _ in range(3))
    for side, here in enumerate((plain & (z_mm < joint_mm), plain & (z_mm > joint_mm))):
        value, t = smooth_round(_filled(surface[here]), sigma_phi), (z_mm[here] - joint_mm)[:, None]
        weight = np.ones_like(value)
        for _ in range(5):
            w, wt = weight.sum(axis=0), (weight * t).sum(axis=0)
            wtt, wv, wtv = (weight * t * t).sum(axis=0), (weight * value).sum(axis=0), (weight * t * value).sum(axis=0)
            det = np.maximum(w * wtt - wt * wt, 1e-12)
            at[side], slope[side] = (wtt * wv - wt * wtv) / det, (w * wtv - wt * wv) / det
            residual = value - at[side] - slope[side] * t
            scale = 1.4826 * np.median(np.abs(residual), axis=0)
            weight = biweight(residual / (TUKEY * np.maximum(scale, 1e-4)))
        # A pipe is straight but for its lean and a slow taper: of the slopes only their low orders of the angle are
        # its own, the rest is noise that the way to the joint would enlarge.
        orders = np.fft.rfft(slope[side])
        orders[SLOPE_ORDERS + 1 :] = 0
        slope[side] = np.fft.irfft(orders, slope.shape[1])
        w = weight.sum(axis=0)
        at[side] = (weight * (value - slope[side] * t)).sum(axis=0) / np.maximum(w, 1e-12)
        few = (2 * SLOPE_ORDERS + 1) / slope.shape[1]
        sigma[side] = floor_mm + scale * np.sqrt(1 / np.maximum(w, 1e-12) + few * wt**2 / np.maximum(w * det, 1e-12))
    return Sides(at, slope, sigma, joint_mm)


def noise_along(rows: FloatArray) -> float:
    """Of one place of a plain surface (Z, P), mm: from second differences along z, which no lean or taper is in."""
    return 1.4826 * float(np.nanmedian(np.abs(np.diff(rows, 2, axis=0) / math.sqrt(6))))


def _filled(rows: FloatArray) -> FloatArray:
    """NaN replaced by its column's median."""
    usual = nan_median(rows)
    return np.where(np.isfinite(rows), rows, np.where(np.isfinite(usual), usual, np.nanmedian(usual)))


@dataclass(frozen=True, slots=True)
class Bead:
    """One bead by angle, each (P,), mm: NaN where there is none. `notch_z` along the axis."""

    width: FloatArray
    height: FloatArray  # mean of the two rolls' crests over the plain wall
    notch: FloatArray  # height over the plain wall in the valley between the rolls
    notch_z: FloatArray
    cusp: FloatArray  # how high the rolls stand beside a notch whose floor no plane has to itself; 0 of a wide floor
    rolls: FloatArray  # (2, P) each roll's crest over the plain wall of its own side


def _roll(height: FloatArray, z_mm: FloatArray, foot_up: bool) -> tuple[float, float]:
    """(foot z, crest height) of a roll from its flank and crest, sampled from foot to valley or back."""
    peak = int(np.argmax(height))
    flank = np.arange(0, min(peak + 3, len(height))) if foot_up else np.arange(max(peak - 2, 0), len(height))
    flank = flank[height[flank] > FOOT * height[peak]]
    # Only what hangs together with the crest: noise beyond the foot is no flank.
    cut = np.flatnonzero(np.diff(flank) > 1)
    if len(cut):
        flank = flank[cut[-1] + 1 :] if foot_up else flank[: cut[0] + 1]
    if len(flank) < 4:
        return np.nan, float(height[peak])
    z0 = z_mm[peak]
    c, b, a = np.polynomial.polynomial.polyfit(z_mm[flank] - z0, height[flank] ** 2, 2)
    root = b * b - 4 * a * c
    if a >= 0 or root < 0:
        return np.nan, float(height[peak])
    foot = (-b + (1 if foot_up else -1) * np.sqrt(root)) / (2 * a)
    return float(z0 + foot), float(np.sqrt(max(c - b * b / (4 * a), 0.0)))


def _beside(column: FloatArray, index: int, planes: int) -> float:
    return 0.5 * float(column[max(index - planes, 0)] + column[min(index + planes, len(column) - 1)])


def bead_of(over: FloatArray, offset: FloatArray, z_mm: FloatArray, span: tuple[float, float], least_mm: float) -> Bead:
    """The bead that stands over the plain wall.

    over : (Z, P) height over the halfway surface of both sides, mm, away from the wall; offset : (2, P) how far each
    side's own plain surface stands over that; span : where along z to look; least_mm : less is no bead.
    """
    wide = 2.0 * least_mm + abs(z_mm[1] - z_mm[0])
    here = np.flatnonzero((z_mm >= span[0] - wide) & (z_mm <= span[1] + wide))
    z, count = z_mm[here], over.shape[1]
    width, height, notch, notch_z, cusp = (np.full(count, np.nan) for _ in range(5))
    rolls = np.full((2, count), np.nan)
    middle = 0.5 * (span[0] + span[1])
    for j in range(count):
        column = over[here, j]
        if not np.isfinite(column).all() or column.max() < least_mm:
            continue
        up = np.flatnonzero(column > 0.5 * column.max())
        # The valley: the lowest place between the two rolls, in the middle half of what is high.
        first, last = up[0], up[-1]
        inner = np.arange(first + (last - first) // 5 + 1, last - (last - first) // 5)
        if len(inner) < 3:
            continue
        valley = int(inner[np.argmin(column[inner] + 1e-3 * np.abs(z[inner] - middle))])
        valley = min(max(valley, 1), len(z) - 2)
        before, at, after = column[valley - 1 : valley + 2]
        bend = before - 2 * at + after
        shift = float(np.clip(0.5 * (before - after) / bend, -1, 1)) if bend > 1e-9 else 0.0
        notch_z[j] = z[valley] + shift * (z[1] - z[0])
        notch[j] = at - 0.25 * (before - after) * shift
        near, far = (_beside(column, valley, planes) - at for planes in (1, 2))
        sharp = (FLOOR_RATIO - far / max(near, 1e-9)) / (FLOOR_RATIO - CUSP_RATIO)
        cusp[j] = float(np.clip(sharp, 0.0, 1.0)) * max(far, 0.0)
        own = column - np.where(z > notch_z[j], offset[1, j], offset[0, j])
        left, crest_left = _roll(own[: valley + 1], z[: valley + 1], True)
        right, crest_right = _roll(own[valley:], z[valley:], False)
        width[j] = right - left
        rolls[:, j] = crest_left, crest_right
        height[j] = 0.5 * (crest_left + crest_right + offset[0, j] + offset[1, j])
    return Bead(width, height, notch, notch_z, cusp, rolls)
