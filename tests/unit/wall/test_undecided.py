"""Promises of what is not surely a defect: it is told of, with why, and nothing is claimed."""

from dataclasses import replace

import numpy as np
from synthetic_pipe import SHADOW_RATIO, oval, pocket, round_pipe, scan

from annulus_pipe.wall.defects import UNSURE, Detection, Kind, find_defects
from annulus_pipe.wall.grid import Wall, build_wall
from annulus_pipe.wall.standing import UNSURE_WHY

DEPTH_MM = 0.8


def found(wall: Wall, sigma_mm: float) -> Detection:
    return find_defects(replace(wall, sigma_mm=np.full_like(wall.sigma_mm, sigma_mm)), shadow_ratio=SHADOW_RATIO)


def test_a_large_place_that_many_looked_at_is_told_of_without_a_claim() -> None:
    told = found(build_wall(scan(pocket(round_pipe, 200, 15, 150, 170, DEPTH_MM))), 0.5)
    assert told.defects == () and not told.label.any()
    (one,) = told.undecided
    assert one.kind is Kind.LOSS and abs(one.z_mm - 160) < 3 and abs(one.clock_deg - 200) < 2
    assert abs(one.depth_mm - DEPTH_MM) < 0.05 and one.depth_k2_mm > UNSURE * one.depth_mm


def test_so_is_a_small_one() -> None:
    told = found(build_wall(scan(pocket(round_pipe, 200, 3, 150, 156, DEPTH_MM))), 0.5)
    (one,) = told.undecided
    assert told.defects == () and one.why == UNSURE_WHY and abs(one.z_mm - 153) < 4


def test_an_ovality_is_held_to_the_same() -> None:
    wall = build_wall(scan(oval(round_pipe, 30, 0.01)))
    (one,) = found(wall, 0.02).defects
    assert one.kind is Kind.OVALITY and one.depth_k2_mm < UNSURE * one.depth_mm
    told = found(wall, 0.6)
    assert told.defects == () and [one.kind for one in told.undecided] == [Kind.OVALITY]


def test_an_ovality_is_that_of_where_the_shape_is_known() -> None:
    """A groove drags the shape about where it lies: it looks more oval there, and says how little it knows."""
    wall = build_wall(scan(oval(round_pipe, 30, 0.01)))
    (true,) = found(wall, 0.02).defects
    rows = slice(len(wall.z_mm) // 2, len(wall.z_mm) // 2 + 4)
    shape, covariance = wall.shape_mm.copy(), wall.shape_covariance.copy()
    shape[rows, 3:] *= 1.2
    covariance[rows] += 0.3**2 * np.eye(5)
    (one,) = found(replace(wall, shape_mm=shape, shape_covariance=covariance), 0.02).defects
    assert abs(one.depth_mm - true.depth_mm) < 0.02 and one.depth_k2_mm < 2 * true.depth_k2_mm
