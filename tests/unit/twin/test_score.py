"""The judge is judged: clouds and lists with known errors get exactly those errors."""

import numpy as np
import pytest

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.twin.score import score, score_cloud, score_defects
from annulus_pipe.twin.worlds import WorldFeature, clock_text, demo_world

WORLD = demo_world()


def wall(error_mm: float, seed: int = 0, count: int = 40_000) -> FloatArray:
    rng = np.random.default_rng(seed)
    clock, z = rng.uniform(0, 360, count), rng.uniform(100, 420, count)
    radius = WORLD.radius_mm + WORLD.deviation(clock, z) + error_mm
    angle = np.radians(clock)
    return np.stack([radius * np.sin(angle), -radius * np.cos(angle), z], axis=1)


def test_a_perfect_cloud_scores_zero_and_a_shifted_one_its_shift() -> None:
    assert score_cloud(WORLD, wall(0.0)).rms_mm < 1e-13
    shifted = score_cloud(WORLD, wall(0.125), np.arange(40_000) % 5)
    assert shifted.median_mm == pytest.approx(0.125)
    assert shifted.rms_by_ring_mm == pytest.approx((0.125,) * 5)
    assert shifted.gross_percent == 0.0


def test_gross_errors_are_counted_as_a_share() -> None:
    points = wall(0.0)
    points[::100, :2] *= 1.05
    assert score_cloud(WORLD, points).gross_percent == pytest.approx(1.0, abs=0.025)


def test_a_perfect_list_finds_all_and_nothing_false() -> None:
    listed = [f.as_defect(WORLD.radius_mm) for f in WORLD.features]
    judged = score(WORLD, wall(0.0), defects=listed)["defects"]
    assert (judged["found"], judged["missed"], judged["false"]) == (len(WORLD.features), 0, 0)


def test_a_wrong_kind_or_place_is_both_missed_and_false() -> None:
    listed = [f.as_defect(WORLD.radius_mm) for f in WORLD.features]
    listed[0]["kind"] = "bump"
    listed[1]["z_mm"] += 7.0
    judged = score_defects(WORLD, listed)
    assert (judged["missed"], judged["false"]) == (2, 2)


def test_a_feature_the_scan_did_not_reach_is_not_missed() -> None:
    judged = score_defects(WORLD, [], seen_mm=(100.0, 250.0))
    assert (judged["missed"], judged["not_scanned"]) == (2, len(WORLD.features) - 2)


def test_clock_positions_read_as_on_a_dial() -> None:
    assert [clock_text(d) for d in (0, 90, 215, 359.9, 100)] == ["12:00", "3:00", "7:10", "12:00", "3:20"]


def test_features_have_the_shape_they_say() -> None:
    pocket = WorldFeature("pocket", 100.0, 20.0, 3.0, clock_deg=90.0, arc_deg=30.0)
    clock, z = np.array([90.0, 80.0, 110.0, 90.0]), np.array([100.0, 95.0, 100.0, 111.0])
    np.testing.assert_allclose(pocket.deviation(clock, z, 76.2), [3, 3, 0, 0])
    bump = WorldFeature("bump", 100.0, 24.0, 4.0, clock_deg=0.0)
    assert bump.deviation(np.array([0.0]), np.array([100.0]), 76.2)[0] == pytest.approx(-4.0)
    assert bump.deviation(np.array([0.0]), np.array([112.1]), 76.2)[0] == 0.0
    oval = WorldFeature("oval", 100.0, 60.0, 2.0, clock_deg=30.0)
    np.testing.assert_allclose(
        oval.deviation(np.array([30.0, 120.0, 210.0, 30.0]), np.array([100.0, 100.0, 100.0, 130.0]), 76.2),
        [2, -2, 2, 0],
        atol=1e-12,
    )
