"""A head at rest looks once, however many frames it takes.

Two hundred frames from one place are wrong alike: a pose that an arc of the pipe misled, a stain, a shadow. Counted as
two hundred looks they outvote the frames beside them, and a joint was told where the head had stood. So of frames from
one place only those are kept that show something of the pipe that the others do not.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray
from annulus_pipe.wall.profile import Profile

# Held by tests/regression/rest_counted_as_looks.
PLACE_OF_RADIUS = 0.005  # along the pipe: nearer to each other is one place; rings lie fifty times as far apart
TURN_DEG = 1.0  # a head that has turned more sees other parts of the wall between its rods
SECTORS = 24  # of a ring
NEW = 2  # of them: so many that no frame kept has shown are something new
RESTS_LEAST = 3  # frames of one place: two are a slow head's


def without_rests(profiles: Sequence[Profile]) -> tuple[Profile, ...]:
    """The same profiles, in their order, less frames that a head at rest only repeated; their points are counted as
    rejected["at rest"] of the frame that was kept."""
    usable = [i for i, one in enumerate(profiles) if one.pose is not None and len(one.points_mm)]
    if len(usable) < RESTS_LEAST:
        return tuple(profiles)
    some = np.concatenate([profiles[i].points_mm[::37, :2] for i in usable])
    near = PLACE_OF_RADIUS * float(np.median(np.hypot(some[:, 0], some[:, 1])))
    usable.sort(key=lambda i: (profiles[i].camera, profiles[i].z_mm))
    out: list[Profile | None] = list(profiles)
    group: list[int] = []
    for i in [*usable, -1]:
        if group and (i < 0 or not _is_one_place(profiles[group[0]], profiles[i], near)):
            if len(group) >= RESTS_LEAST:
                for kept, lost in _once([profiles[k] for k in group]):
                    one = profiles[group[kept]]
                    points = sum(len(profiles[group[k]].points_mm) for k in lost)
                    rejected = {**one.rejected, "at rest": one.rejected.get("at rest", 0) + points}
                    out[group[kept]] = replace(one, rejected=rejected) if lost else one
                    for k in lost:
                        out[group[k]] = None
            group = []
        group.append(i)
    return tuple(one for one in out if one is not None)


def places_of(profiles: Sequence[Profile], radius_mm: float) -> NDArray[np.intp]:
    """(N,) the same number for frames that look from one place, turned alike: what a ring says there it says once."""
    near = PLACE_OF_RADIUS * radius_mm
    rolls = [0.0 if one.pose is None else math.degrees(one.pose.roll or 0.0) for one in profiles]
    turned = [round(roll / TURN_DEG) for roll in rolls]
    out, place, first = np.zeros(len(profiles), np.intp), -1, -1
    for i in sorted(range(len(profiles)), key=lambda i: (profiles[i].camera, turned[i], profiles[i].z_mm)):
        if first < 0 or turned[i] != turned[first] or not _is_one_place(profiles[first], profiles[i], near):
            first, place = i, place + 1
        out[i] = place
    return out


def _is_one_place(one: Profile, other: Profile, near_mm: float) -> bool:
    return one.camera == other.camera and abs(other.z_mm - one.z_mm) <= near_mm


def _once(frames: Sequence[Profile]) -> list[tuple[int, list[int]]]:
    """Of frames from one place those that are kept, and with the first of each roll those that only repeat it."""
    rolls = np.degrees([0.0 if one.pose is None else one.pose.roll or 0.0 for one in frames])
    out = []
    for turned in np.unique(np.round(rolls / TURN_DEG)):
        mine = [int(k) for k in np.flatnonzero(np.round(rolls / TURN_DEG) == turned)]
        shown = [_shown(frames[k]) for k in mine]
        seen = np.zeros_like(shown[0])
        kept: list[int] = []
        for at in sorted(range(len(mine)), key=lambda at: -int(shown[at].sum())):
            if not kept or np.count_nonzero(shown[at] & ~seen) >= NEW:
                kept.append(at)
                seen |= shown[at]
        lost = [mine[at] for at in range(len(mine)) if at not in kept]
        out.append((mine[kept[0]], lost))
        out += [(mine[at], []) for at in kept[1:]]
    return out


def _shown(one: Profile) -> BoolArray:
    """(rings * SECTORS,) bool: which parts of which rings a frame has points in."""
    x, y, _ = one.points_mm.T
    sector = np.floor(np.arctan2(y, x) * (SECTORS / (2 * np.pi))).astype(np.intp) % SECTORS
    seen = np.zeros(256 * SECTORS, bool)
    seen[one.ring.astype(np.intp) * SECTORS + sector] = True
    return seen
