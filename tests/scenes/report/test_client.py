"""What a client signs, on a drawn pipe: job, verdict, pictures that say the listed depth, an honest statement."""

import base64
import csv
import json
import math
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, bump, pocket, round_pipe, scan

from annulus_pipe.job import JobSheet, Observation, Origin
from annulus_pipe.numeric.rounding import MEASURE, quoted
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.report.cuts import CIRCLE_PX, SWING_PX, across
from annulus_pipe.report.marks import marks_of
from annulus_pipe.untrusted import parse_toml
from annulus_pipe.wall.conformity import Criteria, judge
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.photograph import Shot, best_views, crop
from annulus_pipe.wall.sections import cut
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.texture import LedFrame

LIMITS = b'title = "<b>ours</b>"\n[[loss]]\nseverity = 4\ndepth_mm = 3\n[[bore]]\nseverity = 2\nsmallest_mm = 140\n'


def account(**more: Any) -> ScanAccount:
    return ScanAccount("a pipe", {"projector": 40}, {}, {"total": 5.0}, **more)


@pytest.fixture(scope="module")
def pipe() -> Survey:
    seen = scan(pocket(bump(round_pipe, 200, 135, 14, 3.0), 90, 12, 120, 150, 4.0))
    camera = CALIBRATION.camera
    grey = np.random.default_rng(3).integers(60, 200, (camera.height, camera.width, 3), dtype=np.uint8)
    seen = [replace(one, sigma_mm=np.full(len(one.ring), 0.03, np.float32)) for one in seen]
    return survey(seen, CALIBRATION, [LedFrame(4, 40.0, grey), LedFrame(9, 70.0, grey)])


@pytest.fixture(scope="module")
def page(pipe: Survey, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("client")
    view = best_views(pipe, CALIBRATION, [Shot(0, 24, 60.0, 0)], [0])[0]
    image = np.full((CALIBRATION.camera.height, CALIBRATION.camera.width, 3), 90, np.uint8)
    made = {"rings": {"by": "annulus calibrate pipe", "held_out_mm": 0.117, "utc": "2026-11-01T00:00:00+00:00"}}
    times = ("2026-11-25T06:00:00.000+00:00", "2026-11-25T06:10:00.000+00:00")
    origin = Origin(JobSheet(client="The <i>Works</i>", sdr=11.0), times, {"serial": "E66"}, made, "head-7.json")
    verdict = judge(pipe, Criteria.from_dict(parse_toml(LIMITS)))
    told = account(origin=origin, verdict=verdict, photographs=(crop(view, image),))
    summary = write(pipe, told, out)
    return (out / "report.html").read_text("utf-8"), summary, out


def text(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))


@pytest.mark.deep(gate="tests/scenes/report/test_client.py::test_the_verdict_is_on_the_page_and_in_the_summary")
def test_the_job_is_on_the_page_and_what_nobody_said_is_not_made_up(page: tuple[str, dict[str, Any], Path]) -> None:
    words = text(page[0])
    assert "The &lt;i&gt;Works&lt;/i&gt;" in words and "SDR 11" in words and "Operator not recorded" in words
    assert "2026-11-25 (UTC, by the recorder&#39;s clock)" in words and "Controller board E66" in words
    assert "annulus calibrate pipe, 2026-11-01, held out 0.117 mm" in words
    assert "Check against a reference section not checked" in words
    assert page[1]["job"] == {"client": "The <i>Works</i>", "sdr": 11.0}
    assert page[1] == json.loads((page[2] / "summary.json").read_text())
    assert "Signature" in words


@pytest.mark.deep(gate="tests/scenes/report/test_client.py::test_the_verdict_is_on_the_page_and_in_the_summary")
def test_what_the_operator_marked_is_on_the_page_the_maps_and_in_the_summary(pipe: Survey, tmp_path: Path) -> None:
    photo = bytes(cv2.imencode(".jpg", np.full((30, 40, 3), 90, np.uint8))[1])
    marks = (
        Observation(130.0, "<script>alert(1)</script>", 95.0, "2026-11-25T06:01:02+00:00", photo, "photo"),
        Observation(145.0, "ring of rust", picture=photo, shows="frame", frame=24, camera=1),
        Observation(math.nan, "", photo_unread=True),
    )
    plain = write(pipe, account(), tmp_path / "plain")
    summary = write(pipe, account(origin=Origin(observations=marks, marks_left_out=3)), tmp_path / "marked")
    html = (tmp_path / "marked/report.html").read_text("utf-8")
    words = text(html)
    assert "<script" not in html and "&lt;script&gt;alert(1)" in words and html.count("data:image/jpeg") >= 2
    for told in (
        "M1 0.130 3:10",
        "2026-11-25 06:01:02",
        "M2 0.145 not said ring of rust not recorded",
        "3 further marks",
        "M3 not known not said nothing not recorded its photo cannot be read",
        "M1: photo by the operator.",
        "M2: LED frame 24 of camera 1, taken there",
        "where the head stood at that moment",
    ):
        assert told in words, told
    assert html.index('id="defects"') < html.index('id="details"') < html.index('id="observations"')
    first = {
        "mark": "M1",
        "z_mm": 130.0,
        "clock_deg": 95.0,
        "clock": "3:10",
        "text": "<script>alert(1)</script>",
        "utc": "2026-11-25T06:01:02+00:00",
        "picture": "photo",
        "frame": None,
        "camera": 0,
    }
    assert summary["observations"][0] == first and summary["observations"][2]["z_mm"] is None
    assert summary["marks_left_out"] == 3 and plain["observations"] == []
    assert "Observations" not in text((tmp_path / "plain/report.html").read_text("utf-8"))
    assert (tmp_path / "marked/unwrapped.png").read_bytes() != (tmp_path / "plain/unwrapped.png").read_bytes()
    assert [one.name for one in marks_of(pipe, marks)][-2:] == ["M1", "M2"]  # of no place, no mark


def test_the_verdict_is_on_the_page_and_in_the_summary(page: tuple[str, dict[str, Any], Path]) -> None:
    html, summary, _ = page
    loss, dent = summary["defects"]
    assert (loss["severity"], loss["decision"]) == (4, "does not conform")
    assert "severity" not in dent and summary["conformity"]["decision"] == "does not conform"
    bore = next(one for one in summary["conformity"]["items"] if one["kind"] == "bore")
    assert bore["decision"] == "conforms" and bore["value"] - bore["k2"] > 140
    words = text(html)
    for said_ in ("&lt;b&gt;ours&lt;/b&gt;", "Does not conform", "guard band w = U", "no limit was named for: bump"):
        assert said_ in words, said_
    usual = Counter((one["reason"], *one["limits"]) for one in summary["conformity"]["not_established"] if one["usual"])
    (reason, *_), many = usual.most_common(1)[0]
    assert many > 1 and f"{many} places" in words, "what every scan has is one row a sort"
    assert words.count(reason) < many


@pytest.mark.deep(gate="tests/scenes/report/test_client.py::test_the_verdict_is_on_the_page_and_in_the_summary")
def test_without_limits_nothing_passes_and_nothing_fails(pipe: Survey, tmp_path: Path) -> None:
    summary = write(pipe, account(), tmp_path)
    words = text((tmp_path / "report.html").read_text("utf-8"))
    assert "makes no statement of conformity" in words
    assert "conformity" not in summary and "severity" not in summary["defects"][0] and summary["job"] == {}
    assert "Client not recorded" in words and "Date of the scan not recorded" in words


def test_every_defect_has_its_pictures_and_says_where_they_are_from(page: tuple[str, dict[str, Any], Path]) -> None:
    html = page[0]
    assert html.count("<svg") == 4 and "<script" not in html and "://" not in html
    pictures = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', html)
    assert len(pictures) == 2
    for one in pictures:
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(one), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None and 20 <= max(picture.shape[:2]) <= 560
    words = text(html)
    assert "LED frame 24, taken" in words and "not a photograph: distance to the right" in words


def test_the_dot_of_the_cross_section_lies_at_the_listed_depth(pipe: Survey) -> None:
    for one in cut(pipe, range(2)):
        defect = pipe.defects[one.index]
        drawn, ring = across(one, pipe.wall.clock_deg, defect)
        x, y = (float(v) for v in re.findall(r'<circle cx="([-\d.]+)" cy="([-\d.]+)" r="3"', drawn)[0])
        departure = (math.hypot(x, y) - CIRCLE_PX) * ring / SWING_PX
        sign = 1 if defect.kind is Kind.LOSS else -1
        assert sign * departure == pytest.approx(
            defect.depth_mm, abs=defect.depth_k2_mm + 0.05 * ring / SWING_PX + 0.01
        )
        assert math.degrees(math.atan2(x, -y)) % 360 == pytest.approx(one.clock_deg, abs=0.2)
        assert "nan" not in drawn


def test_the_page_says_what_the_scan_states_and_no_number_of_a_bench(
    page: tuple[str, dict[str, Any], Path], pipe: Survey
) -> None:
    words = text(page[0])
    stated, of_head = words.split("From this scan: sizing accuracy")[1].split("This head, against a section")
    own = math.hypot(0.03, pipe.wall.scale_part * pipe.wall.mean_radius_mm)
    assert quoted(2 * own, MEASURE) in stated and "not determined" in stated
    assert "Check against a reference section not checked: no section of known diameter was named" in of_head
    assert "calibration.json states no covariance" in of_head and "a wall that light enters" in of_head
    for word in ("bench", "off the truth", "simulated", "at least 36 %", "94.1 %"):
        assert word not in words.lower(), word


def test_stations_have_the_new_columns_at_the_end(page: tuple[str, dict[str, Any], Path], pipe: Survey) -> None:
    with (page[2] / "stations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[-8:] == [
        "diameter_x_mm",
        "diameter_y_mm",
        "circumference_mm",
        "circumference_k2_mm",
        "area_mm2",
        "area_k2_mm2",
        "diameter_min_k2_mm",
        "diameter_max_k2_mm",
    ]
    known = [row for row in rows if row["area_mm2"]]
    assert len(known) > 5
    for row in known:
        assert float(row["circumference_mm"]) == pytest.approx(math.pi * 152.4, abs=12)
        own = math.hypot(0.03, pipe.wall.scale_part * pipe.wall.mean_radius_mm)
        assert float(row["area_k2_mm2"]) == pytest.approx(2 * float(row["circumference_mm"]) * own, rel=0.03)
    assert "smallest diameter" in text(page[0])
