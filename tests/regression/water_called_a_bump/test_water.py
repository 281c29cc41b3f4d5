"""Water 6 mm deep after a knock was listed as a bump of 5.5 mm: the wall beside it lay 1.1 mm off the shape, and a
chord was asked to fit without that. Silt that was seen over 0.8 of the radius only was a bump as well. Fails with
`_left_by` of chords.py that may not move its forms, and with LENGTH_OF_RADIUS at 1."""

import numpy as np
import pytest

from annulus.wall.chords import DOWN_DEG, Slabs, _cornered, find_chords

R, DEPTH_MM = 76.0, 6.0
CLOCK_DEG = np.arange(1.0, 360.0, 2.0)
HALF_DEG = float(np.degrees(np.arccos(1 - DEPTH_MM / R)))
AWAY_DEG = np.abs(CLOCK_DEG - DOWN_DEG)
CHORD_MM = np.maximum(R - (R - DEPTH_MM) / np.cos(np.radians(np.minimum(AWAY_DEG, 80.0))), 0.0)
DENT_MM = DEPTH_MM * np.cos(np.radians(90.0 * np.minimum(AWAY_DEG / (1.5 * HALF_DEG), 1.0))) ** 2


def slabs(inwards: np.ndarray, rows: int, of: int = 40) -> Slabs:
    radius = np.full((of, len(CLOCK_DEG)), R)
    radius[10 : 10 + rows] -= inwards
    return Slabs(radius, np.arange(of) * 0.1 * R, CLOCK_DEG)


@pytest.mark.parametrize("off_mm", [0.0, 1.1, -0.8])
def test_corners_are_told_whatever_the_wall_beside_them_is_off(off_mm: float) -> None:
    noise = np.random.default_rng(5).normal(0.0, 0.1, len(CLOCK_DEG))
    for inwards, is_chord in ((CHORD_MM, True), (DENT_MM, False)):
        seen = inwards + off_mm + noise
        assert _cornered(slabs(seen, 10), seen, np.full(len(CLOCK_DEG), R), DOWN_DEG, HALF_DEG) is is_chord


def test_a_level_may_be_shorter_than_the_radius_and_a_rim_is_none() -> None:
    assert len(find_chords(slabs(CHORD_MM, 8), 24.0)) == 1
    assert not find_chords(slabs(CHORD_MM, 6), 24.0)
    assert not find_chords(slabs(DENT_MM, 8), 24.0)
