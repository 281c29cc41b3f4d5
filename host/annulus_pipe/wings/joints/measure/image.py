"""A joint from its CT volume: surfaces, beads, density map, zone, flaws. The one door of the room's first half."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.density import air_level, density_map, relative_density, wall_samples
from annulus_pipe.wings.joints.measure.find import FoundJoint, find
from annulus_pipe.wings.joints.measure.flaws import Flaw, flaws_of
from annulus_pipe.wings.joints.measure.greys import LEVEL, densities
from annulus_pipe.wings.joints.measure.surface import (
    SMOOTH_MM,
    Bead,
    Sides,
    bead_of,
    edges,
    noise_along,
    plain_planes,
    sides_of,
    smooth_round,
)
from annulus_pipe.wings.joints.measure.unwrap import Volume, planes
from annulus_pipe.wings.joints.measure.zone import Zone, zone_of

Progress = Callable[[str, int, int], None]
ANGLES_MIN, ANGLES_MAX = 360, 1440
NOTCH_BLUR = 0.1  # of a voxel: a groove's floor is seen so much too high or too low
# Of how high the rolls stand beside a cusp, two planes off: what lies under the floor that is seen. Drawn joints of
# five pipes and voxels: 0.15 to 0.55, the median of each.
NOTCH_CUSP = 0.3
HILO_LEFT = 0.15  # of the hi-lo: rms of what its step leaves in T (drawn joints with 0.4 and 0.8 mm of it)
UNEVEN = 0.025  # of a voxel: rings and strips leave a surface so far off in every slice
# Of a wall's density, in a slice with twice the plastic: paths of 80 mm at 60 kV without a filter.
HARDENED = 0.1
BANDS = 5  # of depth, in which the zone's flare is seen
BEAD_MAX = 1.0  # of the wall: no bead stands higher
BORE = (0.6, 1.3)  # of the wall: from the inner surface inwards, where the bore's air is taken ..
CLEAR_OF_BEAD = 0.2  # .. and not so near to the bead inside, which is plastic and no air


@dataclass(frozen=True, slots=True)
class Parts:
    """What of the wall the density map is the mean over: the middle `inner_mm` of `of_mm`, as a part of any wall."""

    inner_mm: float = 4.0
    of_mm: float = 5.6

    def __post_init__(self) -> None:
        if not 0 < self.inner_mm <= self.of_mm:
            raise AnnulusError(f"inner {self.inner_mm:g} mm of a wall of {self.of_mm:g} mm: expected a part of it")


@dataclass(frozen=True, slots=True, eq=False)
class JointImage:
    """All that a volume says of its joint. Lengths in mm, z along the axis, angles from the volume's x to its y."""

    found: FoundJoint
    phi: FloatArray  # (P,) rad
    z_mm: FloatArray  # (Z,)
    outer: FloatArray  # (Z, P) surface, bead included
    inner: FloatArray  # (Z, P)
    density: FloatArray  # (Z, P) relative to plain wall
    plain: BoolArray  # (Z,)
    outer_sides: Sides
    inner_sides: Sides
    bead_out: Bead
    bead_in: Bead
    fusion_mm: FloatArray  # (P,) the fusion plane
    zone: Zone
    flaws: list[Flaw]

    @property
    def wall_mm(self) -> FloatArray:
        """(P,) of plain wall, mean of both sides."""
        return np.asarray(np.mean(self.outer_sides.at_mm - self.inner_sides.at_mm, axis=0))

    @property
    def thickness_mm(self) -> FloatArray:
        """(P,) T: from notch to notch."""
        return self.wall_mm + self.bead_out.notch + self.bead_in.notch

    @property
    def thickness_sigma_mm(self) -> FloatArray:
        """(P,) of T: each surface's noise, smoothed as it was, a notch's blur and step, which no smoothing takes, and
        how much deeper floors may lie that are finer than a voxel."""
        blur = math.sqrt(2) * NOTCH_BLUR * min(self.z_mm[1] - self.z_mm[0], self.found.wall_mm)
        step = HILO_LEFT * 0.5 * (self.outer_sides.hilo_mm + self.inner_sides.hilo_mm)
        finer = NOTCH_CUSP * (self.bead_out.cusp + self.bead_in.cusp)
        return np.hypot(np.hypot(math.hypot(self._noise(self.outer), self._noise(self.inner), blur), step), finer)

    def _noise(self, surface: FloatArray) -> float:
        smooth = smooth_round(np.nan_to_num(surface[self.plain]), _sigma_phi(self.found.radius_mm, len(self.phi)))
        return noise_along(smooth)

    @property
    def crest_mm(self) -> FloatArray:
        """(P,) from crest to crest."""
        return self.wall_mm + self.bead_out.height + self.bead_in.height


def _sigma_phi(radius_mm: float, angles: int) -> float:
    return SMOOTH_MM / (2 * math.pi * radius_mm / angles)


def image(volume: Volume, parts: Parts = Parts(), progress: Progress = lambda what, done, total: None) -> JointImage:
    """Volume to maps and features, in two passes over its slices.

    Raises AnnulusError where there is no whole hollow cylinder in it, no bead, or no plain wall beside it.
    """
    if volume.shape[0] < 16 or min(volume.shape[1:]) < 32:
        raise AnnulusError(f"a volume of {' x '.join(map(str, volume.shape))} voxels: expected at least 16 x 32 x 32")
    volume = densities(volume)
    found = find(volume, progress)
    axis, wall = found.axis, found.wall_mm
    voxel = float(np.prod(volume.voxel_mm) ** (1 / 3))
    across, down, along = axis.frame()
    lean = math.hypot(across[2], down[2])
    top = found.radius_mm + BEAD_MAX * wall
    dz = volume.voxel_mm[0]
    length = (volume.shape[0] - 1) * dz
    ends = (found.radius_mm + 0.3 * wall) * lean
    z_mm: FloatArray = np.arange(ends / along[2], (length - ends) / along[2], dz)
    if len(z_mm) < 16:
        raise AnnulusError(f"{length:.1f} mm of a pipe that leans by {axis.lean_deg:.1f} degrees: too short")
    count = int(np.clip(4 * round(math.pi * found.radius_mm / (2 * voxel)), ANGLES_MIN, ANGLES_MAX))
    phi: FloatArray = np.arange(count, dtype=np.float64) * (2 * math.pi / count)
    step = 0.5 * min(volume.voxel_mm[1:])
    bottom = found.radius_mm - (1 + BORE[1]) * wall
    rho: FloatArray = np.arange(max(bottom, 2 * step), top, step)
    surface = [np.empty((len(z_mm), count)) for _ in range(2)]
    air = np.empty((len(z_mm), count))
    bore = rho < max(found.radius_mm - (1 + BORE[0]) * wall, rho[0] + 2 * step)
    for start, block in planes(volume, axis, z_mm, phi, rho):
        stop = start + len(block)
        surface[0][start:stop], surface[1][start:stop] = edges(block, rho, LEVEL)
        open_bore = bore & (rho < np.nan_to_num(surface[1][start:stop], nan=np.inf)[:, :, None] - CLEAR_OF_BEAD * wall)
        air[start:stop] = np.where(open_bore, block, 0.0).sum(axis=2) / np.maximum(open_bore.sum(axis=2), 1)
        air[start:stop][~open_bore.any(axis=2)] = np.nan
        progress("surfaces", stop, len(z_mm))
    outer, inner = surface
    plain, beads = plain_planes(outer, inner, z_mm, found.joint_mm, wall, voxel)
    joint = 0.5 * (beads[0] + beads[1])
    sigma = _sigma_phi(found.radius_mm, count)
    sides_out, sides_in = (sides_of(s, z_mm, plain, joint, sigma, UNEVEN * voxel) for s in surface)
    both = ((outer, sides_out, 1), (inner, sides_in, -1))
    bead_out, bead_in = (bead_over(*one, z_mm, beads, voxel, sigma=sigma) for one in both)
    # The floor of a notch between unequal sides is lowest on the lower one, outside and inside on different ones: their
    # middle is the fusion plane, and only without its step there do both notches say how thick the joint is.
    fusion = fusion_plane(bead_out, bead_in, joint)
    bead_out, bead_in = (bead_over(*one, z_mm, beads, voxel, fusion, sigma) for one in both)
    relative, inner_wall, outer_wall = _wall(volume, found, z_mm, phi, rho, sides_in, sides_out, voxel, progress)
    shade, air_grey = air_level(air, plain), float(np.nanmean(air[plain]))
    relative_density(relative, shade, air_grey, z_mm, plain, joint)
    progress("zone and flaws", 1, 3)
    flaws, mask = flaws_of(relative, z_mm, inner_wall, outer_wall, fusion, voxel)
    progress("zone and flaws", 2, 3)
    skin = 0.5 * (1 - parts.inner_mm / parts.of_mm)
    depths = np.linspace(skin, 1 - skin, BANDS + 1)
    sound = density_map(relative, skin, 1 - skin, mask)
    bands = np.stack([density_map(relative, a, b, mask) for a, b in pairwise(depths)], axis=2)
    hardened = hardening(outer, inner, plain)
    zone, share = zone_of(sound, bands, hardened, z_mm, fusion, beads, wall, voxel)
    density = 1 + density_map(relative, skin, 1 - skin, np.zeros_like(mask)) - share * hardened
    progress("zone and flaws", 3, 3)
    return JointImage(
        found, phi, z_mm, outer, inner, density, plain, sides_out, sides_in, bead_out, bead_in, fusion, zone, flaws
    )


def hardening(outer: FloatArray, inner: FloatArray, plain: BoolArray) -> FloatArray:
    """(Z, P) the most by which beads harden the beam that passes the wall: a part of the plastic that they add."""
    wall = np.nan_to_num(outer - inner)
    added = wall.mean(axis=1) / float(np.median(wall[plain].mean(axis=1))) - 1
    return np.repeat(np.where(plain, 0.0, -HARDENED * added)[:, None], wall.shape[1], axis=1)


def bead_over(
    surface: FloatArray,
    sides: Sides,
    sign: int,
    z_mm: FloatArray,
    span: tuple[float, float],
    voxel: float,
    fusion: FloatArray | None = None,
    sigma: float = 0.0,
) -> Bead:
    """The bead on a surface (Z, P), sign 1 outside and -1 inside; its sides' step taken out if the plane is known."""
    half = 0.5 * sign * sides.hilo_mm
    plain, offset = sides.middle(z_mm), np.stack([-half, half])
    if fusion is not None:
        plain, offset = sides.stepped(z_mm, fusion), np.zeros_like(offset)
    over = smooth_round(np.nan_to_num(sign * (surface - plain)), sigma)
    return bead_of(over, offset, z_mm, span, max(1.5 * voxel, 0.3))


def fusion_plane(outside: Bead, inside: Bead, joint: float) -> FloatArray:
    """(P,) the fusion plane along z: mean of both notches; a plane's first order of angle where they are not seen."""
    both = np.stack([outside.notch_z, inside.notch_z])
    seen = np.isfinite(both).any(axis=0)
    count = both.shape[1]
    phi = np.arange(count) * 2 * math.pi / count
    terms = np.stack([np.ones(count), np.cos(phi), np.sin(phi)])
    if seen.sum() < 0.3 * count:
        return np.full(count, joint)
    value = np.nansum(both, axis=0) / np.maximum(np.isfinite(both).sum(axis=0), 1)
    weight = seen.astype(float)
    for _ in range(6):
        fit = np.linalg.solve((terms * weight) @ terms.T, (terms * weight) @ value)
        residual = value - fit @ terms
        scale = 1.4826 * float(np.median(np.abs(residual[seen]))) + 1e-6
        weight = seen * np.where(np.abs(residual) < 4.7 * scale, (1 - (residual / (4.7 * scale)) ** 2) ** 2, 0.0)
    return np.asarray(fit @ terms)


def _wall(
    volume: Volume,
    found: FoundJoint,
    z_mm: FloatArray,
    phi: FloatArray,
    rho: FloatArray,
    inner: Sides,
    outer: Sides,
    voxel: float,
    progress: Progress,
) -> tuple[NDArray[np.float32], FloatArray, FloatArray]:
    """Grey of the wall between its plain surfaces, (Z, P, U), and these, (Z, P)."""
    low, high = inner.along(z_mm), outer.along(z_mm)
    depth = max(8, math.ceil(found.wall_mm / voxel))
    wall = np.empty((len(z_mm), len(phi), depth), np.float32)
    for start, block in planes(volume, found.axis, z_mm, phi, rho):
        stop = start + len(block)
        wall[start:stop] = wall_samples(block, rho, low[start:stop], high[start:stop], depth)
        progress("wall", stop, len(z_mm))
    return wall, low, high
