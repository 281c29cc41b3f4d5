"""Sightings of a chain of pieces, and their derivatives, in C against tests/reference/wall_adjustment.py."""

from dataclasses import replace

import numpy as np
import wall_adjustment
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.wall.adjustment import (
    BIAS,
    HEAD,
    HEAD_STEPS,
    PIECE,
    PIECE_STEPS,
    START,
    AdjustmentState,
    Sightings,
    by_head,
    by_pieces,
    locate,
)
from annulus_pipe.wall.centreline import Centreline, Piece

few = settings(max_examples=25, deadline=None, derandomize=True)
RINGS, R = 3, 76.2


def chain(rng: np.random.Generator, count: int, bent: float) -> np.ndarray:
    """(P, PIECE) of pieces that begin, kink, bend and taper as they like; every third is straight."""
    pieces = np.zeros((count, PIECE))
    pieces[:, START] = np.sort(rng.uniform(0.0, 400.0, count)) + np.arange(count)
    pieces[:, 0:4] = rng.normal(0, 1, (count, 4)) * [0.5, 0.5, 0.02, 0.02]
    pieces[:, 4:6] = bent * rng.normal(0, 1, (count, 2)) * (np.arange(count) % 3 != 2)[:, None]
    pieces[0, 0:4] = 0.0
    pieces[:, 6], pieces[:, 7:12] = rng.normal(0, 0.5, count), rng.normal(0, 1, (count, 5)) * [0.01, 1, 1, 0.2, 0.2]
    pieces[0, 6] += R
    return pieces


def scene(seed: int, count: int, heads: int, each: int, bent: float) -> tuple[Sightings, AdjustmentState]:
    rng = np.random.default_rng(seed)
    n = heads * each
    turn, ahead = rng.uniform(0, 2 * np.pi, n), rng.uniform(-20.0, 250.0, n)
    points = np.stack([R * np.cos(turn), R * np.sin(turn), ahead], axis=1) + rng.normal(0, 2, (n, 3))
    chainage = np.sort(rng.uniform(-20.0, 380.0, heads))
    stand = rng.normal(0, 1, (heads, HEAD)) * [0.02, 0.02, 2.0, 2.0, 0.1]
    seen = Sightings(
        points,
        np.full(n, 0.05),
        np.repeat(np.arange(heads), each),
        rng.integers(0, RINGS, n),
        np.arange(heads) * each,
        chainage,
        stand,
        np.ones(heads, bool),
        np.arange(heads),
        RINGS,
        R,
        rng.normal(0, 1, (n, 3)),
        np.column_stack([np.ones(n), np.cos(turn), np.sin(turn)]),
    )
    return seen, AdjustmentState(chain(rng, count, bent), rng.normal(0, 0.03, (RINGS, BIAS)), stand)


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 6),
    heads=st.integers(1, 4),
    each=st.sampled_from([1, 7, 20]),
    bent=st.sampled_from([0.0, 1e-10, 1e-6, 3e-3]),
)
def test_they_are_the_references(seed: int, count: int, heads: int, each: int, bent: float) -> None:
    seen, state = scene(seed, count, heads, each, bent)
    found, expected = locate(seen, state), wall_adjustment.locate(seen, state)
    # of lengths of half a metre: a turn's last bits
    np.testing.assert_allclose(found.residual_mm, expected.residual_mm, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.chainage_mm, expected.chainage_mm, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.direction, expected.direction, rtol=0, atol=1e-9)


@few
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 4), bent=st.sampled_from([0.0, 1e-4, 3e-3]))
def test_a_derivative_is_the_difference_of_what_it_is_of(seed: int, count: int, bent: float) -> None:
    seen, state = scene(seed, count, 3, 8, bent)
    where, columns = locate(seen, state), np.arange(count * PIECE)
    pieces = np.empty((len(seen.frame), len(columns)))
    for j in columns:
        step = PIECE_STEPS[j % PIECE]
        tried = state.pieces.copy()
        tried.flat[j] += step
        pieces[:, j] = (locate(seen, replace(state, pieces=tried)).residual_mm - where.residual_mm) / step
    assert (by_pieces(seen, state, where, columns) == pieces).all()
    heads = np.empty((len(seen.frame), HEAD))
    for i, step in enumerate(HEAD_STEPS):
        stood = state.heads.copy()
        stood[:, i] += step
        heads[:, i] = (locate(seen, replace(state, heads=stood)).residual_mm - where.residual_mm) / step
    assert (by_head(seen, state, where) == heads.clip(-1e4, 1e4)).all()


@few
@given(seed=st.integers(0, 2**32 - 1), rubbish=st.floats(), column=st.integers(0, 2 * PIECE - 1))
def test_rubbish_touches_no_other_memory(seed: int, rubbish: float, column: int) -> None:
    seen, state = scene(seed, 2, 2, 5, 1e-3)
    state.pieces.flat[column] = rubbish
    seen.points_mm[3], state.heads[1, column % HEAD] = rubbish, rubbish
    seen.frame[:2], seen.ring[:2] = (-7, 2**62), (2**62, -7)
    where = locate(seen, state)
    by_pieces(seen, state, where, np.array([-5, column, 2**62]))
    by_head(seen, state, where)


@few
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 5), bent=st.sampled_from([0.0, 1e-4, 3e-3]))
def test_space_comes_back_to_pipe_coordinates(seed: int, count: int, bent: float) -> None:
    rng = np.random.default_rng(seed)
    rows = chain(rng, count, bent)
    line = Centreline([Piece(float(r[12]), R, tuple(r[0:2]), tuple(r[2:4]), tuple(r[4:6])) for r in rows])
    space = rng.uniform(-300, 600, (9, 3))
    since = rng.integers(0, count, 9)
    out = line.to_pipe(space, since)
    if not line.is_straight:
        for point, own, found in zip(space, since, out, strict=True):
            np.testing.assert_allclose(found, wall_adjustment.point_to_pipe(point, int(own), line), rtol=0, atol=1e-9)
    line.to_pipe(np.array([[np.nan, np.inf, 1e300]] * 3), np.array([-3, 0, 2**60]))
