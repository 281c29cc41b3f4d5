"""Promises of what goes all round: a rod hides a part of it, sound wall ends it."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import SHADOW_RATIO, oval, pocket, round_pipe, scan

from annulus_pipe.wall.defects import Defect, Kind, find_defects
from annulus_pipe.wall.grid import build_wall


def only_loss(half_deg: float, hidden_deg: float, percent: float = 0.0) -> Defect:
    """A groove 20 mm long and 1.2 mm deep over twice `half_deg` about 6 o'clock, part of it hidden about 12."""
    pipe = oval(round_pipe, 30, percent / 100) if percent else round_pipe
    wall = build_wall(scan(pocket(pipe, 180, half_deg, 160, 180, 1.2)))
    radius = wall.radius_mm.copy()
    radius[:, np.abs((wall.clock_deg + 180) % 360 - 180) < hidden_deg / 2] = np.nan
    found = find_defects(replace(wall, radius_mm=radius), shadow_ratio=SHADOW_RATIO).defects
    (loss,) = (one for one in found if one.kind is not Kind.OVALITY)
    assert loss.kind is Kind.LOSS and loss.depth_mm == pytest.approx(1.2, abs=0.05)
    return loss


@pytest.mark.deep(but="40.0-3.0")
@pytest.mark.parametrize("percent", [0.0, 3.0])
@pytest.mark.parametrize("hidden_deg", [0.0, 10.0, 40.0])
def test_a_groove_goes_all_round_whatever_hides_some_of_it(hidden_deg: float, percent: float) -> None:
    found = only_loss(181, hidden_deg, percent)
    assert found.is_all_round and found.arc_deg == 360 and found.clock_range == ("12:00", "12:00")


def test_one_that_ends_at_sound_wall_does_not() -> None:
    found = only_loss(160, 0.0)
    assert not found.is_all_round and abs(found.arc_deg - 320) < 6 and abs(found.clock_deg - 180) < 3
