"""Which points are contradicted, in C against tests/reference/wall_consistency.py."""

import numpy as np
import wall_consistency
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.wall.consistency import _votes

few = settings(max_examples=40, deadline=None, derandomize=True)


def voted(cell: np.ndarray, frame: np.ndarray, radius: np.ndarray, weight: np.ndarray, rows: int, columns: int) -> list:
    n = len(cell)
    good, room = np.zeros(n, bool), (np.empty(rows * columns + 1, np.int64), np.empty(n, np.int64), np.empty((3, n)))
    _votes(cell, frame.astype(float), radius, weight, 0.7, 3, 0.1, rows, *room, good)
    return good.tolist()


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.sampled_from([0, 1, 5, 60, 400]),
    frames=st.integers(1, 6),
    rows=st.integers(1, 5),
    columns=st.sampled_from([3, 4, 9]),
    spread=st.sampled_from([0.1, 2.0]),
)
def test_it_is_the_references(seed: int, n: int, frames: int, rows: int, columns: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    cell, frame = rng.integers(0, rows * columns, n), rng.integers(0, frames, n)
    # whole weights and tenths of a millimetre: no sum that the order of its parts changes
    radius, weight = 76.2 + np.rint(rng.normal(0, 10 * spread, n)) / 16, rng.integers(1, 9, n).astype(float)
    expected = wall_consistency.votes(cell, frame, radius, weight, 0.7, 3, 0.1, rows, columns)
    assert voted(cell, frame, radius, weight, rows, columns) == expected.tolist()


@few
@given(st.lists(st.tuples(st.integers(-(2**63), 2**63 - 1), st.floats(), st.floats()), max_size=30), st.integers(1, 9))
def test_rubbish_touches_no_other_memory(points: list, columns: int) -> None:
    cell = np.array([one[0] for one in points], np.int64)
    radius, weight = (np.array([one[k] for one in points], float) for k in (1, 2))
    voted(cell, cell % 3, radius, weight, 2, columns)
