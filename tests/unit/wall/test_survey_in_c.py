"""Stations, spots, observations, middles and beginnings in C, against tests/reference/wall_survey.py."""

import numpy as np
import wall_survey
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.wall.adjustment import _middle_points
from annulus_pipe.wall.axis import HELD, LANES, _begin_normals
from annulus_pipe.wall.crosscheck import _spot_pairs
from annulus_pipe.wall.cylinder import round_axis, round_clock
from annulus_pipe.wall.grid import _cell_observations
from annulus_pipe.wall.looks import _shape_departures
from annulus_pipe.wall.openings import _ring_ends
from annulus_pipe.wall.stations import _closed_lines, station_medians

few = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
anything = st.floats(width=32)
indices = st.integers(-(2**63), 2**63 - 1)


def pairs_of(cell: np.ndarray, frame: np.ndarray, ring: np.ndarray, calm: np.ndarray) -> list[tuple[int, int]]:
    room = np.empty(len(calm), np.int64), np.empty(len(cell), np.int32), np.empty(len(cell), np.int32)
    pairs, more = np.empty((2, 2, len(cell)), np.int32), np.empty(1, np.int64)
    first = _spot_pairs(cell, frame, ring, calm, *room, pairs, more)
    return [(int(a), int(b)) for of, size in zip(pairs, (first, more[0]), strict=True) for a, b in of[:, :size].T]


def observed(cell: np.ndarray, number: np.ndarray, square: np.ndarray, cells: int) -> tuple[list, list]:
    times, squares = np.empty(cells), np.empty(cells)
    _cell_observations(cell, number, square, np.empty(cells, np.int64), np.empty(len(cell), np.int32), times, squares)
    return times.tolist(), squares.tolist()


def middles(points: np.ndarray, ring: np.ndarray, sectors: int, rings: int) -> list[int]:
    n = len(ring)
    room = np.empty(rings * sectors, np.int64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty((2, n))
    chosen = np.empty(n, np.int64)
    return [int(one) for one in chosen[: _middle_points(points, ring, sectors, 3, *room, chosen)]]


@few
@given(seed=seeds, rows=st.integers(1, 4), beside=st.integers(0, 2), seen=st.sampled_from([0.0, 0.3, 0.9, 1.0]))
def test_stations_are_the_references(seed: int, rows: int, beside: int, seen: float) -> None:
    rng = np.random.default_rng(seed)
    field = np.where(rng.random((7, 9)) < seen, rng.normal(76.2, 1.0, (7, 9)), np.nan).astype(np.float32)
    np.testing.assert_array_equal(
        station_medians(field, rows, beside), wall_survey.station_medians(field, rows, beside)
    )
    radius, shape, out = field.astype(float), rng.normal(76.2, 0.1, (7, 9)), np.empty((7, 2))
    turn = 2 * np.pi / 9
    of_arc = (turn / 2) / np.sin(turn / 2), np.cos(turn), turn
    _closed_lines(radius, shape, 4.0, 2.0, rows, *of_arc, np.empty(9), np.empty(9), out)
    expected = [wall_survey.closed_line(*one, 4.0, 2.0, rows) for one in zip(radius, shape, strict=True)]
    np.testing.assert_allclose(out, expected, rtol=1e-12)


@few
@given(seed=seeds, n=st.sampled_from([0, 1, 30, 300]), cells=st.integers(1, 7), frames=st.integers(1, 5))
def test_spots_and_observations_are_the_references(seed: int, n: int, cells: int, frames: int) -> None:
    rng = np.random.default_rng(seed)
    cell, frame, ring = rng.integers(0, cells, n), np.sort(rng.integers(0, frames, n)), rng.integers(0, 3, n)
    calm = rng.random(cells) < 0.7
    assert pairs_of(cell, frame, ring, calm) == wall_survey.spot_pairs(cell, frame, ring, calm)
    square = rng.integers(1, 9, 3).astype(float)  # whole: no sum that the order of its parts changes
    number = rng.integers(0, 12, n).astype(np.int32)
    assert observed(cell, number, square, cells) == wall_survey.cell_observations(cell, number, square, cells)


@few
@given(seed=seeds, n=st.sampled_from([1, 40, 200]), stations=st.integers(1, 6), rings=st.integers(1, 3))
def test_points_are_the_references(seed: int, n: int, stations: int, rings: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, 60.0, (n, 3)).astype(np.float32)
    at, shape = np.linspace(-40.0, 70.0, stations), rng.normal(0.0, 1.0, (stations, 5))
    radius, departure = np.empty(n), np.empty(n)
    _shape_departures(points, at, shape, radius, departure)
    expected = wall_survey.shape_departures(points, at, shape)
    np.testing.assert_allclose([radius, departure], expected, rtol=1e-11, atol=1e-11)
    for found, clock in ((round_axis(points), False), (round_clock(points), True)):
        np.testing.assert_allclose(found, wall_survey.round_axis(points, clock), rtol=1e-14, atol=1e-13)
    ring = rng.integers(0, rings, n).astype(np.uint8)
    assert middles(points, ring, 8, rings) == wall_survey.middle_points(points, ring, 8, 3)


def ends_of(look: np.ndarray, angle: np.ndarray, column: np.ndarray, *of_looks: np.ndarray) -> list:
    looks = len(of_looks[0])
    first = np.searchsorted(look, np.arange(looks + 1))
    at, end = np.empty((2 * looks, 2), np.int64), np.empty(2 * looks)
    size = _ring_ends(first, angle, column, np.empty(len(look)), *of_looks, at, end)
    return [(*pair, one) for pair, one in zip(at[:size].tolist(), end[:size].tolist(), strict=True)]


@few
@given(seed=seeds, n=st.sampled_from([0, 1, 30, 200]), looks=st.integers(1, 6), part=st.sampled_from([0.1, 0.4, 0.9]))
def test_ends_of_rings_are_the_references(seed: int, n: int, looks: int, part: float) -> None:
    rng = np.random.default_rng(seed)
    look, angle, column = np.sort(rng.integers(0, looks, n)), rng.normal(0, 1, n), rng.integers(0, 12, n)
    of_looks = rng.random((looks, 12)) < part, rng.random((looks, 12)) < 0.3, rng.permutation(12)
    found, expected = (of(look, angle, column, *of_looks) for of in (ends_of, wall_survey.ring_ends))
    assert [one[:2] for one in found] == [one[:2] for one in expected]
    np.testing.assert_allclose([one[2] for one in found], [one[2] for one in expected], rtol=1e-13, atol=1e-15)


@few
@given(seed=seeds, frames=st.integers(1, 4), place=st.floats(-30.0, 130.0))
def test_what_begins_is_the_references(seed: int, frames: int, place: float) -> None:
    rng = np.random.default_rng(seed)
    n, frame = 60 * frames, np.repeat(np.arange(frames), 60)
    z, t = 20.0 * frame + rng.uniform(0.0, 60.0, n), rng.uniform(0.0, 6.3, n)
    direction, weight = np.stack([np.cos(t), np.sin(t)], axis=1), rng.uniform(0.0, 2.0, n)
    residual, lean = rng.normal(0.0, 0.1, n), rng.normal(0.0, 1.0, (n, 5))
    first = np.arange(frames) * 60
    low, high = np.minimum.reduceat(z, first), np.maximum.reduceat(z, first)
    room = np.empty((frames, 5, 5)), np.empty((frames, 5)), np.empty((22, 60 + LANES))
    normal, right = np.empty((1, 8, 8)), np.empty((1, 8))
    known = (z, direction, weight, residual, lean, np.array(HELD), np.array([place]))
    _begin_normals(first, low, high, *known, *room, normal, right)
    expected = wall_survey.begin_normals(frame, z, direction, weight, residual, lean, np.array(HELD), place)
    np.testing.assert_allclose(normal[0], expected[0], rtol=1e-9, atol=1e-6 * np.abs(expected[0]).max() + 1e-12)
    np.testing.assert_allclose(right[0], expected[1], rtol=1e-9, atol=1e-6 * np.abs(expected[1]).max() + 1e-12)


@few
@given(st.lists(st.tuples(indices, indices, anything, anything), min_size=1, max_size=20), st.integers(1, 5))
def test_rubbish_touches_no_other_memory(of: list, size: int) -> None:
    a, b = (np.array([one[k] for one in of], np.int64) for k in (0, 1))
    x, y = (np.array([one[k] for one in of], np.float32) for k in (2, 3))
    points, n = np.stack([x, y, x], axis=1), len(of)
    pairs_of(a, b, b, np.ones(size, bool))
    observed(a, a.astype(np.int32), np.ones(size), size)
    middles(points, a.astype(np.uint8), size, 2)
    round_axis(points), round_clock(points)
    ends_of(a, x.astype(float), b, *(np.resize(a % 2 == k, (size, 7)) for k in (0, 1)), np.resize(b, 7))
    _shape_departures(points, np.resize(x, n).astype(float), np.ones((n, 5)), np.empty(n), np.empty(n))
    station_medians(np.stack([x, y]), size, size)
    wide, out = np.resize(x, (1, max(n, 3))).astype(float), np.empty((1, 2))
    _closed_lines(wide, wide, 1e9, 1e9, size, 1.0, 1.0, 1.0, np.empty(max(n, 3)), np.empty(max(n, 3)), out)
    reals, frames = np.resize(x, n).astype(float), np.sort(a % n)
    room = np.empty((n, 5, 5)), np.empty((n, 5)), np.empty((22, n + LANES))
    of_points = reals, np.stack([reals, reals], axis=1), reals, reals, np.stack([reals] * 5, axis=1)
    _begin_normals(frames, reals, reals, *of_points, np.ones(5), reals, *room, np.empty((n, 8, 8)), np.empty((n, 8)))
