"""A bend of 8 degrees that was shorter than half a radius was listed as a joint with an angle of 8 degrees, and what
was no surer than 4 +- 11 degrees as a bend. Fails without KINK_MOST of joints.py, and without SURE of bends.py."""

import math
from dataclasses import replace

import numpy as np
import pytest
from chained_pipe import frames
from synthetic_pipe import CALIBRATION, RADIUS_MM

from annulus_pipe.wall.axis import find_axis
from annulus_pipe.wall.bends import find_bends
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.survey import survey

STATIONS = [4.0 * i for i in range(25) if i % 5 != 4]
BEND_MM = 3.0 * RADIUS_MM


def bent(degrees: float) -> Centreline:
    ends = 150.0 + math.radians(degrees) * BEND_MM
    return Centreline(
        [Piece(0.0, RADIUS_MM), Piece(150.0, RADIUS_MM, curvature=(1 / BEND_MM, 0.0)), Piece(ends, RADIUS_MM)]
    )


def test_a_joint_or_a_bend_has_no_name_and_conforms_to_nothing() -> None:
    pipe = survey(frames(bent(8.0), STATIONS), CALIBRATION)
    (place,) = pipe.features
    assert place.kind is FeatureKind.NAMELESS
    assert abs(place.measured("angle_deg") - 8.0) < 1.0
    (open_,) = (one for one in pipe.unjudged if "not established" in one.reason)
    assert open_.kinds == ("joint", "gap") and open_.z_from_mm < place.z_mm < open_.z_to_mm


@pytest.mark.deep(
    gate="tests/regression/short_bend_called_a_joint/test_short_bend.py::test_a_joint_or_a_bend_has_no_name_and_conforms_to_nothing"
)
def test_what_does_not_surely_bend_is_no_bend() -> None:
    axis = find_axis(frames(bent(12.0), STATIONS), CALIBRATION.rings)
    assert axis.adjusted is not None
    (bend,) = find_bends(axis, (100.0, 300.0))
    unsure = (bend.measured("angle_deg") / next(one.k2 for one in bend.measures if one.name == "angle_deg")) ** 2
    vague = replace(axis, adjusted=replace(axis.adjusted, covariance=np.asarray(unsure * axis.adjusted.covariance)))
    assert bend.kind is FeatureKind.BEND
    assert [one.kind for one in find_bends(vague, (100.0, 300.0))] == [FeatureKind.NAMELESS]
