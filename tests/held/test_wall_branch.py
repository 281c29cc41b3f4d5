"""Openings in traced pictures: a branch is one; pockets, a coupling's gap, dirt and dead columns are none."""

import json
from pathlib import Path

import pytest

from annulus_pipe.reprocess import survey_of
from annulus_pipe.wall.features import FeatureKind

PIPES = Path(__file__).resolve().parents[3] / "shared" / "scenes" / "pipes"
OPENINGS = (FeatureKind.BRANCH, FeatureKind.TEE)
SCENES = ("s00a-control", "s02a-coupling", "s06a-dirt", "s07a-leak", "s09a-branch")


@pytest.mark.skipif(not PIPES.is_dir(), reason="needs ../shared/scenes/pipes")
@pytest.mark.parametrize("name", SCENES)
def test_a_branch_is_named_where_there_is_one_and_nowhere_else(name: str) -> None:
    folder = PIPES / name
    true = json.loads((folder / "truth.json").read_text())["scene"]["pipe"].get("features", {}).get("branch")
    pipe = survey_of(folder, folder / "calibration.json")
    found = [feature for feature in pipe.features if feature.kind in OPENINGS]
    assert len(found) == (true is not None)
    if true is not None:
        assert found[0].kind is FeatureKind.BRANCH
        assert found[0].z_mm == pytest.approx(true["z"], abs=0.7)
        assert found[0].clock_deg == pytest.approx((true["phi_deg"] + 90) % 360, abs=0.5)
        (diameter,) = found[0].measures
        assert diameter.value == pytest.approx(true["inner_d"], abs=1.0)
        assert abs(diameter.value - true["inner_d"]) < diameter.k2
        assert not [
            d for d in pipe.defects if abs(d.z_mm - true["z"]) < 20 and abs(d.clock_deg - found[0].clock_deg) < 20
        ]
