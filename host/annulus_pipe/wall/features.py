"""What an inspector names in a pipe, beside damage: joints, gaps, openings, levels, tapers, bends.

A feature is no defect of the wall. It has a kind, a place, and what was measured of it, each number with its
expanded uncertainty. Whatever belongs to one is not looked at again for losses and bumps.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from annulus_pipe.numeric.rounding import clock_face

NOT_TOLD = "kind not established"  # how a joint's remark begins of which too little was seen

GAP_OR_GROOVE = "a gap between two pipes, or a groove"  # remark of a place without a name that explains its loss


class FeatureKind(StrEnum):
    """In the words of summary.json."""

    JOINT = "joint"  # butt fusion, socket or coupling, or what could not be told
    GAP = "gap"  # between two pipe ends inside a coupling
    BRANCH = "branch"  # an opening in the wall
    TEE = "tee"  # an opening whose rim stands into the pipe
    WATER = "water"
    DEPOSIT = "deposit"  # silt: a flat or uneven bottom that is no wall
    REDUCER = "reducer"
    TAPER = "taper"
    BEND = "bend"
    NAMELESS = (
        "not established"  # something goes all round, and whether it is a joint, a bend or a reducer is not known
    )
    CROSS_BORE = "cross bore"  # a sewer that the pipe was drilled through, behind the wall


@dataclass(frozen=True, slots=True)
class FeatureMeasure:
    """One number of a feature. `name` ends in its unit (height_mm, angle_deg); `k2` is the expanded uncertainty (k = 2)
    in that unit, NaN where nobody knows it."""

    name: str
    value: float
    k2: float = math.nan

    @property
    def unit(self) -> str:
        return self.name.rsplit("_", 1)[1]

    @property
    def k2_name(self) -> str:
        """What its uncertainty is called beside it: height_k2_mm."""
        return f"{self.name.removesuffix(self.unit)}k2_{self.unit}"


@dataclass(frozen=True, slots=True)
class Feature:
    """Positions are the middle of the extent: chainage and clock angle (degrees clockwise from 12). An arc of 360 is
    all round. `remark` is for people: "butt fusion", "3.0 D, 90 degrees, to 3 o'clock"."""

    kind: FeatureKind
    z_mm: float
    length_mm: float
    clock_deg: float = 0.0
    arc_deg: float = 360.0
    measures: tuple[FeatureMeasure, ...] = ()
    remark: str = ""

    @property
    def clock(self) -> str:
        return clock_face(self.clock_deg)

    @property
    def z_range_mm(self) -> tuple[float, float]:
        return self.z_mm - self.length_mm / 2, self.z_mm + self.length_mm / 2

    def measured(self, name: str) -> float:
        """One of its numbers; NaN where it was not measured."""
        return next((one.value for one in self.measures if one.name == name), math.nan)
