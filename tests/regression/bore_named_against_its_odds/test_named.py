"""A weak dip on one side was called "air" where its own odds said part, 0.885; and odds of one drawer's pipes were said
of every pipe: a "part" at 95 % was one in 11 of 14 by another drawer."""

import math
from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.wings.crossbore.ground import Bore, Ground, log
from annulus_pipe.wings.crossbore.measure import BORES, BoreKind, PipeGrid, detect, on_grid
from annulus_pipe.wings.crossbore.measure.odds import COUNTED, FATES, MIDDLE, odds

PLAIN = Ground(6000.0, uneven=0.06)


def weaker(grid: PipeGrid, by: float) -> PipeGrid:
    """The same log where everything but the soil itself takes off so much less, as by a head that sees less deep."""
    soil = np.median(grid.c_ff, axis=0)
    return replace(grid, c_ff=soil + by * (grid.c_ff - soil))


@pytest.mark.parametrize("kind", sorted(COUNTED))
def test_the_name_of_every_row_of_the_table_is_the_likeliest_of_its_fates(kind: str) -> None:
    fate = kind.split()[0]
    for part in (0.5, 0.9):
        said = odds(fate, part, kind != "air all round", 1.0 if kind == "water by loss" else math.nan)
        assert max(said, key=said.__getitem__) == (fate if fate in BORES else "soil")


@pytest.mark.parametrize("by", [1.0, 0.7, 0.5, 0.4])
@pytest.mark.parametrize("phi", [20.0, 90.0, 160.0])
def test_a_dip_on_one_side_of_any_strength_is_called_what_its_odds_say(phi: float, by: float) -> None:
    grid = on_grid(log(replace(PLAIN, bores=(Bore(3000.0, 101.0, 101.0, phi),)), 3).rows())
    (one,) = detect(weaker(grid, by)).bores
    assert max(FATES, key=one.odds.__getitem__) == str(one.kind)
    assert one.kind is (BoreKind.PART if one.part < MIDDLE else BoreKind.AIR)
    assert math.isnan(one.phi_deg) == (one.kind is BoreKind.PART)


@pytest.mark.parametrize("kind", sorted(COUNTED))
def test_no_odds_are_surer_than_the_drawer_with_the_fewest_places_lets_them_be(kind: str) -> None:
    fate = kind.split()[0]
    said = odds(
        fate, 0.9 if kind == "air strong" else 0.5, kind != "air all round", 1.0 if "loss" in kind else math.nan
    )
    for drawer in COUNTED[kind]:
        assert max(said.values()) <= 0.5 + 0.5 * (sum(drawer) + 0.5) / (sum(drawer) + 2)
