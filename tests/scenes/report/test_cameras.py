"""Which of two cameras saw what: in the survey, in summary.json and on the page."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, round_pipe, scan

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import survey

TWO = replace(CALIBRATION, others=(HeadCamera(4, CALIBRATION.camera),))


def looked_at(profile: Profile) -> Profile:
    """The right half by camera 0, the left's lower part by both, 330 to 350 degrees by none, the rest by camera 4."""
    clock = np.degrees(np.arctan2(profile.points_mm[:, 0], -profile.points_mm[:, 1])) % 360.0
    by = np.where(clock < 180, 0, np.where(clock < 240, 2, 1)).astype(np.uint8)
    return replace(profile, seen_by=by).without((clock > 330) & (clock < 350), "hidden")


@pytest.mark.deep(
    gate="tests/scenes/report/test_cameras.py::test_a_frame_that_another_camera_took_counts_as_seen_by_more_than_one"
)
def test_a_survey_of_two_cameras_says_which_of_them_saw_each_place(tmp_path: Path) -> None:
    profiles = [looked_at(one) for one in scan(round_pipe, z_mm=[3.0 * i for i in range(20)])]
    pipe = survey(profiles, TWO)
    who = pipe.wall.seen_by(2)
    for columns, expected in (((3, 177), 1), ((183, 237), 3), ((243, 327), 2)):
        part = who[:, slice(*columns)]
        assert (part[part > 0] == expected).all() and (part > 0).mean() > 0.8
    assert (who[:, 333:347] == 0).all()
    assert ((who > 0) == pipe.wall.seen).all()
    write(pipe, ScanAccount("two", {}, {}, {}), tmp_path)
    share = json.loads((tmp_path / "summary.json").read_text())["seen_by_percent"]
    assert share == pytest.approx({"0": 47.0, "4": 27.0, "several": 15.0}, abs=4.0)  # of the wall, its ragged ends, too
    assert sum(share.values()) == pytest.approx(100 * pipe.seen_fraction, abs=0.1)
    assert "Which camera saw what" in (tmp_path / "report.html").read_text()


def test_a_frame_that_another_camera_took_counts_as_seen_by_more_than_one() -> None:
    """A flash that one camera missed is measured by the other alone, over places both saw before."""
    profiles = scan(round_pipe, z_mm=[3.0 * i for i in range(20)])
    turns = [replace(one, seen_by=np.full(len(one.ring), i % 2, np.uint8)) for i, one in enumerate(profiles)]
    who = survey(turns, TWO).wall.seen_by(2)
    assert np.isin(who, (0, 1, 2, 3)).all() and (who == 3).mean() > 0.1


def test_one_camera_needs_no_such_picture(tmp_path: Path) -> None:
    write(
        survey(scan(round_pipe, z_mm=[3.0 * i for i in range(20)]), CALIBRATION),
        ScanAccount("one", {}, {}, {}),
        tmp_path,
    )
    assert "seen_by_percent" not in json.loads((tmp_path / "summary.json").read_text())
    assert "Which camera saw what" not in (tmp_path / "report.html").read_text()
