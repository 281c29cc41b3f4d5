"""A place 0.53 mm deep whose own k = 2 was 0.47 was listed as a defect on the demo's pipe (1394321). Fails without
UNSURE in find_defects."""

from dataclasses import replace

import numpy as np
from synthetic_pipe import SHADOW_RATIO, pocket, round_pipe, scan

from annulus_pipe.wall.defects import UNSURE, find_defects
from annulus_pipe.wall.grid import Wall, build_wall

DEPTH_MM = 0.6


def wall(sigma_mm: float) -> Wall:
    seen = build_wall(scan(pocket(round_pipe, 45, 20, 150, 190, DEPTH_MM)))
    return replace(seen, sigma_mm=np.full_like(seen.sigma_mm, sigma_mm))


def test_a_place_that_may_be_nothing_is_counted_and_not_listed() -> None:
    sure = find_defects(wall(0.1 * DEPTH_MM), shadow_ratio=SHADOW_RATIO)
    assert len(sure.defects) == 1 and sure.undecided == ()
    assert sure.defects[0].depth_k2_mm < UNSURE * sure.defects[0].depth_mm
    unsure = find_defects(wall(0.4 * DEPTH_MM), shadow_ratio=SHADOW_RATIO)
    assert unsure.defects == () and len(unsure.undecided) == 1
    assert not unsure.label.any()


def test_who_says_nothing_of_their_uncertainty_keep_their_defects() -> None:
    assert len(find_defects(wall(np.nan), shadow_ratio=SHADOW_RATIO).defects) == 1
