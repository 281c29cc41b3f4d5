"""Pipes with joints, a bend, an opening, water; everything that can be measured of them is drawn from the seed.

The head is the demo's at half the picture's size, with slits twice as wide. Ranges are what fused and
coupled pipes of this size show, not what a survey measures well.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from annulus_pipe.twin.worlds.course import Course, WorldJoint, WorldOpening, WorldPiece
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.twin.worlds.pipes import demo_projector, demo_world
from annulus_pipe.twin.worlds.world import World

_WIDTH = 832
_RADIUS_MM = 76.2
_ENDLESS_MM = 2000.0

Dice = np.random.Generator


def _world(
    seed: int, course: Course, features: tuple[WorldFeature, ...], travel_mm: float, roll_deg: float = 0.0
) -> World:
    world = demo_world(seed, travel_mm).scaled(_WIDTH)
    slits = demo_projector()
    slits = replace(slits, slit_half_deg=tuple(2 * h for h in slits.slit_half_deg))
    optics = replace(world.optics, blur_px=0.8)
    return replace(
        world, projector=slits, optics=optics, features=features, course=course, radius_mm=_RADIUS_MM, roll_deg=roll_deg
    )


def _joint(dice: Dice, bead: bool) -> WorldJoint:
    """Hi-lo up to 2 mm, a turn up to 2 degrees, a bead of 2.5 to 5 mm."""
    height = float(dice.uniform(2.5, 5.0)) if bead else 0.0
    return WorldJoint(
        hilo_mm=float(dice.uniform(0.6, 2.0)),
        hilo_clock_deg=float(dice.uniform(0, 360)),
        angle_deg=float(dice.uniform(0.4, 2.0)),
        angle_clock_deg=float(dice.uniform(0, 360)),
        height_mm=height,
        width_mm=float(dice.uniform(7.0, 12.0)),
        notch_mm=float(dice.uniform(0.3, 0.7)) * height,
    )


def _pocket(dice: Dice, z_mm: float) -> WorldFeature:
    length, arc = float(dice.uniform(16, 26)), float(dice.uniform(16, 30))
    depth, clock = float(dice.uniform(1.5, 3.5)), float(dice.uniform(0, 360))
    return WorldFeature("pocket", z_mm, length, depth, clock, arc)


def butt_world(seed: int) -> World:
    """Butt fusion between a pocket before it and one behind."""
    dice = np.random.default_rng([seed, 0xB077])
    at = float(dice.uniform(165, 185))
    course = Course((WorldPiece(at, _RADIUS_MM), WorldPiece(_ENDLESS_MM, _RADIUS_MM, joint=_joint(dice, True))))
    return _world(seed, course, (_pocket(dice, at - 38), _pocket(dice, at + 34)), 120.0)


def coupling_world(seed: int) -> World:
    """Two pipes of different size in a dark socket, apart; a pocket behind."""
    dice = np.random.default_rng([seed, 0xC0])
    at, gap = float(dice.uniform(160, 180)), float(dice.uniform(4, 9))
    socket = WorldPiece(gap, _RADIUS_MM + float(dice.uniform(6, 10)), is_gap=True, brightness=0.13)
    after = WorldPiece(_ENDLESS_MM, _RADIUS_MM + float(dice.uniform(-1.0, 1.0)), joint=_joint(dice, False))
    return _world(seed, Course((WorldPiece(at, _RADIUS_MM), socket, after)), (_pocket(dice, at + gap + 32),), 120.0)


def branch_world(seed: int) -> World:
    """An opening in the wall, a plain joint without a bead behind it, a pocket."""
    dice = np.random.default_rng([seed, 0xB4])
    at = float(dice.uniform(150, 165))
    opening = WorldOpening(at, float(dice.uniform(0, 360)), float(dice.uniform(18, 40)))
    step = WorldJoint(hilo_mm=float(dice.uniform(0.8, 2.0)), hilo_clock_deg=float(dice.uniform(0, 360)))
    pieces = (
        WorldPiece(at + 45.0, _RADIUS_MM),
        WorldPiece(_ENDLESS_MM, _RADIUS_MM + float(dice.uniform(0.4, 1.2)), joint=step),
    )
    pocket = replace(_pocket(dice, at + 2.0), clock_deg=(opening.clock_deg + float(dice.uniform(90, 270))) % 360.0)
    return _world(seed, Course(pieces, (opening,)), (pocket,), 120.0)


def bend_world(seed: int) -> World:
    """A level bend of 45 to 90 degrees and 2 to 4 diameters, a pocket in it, butt fusion in the straight after."""
    dice = np.random.default_rng([seed, 0xBE])
    start, angle = float(dice.uniform(150, 180)), float(dice.uniform(45, 90))
    bend = 2 * _RADIUS_MM * float(dice.uniform(2.0, 4.0))
    toward = 90.0 if dice.uniform() < 0.5 else 270.0
    turn, after = bend * math.radians(angle), float(dice.uniform(70, 110))
    pieces = (
        WorldPiece(start, _RADIUS_MM),
        WorldPiece(turn, _RADIUS_MM, bend_radius_mm=bend, toward_deg=toward),
        WorldPiece(after, _RADIUS_MM),
        WorldPiece(_ENDLESS_MM, _RADIUS_MM, joint=_joint(dice, True)),
    )
    pocket = _pocket(dice, start + turn * float(dice.uniform(0.35, 0.65)))
    return _world(seed, Course(pieces), (pocket,), start + turn + after - 60.0, roll_deg=2.0)


def water_world(seed: int) -> World:
    """Clear water at the bottom, a pocket in the wall above it."""
    dice = np.random.default_rng([seed, 0x3A])
    half = float(dice.uniform(22, 40))  # degrees of the arc under water, to either side
    course = Course((WorldPiece(_ENDLESS_MM, _RADIUS_MM),), level_mm=_RADIUS_MM * math.cos(math.radians(half)))
    pocket = replace(_pocket(dice, 160.0), clock_deg=float(dice.uniform(-100, 100)) % 360.0)
    return _world(seed, course, (pocket,), 120.0)


FITTINGS: Mapping[str, Callable[[int], World]] = {
    "butt": butt_world,
    "coupling": coupling_world,
    "branch": branch_world,
    "bend": bend_world,
    "water": water_world,
}
