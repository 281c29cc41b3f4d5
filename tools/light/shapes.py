"""A drawn pipe as Mitsuba has it: its wall as triangles, what stands in its bore, and what both are made of.

The wall's triangles and its specks of dirt are laid out in the true surface's own coordinates (clock, chainage).
"""

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tools.bench.blind.mesh import mesh
from tools.bench.blind.pipe import Material, Scene, Thing
from tools.bench.blind.surface import BOTTOMS, Surface, out
from tools.light.effects import Effects
from tools.light.mitsuba3 import mi

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
FIRST_OF_RADIUS, AHEAD_OF_RADIUS = 0.2, 1.2  # of the head's first place, and of the last ring: wall is drawn between
SPECK_OF_RADIUS = 0.015  # sigma of the noise that dirt is made of
DIRTY = 0.3  # of the wall's albedo
TURNS = 72  # flats round a hole
CUTS = 3  # times that a triangle at a hole's edge is halved
DARK = (0.05, 0.05, 0.06)  # cables and rods
GREY, MUD = (0.3, 0.3, 0.32), (0.17, 0.13, 0.09)


def pipe_shapes(scene: Scene, effects: Effects, last_mm: float) -> dict[str, Any]:
    """Shapes of everything but the head, as far as `last_mm` of the rings' light."""
    surface, radius = Surface(scene.pipe), scene.pipe.radius_mm
    first, last = FIRST_OF_RADIUS * radius, last_mm + AHEAD_OF_RADIUS * radius
    points, faces = mesh(surface, first, last)
    rng = np.random.default_rng([scene.seed, 0x11647])
    wall = skin(_colour(scene.pipe.material, radius, last - first, rng), effects)
    shapes: dict[str, Any] = {}
    for k, thing in enumerate(scene.pipe.things):
        if thing.kind in ("branch", "tee"):
            points, faces = _hole(surface, thing, points, faces)
        for j, shape in enumerate(_object(surface, thing, radius, scene.pipe.material, effects)):
            shapes[f"thing{k}_{j}"] = shape
    clock, z, _ = surface.from_space(points)
    return {"wall": triangles(points, faces, wall, _unrolled(clock, faces), (z - first) / (last - first)), **shapes}


def skin(colour: Any, effects: Effects, matt: bool = False) -> dict[str, Any]:
    """A wall of a colour under a rough dielectric, if there is one; seen from both sides."""
    if effects.alpha and not matt:
        inside = {
            "type": "roughplastic",
            "distribution": "beckmann",
            "alpha": effects.alpha,
            "int_ior": effects.index,
            "nonlinear": True,
            "diffuse_reflectance": colour,
        }
    else:
        inside = {"type": "diffuse", "reflectance": colour}
    return {"type": "twosided", "bsdf": inside}


def rgb(values: Iterable[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in values]}


def triangles(points: Array, faces: Faces, bsdf: dict[str, Any], u: Array | None = None, v: Array | None = None) -> Any:
    """A Mitsuba mesh with flat faces; u, v : of each vertex, on its texture."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    properties["face_normals"] = True
    shape = mi.Mesh("mesh", len(points), len(faces), properties, has_vertex_texcoords=u is not None)
    buffers = mi.traverse(shape)
    buffers["vertex_positions"] = np.ascontiguousarray(points, np.float32).ravel()
    buffers["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
    if u is not None and v is not None:
        buffers["vertex_texcoords"] = np.stack([u, v], 1).astype(np.float32).ravel()
    buffers.update()
    return shape


# ---- colour --------------------------------------------------------------------------------------------------------
def _colour(material: Material, radius: float, length: float, rng: Generator) -> dict[str, Any]:
    if not material.dirt:
        return rgb(material.albedo)
    wide = 1024
    high = max(16, round(wide * length / (2.0 * math.pi * radius)))
    sigma = SPECK_OF_RADIUS / (2.0 * math.pi) * wide
    noise = rng.normal(size=(high, 3 * wide))
    noise[:, :wide] = noise[:, 2 * wide :] = noise[:, wide : 2 * wide]  # it meets itself round the pipe
    noise = cv2.GaussianBlur(noise, (0, 0), sigma)[:, wide : 2 * wide]
    edge, soft = np.quantile(noise, 1.0 - material.dirt), 0.1 * noise.std()
    dirt = np.clip((noise - edge) / soft + 0.5, 0.0, 1.0)[..., None]
    image = (1.0 - dirt * (1.0 - DIRTY)) * np.array(material.albedo)
    bitmap = mi.Bitmap(image[::-1].astype(np.float32).copy())  # v goes up
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat"}


def _unrolled(clock: Array, faces: Faces) -> Array:
    """Parts of a turn of every vertex; a triangle that meets 12 o'clock from the left goes on beyond 1. Vertices there
    are of that side alone, for blocks of the mesh share none."""
    turn = np.round(clock, 7) % 360.0 / 360.0
    corners = turn[faces]
    over = corners.max(axis=1) - corners.min(axis=1) > 0.5
    low = np.unique(faces[over][corners[over] < 0.5])
    turn[low] += 1.0
    return turn


# ---- what stands in the bore ---------------------------------------------------------------------------------------
def _axes(surface: Surface, thing: Thing) -> tuple[Array, Array, Array, Array]:
    """Place on the centre line, and unit vectors across, ahead and to the thing."""
    origin, frame = surface.frame_at(thing.z_mm)
    way = frame @ np.array([*out(np.array(thing.clock_deg)), 0.0])
    return origin, np.cross(frame[:, 2], way), frame[:, 2], way


def _hole(surface: Surface, thing: Thing, points: Array, faces: Faces) -> tuple[Array, Faces]:
    """The wall without what lies in a round hole; triangles at its edge are halved before they are left out."""
    origin, across, ahead, way = _axes(surface, thing)
    radius = thing.numbers["inner_d_mm"] / 2

    def away(at: Array) -> Array:
        local = at - origin
        return np.where(local @ way > 0.0, np.hypot(local @ across, local @ ahead), np.inf)

    for _ in range(CUTS):
        corner = away(points)[faces]
        reach = np.linalg.norm(points[faces] - points[np.roll(faces, 1, axis=1)], axis=2).max(axis=1)
        near = (
            (corner.min(axis=1) < radius + reach)
            & (corner.max(axis=1) > radius - reach)
            & np.isfinite(corner.max(axis=1))
        )
        points, faces = _halved(points, faces, near)
    return points, faces[away(points[faces].mean(axis=1)) > radius]


def _halved(points: Array, faces: Faces, which: NDArray[np.bool_]) -> tuple[Array, Faces]:
    """Each of `which` as four. Neighbours keep their long side: the seam is closed, for both lie on one line."""
    a, b, c = points[faces[which]].transpose(1, 0, 2)
    corners = np.concatenate([a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2])
    n, start = len(a), len(points)
    index = start + np.arange(6 * n).reshape(6, n)
    new = [index[[i, j, k]].T for i, j, k in ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))]
    return np.concatenate([points, corners]), np.concatenate([faces[~which], *new])


def _object(surface: Surface, thing: Thing, radius: float, material: Material, effects: Effects) -> list[Any]:
    """What a thing adds to the wall."""
    if thing.kind not in (*BOTTOMS, "branch", "tee", "cable", "hose"):
        return []
    origin, across, ahead, way = _axes(surface, thing)
    half, wall = thing.length_mm / 2, float(surface.shape(np.array(thing.clock_deg), np.array(thing.z_mm)))
    plastic = skin(rgb(material.albedo), effects)
    if thing.kind == "cable":
        middle = origin + thing.numbers["aside_mm"] * way
        return [_rod(middle - 1.3 * radius * across, middle + 1.3 * radius * across, half, DARK)]
    if thing.kind == "hose":
        thick = thing.numbers["thick_mm"] / 2
        ends = [origin + (wall - thick) * way + side * (half - thick) * ahead for side in (-1.0, 1.0)]
        balls = [
            {"type": "sphere", "center": list(end), "radius": thick, "bsdf": skin(rgb(GREY), effects, matt=True)}
            for end in ends
        ]
        return [_rod(ends[0], ends[1], thick, GREY), *balls]
    if thing.kind in BOTTOMS:
        level, wide = thing.numbers["level_mm"], 1.2 * radius
        wet = Effects(alpha=0.05, index=1.33) if thing.kind == "water" else Effects()
        corners = np.array(
            [
                origin + x * across + y * ahead + z * way
                for z in (level, wide)
                for y in (-half, half)
                for x in (-wide, wide)
            ]
        )
        quads = ((0, 1, 3, 2), (0, 1, 5, 4), (2, 3, 7, 6))  # its top and both its ends
        faces = np.array([[q[i] for i in tri] for q in quads for tri in ((0, 1, 2), (0, 2, 3))])
        return [triangles(corners, faces, skin(rgb(MUD), wet))]
    inner, outer = thing.numbers["inner_d_mm"] / 2, thing.numbers["outer_d_mm"] / 2
    turn = np.linspace(0.0, 2.0 * math.pi, TURNS + 1)
    far = np.full(len(turn), 2.2 * radius)

    def ring(r: float, height: Array) -> Array:
        return origin + np.cos(turn)[:, None] * r * across + np.sin(turn)[:, None] * r * ahead + height[:, None] * way

    if thing.kind == "branch":
        start = np.sqrt(np.maximum((0.998 * wall) ** 2 - (inner * np.cos(turn)) ** 2, 0.0))
        rings = [ring(inner, start), ring(inner, far)]
    else:
        start = np.full(len(turn), wall - thing.depth_mm)
        rings = [ring(inner, far), ring(inner, start), ring(outer, start), ring(outer, far)]
    return [triangles(*_strip(a, b), plastic) for a, b in pairwise(rings)]


def _strip(one: Array, other: Array) -> tuple[Array, Faces]:
    n = len(one)
    i = np.arange(n - 1)
    return np.concatenate([one, other]), np.concatenate(
        [np.stack([i, i + 1, n + i], 1), np.stack([i + 1, n + i + 1, n + i], 1)]
    )


def _rod(first: Array, last: Array, thick: float, colour: Iterable[float]) -> dict[str, Any]:
    return {
        "type": "cylinder",
        "p0": list(first),
        "p1": list(last),
        "radius": thick,
        "bsdf": skin(rgb(colour), Effects()),
    }


def rods(head_rods: Iterable[tuple[float, float, float]], at: Array, axes: Array, back_mm: float) -> dict[str, Any]:
    """Rods beside the camera, from `back_mm` behind it to its own plane, where it does not see them."""
    shapes = {}
    for k, (clock, away, thick) in enumerate(head_rods):
        x, y = away * out(np.array(clock))
        ends = [at + axes @ np.array([x, y, z]) for z in (-back_mm, 0.0)]
        shapes[f"rod{k}"] = _rod(ends[0], ends[1], thick, DARK)
    return shapes
