"""How far a frame leans, in C against tests/reference/wall_registration.py."""

import numpy as np
import wall_registration
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, TUKEY
from annulus_pipe.wall.grid import NOISE_FLOOR_MM
from annulus_pipe.wall.registration import CONDITION_MOST, LANES, POINTS_NEEDED, _frame_correction

few = settings(max_examples=40, deadline=None, derandomize=True)
R = 76.2


def corrected(
    points: np.ndarray, z_mm: float, stations: np.ndarray, shape: np.ndarray
) -> tuple[int, np.ndarray, float]:
    found, moves = np.empty(4), np.empty(1)
    known = (float(np.median(shape[:, 0])), POINTS_NEEDED, NOISE_FLOOR_MM, TUKEY, SIGMA_OF_MAD, CONDITION_MOST)
    room = np.empty((13, len(points) + LANES))
    agrees = _frame_correction(points.astype(np.float32), z_mm, stations, shape, *known, room, found, moves)
    return agrees, found, float(moves[0])


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([199, 200, 333, 800]),
    turn=st.sampled_from([0.02, 1.0, 6.28]),
    lean=st.tuples(*[st.floats(-0.02, 0.02)] * 2, *[st.floats(-2.0, 2.0)] * 2),
    dent=st.sampled_from([0.0, 4.0, -20.0]),
    stations=st.sampled_from([1, 2, 30]),
)
def test_it_is_the_references(
    seed: int, size: int, turn: float, lean: tuple[float, ...], dent: float, stations: int
) -> None:
    rng = np.random.default_rng(seed)
    at = 100.0 + 4.0 * np.arange(stations)
    shape = np.array([R, 0.0, 0.0, 0.0, 0.0]) + rng.normal(0, 0.1, (stations, 5))
    angle, z = rng.uniform(0, turn, size), rng.uniform(95.0, 210.0, size)
    radius = R + rng.normal(0, 0.05, size) + dent * (angle < turn / 5)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    points = Pose(*lean).to_pipe(points - [0, 0, 50.0], 50.0).astype(np.float32)
    agrees, found, moves = corrected(points, 50.0, at, shape)
    expected = wall_registration.correction(points.astype(float), 50.0, at, shape)
    assert bool(agrees) == (expected is not None)
    if expected is not None:
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)  # of a condition of up to a million
        x, y, z = points.astype(float)[(points[:, 2] >= at[0]) & (points[:, 2] <= at[-1])].T
        ahead = (z - 50.0) / np.median(shape[:, 0])
        turned = ((found[0] + found[2] * ahead) * x + (found[1] + found[3] * ahead) * y) / np.hypot(x, y)
        np.testing.assert_allclose(moves, np.percentile(np.abs(turned), 90), rtol=1e-9)


@few
@given(st.lists(st.tuples(*[st.floats(width=32)] * 3), min_size=1, max_size=9), st.floats(), st.integers(1, 3))
def test_rubbish_has_a_correction_or_none(
    rows: list[tuple[float, float, float]], rubbish: float, stations: int
) -> None:
    points = np.tile(np.array(rows, np.float32), (300, 1))
    at = np.array([100.0, 110.0, rubbish][:stations])
    corrected(points, rubbish, at, np.full((stations, 5), rubbish))
    corrected(points, 50.0, at, np.full((stations, 5), R))
