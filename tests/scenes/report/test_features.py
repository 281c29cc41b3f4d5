"""Promises of the page about features and places that could not be decided."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, pocket, round_pipe, scan

from annulus_pipe.report import ScanAccount, write
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.survey import Survey, survey

JOINT = Feature(
    FeatureKind.JOINT,
    120.0,
    8.0,
    remark="butt fusion",
    measures=(
        FeatureMeasure("height_mm", 3.4, 0.193),
        FeatureMeasure("hilo_clock_deg", 90.0),
        FeatureMeasure("gap_mm", float("nan")),
    ),
)
OPENING = Feature(FeatureKind.BRANCH, 150.0, 25.0, 355.0, 20.0, (FeatureMeasure("inner_d_mm", 25.2, 1.0),))
BEYOND = Feature(FeatureKind.WATER, 900.0, 50.0, 180.0, 60.0)  # where nothing was scanned
PLACE = Defect(Kind.LOSS, 140.0, 60.0, 12.0, 20.0, 1.5, 200.0, False, 2.4)


def written(pipe: Survey, out: Path) -> tuple[dict[str, object], str]:
    summary = write(pipe, ScanAccount("a pipe", {"projector": 20}, {}, {}), out)
    assert summary == json.loads((out / "summary.json").read_text())
    return summary, (out / "report.html").read_text()


@pytest.fixture(scope="module")
def sound() -> Survey:
    return survey(scan(round_pipe, z_mm=[4.0 * i for i in range(20)]), CALIBRATION)


def verdict(page: str) -> str:
    found = re.search(r'class="verdict (\w*)">([^<]*)', page)
    assert found
    return f"{found[1]}: {' '.join(found[2].split())}"


@pytest.mark.deep(
    gate="tests/scenes/report/test_features.py::test_a_ring_that_was_lost_is_said_in_the_verdict_the_warnings_and_the_summary"
)
def test_a_page_is_green_only_where_nothing_at_all_is_listed(sound: Survey, tmp_path: Path) -> None:
    none = "No defect above the listing limits on the wall that was seen."
    assert verdict(written(sound, tmp_path)[1]) == f"sound: {none}"
    with_joints = replace(sound, features=(JOINT, replace(JOINT, z_mm=160.0), OPENING))
    assert verdict(written(with_joints, tmp_path)[1]) == f"look: {none} Also in the pipe: 2 joints, 1 opening."
    unsure = replace(sound, detection=replace(sound.detection, undecided=(PLACE,)))
    said = verdict(written(unsure, tmp_path)[1])
    assert said.startswith("look: No sure defect") and "1 place stands out and could not be decided" in said
    damaged = survey(scan(pocket(round_pipe, 60, 10, 130, 150, 2.0), z_mm=[4.0 * i for i in range(20)]), CALIBRATION)
    said = verdict(written(replace(damaged, features=(JOINT,)), tmp_path)[1])
    assert said.startswith(": 1 wall loss. Deepest") and said.endswith("Also in the pipe: 1 joint.")


def test_a_ring_that_was_lost_is_said_in_the_verdict_the_warnings_and_the_summary(
    sound: Survey, tmp_path: Path
) -> None:
    without = replace(sound, profiles=tuple(p.without(p.ring == 1, "swallowed") for p in sound.profiles))
    summary, page = written(without, tmp_path)
    assert verdict(page).startswith("look: No defect") and verdict(page).endswith(
        "A ring of the pattern was lost: see below."
    )
    (warning,) = summary["warnings"]  # type: ignore[misc,attr-defined]
    assert warning["kind"] == "ring lost" and len(warning["frames"]) == 20
    assert "ring 2 of 5" in warning["text"] and "ring 2 of 5" in page


@pytest.mark.deep(
    gate="tests/scenes/report/test_features.py::test_a_ring_that_was_lost_is_said_in_the_verdict_the_warnings_and_the_summary"
)
def test_every_feature_has_its_row_its_letter_and_its_picture(sound: Survey, tmp_path: Path) -> None:
    pipe = replace(sound, features=(JOINT, OPENING, BEYOND), detection=replace(sound.detection, undecided=(PLACE,)))
    summary, page = written(pipe, tmp_path)
    for words in ("butt fusion", "all round", "11:30 to 12:10", "inner diameter", "25.20 ± 1.00 mm", "3.40 ± 0.20 mm"):
        assert words in page, words
    assert "hi-lo towards <b>3:00</b>" in page and "gap <b>not measured</b>" in page
    assert "Not decided" in page and "Stands outwards" in page and "≥ 1.50 ± 2.40 mm" in page
    captions = re.findall(r"<figcaption>(\S+: [^<]+)</figcaption>", page)
    assert captions == ["A: joint", "B: opening, branch", "C: water", "?1: stands outwards"]
    images = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(images) == 5 + 4
    for image in images:
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(image), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None and picture.std() > 3
    (place,) = summary["undecided"]  # type: ignore[misc]
    assert (place["kind"], place["z_mm"], place["depth_k2_mm"]) == ("loss", 140.0, 2.4)


@pytest.mark.deep(
    gate="tests/scenes/report/test_features.py::test_a_ring_that_was_lost_is_said_in_the_verdict_the_warnings_and_the_summary"
)
def test_marks_change_the_maps_and_not_the_stations(sound: Survey, tmp_path: Path) -> None:
    written(sound, tmp_path / "plain")
    written(replace(sound, features=(JOINT, OPENING)), tmp_path / "marked")
    for name, same in (("unwrapped.png", False), ("texture.png", False), ("stations.csv", True)):
        files = [(tmp_path / one / name).read_bytes() for one in ("plain", "marked")]
        assert (files[0] == files[1]) is same, name


@pytest.mark.deep(
    gate="tests/scenes/report/test_features.py::test_a_ring_that_was_lost_is_said_in_the_verdict_the_warnings_and_the_summary"
)
def test_a_loss_all_round_is_called_a_groove(sound: Survey, tmp_path: Path) -> None:
    groove = replace(PLACE, arc_deg=360.0, clock_deg=0.0, depth_mm=1.5, depth_k2_mm=0.2, floor_seen=True)
    for place, depth in ((groove, "1.50"), (replace(groove, floor_seen=False), "≥ 1.50")):
        pipe = replace(sound, detection=replace(sound.detection, defects=(place,)))
        summary, page = written(pipe, tmp_path)
        said = f": 1 wall loss. Deepest: groove all round of {depth} "
        assert ">Groove all round<" in page and verdict(page).startswith(said)
        assert summary["defects"][0]["kind"] == "loss" and summary["defects"][0]["all_round"]  # type: ignore[index]
