"""Two frames from one place counted as two looks, so that what one ring said wrongly twice was a defect, and a branch
of 12 mm was made up where a head stood still; in a 2-inch pipe openings were fitted to millimetres. Fails where
an observation is a frame's, and with EDGE of openings.py as millimetres."""

from dataclasses import replace

import numpy as np
from synthetic_pipe import CALIBRATION, SHADOW_RATIO, opening, round_pipe, scan

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.wall.defects import find_defects
from annulus_pipe.wall.features import Feature
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.looks import looks_of
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import survey

STATIONS = tuple(3.0 * i for i in range(32) if i % 5 != 4)


def drawn_aside(one: Profile, by_mm: float) -> Profile:
    x, y, z = one.points_mm.astype(np.float64).T
    clock, radius = np.degrees(np.arctan2(x, -y)), np.hypot(x, y)
    scale = np.where((one.ring == 0) & (np.abs(clock - 60.0) < 10.0), (radius + by_mm) / radius, 1.0)
    return replace(one, points_mm=np.stack([x * scale, y * scale, z], axis=1).astype(np.float32))


def test_what_one_ring_says_from_one_place_it_says_once() -> None:
    profiles = scan(round_pipe, z_mm=[4.0 * i for i in range(25)])
    wrong = drawn_aside(profiles[-3], 0.7)
    again = replace(wrong, frame=99, z_mm=wrong.z_mm + 0.1, points_mm=wrong.points_mm + np.float32([0, 0, 0.1]))
    found = find_defects(build_wall([*profiles[:-3], wrong, again, *profiles[-2:]]), shadow_ratio=SHADOW_RATIO)
    assert found.defects == ()


def test_a_ring_has_one_view_from_one_place() -> None:
    profiles = scan(round_pipe, z_mm=[4.0 * i for i in range(12)], directions=180)
    again = [replace(one, frame=99 + one.frame, z_mm=one.z_mm + 0.1) for one in profiles]
    wall = build_wall(profiles)
    _, looks = looks_of([*profiles, *again], wall, CALIBRATION)
    assert len(looks.view) == 2 * 5 * 12 and len(np.unique(looks.view)) == 5 * 12


def test_a_small_pipe_is_the_same_pipe() -> None:
    """Of a branch in a pipe of 0.35 of the size every number is 0.35 of it, how far it may be off as well."""
    profiles = scan(opening(round_pipe, 30.0, 155.0, 25.0), z_mm=STATIONS, steep=True)
    large = branch(profiles, CALIBRATION)
    size = 0.35
    small = branch(
        [replace(p, z_mm=size * p.z_mm, points_mm=np.float32(size) * p.points_mm) for p in profiles],
        replace(
            CALIBRATION,
            pipe_radius_mm=size * CALIBRATION.pipe_radius_mm,
            rings=tuple(replace(ring, vertex_mm=tuple(size * v for v in ring.vertex_mm)) for ring in CALIBRATION.rings),
        ),
    )
    for one, other in zip(large.measures, small.measures, strict=True):
        assert abs(other.value / size - one.value) < 0.15 and abs(other.k2 / size - one.k2) < 0.2 * one.k2, one.name


def branch(profiles: list[Profile], calibration: Calibration) -> Feature:
    (one,) = survey(profiles, calibration).features
    return one
