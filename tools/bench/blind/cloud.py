"""Points of the cloud against the true wall: how many lie within twice their sigma, by place."""

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from tools.bench.blind.pipe import Scene
from tools.bench.blind.places import BREAKS, END_OF_RADIUS, JOINT_OF_RADIUS, ROD_DEG
from tools.bench.blind.surface import NO_WALL, Array, Surface, away_deg, out

Mask = NDArray[np.bool_]
POINTS_MOST = 20_000  # of a pipe
SLICE_OF_RADIUS, SLICE_POINTS, SHIFTS = 0.1, 30, 4  # a slice along the pipe, its least points; times it is shifted
ASIDE_OF_RADIUS = 0.01  # beside a step a point may be on either side of it
STEP_OF_RADIUS = 0.004  # what is more than that within ASIDE is a step


def cloud_coverage(
    scene: Scene, points: Array, sigma: Array, seen: tuple[float, float], scale_part: float
) -> dict[str, tuple[int, int, int]]:
    """Place -> (points, those within 2 sigma, and within 2 sigma less what all radii may be off alike, about the scale
    that this scan has). Points where there is no wall are left out."""
    surface, radius = Surface(scene.pipe), scene.pipe.radius_mm
    known = np.isfinite(sigma)
    keep = np.flatnonzero(known)[:: max(1, int(known.sum()) // POINTS_MOST)]
    clock, z, r = centred(surface, *surface.from_space(points[keep]), SLICE_OF_RADIUS * radius)
    error = errors(surface, clock, z, r)
    wall = np.ones(len(z), bool)
    for thing in scene.pipe.things:
        if thing.kind in NO_WALL:
            off = np.abs(away_deg(clock, thing.clock_deg))
            round_it = np.full(len(z), thing.kind == "cable") | (off <= thing.arc_deg / 2 + 4.0)
            wall &= ~(round_it & (np.abs(z - thing.z_mm) <= thing.length_mm / 2 + 0.05 * radius))
    within = np.abs(error) <= 2.0 * sigma[keep]
    alike = float(np.median(error[wall] / r[wall])) if wall.any() else 0.0
    own = np.sqrt(np.maximum(sigma[keep] ** 2 - (scale_part * r) ** 2, 0.0))
    locally = np.abs(error - alike * r) <= 2.0 * own
    counts = {}
    for place, mine in _places(scene, clock, z, seen).items():
        if (mine & wall).any():
            here = mine & wall
            counts[place] = int(here.sum()), int(within[here].sum()), int(locally[here].sum())
    return counts


def errors(surface: Surface, clock: Array, z: Array, r: Array) -> Array:
    """(N,) mm, how far points are outside the wall; at a step, of the range of its two sides."""
    radius = surface.pipe.radius_mm
    aside = ASIDE_OF_RADIUS * radius
    near = [
        surface.radius(clock + np.degrees(da / radius), z + dz)
        for da, dz in ((0, 0), (aside, 0), (-aside, 0), (0, aside), (0, -aside))
    ]
    low, high = np.min(near, axis=0), np.max(near, axis=0)
    plain = r - near[0]
    stepped = r - np.clip(r, low, high)
    return np.asarray(np.where(high - low > STEP_OF_RADIUS * radius, stepped, plain))


def centred(surface: Surface, clock: Array, z: Array, r: Array, slice_mm: float) -> tuple[Array, Array, Array]:
    """The same after the best shift of every slice along the pipe: sigma is of a radius about the axis that the survey
    found, and how far that is off is another number. Clocks turn with the shift: an oval pipe knows the difference."""
    t = np.radians(clock)
    x, y = r * np.sin(t), -r * np.cos(t)
    which = np.floor(z / slice_mm).astype(int)
    slices = [mine for mine in (np.flatnonzero(which == k) for k in np.unique(which)) if len(mine) >= SLICE_POINTS]
    for _ in range(SHIFTS):
        error = errors(surface, clock, z, r)
        for mine in slices:
            way = out(clock[mine])
            off = np.abs(error[mine] - np.median(error[mine]))
            sound = off < 4.0 * (1.4826 * np.median(off) + 1e-3)
            shift = np.linalg.lstsq(way[sound], error[mine][sound], rcond=None)[0]
            x[mine] -= shift[0]
            y[mine] -= shift[1]
        clock, r = np.degrees(np.arctan2(x, -y)) % 360.0, np.hypot(x, y)
    return clock, z, r


def _places(scene: Scene, clock: Array, z: Array, seen: tuple[float, float]) -> dict[str, Mask]:
    """Masks by place, as `places` has them for one thing, but shadows of steps."""
    if scene.change.any:
        return {"in drift": np.ones(len(z), bool)}
    radius = scene.pipe.radius_mm
    masks: dict[str, Mask] = defaultdict(lambda: np.zeros(len(z), bool))
    for one in scene.pipe.things:
        first, last = one.span_mm
        if one.kind == "bend":
            masks["in a bend"] |= (z >= first) & (z <= last)
        elif one.kind in BREAKS:
            masks["beside a joint"] |= (z >= first - JOINT_OF_RADIUS * radius) & (z <= last + JOINT_OF_RADIUS * radius)
    masks["at an end"] = (z < seen[0] + END_OF_RADIUS * radius) | (z > seen[1] - END_OF_RADIUS * radius)
    for rod, _, _ in scene.head.rods:
        masks["behind a step or rod"] |= np.abs(away_deg(clock, rod)) <= ROD_DEG
    left = np.ones(len(z), bool)
    parts = {}
    for place in ("in a bend", "at an end", "beside a joint", "behind a step or rod"):
        parts[place] = masks[place] & left
        left = left & ~masks[place]
    return {**parts, "plain wall": left}
