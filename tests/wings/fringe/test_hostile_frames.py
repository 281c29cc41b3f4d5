"""Whatever frames, poses, slides and cross-sections hold, the loops stay within their tables and mark what they saw."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.wings.fringe.measure.bore import TERMS, BorePoints, HeadFrames, HeadLight, follow_wall, look_around
from annulus_pipe.wings.fringe.measure.groove import Plane, light_of_cut, look_at_cut
from annulus_pipe.wings.fringe.measure.projector import PLAIN
from annulus_pipe.wings.fringe.measure.track import UNSETTLED, TrackFrames, Tracks, follow, look

WILD = np.array([0.0, 1.0, 1e-300, 1e9, -1e300, np.inf, -np.inf, np.nan])
SEEDS, FRAMES, POINTS = st.integers(0, 2**32 - 1), st.integers(0, 5), st.sampled_from([0, 1, 3, 66])  # 66: over a block
HALVES = st.integers(0, 5)  # pairs of harmonics of a slide


class Numbers:
    """Arrays of numbers that are mostly sound in a third of all cases, and anything in others."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.wild = self.random.choice([0.0, 0.01, 0.5])

    def __call__(self, *shape: int) -> FloatArray:
        sound = self.random.normal(0, 2, shape)
        return np.where(self.random.random(shape) < self.wild, self.random.choice(WILD, shape), sound)

    def some(self, count: int) -> list[float]:
        return [float(one) for one in self(count)]

    def images(self, count: int) -> Float32Array:
        with np.errstate(over="ignore"):
            return self(count, *self.random.integers(0, 10, 2)).astype(np.float32)


def outcome_is_legal(flag: FloatArray, height: FloatArray, sigma: FloatArray) -> None:
    assert ((flag >= 0) & (flag <= UNSETTLED)).all()
    assert np.isnan(height[flag > 0]).all() and np.isnan(sigma[flag > 0]).all()


@given(SEEDS, FRAMES, POINTS, HALVES, st.booleans())
def test_points_before_any_frames(seed: int, count: int, points: int, half: int, tracked: bool) -> None:
    any_of = Numbers(seed)
    frames = TrackFrames(
        images=any_of.images(count) if tracked else None,
        samples=None if tracked else any_of(count, points),
        lens=any_of(10),
        cameras=any_of(count, 3, 4),
        eyes=any_of(count, 3),
        projectors=any_of(count, 3, 4),
        slide=any_of(PLAIN + 2 * half),
        drift=any_of(count),
    )
    tracks = Tracks(any_of(points, 3), any_of(1, 3), any_of(points, 3), any_of(points))
    numbers = any_of.some(5)
    with np.errstate(all="ignore"):
        outcome, left = follow(frames, tracks, numbers[0], (numbers[1], numbers[2], numbers[3]), numbers[4], True)
        look(frames.lens, any_of(3, 4), tracks.base)
    assert left.shape == (count, points)
    if points:
        outcome_is_legal(outcome.flag, outcome.height, outcome.sigma)


@given(SEEDS, FRAMES, POINTS, HALVES, st.integers(1, 3))
def test_a_wall_before_any_head(seed: int, count: int, points: int, half: int, eyes: int) -> None:
    any_of = Numbers(seed)
    frames = HeadFrames(
        images=any_of.images(count),
        lens=any_of(count, 10),
        cameras=any_of(count, 3, 4),
        heads=any_of(count, 3, 4),
        eyes=any_of(count, 3),
        projectors=any_of(count, 3, 4),
        slide=any_of(count, PLAIN + 2 * half),
        drift=any_of(count),
        eye=any_of.random.integers(-(2**63), 2**63 - 1, count),
    )
    numbers = any_of.some(6)
    shading = any_of(eyes, 3, TERMS)
    wall = BorePoints(any_of(points, 3), any_of(points, 3), any_of(points), any_of(points))
    light = HeadLight(shading, numbers[0], numbers[1], (numbers[2], numbers[3], numbers[4]))
    outcome, who = follow_wall(frames, light, wall, numbers[5])
    assert ((who >= -1) & (who <= eyes)).all()
    outcome_is_legal(outcome.flag, outcome.height, outcome.sigma)
    assert look_around(frames, wall.base, wall.path)[0].shape == (count, points)
    look_at_cut(frames, shading, numbers[0], any_of(3), numbers[1], any_of(points))


@given(SEEDS, FRAMES, st.integers(0, 9), HALVES)
def test_a_groove_before_any_light(seed: int, count: int, rows: int, half: int) -> None:
    any_of = Numbers(seed)
    numbers = any_of.some(3)
    plane = Plane(
        any_of(count, PLAIN + 2 * half),
        any_of(count, 3, 4),
        any_of(count, 2),
        any_of(count, 2),
        any_of(3),
        numbers[0],
        numbers[1],
        numbers[2],
    )
    looks = [any_of(count, rows) for _ in range(3)]
    assert light_of_cut(plane, any_of(5), looks[0], looks[1], looks[2]).shape == (count, rows, rows)
