"""Promises of how far a place reaches: what a rim hides is part of it, what lies behind sound wall is not."""

import numpy as np
import pytest

from annulus_pipe.wall.extent import with_shadow, without_scraps
from annulus_pipe.wall.indications import Indication, Kind, Limits, Scale

Z, A = 80, 360
STEP_MM = 1.0
RATIOS = 1.8, 2.9  # shadow over depth, widest and narrowest ring
SCALE = Scale((STEP_MM, 1.33), 76.2, Limits())
SLIT_MM = SCALE.mm(SCALE.limits.edge_of_radius)
FIRST, LAST, DEPTH_MM = 30, 55, 3.0  # rows of a pocket


def hidden(rows: int) -> tuple[Indication, np.ndarray]:
    """A pocket whose floor is first seen so many rows behind its rim, wall up to half a slit before it."""
    unseen = np.zeros((Z, A), bool)
    unseen[FIRST - round(SLIT_MM / 2) : FIRST + rows, 100:130] = True
    mask = np.zeros((Z, A), bool)
    mask[FIRST + rows : LAST, 100:130] = True
    even = np.full((Z, A), 0.05, np.float32)
    return Indication(Kind.LOSS, mask, np.where(mask, DEPTH_MM, 0.0).astype(np.float32), even, even), unseen


@pytest.mark.parametrize("rows", [6, 9, 12, 16])
def test_a_steep_pocket_begins_at_its_rim_wherever_its_floor_is_first_seen(rows: int) -> None:
    """From the widest ring's shadow to the narrowest one's with a slit and a gap between frames; 12 was 12 mm short."""
    place, unseen = hidden(rows)
    whole = with_shadow(place, unseen, RATIOS, SCALE, DEPTH_MM)
    begins = np.array([np.flatnonzero(whole[:, column])[0] for column in range(100, 130)])
    assert np.abs(begins - FIRST).max() <= 1 and np.flatnonzero(whole.any(axis=1))[-1] == LAST - 1
    assert not (whole & ~unseen & ~place.mask).any(), "seen wall is not hidden"


def test_a_rods_shadow_beside_it_moves_no_rim() -> None:
    place, unseen = hidden(9)
    unseen[:LAST, 112:115] = True
    place.mask[FIRST:45, 112:115] = False
    whole = with_shadow(place, unseen, RATIOS, SCALE, DEPTH_MM)
    begins = np.array([np.flatnonzero(whole[:, column])[0] for column in range(100, 130)])
    assert np.abs(begins - FIRST).max() <= 1


def test_what_begins_out_of_sight_is_no_longer_than_its_shadow() -> None:
    place, unseen = hidden(9)
    unseen[:FIRST, :] = True
    whole = with_shadow(place, unseen, RATIOS, SCALE, DEPTH_MM)
    assert abs(int(np.flatnonzero(whole.any(axis=1))[0]) - FIRST) <= 3


def test_what_nobody_saw_within_a_place_belongs_to_it() -> None:
    place, unseen = hidden(0)
    unseen[40:44, 105:110] = True
    place.mask[40:44, 105:110] = False
    assert with_shadow(place, unseen, RATIOS, SCALE, DEPTH_MM)[40:44, 105:110].all()


def test_a_ghost_behind_sound_wall_is_no_part_of_a_place() -> None:
    core, sound = np.zeros((Z, A), bool), np.ones((Z, A), bool)
    core[20:40, 350:] = core[20:40, :20] = True  # over 12 o'clock
    core[50:52, 5:15] = True
    sound &= ~core
    kept = without_scraps(core, sound)
    assert kept[20:40, 350:].all() and kept[20:40, :20].all() and not kept[50:52].any()
    sound[40:50, 5:15] = False  # not seen, so it may be one place
    assert without_scraps(core, sound)[50:52, 5:15].all()


def test_a_small_part_beside_a_rods_shadow_stays() -> None:
    core, sound = np.zeros((Z, A), bool), np.ones((Z, A), bool)
    core[20:40, 100:130] = core[20:40, 135:138] = True
    assert (without_scraps(core, sound & ~core) == core).all()
