"""A head that projects fringes, as calibration.json has it: cameras, slide, curves, the wall it stands before.

`annulus-calibration/2` with "pattern": {"kind": "fringe", "projector": {..}, "rms_rad": of the phase about it}. Beside
it "transfer" (see `transfer`), "motion" (unit vector, the first camera's frame; x where missing) and the wall:
"distance_mm" of a plate across the first camera's axis, or "pipe" with its radius: such a file is a `Calibration` too.

A head that lights a pipe all around by several slides, in turn, has "projectors": [{.., "cameras": [ids that look at
its light], "slots": [places in the lamp cycle at which it is lit]}, ..] in place of "projector"; without "slots" it is
lit at all. Where the first camera does not look along the pipe, "pipe" has "rotation" and "translation_mm", too: a
point X of that camera's frame lies at rotation X + translation_mm in a frame whose z is the pipe's axis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.geometry.calibration import (
    CAMERA_ID_MAX,
    STILL,
    HeadCamera,
    Matrix,
    Vector,
    cameras_from_dict,
    matrix_of,
    placement_from_dict,
    vector_of,
)
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.placement import Eye
from annulus_pipe.wings.fringe.measure.projector import FringeProjector
from annulus_pipe.wings.fringe.measure.transfer import Transfer, transfers

LAMPS_MAX = 16
RADIUS_MIN_MM = 1.0  # what is beyond these two is a typing error, no pipe
RADIUS_MAX_MM = 5000.0


@dataclass(frozen=True, slots=True)
class SlideLamp:
    """One slide of several: ids of the cameras that look at its light, and the slots of the lamp cycle at which it is
    lit; empty: all."""

    projector: FringeProjector
    cameras: tuple[int, ...] = ()
    slots: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class FringeHead:
    """What is known of the head; `projector` None where the file is only about to be calibrated, or has `lamps`.
    distance_mm : of a plate, height 0, from the first camera along its axis; radius_mm : of a pipe. None where the wall
    is another. mount : rotation and translation_mm of a pipe's frame. rms_rad : of the phase about the slide, as its
    calibration on a plate left it."""

    cameras: tuple[HeadCamera, ...]
    projector: FringeProjector | None
    motion: Vector = (1.0, 0.0, 0.0)
    distance_mm: float | None = None
    transfer: Mapping[str, Transfer] = field(default_factory=dict, hash=False)
    radius_mm: float | None = None
    lamps: tuple[SlideLamp, ...] = ()
    mount: tuple[Matrix, Vector] = (STILL, (0.0, 0.0, 0.0))
    rms_rad: float = 0.0

    @staticmethod
    def from_dict(data: object) -> "FringeHead":
        """Raises ValueError naming the key that is wrong."""
        top = untrusted.mapping(data, "the file")
        cameras = cameras_from_dict(top)
        pattern = top.get("pattern", {"kind": "fringe"})
        kind = pattern.get("kind", "slits") if isinstance(pattern, Mapping) else pattern
        if kind != "fringe":
            raise ValueError(f'"pattern.kind" is {untrusted.shown(kind)}, expected fringe')
        projector, lamps = pattern.get("projector"), pattern.get("projectors")
        if projector is not None and lamps is not None:
            raise ValueError('"pattern" has "projector" and "projectors", expected one of them')
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
            () if lamps is None else _lamps(lamps, cameras),
            placement_from_dict(pipe, "pipe") if "rotation" in pipe else (STILL, (0.0, 0.0, 0.0)),
            untrusted.within(pattern.get("rms_rad", 0.0), '"pattern.rms_rad"', 0.0, np.pi),
        )

    def eyes(self) -> tuple[tuple[Eye, int, tuple[int, ...]], ...]:
        """Each camera with each slide it looks at, in the pipe's frame: the eye, the camera's id, the slots at which
        that slide is lit (none: all)."""
        lamps = self.lamps or (() if self.projector is None else (SlideLamp(self.projector),))
        turn, moved = np.array(self.mount[0]), np.array(self.mount[1])
        out = []
        for lamp in lamps:
            slide = lamp.projector
            light = replace(
                slide,
                centre_mm=vector_of(turn @ np.array(slide.centre_mm) + moved),
                rotation=matrix_of(np.array(slide.rotation) @ turn.T),
            )
            for one in self.cameras:
                if not lamp.cameras or one.id in lamp.cameras:
                    own = np.array(one.rotation) @ turn.T
                    seen = HeadCamera(
                        one.id, one.camera, matrix_of(own), vector_of(np.array(one.translation_mm) - own @ moved)
                    )
                    out.append((Eye(seen, light), one.id, lamp.slots))
        return tuple(out)

    def with_projector(self, slide: FringeProjector) -> "FringeHead":
        """The same head under one slide, told in the pipe's frame as `eyes` gives it."""
        turn, moved = np.array(self.mount[0]), np.array(self.mount[1])
        own = replace(
            slide,
            centre_mm=vector_of(turn.T @ (np.array(slide.centre_mm) - moved)),
            rotation=matrix_of(np.array(slide.rotation) @ turn),
        )
        return replace(self, projector=own)

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


def _lamps(value: object, cameras: Sequence[HeadCamera]) -> tuple[SlideLamp, ...]:
    where = '"pattern.projectors"'
    if not isinstance(value, list) or not 1 <= len(value) <= LAMPS_MAX:
        raise ValueError(f"{where} must be a list of 1..{LAMPS_MAX} slides")
    known, out = {one.id for one in cameras}, []
    for i, section in enumerate(value):
        slide = FringeProjector.from_dict(section)
        assert isinstance(section, Mapping)
        ids, slots = (_places(section.get(key, []), f'{where}[{i}]."{key}"') for key in ("cameras", "slots"))
        if set(ids) - known:
            raise ValueError(f'{where}[{i}]."cameras" names {min(set(ids) - known)}, which is no camera of the head')
        out.append(SlideLamp(slide, ids, slots))
    return tuple(out)


def _places(value: object, where: str) -> tuple[int, ...]:
    if not isinstance(value, list) or len(value) > CAMERA_ID_MAX:
        raise ValueError(f"{where} must be a list of whole numbers")
    return tuple(untrusted.whole(one, where, 0, CAMERA_ID_MAX) for one in value)


def lamps_to_list(lamps: Sequence[SlideLamp]) -> list[dict[str, Any]]:
    """`pattern.projectors`, as `FringeHead.from_dict` reads it."""
    return [
        {**projector_to_dict(lamp.projector), "cameras": list(lamp.cameras), "slots": list(lamp.slots)}
        for lamp in lamps
    ]


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
    if slide.harmonics:
        out["harmonics"] = list(slide.harmonics)
    if slide.distortion:
        out["distortion"] = list(slide.distortion)
    if slide.mirror_mm:
        out["mirror"] = {"centre_mm": list(slide.mirror_mm[:3]), "radius_mm": slide.mirror_mm[3]}
    return out
