"""Promises of the recording that ships beside the program: the same bytes each time, every label provable, and what is
in its pipe is found, with the depth that is claimed.
"""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.record.recording import open_recording
from annulus_pipe.reprocess import survey_of
from annulus_pipe.reprocess.relabel import audit
from annulus_pipe.twin.score import score
from annulus_pipe.twin.worlds import demo_world
from tools.sample.__main__ import FRAMES, WIDTH, write


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sample")
    write(folder)
    return folder


@pytest.mark.deep(gate="tests/scenes/test_sample.py::test_the_four_known_defects_are_found_and_no_other")
def test_the_same_bytes_are_made_again(folder: Path, tmp_path: Path) -> None:
    write(tmp_path)
    for name in ("scan.mcap", "truth.json"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.deep(gate="tests/scenes/test_sample.py::test_the_four_known_defects_are_found_and_no_other")
def test_it_is_small_whole_and_every_label_follows_from_its_evidence(folder: Path) -> None:
    recording = open_recording(folder / "scan.mcap")
    assert len(recording.frames) == FRAMES and not recording.torn and not recording.check()
    assert 10e6 < (folder / "scan.mcap").stat().st_size < 25e6
    found = audit(folder / "scan.mcap")
    assert found.frames >= FRAMES and not found.changed and not found.without_evidence


def test_the_four_known_defects_are_found_and_no_other(folder: Path) -> None:
    world = demo_world().scaled(WIDTH)
    assert json.loads((folder / "truth.json").read_text())["defects"] == world.truth()["defects"]
    pipe = survey_of(folder / "scan.mcap")
    points = np.concatenate([profile.points_mm for profile in pipe.profiles])
    scored = score(world, points, None, [asdict(defect) for defect in pipe.defects])
    assert (scored["defects"]["true"], scored["defects"]["found"], scored["defects"]["false"]) == (4, 4, 0)
    assert scored["cloud"]["rms_mm"] < 0.25  # 0.13 measured, at half size and 5 mm a frame
    kinds = [(defect.kind.value, round(defect.depth_mm, 1)) for defect in pipe.defects]
    assert [kind for kind, _ in kinds] == ["loss", "bump", "loss", "ovality"]
    for defect, truth in zip(pipe.defects[:3], (4.0, 4.0, 2.0), strict=True):
        assert abs(defect.depth_mm - truth) < 1.5 * defect.depth_k2_mm, defect
