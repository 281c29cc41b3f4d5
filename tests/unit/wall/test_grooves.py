"""A groove is as deep as its floor: not as what slits show that lie half on a rim."""

import numpy as np
import pytest
from even_wall import RADIUS_MM, even_wall

from annulus_pipe.wall.grooves import groove_floor
from annulus_pipe.wall.points import WallPoints
from annulus_pipe.wall.profile import Profile

AT_MM = 172.0
RATIOS = np.array([2.9, 2.6, 2.3, 2.0, 1.8])
SLITS_MM = np.array([3.1, 2.2, 1.6, 1.1, 0.8])  # half of each, on the wall


def _frames(deep: float, width: float, rng: np.random.Generator) -> list[Profile]:
    """Heads 5 mm apart, a little askew: each slit shows the middle of what of it is lit, on its nominal cone."""
    z1, z2 = AT_MM - width / 2, AT_MM + width / 2
    out = []
    for n, start in enumerate(np.arange(120.0, 180.0, 5.0)):
        clock = np.radians(np.arange(0.0, 360.0, 5.0))
        points, rings = [], []
        for k, (q, slit) in enumerate(zip(RATIOS, SLITS_MM, strict=True)):
            nominal = start + 12.0 * k + 1.5 * np.sin(clock + n) + rng.uniform(-2, 2)
            lands = nominal[:, None] + np.linspace(-slit, slit, 41)
            inside = (lands > z1) & (lands < z2)
            shown = np.where(inside, np.minimum(deep, (z2 - lands) / q), 0.0).mean(axis=1) + rng.normal(0, 0.03, 72)
            radius, z = RADIUS_MM + shown, nominal + q * shown
            points.append(np.stack([radius * np.sin(clock), -radius * np.cos(clock), z], axis=1))
            rings += [k] * len(clock)
        xyz = np.concatenate(points).astype(np.float32)
        count = len(xyz)
        out.append(
            Profile(
                n,
                start,
                None,
                xyz,
                np.zeros((count, 3), np.uint8),
                np.array(rings, np.uint8),
                np.zeros(count, np.uint16),
                sigma_mm=np.full(count, 0.05, np.float32),
                slit_rad=(SLITS_MM / RADIUS_MM / (1 + RATIOS**2)).astype(np.float32),
            )
        )
    return out


def _floor(
    deep: float, width: float, listed: float, seed: int = 2, arc_deg: float = 360.0
) -> tuple[float, float] | None:
    wall = even_wall()
    points = WallPoints.of(wall, _frames(deep, width, np.random.default_rng(seed)), RATIOS)
    return groove_floor(wall, points, (AT_MM - 6, AT_MM + 6), 30.0, arc_deg, listed)


@pytest.mark.parametrize(("deep", "width", "listed"), [(1.5, 8.0, 1.35), (1.8, 9.0, 1.6), (2.5, 12.0, 2.9)])
@pytest.mark.parametrize("arc_deg", [360.0, 90.0])
def test_a_groove_is_as_deep_as_its_floor(deep: float, width: float, listed: float, arc_deg: float) -> None:
    found = _floor(deep, width, listed, arc_deg=arc_deg)
    assert found is not None
    depth, k2 = found
    assert abs(depth - deep) < 0.1
    assert abs(depth - deep) < k2 < 0.6


def test_a_groove_whose_floor_no_slit_shows_whole_has_none() -> None:
    assert _floor(1.8, 3.0, 1.6, 4) is None
