"""In an oval pipe with a joint all heads leaned by a degree, and each ring was moved aside to make up for it: a circle
aside of its place in an oval shows a threefold wave, and the wall had one of a tenth of a millimetre."""

import numpy as np
import pytest
from chained_pipe import ridden
from synthetic_pipe import CALIBRATION

from annulus_pipe.wall.axis import find_axis
from annulus_pipe.wall.centreline import Centreline, Piece

R = CALIBRATION.pipe_radius_mm
MOST_DEG = 0.06  # 0.02 measured; 0.85 with the wave left out


@pytest.mark.parametrize("wave_deg", [0.0, pytest.param(45.0, marks=pytest.mark.deep(but=1))])
def test_no_lean_of_all_heads_makes_up_for_the_walls_own_wave(wave_deg: float) -> None:
    def wall(clock: np.ndarray, _: np.ndarray) -> np.ndarray:
        t = np.radians(clock)
        return R * (0.04 * np.cos(2 * t) + 0.003 * np.cos(3 * t - np.radians(wave_deg)))

    line = Centreline([Piece(0.0, R), Piece(170.0, R, (0.8, -0.5))])
    stations = 6.0 * np.arange(18)
    profiles, heads = ridden(line, list(stations), wall)
    axis = find_axis(profiles, CALIBRATION.rings)
    assert len(axis.begins) == 2
    posed = [(one.pose, head) for one, head in zip(axis.profiles, heads, strict=True) if one.pose]
    off = np.degrees([[pose.rx - head.rx, pose.ry - head.ry] for pose, head in posed])
    assert np.abs(np.median(off, axis=0)).max() < MOST_DEG, np.median(off, axis=0)
