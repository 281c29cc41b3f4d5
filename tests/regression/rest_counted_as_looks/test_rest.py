"""A head rested at the end of its run and saw an arc of the pipe from one place two hundred times: a joint was reported
there, 4.7 mm of hi-lo. Fails without `without_rests` and without ROUND_LEAST of axis.py."""

from dataclasses import replace

import numpy as np
from over_limit import resting, scanned
from synthetic_pipe import CALIBRATION, round_pipe

from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.rests import without_rests
from annulus_pipe.wall.survey import survey


def test_a_rest_is_one_look_and_makes_no_joint() -> None:
    profiles = resting(scanned(round_pipe), 200, middle_deg=60.0, half_deg=60.0, off_mm=2.0, shrunk=0.98)
    kept = without_rests(profiles)
    assert len(kept) <= len(profiles) - 195
    assert sum(len(one.points_mm) for one in kept) + sum(one.rejected.get("at rest", 0) for one in kept) == sum(
        len(one.points_mm) for one in profiles
    ), "what is left out is counted"
    named = {one.kind for one in survey(profiles, CALIBRATION).features}
    assert not named & {FeatureKind.JOINT, FeatureKind.GAP, FeatureKind.BEND, FeatureKind.TAPER, FeatureKind.REDUCER}


def test_frames_that_show_something_else_are_kept() -> None:
    one, *_ = scanned(round_pipe)
    clock = np.degrees(np.arctan2(one.points_mm[:, 0], -one.points_mm[:, 1])) % 360
    parts = [one.without((clock // 120 != k), "hidden") for k in range(3)]
    assert len(without_rests([replace(p, frame=k) for k, p in enumerate([*parts, *parts])])) == 3
