"""The surface, opened by trimesh, and the drawing, opened by ezdxf."""

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import trimesh
from plyfile import PlyData
from results_folder import RADIUS_MM

from annulus_pipe.export import open_results, write
from annulus_pipe.export.dxf import runs

Written = Callable[[str], Path]


def test_glb_is_the_mesh_in_metres_with_y_up(written: Written, folder: Path) -> None:
    mesh = PlyData.read(folder / "mesh.ply")
    vertices, faces = mesh["vertex"].data, np.stack(mesh["face"].data["vertex_indices"])
    scene = trimesh.load_scene(written("glb"))
    (read,) = scene.geometry.values()
    here = np.stack([vertices["x"], -vertices["y"], -vertices["z"]], axis=1).astype(float) / 1000
    assert np.abs(read.vertices - here).max() < 3e-8 and np.array_equal(read.faces, faces)
    light = np.asarray(read.visual.vertex_attributes["color"])
    screen = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    ours = np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1)
    assert np.abs(255 * screen - ours).max() < 0.01
    assert np.array_equal(read.vertex_attributes["_DEVIATION"][:, 0], np.nan_to_num(vertices["quality"], nan=-9999))
    assert read.visual.material.doubleSided and read.visual.material.metallicFactor == 0
    assert scene.metadata["unit"] == "m" and scene.metadata["job"]["pipe"] == "P-12"
    assert read.vertices[:, 2].max() < 0  # who looks forward looks along -z


def test_glb_is_laid_out_as_gltf_2_asks(written: Written) -> None:
    data = written("glb").read_bytes()
    magic, version, length, head, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON") and head % 4 == 0
    tree = json.loads(data[20 : 20 + head])
    size, kind = struct.unpack_from("<I4s", data, 20 + head)
    assert (size, kind) == (tree["buffers"][0]["byteLength"], b"BIN\0") and length == 28 + head + size
    ends = [view["byteOffset"] + view["byteLength"] for view in tree["bufferViews"]]
    assert [0, *ends[:-1]] == [view["byteOffset"] for view in tree["bufferViews"]] and ends[-1] == size
    places, count = tree["accessors"][0], tree["accessors"][0]["count"]
    points = np.frombuffer(data, "<f4", 3 * count, 28 + head).reshape(-1, 3)
    assert points.min(axis=0).tolist() == places["min"] and points.max(axis=0).tolist() == places["max"]
    corners = np.frombuffer(
        data, "<u4", tree["accessors"][3]["count"], 28 + head + tree["bufferViews"][3]["byteOffset"]
    )
    assert corners.max() < count and len(corners) % 3 == 0


def test_the_surfaces_normals_point_into_the_pipe_as_the_meshs_do(written: Written, folder: Path) -> None:
    (read,) = trimesh.load_scene(written("glb")).geometry.values()
    mesh = PlyData.read(folder / "mesh.ply")
    points = np.stack([mesh["vertex"].data[axis] for axis in "xyz"], axis=1).astype(float)
    a, b, c = points[np.stack(mesh["face"].data["vertex_indices"])].transpose(1, 0, 2)
    inwards = (np.cross(b - a, c - a)[:, :2] * (a + b + c)[:, :2]).sum(axis=1) < 0
    there = (read.face_normals[:, :2] * read.triangles_center[:, :2]).sum(axis=1) < 0
    assert np.array_equal(inwards, there)


def test_glb_is_the_same_whatever_its_parts(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (whole,) = write(open_results(folder), ["glb"], folder / "a")
    monkeypatch.setattr("annulus_pipe.export.glb.CHUNK", 100)
    (parts,) = write(open_results(folder), ["glb"], folder / "b")
    assert whole.read_bytes() == parts.read_bytes()


@pytest.mark.deep(gate="tests/unit/export/test_drawn.py::test_in_a_bend_outlines_follow_the_centre_line")
def test_dxf_opens_without_a_complaint_in_millimetres_with_its_layers(written: Written) -> None:
    drawing = ezdxf.readfile(written("dxf"))
    audit = drawing.audit()
    assert not audit.errors and not audit.fixes
    assert drawing.units == ezdxf.units.MM and drawing.dxfversion == "AC1024"
    used = {entity.dxf.layer for entity in drawing.modelspace()}
    assert used == {layer.dxf.name for layer in drawing.layers} - {"0", "Defpoints"}


@pytest.mark.deep(gate="tests/unit/export/test_drawn.py::test_in_a_bend_outlines_follow_the_centre_line")
def test_stations_stand_in_space_where_the_map_has_them(written: Written) -> None:
    drawing = ezdxf.readfile(written("dxf"))
    lines = drawing.modelspace().query('POLYLINE[layer=="STATIONS"]')
    points = np.array([point.xyz for line in lines for point in line.points()])
    clock = np.degrees(np.arctan2(points[:, 0], points[:, 2])) % 360
    radius = np.hypot(points[:, 0], points[:, 2])
    notch = (clock > 86) & (clock < 94)
    assert np.abs(radius[notch] - RADIUS_MM - 3.0).max() < 1e-3
    assert not ((clock > 176) & (clock < 184)).any()  # nobody saw that
    assert not any(line.is_closed for line in lines)
    assert 100 < points[:, 1].min() < points[:, 1].max() < 300
    (course,) = drawing.modelspace().query('POLYLINE[layer=="CENTRE-LINE"]')
    assert np.allclose([point.xyz for point in course.points()], [(0, 100, 0), (0, 300, 0)])


@pytest.mark.deep(gate="tests/unit/export/test_drawn.py::test_outlines_are_cut_at_gaps_and_nowhere_else")
def test_defects_lie_on_the_plan_at_their_distance_and_arc(written: Written, folder: Path) -> None:
    defects = json.loads((folder / "summary.json").read_text())["defects"]
    model = ezdxf.readfile(written("dxf")).modelspace()
    boxes = [np.array(box.get_points("xy")) for box in model.query('LWPOLYLINE[layer=="PLAN-LOSS"]')]
    first = defects[0]
    arc = math.radians(1) * RADIUS_MM
    box = next(box for box in boxes if abs(box[:, 0].min() - first["z_from_mm"]) < 1e-6)
    assert box[:, 0].max() == pytest.approx(first["z_to_mm"])
    assert -box[:, 1].max() == pytest.approx(arc * (first["clock_deg"] - first["arc_deg"] / 2))  # 12 o'clock at 0
    assert -box[:, 1].min() == pytest.approx(arc * (first["clock_deg"] + first["arc_deg"] / 2))
    assert len(boxes) == 3  # the one about 11 o'clock passes 12 and has two
    texts = [text.dxf.text for text in model.query("TEXT")]
    assert any(text.startswith("D1  loss 4.00 ± 0.11 mm (k=2) at 0.146 m, from 0.129 to 0.162 m") for text in texts)
    assert any("bump ≥ 4.00 mm" in text for text in texts)
    assert {"12:00", "1:00", "11:00"} <= set(texts)


def test_a_long_pipe_has_a_drawing_that_a_program_can_hold(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("annulus_pipe.export.dxf.OUTLINES_MAX", 7)
    (path,) = write(open_results(folder), ["dxf"], folder / "export")
    lines = ezdxf.readfile(path).modelspace().query('POLYLINE[layer=="STATIONS"]')
    assert len({line[0].dxf.location.y for line in lines}) == 7


def test_outlines_are_cut_at_gaps_and_nowhere_else() -> None:
    seen = np.ones(12, bool)
    assert [(list(run), closed) for run, closed in runs(seen)] == [(list(range(12)), True)]
    seen[[3, 7]] = False
    assert [(list(run), closed) for run, closed in runs(seen)] == [([4, 5, 6], False), ([8, 9, 10, 11, 0, 1, 2], False)]
    assert not list(runs(np.zeros(12, bool)))


def test_in_a_bend_outlines_follow_the_centre_line(folder: Path) -> None:
    quarter = 1.0 / (200.0 / (math.pi / 2))  # 1/mm: 200 mm of pipe turn a right angle to the right
    course = json.loads((folder / "centreline.json").read_text())
    course["pieces"] = [
        {
            "start_mm": 100.0,
            "radius_mm": 76.2,
            "taper_mm_per_mm": 0.0,
            "offset_mm": [0.0, 0.0],
            "turn_deg": [0.0, 0.0],
            "curvature_per_m": [1e3 * quarter, 0.0],
        }
    ]
    (folder / "centreline.json").write_text(json.dumps(course))
    (path,) = write(open_results(folder), ["dxf"], folder / "export")
    lines = list(ezdxf.readfile(path).modelspace().query('POLYLINE[layer=="STATIONS"]'))
    last = np.array([point.xyz for point in lines[-1].points()])
    assert np.ptp(last[:, 0]) < 10 < 140 < np.ptp(last[:, 1])  # the last circle looks to the right
    assert last[:, 0].mean() == pytest.approx(1 / quarter, abs=12)
