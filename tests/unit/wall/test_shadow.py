"""Behind a step nothing is known, whatever half a slit may say there."""

import numpy as np

from annulus_pipe.wall.shadow import between_levels, shadowed

STEP_MM = 1.0
WIDE, NARROW = 0.55, 0.34  # tangents of the widest and the narrowest ring's half-angle


def wall():
    return np.full((60, 90), 76.2)


def test_a_false_floor_half_way_down_is_not_kept():
    radius = wall()
    radius[20:40, 10:30] += 2.0
    radius[20:24, 10:30] = 77.1  # seen by slits that lie half on the rim and half on the floor
    false = between_levels(radius, STEP_MM, WIDE)
    assert false[20:23, 10:30].all()
    radius[false] = np.nan
    assert np.isnan(radius[20:23, 10:30]).all()
    assert np.isfinite(radius[:20]).all() and np.isfinite(radius[25:]).all()


def test_a_ramp_that_light_can_reach_stays():
    radius = wall()
    for i in range(8):
        radius[20 + i] += 0.45 * i
    radius[28:] += 3.6
    assert not between_levels(radius, STEP_MM, WIDE).any()


def test_noise_and_falling_edges_hide_nothing():
    rng = np.random.default_rng(5)
    radius = wall() + rng.normal(0, 0.08, (60, 90))
    radius[30:] -= 3.0  # the far rim of a loss, the front of a bump
    assert not between_levels(radius, STEP_MM, WIDE).any()
    radius[29:31] = np.nan
    assert not shadowed(radius, STEP_MM, NARROW).any()


def test_what_a_step_hides_is_told_from_what_a_rod_hides():
    radius = wall()
    radius[20:40, 10:30] += 2.0
    radius[19:24, 10:30] = np.nan
    radius[5:50, 60:63] = np.nan
    dark = shadowed(radius, STEP_MM, NARROW)
    assert dark[19:24, 10:30].all() and dark.sum() == 5 * 20
