"""A scene from a seed: everything is drawn here, before anything is rendered, from wide distributions.

Sizes of what is in a pipe are parts of its radius, for a head is built to its pipe. Nothing here was chosen on what a
survey makes of it.
"""

import math
from typing import Any

import numpy as np
from numpy.random import Generator

from tools.bench.blind.head import Reach, draw_head, draw_stands, reach_of
from tools.bench.blind.pipe import Change, Material, Piece, Pipe, Scene, Sensor, Thing
from tools.bench.blind.things import place_things

INCH = 25.4
BORES_INCH = (2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0)
BORE_ODDS = (0.1, 0.12, 0.2, 0.28, 0.14, 0.08, 0.08)
ALBEDOS = {
    "white": (0.78, 0.77, 0.74),
    "yellow": (0.80, 0.62, 0.12),
    "orange": (0.78, 0.34, 0.07),
    "black": (0.055, 0.055, 0.058),
}
LINES = ("", "joint", "gap", "reducer", "taper", "bend")
LINE_ODDS = (0.2, 0.34, 0.14, 0.08, 0.1, 0.14)
MARKS = ("drift", "knock", "burnt", "burnt band", "lost", "still", "backward", "leaning")
MARK_ODDS = (0.12, 0.12, 0.06, 0.08, 0.2, 0.12, 0.12, 0.2)


def draw(seed: int) -> Scene:
    """The scene of one seed; equal seeds draw equal scenes."""
    rng = np.random.default_rng([seed, 0xB11D])
    marks = tuple(name for name, odds in zip(MARKS, MARK_ODDS, strict=True) if rng.random() < odds)
    bore = float(rng.choice(BORES_INCH, p=BORE_ODDS)) * rng.uniform(0.92, 1.05)
    radius = bore * INCH / 2
    head = draw_head(rng, radius)
    reach = reach_of(head, radius)
    stands = draw_stands(rng, radius, marks)
    travel = max(one.z_mm for one in stands)
    seen = Reach(reach.near, travel + reach.far)
    middle, least = (seen.first + seen.last) / 2, 0.4 * radius
    sure = Reach(min(reach.far, middle - least), max(travel + reach.near, middle + least))  # every ring passes here
    pieces, lines = _course(rng, radius, sure)
    things = place_things(rng, radius, head, seen, sure, lines)
    pipe = Pipe(
        pieces,
        things,
        _material(rng),
        *_shape(rng, sure),
        tuple((abs(rng.normal(0.0, 0.0015)), rng.uniform(0.0, 360.0)) for _ in range(2)),
    )
    return Scene(seed, pipe, head, stands, _sensor(rng, marks), _change(rng, marks), _limits(rng, pipe), marks)


def _course(rng: Generator, radius: float, sure: Reach) -> tuple[tuple[Piece, ...], list[Thing]]:
    """The centre line, and the things that are part of it."""
    length = sure.last - sure.first
    pieces, lines = [Piece(-3.0 * radius, radius)], []
    kinds = [str(rng.choice(LINES, p=LINE_ODDS))]
    if kinds[0] in ("joint", "gap") and rng.random() < 0.25:
        kinds.append("joint")
    places = np.sort(rng.uniform(0.15, 0.85, len(kinds))) * length + sure.first
    if len(places) == 2 and places[1] - places[0] < 0.5 * radius:
        kinds, places = kinds[:1], places[:1]
    for kind, z in zip(kinds, places, strict=True):
        if kind:
            more, thing = _line(rng, kind, float(z), radius, pieces[-1].radius_mm)
            pieces += more
            lines.append(thing)
    return tuple(pieces), lines


def _line(rng: Generator, kind: str, z: float, size: float, radius: float) -> tuple[list[Piece], Thing]:
    """The pieces that begin with a joint, gap, reducer, taper or bend at z, and what it is called."""
    clock = float(rng.uniform(0.0, 360.0))
    way = math.sin(math.radians(clock)), -math.cos(math.radians(clock))
    if kind in ("joint", "gap"):
        hilo, kink = abs(rng.normal(0.0, 0.012)) * size, abs(rng.normal(0.0, 0.6))
        step = float(rng.choice([0.0, rng.normal(0.0, 0.008)])) * size
        turn = float(rng.uniform(0.0, 2.0 * math.pi))
        bent = (math.radians(kink) * math.cos(turn), math.radians(kink) * math.sin(turn))
        numbers = {"hilo_mm": hilo, "angle_deg": kink, "step_mm": 2.0 * step, "radius_after_mm": radius + step}
        length = size * float(rng.uniform(0.05, 0.14) if kind == "joint" else rng.uniform(0.03, 0.16))
        start = z if kind == "joint" else z + length / 2
        offset = (hilo * way[0], hilo * way[1])
        after = [Piece(start, radius + step, offset, bent)]
        if kind == "gap":
            numbers |= {"gap_mm": length, "socket_mm": radius + size * float(rng.uniform(0.06, 0.14))}
            return after, Thing(kind, z, length, clock, depth_mm=numbers["socket_mm"] - radius, numbers=numbers)
        height = size * float(rng.uniform(0.015, 0.06))
        numbers |= {"height_mm": height, "width_mm": length, "uneven": float(rng.uniform(0.0, 0.2))}
        return after, Thing(kind, z, length, clock, depth_mm=height, numbers=numbers)
    if kind == "bend":
        radius_of_bend = 2.0 * size * float(rng.choice([1.5, 3.0, 5.0]))
        angle = float(min(rng.uniform(8.0, 45.0), math.degrees(2.5 * size / radius_of_bend)))
        length = math.radians(angle) * radius_of_bend
        z = z - length / 4  # some begin and some end in what is seen
        curve = (way[0] / radius_of_bend, way[1] / radius_of_bend)
        numbers = {"start_mm": z, "radius_mm": radius_of_bend, "angle_deg": angle}
        pieces = [Piece(z, radius, curvature=curve), Piece(z + length, radius)]
        return pieces, Thing(kind, z + length / 2, length, clock, numbers=numbers)
    change = float(rng.choice([-1.0, 1.0], p=[0.75, 0.25])) * (
        rng.uniform(0.08, 0.2) if kind == "reducer" else rng.uniform(0.015, 0.04)
    )
    length = size * float(rng.uniform(0.25, 0.7) if kind == "reducer" else rng.uniform(0.9, 1.8))
    first, after_mm = z - length / 2, radius + change * size
    numbers = {"radius_before_mm": radius, "radius_after_mm": after_mm}
    pieces = [Piece(first, radius, taper=change * size / length), Piece(first + length, after_mm)]
    return pieces, Thing(kind, z, length, depth_mm=abs(change) * size, numbers=numbers)


def _shape(rng: Generator, sure: Reach) -> tuple[float, float, float, tuple[float, float]]:
    oval = float(rng.choice([rng.uniform(0.0, 0.01), rng.uniform(0.0, 0.08)], p=[0.55, 0.45]))
    swell = float(rng.choice([0.0, rng.uniform(0.0, 0.08 - oval)], p=[0.75, 0.25]))
    length = sure.last - sure.first
    middle, width = sure.first + length * rng.uniform(0.2, 0.8), length * rng.uniform(0.25, 0.8)
    return oval, float(rng.uniform(0.0, 180.0)), swell, (float(middle), float(width))


def _material(rng: Generator) -> Material:
    name = str(rng.choice(list(ALBEDOS)))
    albedo = tuple(float(v * rng.uniform(0.88, 1.08)) for v in ALBEDOS[name])
    wet, dirty = rng.random() < 0.3, rng.random() < 0.35
    return Material(
        name + (", wet" if wet else "") + (", dirty" if dirty else ""),
        (albedo[0], albedo[1], albedo[2]),
        float(rng.uniform(0.25, 0.7) if wet else rng.uniform(0.0, 0.12)),
        float(rng.uniform(0.005, 0.06)),
        0.04 if wet and rng.random() < 0.3 else 0.0,
        float(rng.uniform(0.03, 0.25) if dirty else 0.0),
        float(rng.uniform(0.0, 0.15)),
    )


def _sensor(rng: Generator, marks: tuple[str, ...]) -> Sensor:
    return Sensor(
        blur_px=float(rng.uniform(0.5, 1.1)),
        full=float(rng.uniform(4e3, 2e4)),
        read=float(rng.uniform(2.0, 12.0)),
        exposure=float(rng.uniform(1.6, 2.6) if "burnt" in marks else rng.uniform(0.55, 0.95)),
        veil=float(rng.choice([0.0, rng.uniform(0.0, 0.04)])),
        jpeg=int(rng.integers(60, 96)),
        burnt=float(rng.uniform(2.5, 5.0)) if "burnt band" in marks else 1.0,
        burnt_deg=(float(rng.uniform(0.0, 360.0)), float(rng.uniform(30.0, 70.0))),
    )


def _change(rng: Generator, marks: tuple[str, ...]) -> Change:
    focal, angles = (float(v) for v in rng.uniform(-1e-3, 1e-3, 2))
    turn, shift = rng.normal(0.0, 1.0, 2), rng.normal(0.0, 1.0, 3)
    turn, shift = math.radians(0.05) * turn / np.linalg.norm(turn), 0.3 * shift / np.linalg.norm(shift)
    drift, knock = "drift" in marks, "knock" in marks
    return Change(
        focal if drift else 0.0,
        angles if drift else 0.0,
        (float(turn[0]), float(turn[1])) if knock else (0.0, 0.0),
        (float(shift[0]), float(shift[1]), float(shift[2])) if knock else (0.0, 0.0, 0.0),
        grows=drift and not knock,
    )


def _limits(rng: Generator, pipe: Pipe) -> dict[str, dict[str, float]]:
    """What limits.toml says: in half of the pipes one thing is over its limit by a third or more, else nothing is."""
    worst: dict[tuple[str, str], float] = {("ovality", "percent"): 100.0 * (pipe.oval + pipe.swell)}
    for thing in pipe.things:
        for key, value in limited(thing).items():
            worst[key] = max(worst.get(key, 0.0), value)
    over: Any = list(worst)[int(rng.integers(len(worst)))] if rng.random() < 0.5 else None
    limits: dict[str, dict[str, float]] = {}
    for (section, quantity), value in worst.items():
        part = rng.uniform(0.45, 0.75) if (section, quantity) == over else rng.uniform(1.35, 2.0)
        least = 3.0 if section == "ovality" else 0.01 * pipe.radius_mm
        limit = value * part if (section, quantity) == over else max(value * part, least)
        limits.setdefault(section, {})[quantity] = round(float(limit), 3)
    return limits


def limited(thing: Thing) -> dict[tuple[str, str], float]:
    """What of a thing may be limited: section and quantity of limits.toml, and how much it truly is."""
    numbers = thing.numbers
    if thing.kind in ("pocket", "groove"):
        return {("loss", "depth_mm"): thing.depth_mm}
    if thing.kind in ("bump", "dent"):
        return {("bump", "height_mm"): thing.depth_mm}
    if thing.kind == "joint":
        return {("joint", "hilo_mm"): numbers["hilo_mm"], ("joint", "bead_height_mm"): numbers["height_mm"]}
    if thing.kind == "gap":
        return {("gap", "gap_mm"): numbers["gap_mm"]}
    if thing.kind == "tee":
        return {("tee", "protrusion_mm"): numbers["protrusion_mm"]}
    if thing.kind in ("silt", "water"):
        return {("deposit" if thing.kind == "silt" else "water", "depth_mm"): thing.depth_mm}
    return {}
