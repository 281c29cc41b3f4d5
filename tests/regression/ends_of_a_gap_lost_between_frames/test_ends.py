"""A gap of 6.8 mm read 12.9 +- 2.8: noise beside its ends counted as the gap, and the way between two frames, in which
an end may lie, as known. Fails with `ways` of 0, and with any row of noise for an end."""

import numpy as np
import pytest
from even_wall import RADIUS_MM, even_wall

from annulus_pipe.wall.joints import _gap
from annulus_pipe.wall.points import WallPoints

AT_MM, HALF_SLIT_MM, DEEP_MM = 172.0, 2.0, 6.0


def measured(gap: float, every_mm: float, noise_mm: float, seed: int) -> tuple[float, float]:
    """Rings `every_mm` apart; of a slit that lies across an edge the deeper half is seen."""
    rng = np.random.default_rng(seed)
    rows = np.arange(140.0, 205.0, every_mm) + rng.uniform(0, every_mm)
    z, clock = (one.ravel() for one in np.meshgrid(rows, np.arange(0.5, 360.0, 1.0)))
    stands = np.where(np.abs(z - AT_MM) < gap / 2 + HALF_SLIT_MM, -DEEP_MM, rng.normal(0, noise_mm, len(z)))
    same = np.ones(len(z))
    sector = (clock // 10).astype(np.intp)
    points = WallPoints(
        z,
        sector,
        stands,
        0.05 * same,
        2.0 * same,
        HALF_SLIT_MM * same,
        RADIUS_MM - stands,
        clock,
        np.zeros_like(sector),
    )
    half = gap / 2 + HALF_SLIT_MM + every_mm
    return _gap(even_wall(), points, (AT_MM - half, AT_MM + half), max(0.005 * RADIUS_MM, 5.0 * noise_mm))


@pytest.mark.parametrize(("every_mm", "noise_mm"), [(0.5, 0.05), (5.0, 0.05), (0.5, 0.5), (5.0, 0.5)])
def test_its_k2_knows_how_far_frames_lie_apart(every_mm: float, noise_mm: float) -> None:
    within = [abs(gap - 7.0) <= k2 for gap, k2 in (measured(7.0, every_mm, noise_mm, seed) for seed in range(20))]
    assert np.mean(within) >= 0.9
