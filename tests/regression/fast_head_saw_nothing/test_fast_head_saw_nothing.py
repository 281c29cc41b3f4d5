"""A capacitive head that read every 15 mm was said to have seen nothing, in stretches, and a sewer there was not told.

A place counted as read where all three sectors were read within the same 5 mm, which a fast head hardly ever does.
"""

import numpy as np
import pytest

from annulus_pipe.wings.crossbore.ground import Bore, Ground, log
from annulus_pipe.wings.crossbore.measure import BoreKind, Log, detect, on_grid

EVERY = 4  # rows of 40 a second at 150 mm a second: one each 15 mm


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.deep(but=1))])
def test_each_sector_is_seen_by_its_own_readings(seed: int) -> None:
    drawn = log(Ground(8000.0, bores=(Bore(4000.0, 76.0),)), seed)
    rows = drawn.rows()
    few = Log(
        rows.t_s[::EVERY],
        rows.odometer_mm[::EVERY],
        rows.c_pf[::EVERY],
        rows.reference_pf[::EVERY],
        rows.roll_deg[::EVERY],
    )
    grid = on_grid(few)
    assert np.mean(grid.seen) > 0.97
    assert [one.kind for one in detect(grid).bores] == [BoreKind.AIR]


def test_a_sector_without_readings_is_unseen_all_the_same() -> None:
    rows = log(Ground(8000.0), 0).rows()
    lost = np.abs(rows.odometer_mm - 4000.0) < 150.0
    c = np.where(lost[:, None] & np.array([True, False, False]), np.nan, rows.c_pf)
    grid = on_grid(Log(rows.t_s, rows.odometer_mm, c, rows.reference_pf, rows.roll_deg))
    assert not grid.seen[np.abs(grid.z_mm - 4000.0) < 50.0].any()
