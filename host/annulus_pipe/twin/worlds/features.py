"""What may be wrong with a wall, as changes of its radius: what the renderer shows and what a score calls true."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray

FeatureKind = Literal["pocket", "bump", "groove", "oval"]
DefectKind = Literal["loss", "bump", "ovality"]
_DEFECT_KIND: Mapping[FeatureKind, DefectKind] = {"pocket": "loss", "groove": "loss", "bump": "bump", "oval": "ovality"}


@dataclass(frozen=True, slots=True)
class WorldFeature:
    """One thing wrong with a wall. Centre, extent and size as a defect list gives them.

    pocket: rectangle of material lost, `depth_mm` deep, walls steep over `edge_mm`. groove: the same all round.
    bump: spherical cap standing `depth_mm` into the pipe, foot `length_mm` across.
    oval: radius changes by +-`depth_mm` as cos 2(clock - clock_deg) over `length_mm`, faded in and out by cosines.
    """

    kind: FeatureKind
    z_mm: float
    length_mm: float
    depth_mm: float
    clock_deg: float = 0.0
    arc_deg: float = 360.0
    edge_mm: float = 0.4

    def deviation(self, clock_deg: FloatArray, z_mm: FloatArray, radius_mm: float) -> FloatArray:
        """Change of the wall's radius in mm (positive = material lost), broadcast over `clock_deg` and `z_mm`."""
        around = np.radians(wrap_deg(clock_deg - self.clock_deg)) * radius_mm
        along = z_mm - self.z_mm
        if self.kind == "bump":
            foot, height = self.length_mm / 2, self.depth_mm
            ball = (foot * foot + height * height) / (2 * height)
            inside = np.maximum(ball * ball - around * around - along * along, 0.0)
            return np.asarray(-np.maximum(np.sqrt(inside) - (ball - height), 0.0))
        if self.kind == "oval":
            fade = np.clip(2 * np.abs(along) / self.length_mm, 0.0, 1.0)
            swell = np.cos(2 * np.radians(clock_deg - self.clock_deg))
            return np.asarray(self.depth_mm * swell * (0.5 + 0.5 * np.cos(np.pi * fade)))
        within = self.length_mm / 2 - np.abs(along)
        if self.kind == "pocket":
            within = np.minimum(within, math.radians(self.arc_deg) / 2 * radius_mm - np.abs(around))
        return np.asarray(self.depth_mm * np.clip(within / self.edge_mm + 0.5, 0.0, 1.0) + 0.0 * around)

    def edge_distance_mm(self, clock_deg: FloatArray, z_mm: FloatArray, radius_mm: float) -> FloatArray:
        """Distance along the wall (mm) to where this feature's radius jumps; infinite for one that fades.

        Zero where light of the projector, which comes along the pipe, does not reach: the floor behind the near wall,
        the far rim, the lee of a bump. What is seen there is a shadow's edge and not a slit's.
        """
        around = np.abs(np.radians(wrap_deg(clock_deg - self.clock_deg))) * radius_mm
        along = z_mm - self.z_mm + 0.0 * around
        half = self.length_mm / 2
        if self.kind == "oval":
            return np.full(along.shape, np.inf)
        if self.kind == "bump":
            off_foot = np.hypot(around, along) - half
            return np.where((off_foot < 3.5 * self.depth_mm) & (along > 0), 0.0, np.abs(off_foot))
        over_z = np.abs(along) - half
        over_arc = around - math.radians(self.arc_deg) / 2 * radius_mm if self.kind == "pocket" else over_z - 1e9
        inside = (over_arc < 0) & (over_z < 0)
        outside_mm = np.hypot(np.maximum(over_arc, 0), np.maximum(over_z, 0))
        distance = np.where(inside, -np.maximum(over_arc, over_z), outside_mm)
        lee = np.where(
            inside, along + half < 3 * self.depth_mm, (along > -half - 1) & (along < half + 3 * self.depth_mm)
        )
        return np.where(lee & (over_arc < 2.0), 0.0, distance)

    def as_defect(self, radius_mm: float) -> dict[str, Any]:
        """The row a perfect defect list would hold for this feature (ARCHITECTURE §7); of an oval it is the diameter
        whose departure counts as depth.
        """
        return {
            "kind": _DEFECT_KIND[self.kind],
            "z_mm": self.z_mm,
            "clock_deg": self.clock_deg,
            "clock": clock_text(self.clock_deg),
            "length_mm": self.length_mm,
            "arc_deg": math.degrees(self.length_mm / radius_mm) if self.kind == "bump" else self.arc_deg,
            "depth_mm": 2 * self.depth_mm if self.kind == "oval" else self.depth_mm,
        }


def clock_text(clock_deg: float) -> str:
    """Clock position as written in a report: 90 degrees -> "3:00", rounded to five minutes of the dial."""
    minutes = round((clock_deg % 360.0) * 2 / 5) * 5 % 720
    return f"{(minutes // 60) or 12}:{minutes % 60:02d}"


def wrap_deg(degrees: FloatArray) -> FloatArray:
    """An angle, -180 to 180."""
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)
