"""A pocket or a bump where a bend begins was listed as the joint the bend is welded with, and looked at for nothing
else: whatever stood out near a bend's end made one. Fails with a zone that shows no bead listed all the same."""

import math

import pytest
from chained_pipe import Departure, bead, frames, pit
from synthetic_pipe import CALIBRATION, RADIUS_MM

from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.survey import survey

STATIONS = [4.0 * i for i in range(25) if i % 5 != 4]
BEND_MM = 3.0 * RADIUS_MM
ENDS_MM = 150.0 + math.radians(20.0) * BEND_MM


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("there", "names"),
    [
        (pit(120.0, 150.0, 2.5), ["bend"]),
        (pit(120.0, 150.0, -2.5), ["bend"]),
        (bead(150.0, 3.0, 4.0), ["joint", "bend"]),
    ],
)
def test_only_a_bead_is_a_weld(there: Departure, names: list[str]) -> None:
    line = Centreline(
        [Piece(0.0, RADIUS_MM), Piece(150.0, RADIUS_MM, curvature=(1 / BEND_MM, 0.0)), Piece(ENDS_MM, RADIUS_MM)]
    )
    pipe = survey(frames(line, STATIONS, there), CALIBRATION)
    assert [str(one.kind) for one in pipe.features] == names
    assert len(pipe.defects) == (FeatureKind.JOINT not in names)
