"""The points so far: thinned, bounded, of a whole scan however long."""

import time
import tracemalloc

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.console.cloud import Cloud

GREY = np.full((3000, 3), 128, np.uint8)


def frame_at(z_mm: float, seed: int = 0) -> NDArray[np.float32]:
    """(3000, 3) mm: ten rings round a pipe of 150 mm, seen from z."""
    rng = np.random.default_rng(seed)
    phi = rng.uniform(0, 2 * np.pi, 3000)
    z = z_mm + 25.0 * rng.integers(0, 10, 3000)
    return np.stack([75 * np.sin(phi), -75 * np.cos(phi), z], axis=1).astype(np.float32)


def test_the_same_place_is_kept_once() -> None:
    cloud = Cloud(50_000)
    for _ in range(50):
        cloud.add(frame_at(0.0), GREY)
    xyz, rgb = cloud.block(0, 50_000)
    assert len(cloud) == len(xyz) == len(rgb)
    assert len(cloud) >= 0.99 * len(np.unique(np.floor(frame_at(0.0) / 2.0), axis=0))
    assert set(map(tuple, xyz.tolist())) <= set(map(tuple, frame_at(0.0).tolist()))


def test_a_metre_is_covered_all_round() -> None:
    """No gap larger than 2 degrees by 10 mm where the wall was seen."""
    cloud = Cloud()
    for number in range(400):
        cloud.add(frame_at(3.0 * number, number), GREY)
    xyz, _ = cloud.block(0, 1_000_000)
    inside = xyz[(xyz[:, 2] > 300) & (xyz[:, 2] < 1100)]
    column = (np.degrees(np.arctan2(inside[:, 0], inside[:, 1])) // 2).astype(int)
    row = (inside[:, 2] // 10).astype(int)
    assert len(set(zip(column.tolist(), row.tolist(), strict=True))) == 180 * 80


def test_eight_hours_are_shown_as_a_whole_in_memory_that_does_not_grow() -> None:
    """2 km at 75 mm/s, every tenth frame: what a frame adds is bounded, so is the sum."""
    tracemalloc.start()
    try:
        cloud = Cloud(20_000)
        begun, _ = tracemalloc.get_traced_memory()
        for number in range(1500):
            cloud.add(frame_at(1400.0 * number, number), GREY)
        now, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert now - begun < 100_000
    xyz, _ = cloud.block(0, 20_000)
    assert 5_000 < len(cloud) <= 20_000
    share, _ = np.histogram(xyz[:, 2], 10, (0, 2_100_000))
    assert share.min() > 0.3 * share.max()


def test_who_follows_it_sees_when_it_begins_anew() -> None:
    cloud = Cloud(4000)
    cloud.add(frame_at(0.0), GREY)
    generation = cloud.generation
    cloud.add(frame_at(100.0), GREY)
    cloud.add(frame_at(800.0), GREY)
    assert cloud.generation > generation and cloud.voxel_mm > 2.0
    generation = cloud.generation
    cloud.clear()
    assert cloud.generation > generation and len(cloud) == 0 and cloud.voxel_mm == 2.0
    cloud.add(frame_at(0.0), GREY)
    assert len(cloud) > 1700


def test_a_frame_costs_little() -> None:
    cloud = Cloud()
    frames = [frame_at(3.0 * number, number) for number in range(100)]
    begun = time.process_time()
    for frame in frames:
        cloud.add(frame, GREY)
    assert time.process_time() - begun < 0.1  # 1 ms each; 0.15 ms are measured


def test_points_from_nowhere_do_no_harm() -> None:
    cloud = Cloud(100)
    cloud.add(np.array([[3e38, -3e38, 0.0], [0.0, 0.0, 0.0]], np.float32), GREY[:2])
    assert len(cloud) == 2
