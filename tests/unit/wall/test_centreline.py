"""A pipe's centre line: there and back, and against what geometry says of a bend."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.wall.centreline import Centreline, Piece

small = st.floats(-0.03, 0.03)
side = st.floats(-3.0, 3.0)
curvature = st.floats(-0.003, 0.003)


@given(st.lists(st.tuples(side, side, small, small, curvature, curvature), min_size=1, max_size=5), st.integers(0, 99))
@settings(max_examples=60, deadline=None)
def test_from_pipe_to_space_and_back(rows: list[tuple[float, ...]], seed: int) -> None:
    pieces = [
        Piece(150.0 * i, 76.2, (row[0], row[1]), (row[2], row[3]), (row[4], row[5])) for i, row in enumerate(rows)
    ]
    line = Centreline(pieces)
    rng = np.random.default_rng(seed)
    pipe = np.column_stack([rng.uniform(-40, 40, (200, 2)), rng.uniform(1.0, 150.0 * len(rows) - 1.0, 200)])
    # near a joint that turns, a point may belong to both its pipes
    clear = np.abs((pipe[:, 2] + 75.0) % 150.0 - 75.0) > 6.0
    pipe = pipe[clear | (len(rows) == 1)]
    since = line.piece_of(pipe[:, 2])
    back = line.to_pipe(line.to_space(pipe), since)
    assert np.abs(back - pipe).max(initial=0.0) < 1e-6


def test_a_bend_of_90_degrees_ends_beside_its_beginning() -> None:
    radius = 457.2
    arc = radius * np.pi / 2
    line = Centreline([Piece(0.0, 76.2), Piece(150.0, 76.2, curvature=(1 / radius, 0.0)), Piece(150.0 + arc, 76.2)])
    end = line.to_space(np.array([[0.0, 0.0, 150.0 + arc], [0.0, 0.0, 150.0 + arc + 100.0]]))
    assert end[0] == pytest.approx([radius, 0.0, 150.0 + radius])
    assert end[1] == pytest.approx([radius + 100.0, 0.0, 150.0 + radius])
    inside = line.to_pipe(
        np.array([[radius - (radius - 30.0) / np.sqrt(2), 5.0, 150.0 + (radius - 30.0) / np.sqrt(2)]])
    )
    assert inside[0] == pytest.approx([30.0, 5.0, 150.0 + arc / 2])


def test_a_joint_moves_and_turns_what_lies_behind_it() -> None:
    line = Centreline([Piece(0.0, 76.2), Piece(100.0, 75.0, offset_mm=(1.0, -2.0), turn=(0.02, 0.0))])
    ahead = line.to_space(np.array([[0.0, 0.0, 200.0]]))[0]
    assert ahead == pytest.approx([1.0 + 100 * np.sin(0.02), -2.0, 100.0 + 100 * np.cos(0.02)])
    assert line.radius_at(np.array([50.0, 150.0])) == pytest.approx([76.2, 75.0])


def test_pieces_must_rise() -> None:
    with pytest.raises(ValueError, match="rise"):
        Centreline([Piece(10.0, 76.2), Piece(10.0, 76.2)])
    with pytest.raises(ValueError, match="rise"):
        Centreline([])
