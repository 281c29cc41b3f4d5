"""What is on a pipe's wall or in its bore, put where there is room, and some of it beside a joint or behind a rod."""

import math
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from tools.bench.blind.head import Reach
from tools.bench.blind.pipe import Head, Thing

LARGE = {"dent": 0.12, "groove": 0.15, "tee": 0.15, "branch": 0.2, "cable": 0.1}  # first, while there is room
BOTTOM, BOTTOM_ODDS = ("hose", "silt", "water"), 0.2  # one of them along the bottom
SMALL, POCKETS = ("pocket", "bump"), 0.78
LEAST, MOST = 4, 10  # things in a pipe
TRIES = 60
ROOM_OF_RADIUS = 0.1  # between two things, along the pipe or round it


def place_things(
    rng: Generator, radius: float, head: Head, seen: Reach, sure: Reach, lines: list[Thing]
) -> tuple[Thing, ...]:
    """`lines`, which are part of the centre line, and others between `seen`'s ends until there are enough."""
    things = list(lines)
    wanted = int(rng.integers(LEAST, MOST + 1))
    large = [str(rng.choice(BOTTOM))] if rng.random() < BOTTOM_ODDS else []
    large += [kind for kind, odds in LARGE.items() if rng.random() < odds]
    if any(one.kind == "bend" for one in lines):  # straight things in a straight pipe
        large = [kind for kind in large if kind in ("dent", "groove")]
    for turn in range(TRIES):
        if len(things) >= wanted:
            break
        kind = large[turn % len(large)] if large else SMALL[int(rng.random() > POCKETS)]
        thing = _thing(rng, kind, radius, seen if rng.random() < 0.2 else sure)
        if kind == "pocket":
            thing = _beside(rng, thing, radius, head, [one for one in things if one.kind != "bend"])
        first, last = thing.span_mm
        inside = seen.first - 0.1 * radius <= first and last <= seen.last + 0.1 * radius
        if inside and all(_apart(thing, other, radius) for other in things):
            things.append(thing)
            large = [one for one in large if one != kind]
        elif turn > TRIES // 3:
            large = []  # there is no room
    return tuple(sorted(things, key=lambda one: one.z_mm))


def _thing(rng: Generator, kind: str, radius: float, within: Reach) -> Thing:
    """One of KINDS, sizes in parts of the radius."""

    def part(low: float, high: float) -> float:
        return float(radius * rng.uniform(low, high))

    def deep(low: float, high: float) -> float:
        """As many shallow ones as deep ones, by their logarithm."""
        return float(radius * math.exp(rng.uniform(math.log(low), math.log(high))))

    z, clock = float(rng.uniform(within.first, within.last)), float(rng.uniform(0.0, 360.0))
    if kind == "pocket":
        arc = math.degrees(float(rng.uniform(0.12, 0.6)))
        return Thing(kind, z, part(0.1, 0.5), clock, arc, deep(0.006, 0.06), part(0.003, 0.03))
    if kind == "groove":
        return Thing(kind, z, part(0.06, 0.25), depth_mm=deep(0.008, 0.04), ramp_mm=part(0.004, 0.02))
    if kind == "bump":
        return Thing(kind, z, part(0.2, 0.6), clock, math.degrees(float(rng.uniform(0.2, 0.6))), deep(0.012, 0.06))
    if kind == "dent":
        return Thing(kind, z, part(0.7, 1.5), clock, float(rng.uniform(50.0, 100.0)), deep(0.02, 0.08))
    if kind in ("branch", "tee"):
        inner = part(0.25, 0.55)
        wide = inner if kind == "branch" else inner + part(0.08, 0.16)
        numbers = {"inner_d_mm": inner, "outer_d_mm": wide}
        stands = 0.0 if kind == "branch" else part(0.04, 0.16)
        if stands:
            numbers["protrusion_mm"] = stands
        return Thing(kind, z, wide, clock, 2 * math.degrees(math.asin(wide / 2 / radius)), stands, numbers=numbers)
    if kind == "cable":
        return Thing(kind, z, part(0.05, 0.12), clock, numbers={"aside_mm": part(-0.6, 0.6)})
    clock = float(rng.normal(180.0, 4.0 if kind == "silt" else 0.0 if kind == "water" else 20.0)) % 360.0
    length = part(0.8, 2.0)
    if kind == "hose":
        thick = part(0.12, 0.28)
        arc = 2 * math.degrees(math.asin(thick / 2 / (radius - thick / 2)))
        return Thing(kind, z, length, clock, arc, thick, numbers={"thick_mm": thick})
    depth = part(0.06, 0.25)
    arc = 2 * math.degrees(math.acos((radius - depth) / radius))
    return Thing(kind, z, length, clock, arc, depth, numbers={"level_mm": radius - depth})


def _beside(rng: Generator, thing: Thing, radius: float, head: Head, others: list[Thing]) -> Thing:
    """The same beside a thing that is there, or in a rod's shadow, or where it was drawn."""
    where = rng.random()
    if where < 0.45 and others:
        hard = [one for one in others if one.kind != "pocket"] or others
        other = hard[int(rng.integers(len(hard)))]
        side = 1.0 if rng.random() < 0.65 else -1.0  # behind it more often: that is the hard side
        gap = radius * float(rng.uniform(0.005, 0.15))
        z = other.z_mm + side * (other.length_mm / 2 + gap + thing.length_mm / 2)
        near = other.arc_deg < 360.0 and other.kind != "cable"
        clock = other.clock_deg + float(rng.normal(0.0, 5.0)) if near else thing.clock_deg
        return replace(thing, z_mm=z, clock_deg=clock % 360.0, beside=other.kind)
    if where < 0.55 and head.rods:
        rod = head.rods[int(rng.integers(len(head.rods)))][0]
        return replace(thing, clock_deg=(rod + float(rng.normal(0.0, 4.0))) % 360.0, beside="rod")
    return thing


def _apart(thing: Thing, other: Thing, radius: float) -> bool:
    """Whether two things have wall between them, or may lie on one another (anything lies in a bend)."""
    if "bend" in (thing.kind, other.kind) or {thing.kind, other.kind} <= {"pocket", "taper"}:
        return True
    room = 0.004 * radius if thing.beside == other.kind else ROOM_OF_RADIUS * radius
    along = abs(thing.z_mm - other.z_mm) - (thing.length_mm + other.length_mm) / 2
    if along >= room:
        return True
    if "cable" in (thing.kind, other.kind):
        return False
    off = abs((thing.clock_deg - other.clock_deg + 180.0) % 360.0 - 180.0)
    around = math.radians(off - (thing.arc_deg + other.arc_deg) / 2) * radius
    return around >= ROOM_OF_RADIUS * radius and not np.isclose(max(thing.arc_deg, other.arc_deg), 360.0)
