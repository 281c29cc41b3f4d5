"""A bead narrower than a slit was listed as a gap of 8.4 mm in a coupling: most points beside its few high ones lay on
the wall, so it was no bead, and what is no bead was measured as a gap. Fails with a gap that may be where nothing lies
outwards."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from annulus_pipe.wall.features import GAP_OR_GROOVE, Feature, FeatureKind
from annulus_pipe.wall.joints import Joint, _Form, _form, taken
from annulus_pipe.wall.points import SECTORS, WallPoints
from annulus_pipe.wall.unjudged import nameless

BEFORE_MM, AFTER_MM = 50.0, 50.8  # radii of the two pipes
WALL: Any = SimpleNamespace(
    z_step_mm=2.0,
    z_mm=np.array([150.0, 152.0, 154.0, 156.0, 158.0]),
    shape_mm=np.array([[radius, 0.0, 0.0, 0.0, 0.0] for radius in (50.0, 50.0, 50.0, 50.8, 50.8)]),
)


def points(radius_mm: float, off: int, sound: int, sectors: int = SECTORS) -> WallPoints:
    """In each sector so many at that radius, and so many on the wall."""
    radius = np.tile(np.repeat([radius_mm, AFTER_MM], [off, sound]), SECTORS)
    sector = np.repeat(np.arange(SECTORS), off + sound)
    radius = np.where(sector < sectors, radius, AFTER_MM)
    count = len(sector)
    none = np.zeros(count)
    return WallPoints(
        np.full(count, 154.0),
        sector,
        BEFORE_MM - radius,
        none,
        none,
        none,
        radius,
        (sector + 0.5) * 360.0 / SECTORS,
        np.zeros_like(sector),
    )


@pytest.mark.parametrize(
    ("there", "form"),
    [
        (points(49.0, 4, 12), _Form.BEAD),
        (points(52.0, 4, 12), _Form.GAP),
        (points(49.0, 4, 12, sectors=SECTORS // 2), _Form.BEAD),  # what was seen of it, all round as far as it was
        (points(49.0, 4, 12, sectors=4), _Form.UNSEEN),
        (points(50.8, 0, 12), _Form.UNSEEN),
    ],
)
def test_a_joint_is_what_its_points_say_that_lie_on_neither_wall(there: WallPoints, form: _Form) -> None:
    assert _form(WALL, there, (153.0, 155.0), 0.3) is form


def test_what_goes_over_from_one_wall_to_the_other_is_neither_bead_nor_gap() -> None:
    shape = WALL.shape_mm + np.array([[0.0], [0.0], [0.0], [4.0], [4.0]]) * [1.0, 0.0, 0.0, 0.0, 0.0]
    wall: Any = SimpleNamespace(**{**vars(WALL), "shape_mm": shape})
    assert _form(wall, points(52.5, 6, 6), (153.0, 155.0), 0.3) is _Form.BETWEEN


def test_a_gap_or_a_groove_opens_the_limits_of_both() -> None:
    """A groove of 0.6 mm all round was a gap of 7 mm: its line did not jump."""
    place = Feature(FeatureKind.NAMELESS, 154.0, 6.0, remark=GAP_OR_GROOVE)
    (open_,) = nameless([place])
    assert open_.kinds == ("joint", "gap", "loss")
    wall: Any = SimpleNamespace(**vars(WALL), radius_mm=np.zeros((5, 8)), mean_radius_mm=50.0)
    for remark, explains in ((GAP_OR_GROOVE, True), ("a joint or a short bend", False)):
        joint = Joint(replace(place, remark=remark), 151.0, 157.0, is_gap=False)
        assert taken(wall, [joint], 1.0).any() == explains
