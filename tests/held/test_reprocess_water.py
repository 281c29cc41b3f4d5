"""Clear water over a sixth of the pipe's round, ray-traced by others (../shared/scenes/pipes)."""

import json
from pathlib import Path

import pytest

from annulus_pipe.reprocess import survey_of
from annulus_pipe.wall.features import FeatureKind

SCENE = Path(__file__).resolve().parents[3] / "shared" / "scenes" / "pipes" / "s05a-water"


@pytest.mark.skipif(not SCENE.is_dir(), reason="../shared is not here")
def test_water_is_measured_and_nothing_made_of_it() -> None:
    true = json.loads((SCENE / "truth.json").read_text())["scene"]["pipe"]["features"]["water"]["level_mm"]
    pipe = survey_of(SCENE, SCENE / "calibration.json")
    (water,) = pipe.features
    assert water.kind is FeatureKind.WATER and water.remark == "flat"
    (level,) = (one for one in water.measures if one.name == "level_mm")
    assert abs(level.value - true) < 0.05 and level.k2 < 0.3
    assert pipe.defects == () and pipe.findings == ()
    assert all((profile.points_mm[:, 1] < true).all() for profile in pipe.profiles)
    assert pipe.rejected["below level"] > 10_000
