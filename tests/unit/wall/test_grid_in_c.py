"""Cells of the wall in C against tests/reference/wall_grid.py."""

import numpy as np
import wall_grid
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.wall.grid import _bridge, _neighbour_extremes, cell_medians, smooth

few = settings(max_examples=40, deadline=None, derandomize=True)
shapes = st.tuples(st.integers(1, 6), st.sampled_from([3, 5, 16, 17, 40]))


def field(seed: int, shape: tuple[int, int], unseen: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = 76.0 + rng.integers(0, 16, shape) / 8.0  # whole parts: no sum rounds
    out[rng.random(shape) < unseen] = np.nan
    return out


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([0, 1, 7, 90, 400]),
    cells=st.sampled_from([1, 4, 60]),
    weighed=st.booleans(),
)
def test_medians_are_the_references(seed: int, size: int, cells: int, weighed: bool) -> None:
    rng = np.random.default_rng(seed)
    cell, value = rng.integers(0, cells, size), rng.integers(-20, 20, size) / 8.0
    weight = rng.integers(1, 9, size) / 4.0 if weighed else None
    found, count = cell_medians(cell, value, (1, cells), weight)
    assert (count[0] == np.bincount(cell, minlength=cells)).all()
    np.testing.assert_array_equal(found[0], wall_grid.medians(cell, value, cells, weight))


@few
@given(st.lists(st.tuples(st.integers(-(2**63), 2**63 - 1), st.floats(), st.floats()), max_size=70))
def test_rubbish_touches_no_other_memory(points: list[tuple[int, float, float]]) -> None:
    cell, value, weight = (np.array([one[k] for one in points], kind) for k, kind in enumerate((int, float, float)))
    cell_medians(cell, value, (2, 1))
    cell_medians(cell, value, (2, 1), weight)


@few
@given(
    seed=st.integers(0, 2**32 - 1), shape=shapes, unseen=st.sampled_from([0.0, 0.3, 0.8]), rows=st.sampled_from([1, 3])
)
def test_neighbours_say_what_the_references_do(seed: int, shape: tuple[int, int], unseen: float, rows: int) -> None:
    grid = field(seed, shape, unseen)
    np.testing.assert_array_equal(smooth(grid.astype(np.float32), rows), wall_grid.smoothed(grid, rows))
    if shape[1] >= 5:  # fewer columns are their own neighbours twice
        low, high = np.empty(shape), np.empty(shape)
        _neighbour_extremes(grid, np.empty((2, shape[1] + 4)), low, high)
        np.testing.assert_array_equal((low, high), wall_grid.extremes(grid))


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 12), st.sampled_from([3, 5, 17])),
    unseen=st.sampled_from([0.2, 0.6, 1.0]),
    sampling=st.sampled_from([1.0, 2.5, 6.0]),
)
def test_gaps_are_filled_as_the_reference_fills_them(
    seed: int, shape: tuple[int, int], unseen: float, sampling: float
) -> None:
    grid = field(seed, shape, unseen)
    np.testing.assert_allclose(_bridge(grid, sampling), wall_grid.bridged(grid, sampling), rtol=0, atol=1e-12)


@few
@given(st.lists(st.floats(), min_size=24, max_size=24), st.sampled_from([0.0, 1e300, np.nan]))
def test_a_grid_of_rubbish_stays_one(values: list[float], sampling: float) -> None:
    grid = np.array(values).reshape(4, 6)
    assert _bridge(grid, sampling).shape == (4, 6)
    assert smooth(grid.clip(-1e38, 1e38).astype(np.float32)).shape == (4, 6)
