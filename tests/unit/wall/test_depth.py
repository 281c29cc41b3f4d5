"""Promises of a defect's depth: neither a floor's noise nor rings that err more than others make it deeper."""

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, SHADOW_RATIO, pocket, round_pipe, scan, turn

from annulus_pipe.wall.defects import find_defects
from annulus_pipe.wall.grid import Wall, WallObservations, build_wall
from annulus_pipe.wall.indications import Indication, Kind, Limits, Scale, depth_of
from annulus_pipe.wall.survey import survey

Z, A = 60, 360
NOISE_MM = 0.06
SCALE = Scale((1.0, 1.3), 76.2, Limits())


def place(height: np.ndarray, mask: np.ndarray, seed: int, sigma: float | np.ndarray = NOISE_MM) -> Indication:
    noise = np.random.default_rng(seed).normal(0.0, NOISE_MM, height.shape)
    stated = np.full(height.shape, NOISE_MM, np.float32)
    may_be = np.broadcast_to(sigma, height.shape).astype(np.float32)
    return Indication(Kind.LOSS, mask, (height + noise).astype(np.float32), stated, may_be)


def floor() -> np.ndarray:
    mask = np.zeros((Z, A), bool)
    mask[20:40, 100:130] = True
    return mask


@pytest.mark.parametrize("depth_mm", [1.0, 3.0])
def test_a_flat_floor_is_as_deep_as_it_is(depth_mm: float) -> None:
    mask = floor()
    found = [depth_of(place(np.where(mask, depth_mm, 0.0), mask, seed), SCALE)[0] for seed in range(8)]
    assert abs(np.mean(found) - depth_mm) < 0.02  # mm; it was 2 noises, 0.12
    assert np.ptp(found) < 0.06


def test_a_seam_that_one_unsure_ring_sees_too_deep_makes_no_floor_deeper() -> None:
    """Beside a step an inner ring lies 0.3 to 0.6 mm beyond the floor, and says that it may be off by 0.2."""
    mask = floor()
    seam = np.zeros((Z, A), bool)
    seam[36:39, 100:130] = True
    height = np.where(seam, 4.0 + np.linspace(0.3, 0.6, A), np.where(mask, 4.0, 0.0))
    found = [depth_of(place(height, mask, seed, np.where(seam, 0.2, NOISE_MM)), SCALE)[0] for seed in range(8)]
    assert abs(np.mean(found) - 4.0) < 0.03  # mm; it was 0.2 and more


def test_a_pit_in_a_floor_is_what_is_deepest() -> None:
    mask = floor()
    pit = np.zeros((Z, A), bool)
    pit[26:35, 111:118] = True  # 9 x 9 mm, 5 x 6.5 of it calm
    height = np.where(pit, 2.0, np.where(mask, 1.0, 0.0))
    found = [depth_of(place(height, mask, seed), SCALE)[0] for seed in range(8)]
    assert abs(np.mean(found) - 2.0) < 0.1


def test_a_round_crest_is_as_high_as_it_is() -> None:
    z, a = np.meshgrid(np.arange(Z) - 30.0, 1.3 * (np.arange(A) - 115.0), indexing="ij")  # mm
    cap = 2.5 + np.sqrt(np.maximum(25.0**2 - z**2 - a**2, 0.0)) - 25.0
    mask = cap > 0.3
    found = [depth_of(place(np.maximum(cap, 0.0), mask, seed), SCALE)[0] for seed in range(8)]
    assert abs(np.mean(found) - 2.5) < 0.05  # mm; the middle of its highest cells lay 0.1 below


def test_rings_weigh_by_what_they_may_be_off() -> None:
    """In each cell a ring that is sure, and two that all err the same way and say how much."""
    radius = np.array([76.0, 76.4, 76.5], np.float32)
    sigma = np.array([0.05, 0.4, 0.4], np.float32)
    cells = np.arange(Z * A)
    seen = WallObservations(
        np.repeat(cells, 3),
        np.tile(np.arange(3, dtype=np.int32), Z * A),
        np.tile(radius, Z * A),
        np.tile(sigma, Z * A),
        np.zeros(3 * Z * A, np.uint8),
    )
    shape = np.tile([75.0, 0.0, 0.0, 0.0, 0.0], (Z, 1))
    flat = np.zeros((Z, A), np.float32)
    wall = Wall(
        np.arange(Z) + 0.5,
        np.arange(A) + 0.5,
        np.full((Z, A), 76.4, np.float32),
        np.full((Z, A), 3, np.int32),
        shape,
        np.zeros((Z, 5, 5)),
        np.zeros(Z),
        flat,
        seen,
        flat,
    )
    assert np.allclose(wall.residual_mm(), 1.4, atol=1e-4) and np.allclose(wall.weighed_residual_mm(), 1.0, atol=1e-4)


def test_rows_wider_than_a_slit_take_no_top_off_a_crest() -> None:
    """A spherical dent of radius 45 mm in a scan of few frames: rows of 5 mm, of which a median takes three."""

    def dented(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        across = RADIUS_MM * np.radians((clock - 90.0 + 180.0) % 360.0 - 180.0)
        cap = np.sqrt(np.maximum(45.0**2 - across**2 - (z - 152.0) ** 2, 0.0)) - 42.0
        return np.asarray(round_pipe(clock, z) + np.maximum(cap, 0.0))

    wall = build_wall(scan(dented), z_step_mm=5.0)
    (dent,) = find_defects(wall, shadow_ratio=SHADOW_RATIO).defects
    assert abs(dent.depth_mm - 3.0) < 0.1  # mm; it was 0.2


@pytest.mark.parametrize(("hidden_mm", "seen"), [(0.0, True), (18.0, False)])
def test_a_floor_that_was_not_seen_farther_than_its_rim_hides_is_a_lower_bound(hidden_mm: float, seen: bool) -> None:
    profiles = []
    for one in scan(pocket(round_pipe, 60, 9, 140, 166, 1.5)):
        x, y, z = one.points_mm.T
        away = np.abs(turn(np.degrees(np.arctan2(x, -y)), 60.0))
        profiles.append(one.without((away < 12.0) & (z > 150.0 - hidden_mm) & (z < 150.0), "swallowed"))
    (loss,) = survey(profiles, CALIBRATION).defects
    assert loss.floor_seen == seen
    assert loss.depth_mm == pytest.approx(1.5, abs=0.15)
