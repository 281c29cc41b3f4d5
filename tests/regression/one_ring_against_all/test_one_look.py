"""One slit drawn aside along its whole length made a defect where one ring of one frame alone looked (42c0df3). Fails
when one observation is enough (Limits.observations = 1)."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import SHADOW_RATIO, round_pipe, scan

from annulus_pipe.wall.defects import find_defects
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.standing import FEW


@pytest.mark.parametrize("by_mm", [-0.7, 0.7])
def test_what_one_ring_says_in_one_frame_alone_is_told_of_and_not_listed(by_mm: float) -> None:
    profiles = scan(round_pipe, z_mm=[4.0 * i for i in range(25)])
    told = profiles[-3]
    x, y, z = told.points_mm.astype(np.float64).T
    clock, radius = np.degrees(np.arctan2(x, -y)), np.hypot(x, y)
    there = (told.ring == 0) & (np.abs(clock - 60.0) < 10.0)
    scale = np.where(there, (radius + by_mm) / radius, 1.0)
    profiles[-3] = replace(told, points_mm=np.stack([x * scale, y * scale, z], axis=1).astype(np.float32))
    findings = find_defects(build_wall(profiles), shadow_ratio=SHADOW_RATIO)
    assert findings.defects == () and [one.why for one in findings.undecided] == [FEW]
