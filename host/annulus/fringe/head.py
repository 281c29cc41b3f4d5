"""A head that projects fringes, as calibration.json has it: cameras, slide, curves, the wall it stands before.

`annulus-calibration/2` with "pattern": {"kind": "fringe", "projector": {..}}. Beside it "transfer" (see `transfer`),
"motion" (unit vector, the first camera's frame; x where missing) and the wall: "distance_mm" of a plate across the
first camera's axis, or "pipe" with its radius: such a file is a `Calibration` too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from annulus import untrusted
from annulus.fringe.projector import FringeProjector
from annulus.fringe.transfer import Transfer, transfers
from annulus.geometry.calibration import HeadCamera, cameras_from_dict
from annulus.vocabulary import AnnulusError

Vector = tuple[float, float, float]
RADIUS_MIN_MM, RADIUS_MAX_MM = 1.0, 5000.0


@dataclass(frozen=True, slots=True)
class FringeHead:
    """What is known of the head; `projector` None where the file is only about to be calibrated. distance_mm : of a
    plate, height 0, from the first camera along its axis; radius_mm : of a pipe. None where the wall is another."""

    cameras: tuple[HeadCamera, ...]
    projector: FringeProjector | None
    motion: Vector = (1.0, 0.0, 0.0)
    distance_mm: float | None = None
    transfer: Mapping[str, Transfer] = field(default_factory=dict, hash=False)
    radius_mm: float | None = None

    @staticmethod
    def from_dict(data: object) -> "FringeHead":
        """Raises ValueError naming the key that is wrong."""
        top = untrusted.mapping(data, "the file")
        cameras = cameras_from_dict(top)
        pattern = top.get("pattern", {"kind": "fringe"})
        kind = pattern.get("kind", "slits") if isinstance(pattern, Mapping) else pattern
        if kind != "fringe":
            raise ValueError(f'"pattern.kind" is {untrusted.shown(kind)}, expected fringe')
        projector = pattern.get("projector")
        x, y, z = untrusted.numbers(top.get("motion", [1.0, 0.0, 0.0]), '"motion"', (3,), 1.0 + 1e-6)
        if not abs(np.hypot(np.hypot(x, y), z) - 1) < 1e-3:
            raise ValueError('"motion" is no unit vector, expected the direction the stage moves the head in')
        distance = top.get("distance_mm")
        pipe = untrusted.mapping(top["pipe"], '"pipe"') if "pipe" in top else {}
        radius = pipe.get("radius_mm")
        return FringeHead(
            cameras,
            None if projector is None else FringeProjector.from_dict(projector),
            (x, y, z),
            None if distance is None else untrusted.within(distance, '"distance_mm"', 1.0, 1e4),
            transfers(top["transfer"]) if "transfer" in top else {},
            None if radius is None else untrusted.within(radius, '"pipe.radius_mm"', RADIUS_MIN_MM, RADIUS_MAX_MM),
        )

    def curve(self, scan: str) -> Transfer | None:
        """The curve of the scan in a folder of that name; None where the file says none for it."""
        return self.transfer.get(scan, self.transfer.get(""))

    def camera(self, number: int) -> HeadCamera:
        """By its id. AnnulusError where there is none."""
        for one in self.cameras:
            if one.id == number:
                return one
        known = ", ".join(str(one.id) for one in self.cameras)
        raise AnnulusError(f"calibration: knows camera {known}, not camera {number} of the scan")


def projector_to_dict(slide: FringeProjector) -> dict[str, Any]:
    """`pattern.projector`, as `FringeProjector.from_dict` reads it."""
    rings = slide.kind == "rings"
    out: dict[str, Any] = {
        "kind": slide.kind,
        "centre_mm": list(slide.centre_mm),
        "rotation": [list(row) for row in slide.rotation],
        "period_mm" if rings else "period": slide.period,
        "phase0": slide.phase0,
    }
    if rings:
        out["nominal_radius_mm"] = slide.nominal_radius_mm
    else:
        out["turn_deg"] = slide.turn_deg
    return {**out, "harmonics": list(slide.harmonics)} if slide.harmonics else out
