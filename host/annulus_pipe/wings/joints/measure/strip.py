"""A dogbone's W and T from a CT volume of it alone: a strip of pipe, sawn out along the axis, its beads on.

Seen along the strip's own axes its two faces, which were the pipe's surfaces, are nearly planes; the mean over the
middle of its width is then a wall of one angle, and what `image` does at each angle is done once. The faces are the two
that the beads stand on, so a strip as wide as thick does as well. Its sides were sawn: air is beyond the faces and
beside them, and shading by the beads is told from there. Assumed: the strip lies along the volume's z within 10 degrees
and is held by less plastic than is in it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import stats
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.axis import VolumeAxis, fit_axis
from annulus_pipe.wings.joints.measure.density import air_level, density_map, relative_density, wall_samples
from annulus_pipe.wings.joints.measure.greys import LEVEL, densities
from annulus_pipe.wings.joints.measure.image import (
    BEAD_MAX,
    HILO_LEFT,
    NOTCH_BLUR,
    NOTCH_CUSP,
    UNEVEN,
    Parts,
    Progress,
    bead_over,
)
from annulus_pipe.wings.joints.measure.surface import edges, noise_along, plain_planes, sides_of
from annulus_pipe.wings.joints.measure.unwrap import Volume, sampled
from annulus_pipe.wings.joints.measure.zone import zone_of

LEAN_MAX_DEG = 10.0
MIDDLE = 0.5  # of the width: nearer to its sides a sawn face is torn and blurred
LOOKS = 64
PLAIN = 0.04  # of the thickness: a slice that is thicker by more has a bead in it
TURNS_DEG = np.arange(0.0, 90.0, 0.5)  # a section's box is tried at
PLANES_AT_ONCE = 16
AIR = (0.15, 0.4)  # of the thickness: over the highest bead, where air is taken
WHOLE = Parts()


@dataclass(frozen=True, slots=True, eq=False)
class StripImage:
    """Of one dogbone, mm: NaN where a thing is not told. section (Z, R): density, mean over the middle of its width."""

    w_mm: float
    w_sigma_mm: float
    t_mm: float
    t_sigma_mm: float
    wall_mm: float
    width_mm: float  # where it is narrowest
    haz: float  # mean density in the zone relative to plain wall
    haz_sigma: float
    lean_deg: float
    z_mm: FloatArray
    across_mm: FloatArray  # (R,) from the middle of the wall
    section: Float32Array
    joint_mm: float

    def figures(self) -> dict[str, float]:
        """What strip.json says of it."""
        return {
            "W_mm": self.w_mm,
            "W_sigma_mm": self.w_sigma_mm,
            "T_mm": self.t_mm,
            "T_sigma_mm": self.t_sigma_mm,
            "wall_mm": self.wall_mm,
            "width_mm": self.width_mm,
            "haz": self.haz,
            "haz_sigma": self.haz_sigma,
            "lean_deg": self.lean_deg,
            "joint_mm": self.joint_mm,
        }


@dataclass(frozen=True, slots=True)
class _Pose:
    """Where a strip lies: the line through its middle, the angle of its faces' normal, rad, and its size, mm."""

    axis: VolumeAxis
    normal: float
    thickness: float
    width: float


def strip(volume: Volume, parts: Parts = WHOLE, progress: Progress = lambda what, done, total: None) -> StripImage:
    """W and T of a dogbone. Raises AnnulusError where there is no strip along z, no bead on it, or no plain wall."""
    if volume.shape[0] < 16 or min(volume.shape[1:]) < 16:
        raise AnnulusError(f"a volume of {' x '.join(map(str, volume.shape))} voxels: expected at least 16 x 16 x 16")
    volume = densities(volume)
    dz = volume.voxel_mm[0]
    voxel = float(np.prod(volume.voxel_mm) ** (1 / 3))
    pose = _pose(volume, progress)
    step = 0.5 * min(volume.voxel_mm[1:])
    top = (0.5 + BEAD_MAX) * pose.thickness
    rho: FloatArray = np.arange(-top, top + step, step)
    aside: FloatArray = np.arange(-0.5 * MIDDLE * pose.width, 0.5 * MIDDLE * pose.width + 1e-9, step)
    leans = math.tan(math.radians(pose.axis.lean_deg))
    along, lost = math.hypot(1, leans), (top + pose.width) * leans
    z_mm: FloatArray = np.arange(lost, (volume.shape[0] - 1) * dz * along - lost, dz)
    if len(z_mm) < 16:
        raise AnnulusError(f"{len(z_mm) * dz:.1f} mm of a strip: too short")
    for _ in range(2):  # once more with what the faces said of their own tilt
        block = _block(volume, pose, z_mm, aside, rho, progress)
        surface = edges(block, rho, LEVEL)
        tilt = stats.theilslopes(nan_median(0.5 * (surface[0] + surface[1])), aside).slope
        pose = replace(pose, normal=pose.normal - math.atan(tilt))
    # Curved across as the pipe was: what that adds is the same in all planes.
    faces = [np.nanmean(s - nan_median(s), axis=1)[:, None] + float(np.nanmean(nan_median(s))) for s in surface]
    outer, inner = faces
    wall = float(np.nanmedian(outer - inner))
    rough = float(z_mm[int(np.nanargmax(outer - inner))])
    plain, beads = plain_planes(outer, inner, z_mm, rough, wall, voxel)
    joint = 0.5 * (beads[0] + beads[1])
    sides = [sides_of(face, z_mm, plain, joint, 0.0, UNEVEN * voxel) for face in faces]
    both = [bead_over(f, s, sign, z_mm, beads, voxel) for f, s, sign in zip(faces, sides, (1, -1), strict=True)]
    notches = np.array([bead.notch_z[0] for bead in both])
    fusion = np.array([np.nanmean(notches) if np.isfinite(notches).any() else joint])
    both = [bead_over(f, s, sign, z_mm, beads, voxel, fusion) for f, s, sign in zip(faces, sides, (1, -1), strict=True)]
    own = float(np.mean(sides[0].at_mm - sides[1].at_mm))
    noise = math.hypot(*(noise_along(face[plain]) for face in faces))
    blur = math.sqrt(2) * NOTCH_BLUR * min(dz, own)
    finer = NOTCH_CUSP * float(np.nansum([bead.cusp[0] for bead in both]))
    left = HILO_LEFT * 0.5 * float(sides[0].hilo_mm[0] + sides[1].hilo_mm[0])
    zone = _zone(block, rho, z_mm, surface, plain, joint, fusion, beads, own, voxel, parts)
    return StripImage(
        float(zone[0]),
        float(zone[1]),
        own + float(sum(bead.notch[0] for bead in both)),
        math.hypot(noise, blur, left, finer),
        own,
        pose.width,
        float(1 - zone[2]),
        float(zone[3]),
        pose.axis.lean_deg,
        z_mm,
        rho,
        block.mean(axis=1),
        float(fusion[0]),
    )


def _zone(
    block: Float32Array,
    rho: FloatArray,
    z_mm: FloatArray,
    surface: tuple[FloatArray, FloatArray],
    plain: BoolArray,
    joint: float,
    fusion: FloatArray,
    beads: tuple[float, float],
    wall: float,
    voxel: float,
    parts: Parts,
) -> tuple[float, float, float, float]:
    """W, its sigma, drop, its sigma; NaN where no zone is told."""
    # The plain faces' own shape across the strip, straight along it.
    low, high = (sides_of(face, z_mm, plain, joint, 0.0).along(z_mm) for face in (surface[1], surface[0]))
    walls = wall_samples(block, rho, low, high, max(8, math.ceil(wall / voxel)))
    reach = max(float(np.nanmax(surface[0])), -float(np.nanmin(surface[1])))
    beyond = (np.abs(rho) > reach + AIR[0] * wall) & (np.abs(rho) < reach + AIR[1] * wall)
    air = block[:, :, beyond].mean(axis=2).astype(float) if beyond.any() else np.zeros(block.shape[:2])
    shade, grey = air_level(air, plain), float(np.nanmean(air[plain]))
    shade -= np.median(shade[plain])
    relative_density(walls, shade, grey, z_mm, plain, joint)
    skin = 0.5 * (1 - parts.inner_mm / parts.of_mm)
    # A void is in few columns: the median over the strip's width does not see it.
    sound = np.median(density_map(walls, skin, 1 - skin, np.zeros(walls.shape, bool)), axis=1)[:, None]
    # How the zone flares with depth, an edge's rim, and what is left of the beads' shade in the wall, a whole pipe's
    # angles tell together; from a strip they are noise: with a rim W came out up to 0.8 mm wide.
    zone, _ = zone_of(sound, None, np.zeros_like(sound), z_mm, fusion, beads, wall, voxel)
    return float(zone.width[0]), float(zone.width_sigma[0]), float(zone.drop[0]), float(zone.drop_sigma[0])


def _pose(volume: Volume, progress: Progress) -> _Pose:
    count = volume.shape[0]
    dz, dy, dx = volume.voxel_mm
    looks = np.unique(np.linspace(0, count - 1, min(LOOKS, count)).round().astype(int))
    centres, points = [], []
    for i, z in enumerate(looks):
        progress("look for the strip", i, len(looks))
        ys, xs = np.nonzero(volume.slices(int(z), int(z) + 1)[0] > LEVEL)
        if len(xs) < 25:
            continue
        at = np.stack([xs * dx, ys * dy], axis=1)
        middle = at.mean(axis=0)
        centres.append([z * dz, *middle])
        points.append(at - middle)
    progress("look for the strip", len(looks), len(looks))
    if len(centres) < max(8, 0.5 * len(looks)):
        raise AnnulusError(
            f"no strip in the volume: plastic in {len(centres)} of {len(looks)} slices looked at; expected a dogbone "
            "along the slices' normal"
        )
    place = np.array(centres)
    hollow = [p for p in points if _is_hollow(p, volume.voxel_mm)]
    if len(hollow) > 0.5 * len(points):
        raise AnnulusError("no strip in the volume: its section is hollow; is it a pipe's? `image` takes that")
    every = np.concatenate([p[:: max(1, len(p) // 400)] for p in points])
    boxes = [math.prod(_box(every, t)) for t in np.radians(TURNS_DEG)]
    turn = math.radians(float(TURNS_DEG[int(np.argmin(boxes))]))
    # Extents of every slice both ways: beads make it thicker one way only, for a stretch.
    extents = np.array([_box(p, turn) for p in points])
    usual, most = np.median(extents, axis=0), np.percentile(extents, 97, axis=0)
    if not (most / usual > 1 + PLAIN).any():
        raise AnnulusError("no joint in the volume: no bead stands over the strip")
    faces = int(np.argmax([_stands(extents[:, k]) for k in range(2)]))
    normal = turn + (0.0 if faces == 0 else math.pi / 2)
    bead = extents[:, faces] > usual[faces] * (1 + PLAIN)
    joint = float(np.average(place[:, 0], weights=np.maximum(extents[:, faces] - usual[faces], 0) * bead))
    axis = fit_axis(place[:, 1:], place[:, 0], ~bead, joint)
    if axis.lean_deg > LEAN_MAX_DEG:
        raise AnnulusError(
            f"the strip leans by {axis.lean_deg:.1f} degrees in its volume: expected at most {LEAN_MAX_DEG:g}"
        )
    return _Pose(axis, normal, float(usual[faces]), float(np.percentile(extents[:, 1 - faces], 10)))


def _stands(extent: FloatArray) -> float:
    """How steeply an extent rises along the strip: a bead within a few slices, grips slowly."""
    return float(np.max(np.abs(np.diff(extent))) / np.median(extent))


def _box(points: FloatArray, turn: float) -> tuple[float, float]:
    """Extent of a section along both sides of a box that stands at this angle, mm."""
    c, s = math.cos(turn), math.sin(turn)
    first, second = (np.ptp(np.percentile(side, (1, 99))) / 0.98 for side in (points @ (c, s), points @ (-s, c)))
    return float(first), float(second)


def _is_hollow(points: FloatArray, voxel_mm: tuple[float, float, float]) -> bool:
    """Whether the middle of the section's own box holds no plastic."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return bool(np.min(np.hypot(*(points - middle).T)) > 2 * max(voxel_mm[1:]))


def _block(
    volume: Volume, pose: _Pose, z_mm: FloatArray, aside: FloatArray, rho: FloatArray, progress: Progress
) -> Float32Array:
    """(Z, U, R) grey at right angles to the strip: along it, across its width, through its thickness."""
    dz = volume.voxel_mm[0]
    across, down, along = pose.axis.frame()
    through = math.cos(pose.normal) * across + math.sin(pose.normal) * down
    wide = np.cross(along, through)
    origin = np.array([pose.axis.x_mm, pose.axis.y_mm, 0.0])
    rays = (aside[:, None] * wide, np.repeat(through[None], len(aside), axis=0))
    reach = abs(rho).max() * abs(through[2]) + abs(aside).max() * abs(wide[2])
    out = np.empty((len(z_mm), len(aside), len(rho)), np.float32)
    for start in range(0, len(z_mm), PLANES_AT_ONCE):
        z = z_mm[start : start + PLANES_AT_ONCE]
        low = int(np.clip(np.floor((z[0] * along[2] - reach) / dz), 0, volume.shape[0] - 2))
        high = int(np.clip(np.ceil((z[-1] * along[2] + reach) / dz) + 2, low + 2, volume.shape[0]))
        slab = volume.slices(low, high)
        out[start : start + len(z)] = sampled(slab, low, volume.voxel_mm, origin, along, z, rays, rho, to_edge=True)
        progress("strip", start + len(z), len(z_mm))
    return out
