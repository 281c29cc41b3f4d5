"""calibration.json on disk: updated section by section, whole or not at all, and readable by whom the umask says."""

import json
import math
import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.storage.calibration_file import (
    load_calibration,
    load_camera,
    save_calibration,
    save_part,
    update_calibration,
)
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, save_acoustic

DATA = Path(__file__).parents[2] / "data"
CALIBRATION = load_calibration(DATA / "calibration-1.json")
TWO = load_calibration(DATA / "calibration-2.json")


def provenance(path: Path) -> dict:
    """Without the times, each of which must be one of now."""
    told = json.loads(path.read_text()).get("provenance", {})
    for made in told.values():
        assert abs((datetime.now(UTC) - datetime.fromisoformat(made.pop("utc"))).total_seconds()) < 60
    return told


def test_what_is_replaced_loses_its_provenance(tmp_path: Path) -> None:
    path, sections = tmp_path / "c.json", CALIBRATION.to_dict()
    update_calibration(path, sections, {"rings": {"by": "a design"}, "camera": {"by": "a board"}})
    kept = update_calibration(path, {"rings": sections["rings"][::-1], "camera": sections["camera"]})
    assert provenance(path) == {"camera": {"by": "a board"}}  # the same camera again is the one the board measured
    assert kept == ("pattern", "pipe")
    update_calibration(path, {"camera": {**sections["camera"], "fx": 500.0}}, {"camera": {"by": "another board"}})
    assert provenance(path) == {"camera": {"by": "another board"}}


def test_a_head_of_several_cameras_is_no_file_to_update(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    save_calibration(path, TWO)
    before = path.read_bytes()
    with pytest.raises(AnnulusError, match=r"c\.json: is of a head with several cameras"):
        update_calibration(path, {"pipe": {"radius_mm": 50.0}})
    assert path.read_bytes() == before


def test_the_camera_of_a_file_is_its_only_one(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    save_calibration(path, replace(CALIBRATION, camera_id=3))
    assert json.loads(path.read_text())["format"] == "annulus-calibration/2"
    assert load_camera(path) == CALIBRATION.camera
    with pytest.raises(AnnulusError, match=r"calibration-2\.json: the head has 2 cameras, expected one"):
        load_camera(DATA / "calibration-2.json")
    two = TWO.to_dict()
    for camera in two["cameras"]:
        del camera["rotation"]  # a file in the making is refused for the right reason too
    path.write_text(json.dumps(two))
    with pytest.raises(AnnulusError, match="the head has 2 cameras"):
        load_camera(path)


def test_two_cameras_survive_the_disk(tmp_path: Path) -> None:
    save_calibration(tmp_path / "c.json", TWO)
    again = load_calibration(tmp_path / "c.json")
    assert again.cameras == TWO.cameras and [one.id for one in again.cameras] == [0, 1]
    assert again.corrections == TWO.corrections and again.colours == TWO.colours


def test_every_file_is_readable_by_whom_the_umask_says(tmp_path: Path) -> None:
    record = AcousticRecord(np.zeros((4, 32), np.float32), np.arange(4.0), 25.0, 1e7)
    before = os.umask(0o027)
    try:
        save_acoustic(tmp_path / "raw.hdf5", record)
        save_acoustic(tmp_path / "raw.npz", record)
        save_calibration(tmp_path / "calibration.json", CALIBRATION)
        save_part(tmp_path / "colour.json", {})
    finally:
        os.umask(before)
    assert {path.name: oct(path.stat().st_mode & 0o777) for path in tmp_path.iterdir()} == dict.fromkeys(
        ("raw.hdf5", "raw.npz", "calibration.json", "colour.json"), "0o640"
    )


def test_a_file_is_written_whole_or_stays_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text("before")
    with pytest.raises(KeyError), written_whole(path) as file:
        file.write(b"half")
        raise KeyError
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]


def test_what_a_calibration_could_not_tell_is_null_and_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    update_calibration(
        path, {"distance_mm": 120.0}, {"distance_mm": {"by": "a test", "gamma": math.nan, "rows": (1.0, math.inf)}}
    )
    made = json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(name))["provenance"]["distance_mm"]
    assert made["gamma"] is None and made["rows"] == [1.0, None]
    update_calibration(path, {"distance_mm": 121.0})
