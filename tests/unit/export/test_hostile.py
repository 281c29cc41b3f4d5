"""Folders that somebody damaged, or made: each costs one line that names the file, never a traceback or a wait."""

import json
import math
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from annulus_pipe.export import FORMS, open_results, write
from annulus_pipe.vocabulary import AnnulusError

Change = Callable[[Any], Any]


def export(folder: Path, *names: str) -> list[Path]:
    return write(open_results(folder), names or tuple(FORMS), folder / "export")


def refused(folder: Path, file: str, *names: str) -> str:
    with pytest.raises(AnnulusError) as caught:
        export(folder, *names)
    line = str(caught.value)
    assert file in line and "\n" not in line and len(line) < 1000
    return line


def change(path: Path, how: Change) -> None:
    data = json.loads(path.read_text())
    path.write_text(json.dumps(how(data)))


def without(name: str) -> Change:
    return lambda data: {key: value for key, value in data.items() if key != name}


def first_defect(**more: Any) -> Change:
    return lambda data: data | {"defects": [data["defects"][0] | more, *data["defects"][1:]]}


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    "file", ["summary.json", "stations.csv", "centreline.json", "wall.npz", "cloud.ply", "mesh.ply"]
)
def test_a_missing_an_empty_and_a_foreign_file_are_one_line(folder: Path, file: str) -> None:
    path = folder / file
    whole = path.read_bytes()
    for content in (None, b"", b"\x00" * 300, whole[: len(whole) // 2], b"ply\n" * 10_000, b"{" * 100_000):
        path.unlink(missing_ok=True)
        if content is not None:
            path.write_bytes(content)
        refused(folder, file)


def test_what_is_no_folder_of_results_is_said(tmp_path: Path) -> None:
    assert "No such file" in refused(tmp_path / "nowhere", "summary.json")
    (tmp_path / "summary.json").write_text('{"format": "annulus-summary/1", "height_mm": {}}')
    assert "plate" in refused(tmp_path, "summary.json")
    (tmp_path / "summary.json").unlink()
    (tmp_path / "summary.json").mkdir()
    refused(tmp_path, "summary.json")


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    "how",
    [
        without("format"),
        without("scanned_mm"),
        without("diameter_mm"),
        without("defects"),
        without("features"),
        without("points"),
        lambda data: data | {"format": "annulus-summary/2"},
        lambda data: data | {"defects": {}},
        lambda data: data | {"defects": [1]},
        lambda data: data | {"scanned_mm": {"from": 10, "to": 1}},
        lambda data: data | {"points": -1},
        lambda data: data | {"job": ["x"]},
        lambda data: data | {"job": {"a": {"b": {"c": {"d": 1}}}, "x": "y" * 10_000}},
        lambda data: data | {"source": "x" * 100_000},
        lambda data: data | {"diameter_mm": {"nominal": 0}},
        first_defect(z_mm="here"),
        first_defect(z_mm=1e300),
        first_defect(kind=7),
        first_defect(depth_mm=-1),
        first_defect(arc_deg=361),
        first_defect(clock_deg=None),
        first_defect(length_mm=[1]),
        first_defect(clock_deg=True),
        lambda data: [data],
    ],
)
def test_a_summary_that_is_none_is_one_line(folder: Path, how: Change) -> None:
    change(folder / "summary.json", how)
    refused(folder, "summary.json", "pof-csv")


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999", "9" * 5000])
def test_a_number_that_is_none_is_one_line(folder: Path, number: str) -> None:
    path = folder / "summary.json"
    path.write_text(path.read_text().replace("145.5", number))
    refused(folder, "summary.json", "dxf")


def test_what_may_be_absent_may_be_absent(folder: Path) -> None:
    for name in ("job", "warnings", "versions", "seen_percent", "ovality", "created", "source"):
        change(folder / "summary.json", without(name))
    change(folder / "summary.json", first_defect(depth_mm=None, depth_k2_mm=None, severity=None))
    assert len(export(folder)) == len(FORMS) + 2  # radii.json, twice


@pytest.mark.deep(gate="tests/unit/export/test_hostile.py::test_a_face_that_has_no_corner_is_one_line")
def test_texts_that_terminals_spreadsheets_or_drawings_obey_do_no_harm(folder: Path) -> None:
    evil = "=1+1\n0\nEOF\x1b[2J\x00\u202e\ud800 %%u \\P {\\H9;"
    change(folder / "summary.json", lambda data: data | {"source": evil, "job": {evil: evil, "client": evil}})
    change(folder / "summary.json", first_defect(remark=evil, severity=evil, kind=evil[:30]))
    import ezdxf
    import openpyxl
    import trimesh

    files = {file.name: file for file in export(folder)}
    drawing = ezdxf.readfile(files["pipe.dxf"])
    assert not drawing.audit().errors
    assert not [text for text in drawing.modelspace().query("TEXT") if re.search("[\x00-\x1f]", text.dxf.text)]
    book = openpyxl.load_workbook(files["pipe-tally.xlsx"])
    assert not [cell for sheet in book for row in sheet.rows for cell in row if cell.data_type == "f"]
    assert trimesh.load_scene(files["mesh.glb"]).geometry
    assert "\x1b" not in files["pipe-tally.csv"].read_text()


def rewrite_head(path: Path, old: str, new: str) -> None:
    data = path.read_bytes()
    assert old.encode() in data[:2000]
    path.write_bytes(data.replace(old.encode(), new.encode(), 1))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("vertex 1000", "vertex 1001"),
        ("vertex 1000", "vertex 999"),
        ("vertex 1000", "vertex 2000000000"),
        ("vertex 1000", "vertex 99999999999999999999"),
        ("vertex 1000", "vertex -1"),
        ("vertex 1000", "vertex 0"),
        ("float x", "double x"),
        ("float x", "float q"),
        ("float x", "list uchar int x"),
        ("float y", "float x"),
        ("binary_little_endian", "ascii"),
        ("element vertex", "element edge"),
        ("end_header", "endless"),
    ],
)
def test_a_cloud_whose_head_lies_is_one_line(folder: Path, old: str, new: str) -> None:
    rewrite_head(folder / "cloud.ply", old, new)
    refused(folder, "cloud.ply", "laz")


def test_a_cloud_with_a_point_nowhere_is_one_line(folder: Path) -> None:
    data = bytearray((folder / "cloud.ply").read_bytes())
    for bad in (math.nan, math.inf, 1e30):
        data[-29:-25] = np.float32(bad).tobytes()  # the last point's x
        (folder / "cloud.ply").write_bytes(data)
        for name in ("laz", "e57"):
            assert "nowhere" in refused(folder, "cloud.ply", name)
    assert not list((folder / "export").glob("*")) and not list((folder / "export").glob(".*"))


def test_a_face_that_has_no_corner_is_one_line(folder: Path) -> None:
    data = bytearray((folder / "mesh.ply").read_bytes())
    for at, bad in ((-12, np.int32(9_999_999)), (-12, np.int32(-1)), (-13, np.uint8(4))):
        changed = data.copy()
        changed[at : at + bad.nbytes] = bad.tobytes()
        (folder / "mesh.ply").write_bytes(changed)
        refused(folder, "mesh.ply", "glb")


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    "more",
    [
        {"deviation_um": np.zeros((400, 360))},
        {"deviation_um": np.zeros((399, 360), "i2")},
        {"deviation_um": np.zeros(400, "i2")},
        {"z_mm": np.zeros(400)},
        {"z_mm": np.full(400, np.nan)},
        {"z_mm": np.arange(400)[::-1] * 1.0},
        {"clock_deg": np.arange(360) + 5.0},
        {"clock_deg": np.zeros(360)},
        {"radius_mm": np.nan},
        {"radius_mm": -1.0},
        {"radius_mm": np.ones(3)},
        {"z_step_mm": 0.0},
        {"format": "annulus-wall/2"},
        {"format": np.array([{}], dtype=object)},
        {"deviation_um": np.zeros((0, 360), "i2")},
        {"radius_mm": "76.2"},
    ],
)
def test_a_wall_map_that_is_none_is_one_line(folder: Path, more: dict[str, Any]) -> None:
    with np.load(folder / "wall.npz") as file:
        held = dict(file)
    np.savez(folder / "wall.npz", **(held | more))
    refused(folder, "wall.npz", "radii")


def test_a_wall_map_that_would_fill_the_memory_is_one_line(folder: Path) -> None:
    with np.load(folder / "wall.npz") as file:
        held = dict(file)
    np.savez_compressed(folder / "wall.npz", **(held | {"z_mm": np.zeros(20_000_000)}))
    assert "would become" in refused(folder, "wall.npz", "radii")


@pytest.mark.parametrize(
    "how",
    [
        without("line_mm"),
        without("format"),
        lambda data: data | {"line_mm": []},
        lambda data: data | {"line_mm": [[1]]},
        lambda data: data | {"line_mm": [[0, 0, 0, "x"]]},
        lambda data: data | {"pieces": [{}]},
        lambda data: data | {"pieces": [7]},
        lambda data: data | {"pieces": "x"},
        lambda data: (
            data
            | {
                "pieces": [
                    {"start_mm": 0, "radius_mm": 1, "offset_mm": [0], "turn_deg": [0, 0], "curvature_per_m": [0, 0]}
                ]
            }
        ),
    ],
)
def test_a_course_that_is_none_is_one_line(folder: Path, how: Change) -> None:
    change(folder / "centreline.json", how)
    refused(folder, "centreline.json", "dxf")


@pytest.mark.parametrize(
    ("old", "new"),
    [("z_mm,", "z,"), ("102.5000", "nothing"), ("102.5000", "1e300"), ("107.5000", "102.5"), ("z_mm", '"')],
)
def test_stations_that_are_none_are_one_line(folder: Path, old: str, new: str) -> None:
    path = folder / "stations.csv"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    refused(folder, "stations.csv", "radii")


@pytest.mark.deep(gate="tests/unit/export/test_hostile.py::test_a_face_that_has_no_corner_is_one_line")
def test_no_change_of_a_value_or_a_byte_is_more_than_one_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """150 folders with one value of summary.json or centreline.json changed, or some bytes of any file."""
    monkeypatch.setattr("annulus_pipe.export.dxf.OUTLINES_MAX", 2)
    draw = random.Random(17)
    files = {path: path.read_bytes() for path in folder.iterdir()}
    values = [None, True, -1, 0, 1e308, 10**30, "", "x" * 5000, [], {}, [[]], {"a": {"b": {}}}, "\x00", "12:00"]
    refusals = 0
    for _ in range(150):
        path, whole = draw.choice(list(files.items()))
        if path.suffix == ".json" and draw.random() < 0.7:
            data = json.loads(whole)
            at, key = data, draw.choice(list(data))
            while isinstance(at[key], list | dict) and at[key] and draw.random() < 0.8:
                at = at[key]
                key = draw.choice(list(at) if isinstance(at, dict) else range(len(at)))
            at[key] = draw.choice(values)
            path.write_text(json.dumps(data))
        else:
            changed = bytearray(whole)
            for _ in range(draw.choice([1, 3, 20])):
                changed[draw.randrange(min(len(changed), 2000))] = draw.randrange(256)
            path.write_bytes(changed)
        try:
            export(folder, *draw.sample(["pof-csv", "xlsx", "laz", "glb", "dxf", "radii"], 2))
        except AnnulusError as error:
            assert "\n" not in str(error)
            refusals += 1
        path.write_bytes(whole)
    assert 50 < refusals < 150
