import base64
import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from plyfile import PlyData
from synthetic_pipe import CALIBRATION, RADIUS_MM, bump, oval, pocket, round_pipe, scan

from annulus_pipe.report import FILES, ScanAccount, figures, prepare_folder, write
from annulus_pipe.vocabulary import AnnulusError, Finding
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.texture import LedFrame

COUNTS = {"projector": 40, "led": 2, "unknown": 1}


FINDING = Finding("dark", "one frame is dark", (7,))


def account(**more: Any) -> ScanAccount:
    return ScanAccount("a <b>pipe</b>", COUNTS, {"camera": 3}, {"total": 5.0}, **more)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Survey, list[Profile]]:
    out = tmp_path_factory.mktemp("results")
    shape = pocket(bump(round_pipe, 200, 160, 12, 3.0), 90, 12, 130, 160, 4.0)
    profiles = scan(shape, z_mm=[3.0 * i for i in range(26)])
    camera = CALIBRATION.camera
    grey = np.full((camera.height, camera.width, 3), 120, np.uint8)
    pipe = survey(profiles, CALIBRATION, [LedFrame(4, 20.0, grey), LedFrame(9, 60.0, grey)])
    write(pipe, account(truth={"rms_mm": 0.05}, findings=(FINDING,)), out)
    return out, pipe, profiles


@pytest.mark.deep(
    gate="tests/scenes/report/test_results.py::test_the_cloud_holds_every_point_that_is_not_contradicted_with_its_ring_and_frame"
)
def test_every_file_is_there_and_nothing_else(written: tuple[Path, Survey, list[Profile]]) -> None:
    assert sorted(path.name for path in written[0].iterdir()) == sorted(FILES)


def test_the_summary_says_what_the_page_promises(written: tuple[Path, Survey, list[Profile]]) -> None:
    out, pipe, _ = written
    data = json.loads((out / "summary.json").read_text())
    assert data["frames"] == COUNTS and data["drops"]["camera"] == 3 and data["truth"] == {"rms_mm": 0.05}
    assert {"mean", "min", "max"} <= data["diameter_mm"].keys()
    assert data["ovality"]["definition"] == "ASTM F1216"
    loss, dent = data["defects"]
    assert (loss["kind"], loss["clock"], dent["kind"]) == ("loss", "3:00", "bump")
    assert {"z_mm", "clock_deg", "length_mm", "arc_deg", "depth_mm"} <= loss.keys()
    assert loss["depth_mm"] == pytest.approx(pipe.defects[0].depth_mm, abs=6e-4)
    assert data["warnings"] == [{"kind": "dark", "text": "one frame is dark", "frames": [7]}]
    assert data["versions"]["annulus"] and data["timing_ms"]["total"] == 5.0


def test_the_cloud_holds_every_point_that_is_not_contradicted_with_its_ring_and_frame(
    written: tuple[Path, Survey, list[Profile]],
) -> None:
    out, pipe, profiles = written
    cloud = PlyData.read(out / "cloud.ply")["vertex"].data
    assert cloud.dtype.names == ("x", "y", "z", "red", "green", "blue", "radius", "frame", "ring", "sigma", "camera")
    measured = sum(len(p.points_mm) for p in profiles)
    assert len(cloud) == pipe.points
    assert 0.99 * measured < len(cloud) <= measured
    assert np.allclose(cloud["radius"], np.hypot(cloud["x"], cloud["y"]), rtol=0, atol=1e-5)
    assert set(np.unique(cloud["ring"])) == set(range(5)) and set(np.unique(cloud["frame"])) == set(range(26))


def test_the_mesh_has_faces_only_where_the_wall_was_seen(written: tuple[Path, Survey, list[Profile]]) -> None:
    out, pipe, _ = written
    mesh = PlyData.read(out / "mesh.ply")
    vertices = mesh["vertex"].data
    corners = np.stack(mesh["face"].data["vertex_indices"])
    assert corners.min() >= 0 and corners.max() < len(vertices)
    points = np.stack([vertices["x"], vertices["y"], vertices["z"]], axis=1).astype(float)
    middle = points[corners].mean(axis=1)
    clock = np.degrees(np.arctan2(middle[:, 0], -middle[:, 1])) % 360
    assert not (np.abs(clock - 107) < 3).any(), "a face across a rod's shadow"
    normal = np.cross(points[corners[:, 1]] - points[corners[:, 0]], points[corners[:, 2]] - points[corners[:, 0]])
    inward = (normal[:, :2] * middle[:, :2]).sum(axis=1) < 0
    assert inward.all(), "normals point into the pipe"
    assert len(vertices) == pipe.wall.seen.sum()


def test_stations_carry_units_and_the_named_ovality(written: tuple[Path, Survey, list[Profile]]) -> None:
    with (written[0] / "stations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:5] == [
        "z_mm",
        "diameter_min_mm",
        "diameter_max_mm",
        "diameter_mean_mm",
        "ovality_f1216_percent",
    ]
    full = [row for row in rows if row["diameter_mean_mm"]]
    assert len(full) > 15
    for row in full:
        low, high, mean = (float(row[f"diameter_{name}_mm"]) for name in ("min", "max", "mean"))
        assert low <= mean <= high and mean == pytest.approx(2 * RADIUS_MM, abs=1.5)
        assert float(row["ovality_f1216_percent"]) == pytest.approx(100 * max(high - mean, mean - low) / mean, abs=3e-4)


def test_the_report_stands_alone_and_quotes_its_source_safely(written: tuple[Path, Survey, list[Profile]]) -> None:
    page = (written[0] / "report.html").read_text()
    assert "<script" not in page and "://" not in page and "a &lt;b&gt;pipe" in page
    images = re.findall(r'src="(data:image/png;base64,[^"]+)"', page)
    assert len(images) == 5
    for image in images:
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(image.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None and picture.std() > 3
    for words in ("ASTM F1216", "Wall loss", "2:35 to 3:25", "Mean diameter", "Not seen", "unknown"):
        assert words in page, words


@pytest.mark.deep(gate="tests/scenes/report/test_results.py::test_the_summary_says_what_the_page_promises")
def test_an_oval_pipe_makes_a_report_even_without_led_frames(tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder"
    pipe = survey(scan(oval(round_pipe, 30, 0.03), z_mm=[4.0 * i for i in range(8)]), CALIBRATION)
    summary = write(pipe, account(), out)
    assert [defect["kind"] for defect in summary["defects"]] == ["ovality"]
    assert summary == json.loads((out / "summary.json").read_text())
    page = (out / "report.html").read_text()
    assert "Out of round" in page and "long axis 1:00 to 7:00" in page


def test_a_crash_half_way_leaves_the_old_results_alone(
    written: tuple[Path, Survey, list[Profile]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "results"
    shutil.copytree(written[0], out)

    def full(*_args: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figures, "draw", full)
    with pytest.raises(AnnulusError, match="No space left"):
        write(written[1], account(), out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == {
        path.name: path.read_bytes() for path in written[0].iterdir()
    }


def test_an_output_path_that_is_a_file_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(AnnulusError, match="is a file"):
            prepare_folder(out)
    assert (tmp_path / "file").read_text() == "mine"
