"""What ends a bend."""

import numpy as np
import pytest
from chained_pipe import frames
from synthetic_pipe import CALIBRATION

from annulus_pipe.wall.adjustment import PIECE, AdjustmentState, adjust, sightings
from annulus_pipe.wall.adjustment import START as START_OF_PIECE
from annulus_pipe.wall.axis import Begins, _ended, _free
from annulus_pipe.wall.centreline import Centreline, Piece

R = CALIBRATION.pipe_radius_mm
START, END, BEND = 60.0, 150.0, 400.0


@pytest.mark.parametrize(("hilo", "ends"), [(0.0, Begins.STRAIGHT), (1.5, Begins.JOINT)])
def test_a_turn_shortly_before_a_bends_end_is_its_end(hilo: float, ends: Begins) -> None:
    line = Centreline([Piece(0.0, R), Piece(START, R, curvature=(1 / BEND, 0.0)), Piece(END, R, (0.0, hilo))])
    seen = sightings(frames(line, np.arange(-40.0, 160.0, 33.0)), CALIBRATION.rings, 24)
    assert seen is not None
    pieces = np.zeros((3, PIECE))
    pieces[:, START_OF_PIECE], pieces[0, 6], pieces[1, 4] = (0.0, START, END - 5.0), R, 1 / BEND
    begins = [Begins.STRAIGHT, Begins.BEND, Begins.JOINT]
    start = AdjustmentState(pieces, np.zeros((seen.rings, 3)), seen.heads)
    found = adjust(seen, start, _free(begins), scales_mm=(1.0, 0.5))
    found, begins = _ended(seen, found, begins)
    assert begins[2] is ends
    if ends is Begins.STRAIGHT:
        assert found.state.pieces[2, START_OF_PIECE] == pytest.approx(END, abs=0.5)
        assert found.state.pieces[1, 4] == pytest.approx(1 / BEND, rel=0.005)
