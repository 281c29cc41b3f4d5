import base64
import csv
import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from plyfile import PlyData
from synthetic_pipe import CALIBRATION, RADIUS_MM, bump, oval, pocket, round_pipe, scan

from annulus.report import results
from annulus.report.results import FILES, LedFrame, Summary, write_results
from annulus.report.surface import triangulate
from annulus.vocabulary import AnnulusError
from annulus.wall.consistency import without_inconsistent
from annulus.wall.grid import build_wall
from annulus.wall.profile import Profile
from annulus.wall.registration import register

COUNTS = {"projector": 40, "led": 2, "unknown": 1}


def write(out: Path, profiles: list[Profile], led: list[LedFrame] | None = None, **more: object) -> Summary:
    return write_results(
        out, CALIBRATION, profiles, led or [], frames=COUNTS, drops={"camera": 3}, timing_ms={"total": 5.0},
        source="a <b>pipe</b>", **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Summary, list[Profile]]:
    out = tmp_path_factory.mktemp("results")
    pipe = pocket(bump(round_pipe, 200, 160, 12, 3.0), 90, 12, 130, 160, 4.0)
    profiles = scan(pipe, z_mm=[3.0 * i for i in range(26)])
    camera = CALIBRATION.camera
    grey = np.full((camera.height, camera.width, 3), 120, np.uint8)
    summary = write(out, profiles, [LedFrame(4, 20.0, grey), LedFrame(9, 60.0, grey)], truth={"rms_mm": 0.05})
    return out, summary, profiles


def test_every_file_is_there_and_nothing_else(written: tuple[Path, Summary, list[Profile]]) -> None:
    assert sorted(path.name for path in written[0].iterdir()) == sorted(FILES)


def test_the_summary_says_what_the_page_promises(written: tuple[Path, Summary, list[Profile]]) -> None:
    out, summary, _ = written
    data = json.loads((out / "summary.json").read_text())
    assert data == json.loads(json.dumps(summary.to_dict()))
    assert data["frames"] == COUNTS and data["drops"]["camera"] == 3 and data["truth"] == {"rms_mm": 0.05}
    assert {"mean", "min", "max"} <= data["diameter_mm"].keys()
    assert data["ovality"]["definition"] == "ASTM F1216"
    loss, dent = data["defects"]
    assert (loss["kind"], loss["clock"], dent["kind"]) == ("loss", "3:00", "bump")
    assert {"z_mm", "clock_deg", "length_mm", "arc_deg", "depth_mm"} <= loss.keys()
    assert loss["depth_mm"] == pytest.approx(4.0, abs=0.2)
    assert data["versions"]["annulus"] and data["timing_ms"]["total"] == 5.0


def test_the_cloud_holds_every_point_that_is_not_contradicted_with_its_ring_and_frame(
    written: tuple[Path, Summary, list[Profile]],
) -> None:
    out, summary, profiles = written
    cloud = PlyData.read(out / "cloud.ply")["vertex"].data
    assert cloud.dtype.names == ("x", "y", "z", "red", "green", "blue", "radius", "frame", "ring", "sigma")
    measured = sum(len(p.points_mm) for p in profiles)
    assert len(cloud) == summary.points
    assert 0.99 * measured < len(cloud) <= measured
    assert np.allclose(cloud["radius"], np.hypot(cloud["x"], cloud["y"]), atol=1e-3)
    assert set(np.unique(cloud["ring"])) == set(range(5)) and set(np.unique(cloud["frame"])) == set(range(26))


def test_the_mesh_has_faces_only_where_the_wall_was_seen(written: tuple[Path, Summary, list[Profile]]) -> None:
    out, _, profiles = written
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
    assert inward.mean() > 0.99, "normals point into the pipe"
    wall = build_wall(without_inconsistent(register(profiles)))
    assert len(vertices) == wall.seen.sum()


def test_the_mesh_closes_around_the_seam() -> None:
    wall = build_wall(scan(round_pipe, z_mm=[3.0 * i for i in range(20)], rods_deg=(90.0,)))
    _, triangles, flat = triangulate(wall)
    columns = flat[triangles] % len(wall.clock_deg)
    assert ((columns == 0).any(axis=1) & (columns == len(wall.clock_deg) - 1).any(axis=1)).any()


def test_stations_carry_units_and_the_named_ovality(written: tuple[Path, Summary, list[Profile]]) -> None:
    with (written[0] / "stations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:5] == [
        "z_mm", "diameter_min_mm", "diameter_max_mm", "diameter_mean_mm", "ovality_f1216_percent",
    ]  # fmt: skip
    full = [row for row in rows if row["diameter_mean_mm"]]
    assert len(full) > 15
    for row in full:
        low, high, mean = (float(row[f"diameter_{name}_mm"]) for name in ("min", "max", "mean"))
        assert low <= mean <= high and mean == pytest.approx(2 * RADIUS_MM, abs=1.5)
        assert float(row["ovality_f1216_percent"]) == pytest.approx(100 * max(high - mean, mean - low) / mean, abs=0.01)


def test_the_report_stands_alone_and_quotes_its_source_safely(written: tuple[Path, Summary, list[Profile]]) -> None:
    page = (written[0] / "report.html").read_text()
    assert "<script" not in page and "http" not in page and "a &lt;b&gt;pipe" in page
    images = re.findall(r'src="(data:image/png;base64,[^"]+)"', page)
    assert len(images) == 5
    for image in images:
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(image.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None and picture.std() > 3
    for words in ("ASTM F1216", "Wall loss", "2:35 to 3:25", "Mean diameter", "Not seen", "unknown"):
        assert words in page, words


def test_an_oval_pipe_makes_a_report_even_without_led_frames(tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder"
    summary = write(out, scan(oval(round_pipe, 30, 0.03), z_mm=[4.0 * i for i in range(8)]))
    assert [str(defect.kind) for defect in summary.defects] == ["ovality"]
    page = (out / "report.html").read_text()
    assert "Out of round" in page and "long axis 1:00 to 7:00" in page


def test_a_crash_half_way_leaves_the_old_results_alone(
    written: tuple[Path, Summary, list[Profile]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "results"
    shutil.copytree(written[0], out)

    def full(*_args: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results.figures, "draw", full)
    with pytest.raises(AnnulusError, match="No space left"):
        write(out, scan(round_pipe, z_mm=[0.0, 4.0]))
    assert {path.name: path.read_bytes() for path in out.iterdir()} == {
        path.name: path.read_bytes() for path in written[0].iterdir()
    }


def test_an_output_path_that_is_a_file_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(AnnulusError, match="is a file"):
            write(out, [])
    assert (tmp_path / "file").read_text() == "mine"
