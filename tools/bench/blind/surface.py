"""The true inner wall: r(clock, chainage) about a centre line of pieces, and the way between both and space.

Everything that is asked of a survey is worked out here and nowhere else, so what POV-Ray is handed (`mesh`) and what a
score calls true cannot part.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tools.bench.blind.pipe import Pipe, Thing

Array = NDArray[np.float64]
RINGED = ("groove", "joint", "gap")  # things that go all round
BOTTOMS = ("silt", "water")  # flat and opaque: water as a drain has it, through which nobody sees
NO_WALL = ("branch", "tee", "cable", "hose")  # the surface first met there is none of r(clock, z)


def out(clock_deg: Array) -> Array:
    """(.., 2) the way outwards, x right and y down."""
    t = np.radians(clock_deg)
    return np.stack([np.sin(t), -np.cos(t)], -1)


def away_deg(clock_deg: Array, other: float | Array) -> Array:
    """Signed degrees from one clock angle to another, -180..180."""
    return np.asarray((np.asarray(clock_deg) - other + 180.0) % 360.0 - 180.0)


class Surface:
    """One pipe's wall. Arrays of clock (degrees) and chainage (mm) are broadcast."""

    def __init__(self, pipe: Pipe) -> None:
        self.pipe = pipe
        self.starts = np.array([one.start_mm for one in pipe.pieces])
        origin, frame = np.array([0.0, 0.0, pipe.pieces[0].start_mm]), np.eye(3)
        self.origins, self.frames = [origin], [frame]
        for before, piece in zip(pipe.pieces, pipe.pieces[1:], strict=False):
            moved, turned = _follow(before.curvature, np.array(piece.start_mm - before.start_mm))
            origin = origin + frame @ moved + frame @ turned @ np.array([*piece.offset_mm, 0.0])
            frame = frame @ turned @ _lean(piece.turn_rad)
            self.origins.append(origin)
            self.frames.append(frame)

    # ---- r(clock, z) ---------------------------------------------------------------------------------------------
    def piece(self, z: Array) -> NDArray[np.intp]:
        return np.maximum(np.searchsorted(self.starts, z, side="right") - 1, 0)

    def plain(self, z: Array) -> Array:
        """Mean radius of the pipe, without things."""
        own = self.piece(z)
        radius, taper = (np.array([getattr(one, name) for one in self.pipe.pieces]) for name in ("radius_mm", "taper"))
        return np.asarray(radius[own] + taper[own] * (z - self.starts[own]))

    def oval(self, z: Array) -> Array:
        """Part of the radius by which the long axis stands out."""
        middle, width = self.pipe.swell_mm
        return np.asarray(self.pipe.oval + self.pipe.swell * np.exp(-(((z - middle) / width) ** 2)))

    def shape(self, clock: Array, z: Array) -> Array:
        """Radius without things: round, oval and lobed."""
        t = np.radians(clock)
        waves = self.oval(z) * np.cos(2 * (t - math.radians(self.pipe.oval_clock_deg)))
        for order, (part, at) in zip((3, 4), self.pipe.lobes, strict=True):
            waves = waves + part * np.cos(order * (t - math.radians(at)))
        return np.asarray(self.plain(z) * (1.0 + waves))

    def radius(self, clock: Array, z: Array, *, bottoms: bool = True) -> Array:
        """Radius of the wall with everything on it that is a surface r(clock, z); silt and water are its `bottoms`."""
        clock, z = np.broadcast_arrays(np.asarray(clock, float), np.asarray(z, float))
        shape = self.shape(clock, z)
        r = shape.copy()
        for thing in self.pipe.things:
            if thing.kind in ("pocket", "groove", "bump", "dent", "joint"):
                r = r + _departure(thing, clock, z, self.pipe.radius_mm)
        for thing in self.pipe.things:
            inside = np.abs(z - thing.z_mm) < thing.length_mm / 2
            if thing.kind == "gap":
                r = np.where(inside, thing.numbers["socket_mm"], r)
            elif bottoms and thing.kind in BOTTOMS:
                down = np.cos(np.radians(away_deg(clock, thing.clock_deg)))
                level = thing.numbers["level_mm"] / np.maximum(down, 1e-6)
                r = np.where(inside & (down > 0) & (level < r), level, r)
        return np.asarray(r)

    # ---- space ---------------------------------------------------------------------------------------------------
    def frame_at(self, z: float) -> tuple[Array, Array]:
        """Point of the centre line and its frame (columns x, y, ahead) in space."""
        own = int(self.piece(np.array(z)))
        moved, turned = _follow(self.pipe.pieces[own].curvature, np.array(z - self.starts[own]))
        return self.origins[own] + self.frames[own] @ moved, self.frames[own] @ turned

    def to_space(self, clock: Array, z: Array, r: Array) -> Array:
        """(.., 3) points of space."""
        clock, z, r = np.broadcast_arrays(*(np.asarray(one, float) for one in (clock, z, r)))
        own, points = self.piece(z), np.empty((*z.shape, 3))
        for i, piece in enumerate(self.pipe.pieces):
            here = own == i
            if here.any():
                moved, turned = _follow(piece.curvature, z[here] - self.starts[i])
                flat = np.concatenate([out(clock[here]) * r[here][:, None], np.zeros((here.sum(), 1))], 1)
                local = moved + np.einsum("nij,nj->ni", turned, flat)
                points[here] = self.origins[i] + local @ self.frames[i].T
        return points

    def from_space(self, points: Array) -> tuple[Array, Array, Array]:
        """Clock (degrees), chainage and radius of points (N, 3); each by the last piece that it lies in."""
        clock, z, r = (np.full(len(points), np.nan) for _ in range(3))
        ends = [*self.starts[1:], np.inf]
        for i, piece in enumerate(self.pipe.pieces):
            along, aside = _unroll(piece.curvature, (points - self.origins[i]) @ self.frames[i])
            s = self.starts[i] + along
            here = (s >= self.starts[i] if i else np.ones(len(s), bool)) & ((s < ends[i]) | np.isnan(z))
            clock[here] = np.degrees(np.arctan2(aside[here, 0], -aside[here, 1])) % 360.0
            z[here], r[here] = s[here], np.hypot(aside[here, 0], aside[here, 1])
        return clock, z, r


def _departure(thing: Thing, clock: Array, z: Array, radius: float) -> Array:
    """How far a thing stands out (loss) or in, mm, at its places."""
    along = z - thing.z_mm
    around = np.radians(away_deg(clock, thing.clock_deg)) * radius
    if thing.kind == "groove":
        return thing.depth_mm * _box(along, thing.length_mm, thing.ramp_mm)
    if thing.kind == "pocket":
        width = math.radians(thing.arc_deg) * radius
        box = np.minimum(_box(along, thing.length_mm, thing.ramp_mm), _box(around, width, thing.ramp_mm))
        return thing.depth_mm * box
    if thing.kind == "joint":
        return -bead_mm(thing, clock) * _rolls(np.abs(along) / (thing.length_mm / 2))
    half = math.radians(thing.arc_deg / 2) * radius
    square = (along / (thing.length_mm / 2)) ** 2 + (around / half) ** 2
    return np.asarray(-thing.depth_mm * np.maximum(1.0 - square, 0.0) ** 2)


def bead_mm(thing: Thing, clock: Array) -> Array:
    """Height of a joint's bead round the clock."""
    uneven = 1.0 + thing.numbers["uneven"] * np.cos(np.radians(away_deg(clock, thing.clock_deg)))
    return np.asarray(thing.depth_mm * uneven)


def _rolls(u: Array) -> Array:
    """Two rolls side by side, seen from their middle: 1 at each crest, 0 from u = 1 on."""
    outer = 1.0 - ((u - 0.5) / 0.5) ** 2
    return np.asarray(np.where(u >= 1.0, 0.0, np.where(u > 0.5, outer, 0.55 + 0.45 * (1.0 - ((0.5 - u) / 0.5) ** 2))))


def _box(x: Array, length: float, ramp: float) -> Array:
    """1 inside, 0 outside, rising over `ramp` within its ends."""
    return np.asarray(np.clip((length / 2 - np.abs(x)) / max(ramp, 1e-6), 0.0, 1.0))


def _lean(turn: tuple[float, float]) -> Array:
    """The rotation that turns what goes ahead towards (x, y) by |turn|."""
    angle = math.hypot(*turn)
    if angle == 0.0:
        return np.eye(3)
    x, y = turn[0] / angle, turn[1] / angle
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


def _follow(curvature: tuple[float, float], along: Array) -> tuple[Array, Array]:
    """(.., 3) way gone from a piece's start and (.., 3, 3) the frame there, in the start's frame."""
    along = np.asarray(along, float)
    k = math.hypot(*curvature)
    moved = np.zeros((*along.shape, 3))
    turned = np.broadcast_to(np.eye(3), (*along.shape, 3, 3)).copy()
    if k == 0.0:
        moved[..., 2] = along
        return moved, turned
    x, y = curvature[0] / k, curvature[1] / k
    angle = k * along
    aside = (1.0 - np.cos(angle)) / k
    moved[..., 0], moved[..., 1], moved[..., 2] = aside * x, aside * y, np.sin(angle) / k
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    turned = turned + np.sin(angle)[..., None, None] * cross + (1.0 - np.cos(angle))[..., None, None] * (cross @ cross)
    return moved, turned


def _unroll(curvature: tuple[float, float], local: Array) -> tuple[Array, Array]:
    """(N,) way along a piece and (N, 2) place across it, of points in its start's frame."""
    k = math.hypot(*curvature)
    if k == 0.0:
        return local[:, 2], local[:, :2]
    towards = np.array([curvature[0], curvature[1]]) / k
    bent = local[:, :2] @ towards
    angle = np.arctan2(local[:, 2], 1.0 / k - bent)
    straight = local[:, :2] - bent[:, None] * towards
    from_line = 1.0 / k - np.hypot(1.0 / k - bent, local[:, 2])
    return angle / k, straight + from_line[:, None] * towards


def beside_places(pipe: Pipe) -> Iterator[tuple[str, float, float]]:
    """Kind, first and last chainage of whatever breaks the line of the pipe or stands into it all round."""
    for thing in pipe.things:
        if thing.kind in ("joint", "gap", "reducer", "taper"):
            yield thing.kind, *thing.span_mm
