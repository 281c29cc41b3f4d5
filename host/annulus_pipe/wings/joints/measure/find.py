"""What is in the volume: the pipe's axis, size and wall, and roughly where its joint is.

Looks at some 64 slices. Assumed: one pipe; its beads are where its section is larger than usual, and less than half of
the volume's length.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.axis import VolumeAxis, circle_of, fit_axis
from annulus_pipe.wings.joints.measure.greys import LEVEL
from annulus_pipe.wings.joints.measure.unwrap import Volume

LOOKS = 64
PLAIN = 1.02  # of the usual section: a slice with more has a bead in it


@dataclass(frozen=True, slots=True)
class FoundJoint:
    """The axis, and the pipe's mean outer radius and wall; the joint along the axis, mm."""

    axis: VolumeAxis
    radius_mm: float
    wall_mm: float
    joint_mm: float


def find(volume: Volume, progress: Callable[[str, int, int], None] = lambda what, done, total: None) -> FoundJoint:
    """volume : in parts of plastic (`greys`).

    Raises AnnulusError where there is no hollow cylinder whole in the slices, or no joint in it.
    """
    count = volume.shape[0]
    dz, dy, dx = volume.voxel_mm
    looks = np.unique(np.linspace(0, count - 1, min(LOOKS, count)).round().astype(int))
    circles, area = np.full((len(looks), 3), np.nan), np.zeros(len(looks))
    for i, z in enumerate(looks):
        progress("look for the pipe", i, len(looks))
        image = volume.slices(int(z), int(z) + 1)[0]
        area[i] = (image > LEVEL).sum() * dx * dy
        circles[i] = circle_of(image, (dx, dy), LEVEL) or np.nan
    progress("look for the pipe", len(looks), len(looks))
    seen = np.isfinite(circles[:, 0])
    if seen.mean() < 0.5:
        raise AnnulusError(
            f"no cylinder in the volume: a hollow circle in {int(seen.sum())} of {len(seen)} slices looked at; "
            "expected a whole pipe in air, its axis within 10 degrees of the slices' normal"
        )
    usual = float(np.median(area[seen]))
    z_mm = looks * dz
    thick = area > PLAIN * usual
    if not thick.any():
        raise AnnulusError("no joint in the volume: no slice has more plastic in it than the others")
    joint = float(np.average(z_mm[thick], weights=area[thick] - usual))
    plain = seen & ~thick
    axis = fit_axis(circles[:, :2], z_mm, plain, joint)
    if axis.lean_deg > 10:
        raise AnnulusError(f"the pipe leans by {axis.lean_deg:.1f} degrees in its volume: expected at most 10")
    radius = float(np.median(circles[plain, 2]))
    hollow = radius**2 - usual / math.pi
    if hollow <= 0 or not 0.02 < 1 - math.sqrt(hollow) / radius < 0.6:
        raise AnnulusError("no pipe in the volume: its section is no ring with a wall of 2 to 60 % of the radius")
    stretch = math.sqrt(1 + axis.lean_x**2 + axis.lean_y**2)
    return FoundJoint(axis, radius, radius - math.sqrt(hollow), joint * stretch)
