"""Where rows may lie, by all chains: as sure as what lies around them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as drawn

from annulus_pipe.archive.chain import believed_states, joined, likeliest, row_costs

ROWS, STATES, NEAR, FAR, FADE = 41, 31, 1e-6, 1e-3, 0.8


def believed(sure: dict[int, int], leaps: dict[int, int] | None = None) -> np.ndarray:
    """sure: row -> state that it was found at."""
    cost = np.zeros((ROWS, STATES))
    for row, state in sure.items():
        cost[row, state] = -40.0
    leap = np.zeros(ROWS, np.int64)
    for row, states in (leaps or {}).items():
        leap[row] = states
    return believed_states(cost, leap, NEAR, FAR, FADE)


def test_rows_are_sure_at_what_was_found_and_less_so_away_from_it() -> None:
    there = believed({5: 15, 20: 15})
    assert np.allclose(there.sum(axis=1), 1.0)
    assert there[12, 15] > 0.99  # between two that agree
    away = there[20:, 15]
    assert (np.diff(away) < 0).all() and 0.9 < away[-1] < 0.99  # 20 rows on, a slip in a thousand each


def test_a_slip_between_two_that_were_found_may_lie_anywhere_between() -> None:
    there = believed({0: 10, 40: 16})
    assert there[20, 10] == np.clip(there[20, 10], 0.4, 0.6) and there[20, 16] == np.clip(there[20, 16], 0.4, 0.6)
    assert there[1, 10] > 0.9 and there[39, 16] > 0.9


def test_a_slip_that_was_put_at_a_row_may_as_well_lie_beside_it() -> None:
    plain = believed({0: 10, 40: 16})
    put = believed({0: 10, 40: 10}, {20: 6})  # the same, in states beside a chain that slips at row 20
    assert np.allclose(put[:20], plain[:20], atol=0.02)
    assert np.allclose(put[20:, : STATES - 6], plain[20:, 6:], atol=0.02)


def test_a_row_gains_where_it_is_found_again_and_not_from_what_grew() -> None:
    rng = np.random.default_rng(1)
    first = rng.normal(0, 0.05, (40, 60)).astype(np.float32)
    second = (first + rng.normal(0, 0.01, first.shape)).astype(np.float32)
    second[:, 10:20] += 2.0  # new
    at = np.stack([np.arange(40.0), np.arange(40.0) + 7], axis=1)[2:30]
    cost = row_costs(second[2:30], first, at, np.zeros_like(at), 0.014)
    assert (cost[:, 0] < -60).all() and (cost[:, 1] > -40).all()
    bare = np.zeros_like(second[2:30])
    bare[:, 10:20] = 2.0
    empty = np.zeros_like(first)
    assert np.allclose(row_costs(bare, empty, at, np.zeros_like(at), 0.014), 0.0)


@given(st.data(), st.integers(0, 5), st.integers(0, 4), st.integers(0, 9), st.integers(0, 20))
def test_whatever_maps_and_places_hold_no_row_or_state_is_one_that_is_not_there(
    data: st.DataObject, rows: int, others: int, states: int, columns: int
) -> None:
    anything, small = drawn.arrays(np.float64, (rows, states)), drawn.arrays(np.float32, (others, columns))
    second = data.draw(drawn.arrays(np.float32, (rows, columns)))
    at, turned = data.draw(anything), data.draw(anything)
    with np.errstate(all="ignore"):
        cost = row_costs(second, data.draw(small), at, turned, 0.014)
        assert (cost[~((at >= 0) & (np.floor(at) + 1 < others))] == 0).all()
        chain = likeliest(at, *data.draw(st.tuples(st.floats(), st.floats())))
        assert len(chain) == rows and (not states or ((chain >= 0) & (chain < states)).all())
        if states:
            leaps = data.draw(drawn.arrays(np.int64, rows))
            sums = believed_states(at, leaps, NEAR, FAR, FADE).sum(axis=1)
            assert np.allclose(sums[np.isfinite(sums)], 1.0)
        weight, pull = second[:, :1].ravel().astype(float), turned[:, :1].ravel()
        value, variance = joined(np.resize(weight, rows), np.resize(pull, rows), np.zeros(max(rows - 1, 0)))
        assert len(value) == len(variance) == rows
