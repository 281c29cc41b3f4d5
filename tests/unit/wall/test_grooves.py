"""A groove is as deep as its floor: not as what slits show that lie half on a rim."""

from dataclasses import replace

import numpy as np
import pytest

from annulus.wall.defects import Defect, Detection, Kind, Limits
from annulus.wall.grid import Observations, Wall
from annulus.wall.grooves import with_groove_floors
from annulus.wall.profile import Profile

RADIUS_MM, AT_MM = 76.2, 172.0
RATIOS = np.array([2.9, 2.6, 2.3, 2.0, 1.8])
SLITS_MM = np.array([3.1, 2.2, 1.6, 1.1, 0.8])  # half of each, on the wall


def _wall() -> Wall:
    z, clock = np.arange(141.0, 210.0, 2.0), np.arange(0.5, 360.0)
    shape = np.tile([RADIUS_MM, 0.0, 0.0, 0.0, 0.0], (len(z), 1))
    cells, none = np.full((len(z), len(clock)), RADIUS_MM, np.float32), np.zeros(0, np.float32)
    nobody = Observations(none.astype(int), none.astype(np.int32), none, none, none.astype(np.uint8))
    noise = np.full(len(z), 0.02)
    return Wall(z, clock, cells, np.ones(cells.shape, np.int32), shape, np.zeros((len(z), 5, 5)), noise,
                np.full_like(cells, 0.05), nobody, np.full_like(cells, 0.05))  # fmt: skip


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
                n, start, None, xyz, np.zeros((count, 3), np.uint8), np.array(rings, np.uint8),
                np.zeros(count, np.uint16), sigma_mm=np.full(count, 0.05, np.float32),
                slit_rad=(SLITS_MM / RADIUS_MM / (1 + RATIOS**2)).astype(np.float32),
            )
        )  # fmt: skip
    return out


def _listed(depth: float) -> Detection:
    groove = Defect(Kind.LOSS, AT_MM, 0.0, 12.0, 360.0, depth, 1.0, True, 0.6)
    return Detection((groove,), np.zeros((35, 360), np.int32), Limits())


@pytest.mark.parametrize(("deep", "width", "listed"), [(1.5, 8.0, 1.35), (1.8, 9.0, 1.6), (2.5, 12.0, 2.9)])
def test_a_groove_is_as_deep_as_its_floor(deep: float, width: float, listed: float) -> None:
    rng = np.random.default_rng(2)
    (groove,) = with_groove_floors(_listed(listed), _wall(), _frames(deep, width, rng), RATIOS).defects
    assert abs(groove.depth_mm - deep) < 0.08
    assert abs(groove.depth_mm - deep) < groove.depth_k2_mm < 0.6


def test_a_groove_whose_floor_no_slit_shows_whole_keeps_what_was_said_of_it() -> None:
    listed = _listed(1.6)
    assert with_groove_floors(listed, _wall(), _frames(1.8, 3.0, np.random.default_rng(4)), RATIOS) == listed


def test_what_does_not_go_round_is_left_alone() -> None:
    listed = _listed(1.6)
    pocket = replace(listed, defects=(replace(listed.defects[0], arc_deg=80.0),))
    assert with_groove_floors(pocket, _wall(), _frames(1.8, 9.0, np.random.default_rng(4)), RATIOS) == pocket
