"""The room between two pipes whose ends are askew is what each sector shows, and what may be none is known to be so."""

import numpy as np
import pytest
from even_wall import RADIUS_MM, even_wall

from annulus_pipe.wall.joints import _gap
from annulus_pipe.wall.points import WallPoints

AT_MM = 172.0
DEEP_MM = 9.0


def _measured(gap: float, askew_mm: float, half_slit: float) -> tuple[float, float]:
    """Places every 0.5 mm and 5 degrees; of a slit that lies across an edge, the deeper half is seen as often."""
    z, clock = (one.ravel() for one in np.meshgrid(np.arange(150.0, 195.0, 0.5), np.arange(2.5, 360.0, 5.0)))
    off = z - AT_MM - askew_mm * np.cos(np.radians(clock))
    open_ = np.abs(off) < gap / 2 + half_slit if gap > 0 else np.zeros(len(z), bool)
    stands = np.where(open_, -DEEP_MM, 0.0)
    same = np.ones(len(z))
    sector = (clock // 10).astype(np.intp)
    points = WallPoints(
        z, sector, stands, 0.05 * same, 2.0 * same, half_slit * same, RADIUS_MM - stands, clock, np.zeros_like(sector)
    )
    return _gap(
        even_wall(), points, (AT_MM - gap / 2 - half_slit - 2, AT_MM + gap / 2 + half_slit + 2), 0.005 * RADIUS_MM
    )


@pytest.mark.parametrize("askew_mm", [0.0, 2.0])
@pytest.mark.parametrize("half_slit", [1.0, 2.5])
def test_a_gap_is_as_long_as_it_is(askew_mm: float, half_slit: float) -> None:
    gap, k2 = _measured(6.0, askew_mm, half_slit)
    assert abs(gap - 6.0) < min(k2, 2.0)
    assert k2 < gap


def test_pipes_that_touch_have_no_gap_to_be_sure_of() -> None:
    gap, k2 = _measured(0.0, 2.0, 2.5)
    assert gap <= k2
