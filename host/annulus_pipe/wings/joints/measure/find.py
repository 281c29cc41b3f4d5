"""What is in the volume: grey of air and plastic, the pipe's axis, size and wall, and roughly where its joint is.

Looks at some 64 slices. Assumed: one pipe, air and plastic the two commonest greys; its beads are where its section is
larger than usual, and less than half of the volume's length.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.axis import VolumeAxis, circle_of, fit_axis
from annulus_pipe.wings.joints.measure.unwrap import Volume

LOOKS = 64
BINS = 512
PLAIN = 1.02  # of the usual section: a slice with more has a bead in it
CONTRAST_MIN = 3.0  # of plastic over air, in standard deviations of air


@dataclass(frozen=True, slots=True)
class FoundJoint:
    """Greys of air and plastic, the axis, and the pipe's mean outer radius and wall; the joint along the axis, mm."""

    air: float
    plastic: float
    axis: VolumeAxis
    radius_mm: float
    wall_mm: float
    joint_mm: float

    @property
    def level(self) -> float:
        """Halfway: a surface blurred evenly to both sides is where the grey crosses it."""
        return 0.5 * (self.air + self.plastic)


def two_greys(sample: np.ndarray) -> tuple[float, float]:
    """Air and plastic: the medians below and above the threshold that parts the histogram best (Otsu)."""
    lowest, highest = np.percentile(sample, (0.1, 99.9))
    if not highest > lowest:
        raise AnnulusError("no pipe in the volume: all of it is one grey")
    count, edges = np.histogram(sample, BINS, (lowest, highest))
    middle = 0.5 * (edges[1:] + edges[:-1])
    below, moment = np.cumsum(count), np.cumsum(count * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * below / below[-1] - moment) ** 2 / (below * (below[-1] - below))
    level = middle[int(np.nanargmax(between[:-1]))]
    air, plastic = float(np.median(sample[sample <= level])), float(np.median(sample[sample > level]))
    spread = 1.4826 * float(np.median(np.abs(sample[sample <= level] - air)))
    if plastic - air < CONTRAST_MIN * spread:
        raise AnnulusError("no pipe in the volume: expected plastic and air, found no two greys apart")
    return air, plastic


def find(volume: Volume, progress: Callable[[str, int, int], None] = lambda what, done, total: None) -> FoundJoint:
    """Raises AnnulusError where there is no hollow cylinder whole in the slices, or no joint in it."""
    count, rows, columns = volume.shape
    if count < 16 or min(rows, columns) < 32:
        raise AnnulusError(f"a volume of {count} x {rows} x {columns} voxels: expected at least 16 x 32 x 32")
    dz, dy, dx = volume.voxel_mm
    looks = np.unique(np.linspace(0, count - 1, min(LOOKS, count)).round().astype(int))
    some = np.concatenate([volume.slices(z, z + 1)[0, ::3, ::3].ravel() for z in looks[:: max(1, len(looks) // 12)]])
    # A reconstruction is a disc: what lies outside it is one constant, and no air.
    outside = np.concatenate([some[:1], some[-1:]])
    inside = some[~np.isin(some, outside)] if np.isin(some, outside).mean() > 0.02 else some
    if not np.isfinite(some).all() or not len(inside):
        raise AnnulusError("no pipe in the volume: expected finite greys of plastic and air")
    air, plastic = two_greys(inside)
    level = 0.5 * (air + plastic)
    circles, area = np.full((len(looks), 3), np.nan), np.zeros(len(looks))
    for i, z in enumerate(looks):
        progress("look for the pipe", i, len(looks))
        image = volume.slices(int(z), int(z) + 1)[0]
        area[i] = (image > level).sum() * dx * dy
        circles[i] = circle_of(image, (dx, dy), level) or np.nan
    progress("look for the pipe", len(looks), len(looks))
    seen = np.isfinite(circles[:, 0])
    if seen.mean() < 0.5:
        raise AnnulusError(
            f"no cylinder in the volume: a hollow circle in {int(seen.sum())} of {len(seen)} slices looked at; "
            "expected a whole pipe, brighter than its air, its axis within 10 degrees of the slices' normal"
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
    return FoundJoint(air, plastic, axis, radius, radius - math.sqrt(hollow), joint * stretch)
