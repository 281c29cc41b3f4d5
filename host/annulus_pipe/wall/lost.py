"""Rings of the pattern that a scan shows too little of: what only they would have seen is not measured, unasked."""

from collections.abc import Sequence

import numpy as np

from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.profile import Profile

RING_LOST = "ring lost"  # kind of a finding
OBJECT = "object"  # kind of a finding, and of `rejected`
OBJECT_POINTS = 20  # of a frame: more than dirt
# Parts of what the middle one of the rings gives; an image whose edge cuts the outermost ring leaves it two thirds.
# Guarded both ways by test_lost.py.
FEW = 0.5  # of the points over the scan: a ring with fewer is lost ..
NEXT_TO_NONE = 0.25  # .. and so is one with fewer than this part of a frame's ..
OFTEN = 0.2  # .. in more than this part of the frames
POINTS_LEAST = 20  # of the middle ring: a frame with fewer shows no pipe


def lost_rings(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """One line for each ring that gave few points, or next to none in many frames, where the others gave theirs."""
    posed = [p for p in profiles if p.pose is not None]
    rings = max((max(len(p.ring_sigma_mm), int(p.ring.max(initial=0)) + 1) for p in posed), default=0)
    if rings < 2:
        return ()
    count = np.array([np.bincount(p.ring, minlength=rings) for p in posed])
    usual = np.sort(count, axis=1)[:, rings // 2]
    shown = usual >= POINTS_LEAST
    if not shown.any():
        return ()
    count, usual = count[shown], usual[shown]
    frames = np.array([p.frame for p in posed])[shown]
    part = count.sum(axis=0) / usual.sum()
    none = count < NEXT_TO_NONE * usual[:, None]
    out = []
    for k in np.flatnonzero((part < FEW) | (none.mean(axis=0) > OFTEN)):
        text = (
            f"ring {k + 1} of {rings}, counted from the innermost, gave {100 * part[k]:.0f} % of the points of the "
            f"others, and next to none in {none[:, k].sum()} of {len(frames)} frames: it is swallowed by the wall's "
            "colour, drowned in stray light, or not in the slide, and what only it would show is not seen"
        )
        out.append(Finding(RING_LOST, text, tuple(int(frame) for frame in frames[none[:, k]])))
    return tuple(out)


def objects_before_the_wall(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """One line where something stands in the ring that is no wall."""
    frames = tuple(p.frame for p in profiles if p.rejected.get(OBJECT, 0) >= OBJECT_POINTS)
    if not frames:
        return ()
    text = (
        f"in {len(frames)} of {len(profiles)} frames something stands in the ring before the wall (a crawler's leg, "
        "stones): it is no wall, and the wall behind it is unseen"
    )
    return (Finding(OBJECT, text, frames),)
