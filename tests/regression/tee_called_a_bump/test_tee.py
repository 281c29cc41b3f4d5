"""A tee that stands 8 to 12 mm into the pipe was listed as a bump, its opening unsaid: its rim's shadow made a dark
patch far longer than its bore, and the circle that was begun there ran away. Fails without `_standing`."""

import numpy as np
import pytest

from annulus_pipe.wall import openings
from annulus_pipe.wall.grid import Wall, WallObservations

R, Z_MM, CLOCK_DEG = 76.2, 155.0, 30.0
INNER_MM, OUTER_MM, STANDS_MM = 28.0, 38.0, 11.6


def rimmed() -> Wall:
    """What rings show of such a tee: the rim but for its far end, nothing inside, nothing for 40 mm behind it."""
    z, clock = np.arange(100.0, 240.0, 2.0), np.arange(360.0)
    across = R * np.radians((clock - CLOCK_DEG + 180.0) % 360.0 - 180.0)[None, :]
    along = (z - Z_MM)[:, None]
    away = np.hypot(across, along)
    radius = np.where((away > INNER_MM / 2) & (away < OUTER_MM / 2), R - STANDS_MM, R)
    hidden = (away <= INNER_MM / 2) | ((np.abs(across) < OUTER_MM / 2) & (along > 10.0) & (along < 55.0))
    radius = np.where(hidden, np.nan, radius).astype(np.float32)
    none = np.zeros(0)
    return Wall(
        z,
        clock,
        radius,
        np.where(hidden, 0, 5),
        np.tile([R, 0.0, 0.0, 0.0, 0.0], (len(z), 1)),
        np.zeros((len(z), 5, 5)),
        np.full(len(z), 0.05),
        np.full(radius.shape, 0.05, np.float32),
        WallObservations(
            none.astype(int),
            none.astype(np.int32),
            none.astype(np.float32),
            none.astype(np.float32),
            none.astype(np.uint8),
        ),
        np.full(radius.shape, 0.1, np.float32),
    )


def test_a_rim_says_where_its_bore_begins() -> None:
    (start,) = openings._standing(rimmed(), R)
    assert start.z_mm == pytest.approx(Z_MM, abs=0.04 * R)
    assert start.clock_deg == pytest.approx(CLOCK_DEG, abs=1.5)
    assert start.radius_mm == pytest.approx(OUTER_MM / 2, abs=0.03 * R)
    assert start.stands_mm == pytest.approx(STANDS_MM, abs=0.1)
