"""Promises on scenes that other programs drew, small enough for every checkout; the whole ones are in tests/held."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.reprocess import survey_of
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.wall.features import FeatureKind

SCENES = Path(__file__).resolve().parents[1] / "data/scenes"


def test_a_ray_traced_frame_is_measured() -> None:
    folder = SCENES / "rings"
    reconstructor = Reconstructor(Calibration.from_dict(json.loads((folder / "calibration.json").read_text())))
    profile = reconstructor.profile(np.asarray(cv2.imread(str(folder / "000000.jpg"))), frame=0, z_mm=0.0)
    pose = profile.pose
    assert math.degrees(pose.rx) == pytest.approx(-1.7098, abs=0.02)  # 0.007 measured
    assert math.degrees(pose.ry) == pytest.approx(-0.2155, abs=0.02)  # 0.005
    assert (pose.tx, pose.ty) == pytest.approx((0.8506, -0.8290), abs=0.03)  # 0.012
    sound = profile.points_mm[profile.points_mm[:, 2] < 125.0]
    off = np.hypot(sound[:, 0], sound[:, 1]) - 76.2
    assert len(sound) > 1500 and np.sqrt(np.mean(off**2)) < 0.05 and np.abs(off).max() < 0.3  # 0.019, 0.11
    assert len(profile.points_mm) > 0.94 * 5 * 720


def test_clear_water_is_measured_and_nothing_made_of_it() -> None:
    pipe = survey_of(SCENES / "water", SCENES / "water/calibration.json")
    (water,) = pipe.features
    assert water.kind is FeatureKind.WATER and water.remark == "flat"
    (level,) = (one for one in water.measures if one.name == "level_mm")
    assert abs(level.value - 65.99) < 0.05 and level.k2 < 0.3
    assert pipe.defects == () and pipe.findings == ()
    assert all((profile.points_mm[:, 1] < 65.99).all() for profile in pipe.profiles)
    assert pipe.rejected["below level"] > 5_000


def test_two_sewers_are_found_in_a_capacitive_log_and_named(tmp_path: Path) -> None:
    folder, out = SCENES / "crossbore", tmp_path / "found.json"
    done = CliRunner().invoke(app, ["bore", "detect", str(folder / "log.csv.gz"), "-o", str(out)])
    assert done.exit_code == 0, done.output
    found, true = json.loads(out.read_text()), json.loads((folder / "truth.json").read_text())
    assert [one["kind"] for one in found] == [one["kind"] for one in true]
    for one, bore in zip(found, true, strict=True):
        middle = (bore["odo0_mm"] + bore["odo1_mm"]) / 2
        assert abs(one["odometer_mm"] - middle) < 8.0  # 1 measured; 5 mm of rows
        if "phi_deg" in one:
            assert abs((one["phi_deg"] - bore["phi_deg"] + 180) % 360 - 180) < 2 * one["phi_sigma_deg"]
