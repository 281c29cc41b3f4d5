"""Voids, grains and gaps in the wall: what stands out of its neighbours.

The wall's relative density less what its surroundings have (median along an arc and across the depth), smoothed with
bells of a few sizes, over its own noise at that depth. What passes the threshold hangs together as one flaw; its
sign says void or grain, and a dark one that is flat and lies in the fusion plane is a gap. Beads, and the skin within
a voxel or two of a surface, are not looked at: a surface's blur would be taken for flaws.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage

SIZES = (0.8, 1.4)  # voxels: standard deviations of the bells
THRESHOLD = 7.0  # sigma: of a million voxels none by chance, with room for what noise of reconstructions leaves alike
AROUND_DEG = 5.0  # blocks of angle whose median makes the surroundings ..
BLOCKS = 13  # .. and how many of them
FLAT_MM = 1.2  # off the fusion plane: so near is a gap's middle
LONG = 2.5  # of its length along z: a gap is at least so far round
JOINED_MM = 4.0  # pieces of one gap lie no further apart
SKIN_VOXELS = 2.0


@dataclass(frozen=True, slots=True)
class Flaw:
    """kind void, grain or gap; place: angle in degrees, distance from the axis and along it, mm; contrast relative."""

    kind: str
    phi_deg: float
    rho: float
    z: float
    arc_deg: float
    length_mm: float  # along z
    depth_mm: float  # across the wall
    contrast: float  # mean relative density, less its surroundings, at the peak
    snr: float


def surroundings(relative: Float32Array) -> FloatArray:
    """(Z, P) what is usual at each place: medians across the depth and round an arc, in which no flaw has a part."""
    count = relative.shape[1]
    blocks = max(8, round(360 / AROUND_DEG))
    edge = np.linspace(0, count, blocks + 1).astype(int)
    inner = relative[:, :, relative.shape[2] // 5 : max(relative.shape[2] * 4 // 5, 1)]
    some = np.stack([np.median(inner[:, a:b], axis=(1, 2)) for a, b in pairwise(edge)], axis=1)
    some = ndimage.median_filter(some, size=(1, min(BLOCKS, blocks)), mode="wrap")
    at = (np.arange(count) + 0.5) / count * blocks - 0.5
    low = np.floor(at).astype(int)
    part = at - low
    return np.asarray(some[:, low % blocks] * (1 - part) + some[:, (low + 1) % blocks] * part)


def flaws_of(
    relative: Float32Array,
    z_mm: FloatArray,
    inner: FloatArray,
    outer: FloatArray,
    plane_mm: FloatArray,
    voxel_mm: float,
) -> tuple[list[Flaw], BoolArray]:
    """Flaws, the plainest first, and a mask (Z, P, U) of their voxels.

    relative : (Z, P, U) density less plain wall's; inner, outer : (Z, P) mm, the wall it was sampled between;
    plane_mm : (P,) the fusion plane along z.
    """
    depth_count, count = relative.shape[2], relative.shape[1]
    wall, radius = float(np.mean(outer - inner)), float(np.mean(0.5 * (inner + outer)))
    cell = (abs(z_mm[1] - z_mm[0]), 2 * math.pi * radius / count, wall / depth_count)
    skin = max(1, math.ceil(SKIN_VOXELS * voxel_mm / cell[2]))
    over = relative - surroundings(relative).astype(np.float32)[:, :, None]
    over = over[:, :, skin : depth_count - skin]
    mask = np.zeros(relative.shape, bool)
    score = np.zeros(over.shape, np.float32)
    for size in SIZES:
        bell = [size * voxel_mm / c for c in cell]
        smooth = ndimage.gaussian_filter(over, bell, mode=("nearest", "wrap", "nearest"), truncate=3.0)
        smooth /= 1.4826 * np.median(np.abs(smooth[::2, ::2]), axis=(0, 1))
        better = np.abs(smooth) > np.abs(score)
        score[better] = smooth[better]
    flaws: list[Flaw] = []
    hot = np.abs(score) > THRESHOLD
    # One turn joins its end to its beginning: looked at from where nothing is hot, if there is such a place.
    start = int(np.argmin(hot.sum(axis=(0, 2))))
    score, hot, over = (np.roll(a, -start, axis=1) for a in (score, hot, over))
    for sign in (-1, 1):
        parts, number = ndimage.label(hot & (sign * score > 0), structure=np.ones((3, 3, 3)))
        if not number:
            continue
        top = ndimage.maximum(np.abs(score), parts, np.arange(1, number + 1))
        for n in np.flatnonzero(top > THRESHOLD) + 1:
            at = np.argwhere(parts == n)
            weight = np.abs(over[tuple(at.T)]) + 1e-9
            strong = int(np.argmax(np.abs(score[tuple(at.T)])))
            centre = np.average(at, axis=0, weights=weight)
            size = (np.ptp(at, axis=0) + 1) * np.array(cell)
            j = round(float(centre[1]) + start) % count
            k = int(np.clip(round(centre[0]), 0, len(z_mm) - 1))
            z = float(np.interp(centre[0], np.arange(len(z_mm)), z_mm))
            flat = size[1] > LONG * size[0] and size[1] > 4 * voxel_mm and abs(z - plane_mm[j]) < FLAT_MM
            part = (centre[2] + skin + 0.5) / depth_count
            flaws.append(
                Flaw(
                    "grain" if sign > 0 else "gap" if flat else "void",
                    float(((centre[1] + start) * 360 / count) % 360),
                    float(inner[k, j] + part * (outer[k, j] - inner[k, j])),
                    z,
                    float((np.ptp(at[:, 1]) + 1) * 360 / count),
                    float(size[0]),
                    float(size[2]),
                    float(over[tuple(at[strong])]),
                    float(top[n - 1]),
                )
            )
            # Its blur reaches a voxel further than what is over the threshold.
            z0, j0, u0 = (np.maximum(at.min(axis=0) - 1, 0)).tolist()
            z1, j1, u1 = (at.max(axis=0) + 2).tolist()
            mask[z0:z1, (np.arange(j0, j1) + start) % count, u0 + skin : u1 + skin] = True
    return sorted(_gaps_joined(flaws, radius, plane_mm), key=lambda flaw: -flaw.snr), mask


def _gaps_joined(flaws: list[Flaw], radius: float, plane_mm: FloatArray) -> list[Flaw]:
    """Pieces of one gap, and dark specks in the plane beside it, as one."""

    def turned(a: float, b: float) -> float:
        return (a - b + 180) % 360 - 180

    done = [flaw for flaw in flaws if flaw.kind == "grain"]
    dark = sorted((flaw for flaw in flaws if flaw.kind != "grain"), key=lambda flaw: (flaw.kind != "gap", -flaw.snr))
    while dark:
        one = dark.pop(0)
        if one.kind == "gap":
            joined = True
            while joined:
                joined = False
                for other in dark:
                    apart = abs(turned(other.phi_deg, one.phi_deg)) - 0.5 * (one.arc_deg + other.arc_deg)
                    plane = plane_mm[int(other.phi_deg / 360 * len(plane_mm)) % len(plane_mm)]
                    if math.radians(apart) * radius < JOINED_MM and abs(other.z - plane) < FLAT_MM:
                        one = _both(one, other, turned(other.phi_deg, one.phi_deg))
                        dark.remove(other)
                        joined = True
                        break
        done.append(one)
    return done


def _both(a: Flaw, b: Flaw, turn: float) -> Flaw:
    low, high = min(-0.5 * a.arc_deg, turn - 0.5 * b.arc_deg), max(0.5 * a.arc_deg, turn + 0.5 * b.arc_deg)
    part = b.arc_deg / (a.arc_deg + b.arc_deg)
    strong = a if a.snr >= b.snr else b
    return Flaw(
        "gap",
        (a.phi_deg + 0.5 * (low + high)) % 360,
        a.rho + part * (b.rho - a.rho),
        a.z + part * (b.z - a.z),
        high - low,
        max(a.length_mm, b.length_mm),
        max(a.depth_mm, b.depth_mm),
        strong.contrast,
        strong.snr,
    )
