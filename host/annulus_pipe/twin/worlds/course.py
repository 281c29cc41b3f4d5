"""A pipe that is no one straight tube: pieces in a row, what stands where they meet, openings, standing water.

Space is the pipe frame of the first piece: x right, y down, z along it, its beginning at z = 0; the first piece goes on
behind that, the last one ahead of all. A clock position c is the direction (sin c, -cos c) across the pipe, carried
along without twist. Chainage counts along the axis of every piece.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError


@dataclass(frozen=True, slots=True)
class WorldJoint:
    """Where a piece begins: how it is set to the one before, and the bead of butt fusion.

    The bead is two half ellipses `height_mm` high, side by side over `width_mm`, and a notch `notch_mm` deep between.
    """

    hilo_mm: float = 0.0  # how far its axis is set aside ..
    hilo_clock_deg: float = 0.0  # .. and where to
    angle_deg: float = 0.0  # how far it turns, there and then
    angle_clock_deg: float = 0.0
    height_mm: float = 0.0
    width_mm: float = 8.0
    notch_mm: float = 1.0


@dataclass(frozen=True, slots=True)
class WorldPiece:
    """Straight, or a bend where `bend_radius_mm` (of its axis) is given, turning towards a clock position; its radius
    goes from `radius_mm` to `end_radius_mm`. A piece inside a coupling is one with the socket's radius.
    """

    length_mm: float
    radius_mm: float
    end_radius_mm: float | None = None
    bend_radius_mm: float = 0.0
    toward_deg: float = 90.0
    joint: WorldJoint | None = None
    is_gap: bool = False  # between two pipe ends
    brightness: float = 1.0  # of the world's albedo


@dataclass(frozen=True, slots=True)
class WorldOpening:
    """A branch: a bore square to the pipe's axis, `deep_mm` from it."""

    z_mm: float
    clock_deg: float
    inner_d_mm: float
    deep_mm: float = 150.0


@dataclass(frozen=True)
class Course:
    """A pipe's pieces in order. `level_mm`: still, clear water stands that far below the axis of a level pipe."""

    pieces: tuple[WorldPiece, ...]
    openings: tuple[WorldOpening, ...] = ()
    level_mm: float | None = None

    def __post_init__(self) -> None:
        if not self.pieces or any(p.length_mm <= 0 or p.radius_mm <= 0 for p in self.pieces):
            raise AnnulusError("course: expected pieces whose length and radius are above zero")
        if any(0 < p.bend_radius_mm <= p.radius_mm for p in self.pieces):
            raise AnnulusError("course: a bend's axis must be further from its centre than its wall")
        if self.level_mm is not None and len(self.pieces) > 1:
            raise AnnulusError("course: water stands in one straight piece only")

    @cached_property
    def starts_mm(self) -> FloatArray:
        """(P,) chainage at which each piece begins."""
        return np.concatenate([[0.0], np.cumsum([p.length_mm for p in self.pieces[:-1]])])

    @cached_property
    def placed(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Of every piece, where it begins, (3,) mm, and its right, down and forward as columns, (3, 3)."""
        origin, axes = np.zeros(3), np.eye(3)
        out = []
        for i, piece in enumerate(self.pieces):
            if i > 0 and (joint := piece.joint) is not None:
                origin = origin + axes @ (joint.hilo_mm * across(joint.hilo_clock_deg))
                axes = axes @ turned(joint.angle_clock_deg, math.radians(joint.angle_deg))
            out.append((origin, axes))
            origin, axes = _along(piece, origin, axes, piece.length_mm)
        return tuple(out)

    def frame(self, z_mm: float) -> tuple[FloatArray, FloatArray, int]:
        """The axis at a chainage: (3,) mm, its axes as columns, (3, 3), and the piece it is in."""
        i = max(int(np.searchsorted(self.starts_mm, z_mm, side="right")) - 1, 0)
        origin, axes = _along(self.pieces[i], *self.placed[i], z_mm - float(self.starts_mm[i]))
        return origin, axes, i

    def features(self) -> list[dict[str, Any]]:
        """What a perfect survey would list, in the words of summary.json."""
        out = []
        for i, (piece, start) in enumerate(zip(self.pieces, self.starts_mm, strict=True)):
            before = self.pieces[i - 1] if i else piece
            end = piece.radius_mm if piece.end_radius_mm is None else piece.end_radius_mm
            if piece.is_gap:
                after = self.pieces[i + 1]
                out.append(_row("gap", start, start + piece.length_mm, gap_mm=piece.length_mm, **_set(after, before)))
            elif i and piece.joint is not None and not before.is_gap:
                half = piece.joint.width_mm / 2
                bead = {"height_mm": piece.joint.height_mm, "width_mm": piece.joint.width_mm}
                measures = {**(bead if piece.joint.height_mm else {}), **_set(piece, before)}
                out.append(_row("joint", start - half, start + half, **measures))
            if piece.bend_radius_mm:
                out.append(_row("bend", start, start + piece.length_mm, **self._bend(i)))
            if end != piece.radius_mm:
                out.append(_row("taper", start, start + piece.length_mm, radius_after_mm=end))
        for one in self.openings:
            half, piece = one.inner_d_mm / 2, self.pieces[self.frame(one.z_mm)[2]]
            arc = 2 * math.degrees(math.asin(half / piece.radius_mm))
            row = _row("branch", one.z_mm - half, one.z_mm + half, inner_d_mm=one.inner_d_mm)
            out.append({**row, "clock_deg": one.clock_deg, "arc_deg": arc})
        if self.level_mm is not None:
            arc = 2 * math.degrees(math.acos(self.level_mm / self.pieces[0].radius_mm))
            row = _row("water", 0.0, self.pieces[0].length_mm, level_mm=self.level_mm)
            out.append({**row, "clock_deg": 180.0, "arc_deg": arc})
        return out

    def truth(self) -> dict[str, Any]:
        """What stands in a truth.json besides the world: features, and bends as centreline.json has them."""
        first = self.pieces[0].radius_mm
        return {"named": self.features(), "centreline": {"bends": self.bends(), "pipe_radius_mm": first}}

    def bends(self) -> list[dict[str, float]]:
        """As centreline.json has them."""
        return [self._bend(i) for i, piece in enumerate(self.pieces) if piece.bend_radius_mm]

    def _bend(self, i: int) -> dict[str, float]:
        piece = self.pieces[i]
        angle = math.degrees(piece.length_mm / piece.bend_radius_mm)
        plane = (piece.toward_deg - 90.0 + 180.0) % 360.0 - 180.0
        start = float(self.starts_mm[i])
        return {"start_mm": start, "radius_mm": piece.bend_radius_mm, "angle_deg": angle, "plane_deg": plane}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Course":
        pieces = tuple(
            WorldPiece(**{**one, "joint": None if one["joint"] is None else WorldJoint(**one["joint"])})
            for one in data["pieces"]
        )
        return cls(pieces, tuple(WorldOpening(**one) for one in data["openings"]), data["level_mm"])


def across(clock_deg: float) -> FloatArray:
    """(3,) unit vector from the axis to a clock position, in a piece's own axes."""
    c = math.radians(clock_deg)
    return np.array([math.sin(c), -math.cos(c), 0.0])


def turned(clock_deg: float, angle: float) -> FloatArray:
    """(3, 3) turn of the forward axis towards a clock position by `angle` radians, without twist."""
    way, forward = across(clock_deg), np.array([0.0, 0.0, 1.0])
    normal = np.cross(forward, way)
    skew = np.array([[0, -normal[2], normal[1]], [normal[2], 0, -normal[0]], [-normal[1], normal[0], 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * skew + (1 - math.cos(angle)) * skew @ skew)


def _along(piece: WorldPiece, origin: FloatArray, axes: FloatArray, s: float) -> tuple[FloatArray, FloatArray]:
    if not piece.bend_radius_mm:
        return origin + axes[:, 2] * s, axes
    bend, angle = piece.bend_radius_mm, s / piece.bend_radius_mm
    local = bend * (1 - math.cos(angle)) * across(piece.toward_deg) + np.array([0, 0, bend * math.sin(angle)])
    return origin + axes @ local, axes @ turned(piece.toward_deg, angle)


def _set(piece: WorldPiece, before: WorldPiece) -> dict[str, float]:
    """How a piece is set to the one before, as measured."""
    joint = piece.joint or WorldJoint()
    end = before.radius_mm if before.end_radius_mm is None else before.end_radius_mm
    return {
        "hilo_mm": joint.hilo_mm,
        "hilo_clock_deg": joint.hilo_clock_deg,
        "angle_deg": joint.angle_deg,
        "angle_clock_deg": joint.angle_clock_deg,
        "step_mm": 2 * (piece.radius_mm - end),
        "radius_after_mm": piece.radius_mm,
    }


def _row(kind: str, start: float, end: float, **measures: float) -> dict[str, Any]:
    place = {"z_mm": float(start + end) / 2, "length_mm": float(end - start), "clock_deg": 0.0, "arc_deg": 360.0}
    return {"kind": kind, **place, **measures}
