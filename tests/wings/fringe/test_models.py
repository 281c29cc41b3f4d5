"""The twin's heads under fringes (§6.8.2, Models A, B and C), by the commands alone: scan, wall, defects, report."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.twin.worlds import World
from annulus_pipe.wings.fringe.heads import mirror_fringe_world, modules_world, series_world
from annulus_pipe.wings.fringe.measure import pipe
from tests import kept

COARSE = "tests/wings/fringe/test_models.py::test_model_c_measures_its_pipe_on_a_coarse_grid"

EDGE_MM = 1.5  # nearer to a step the truth jumps


def errors(world: World, depth: Any) -> tuple[FloatArray, FloatArray]:
    """mm off the truth, and over sigma, of cells away from edges; the mean radius is the head's common offset."""
    clock, z = (depth["phi_deg"] + 90.0) % 360.0, depth["z_mm"][:, None]
    off = depth["radius_mm"] - world.radius_mm - world.deviation(clock[None], z)
    away = np.isfinite(off)
    for feature in world.features:
        away &= np.abs(feature.edge_distance_mm(clock[None] + 0 * z, z + 0 * clock[None], world.radius_mm)) > EDGE_MM
    told = off[away] - np.median(off[away])
    return told, told / depth["sigma_mm"][away]


def measured(world: World, frames: int, folder: Path) -> tuple[Path, dict[str, Any]]:
    """Its scan, reconstructed by the command; where the results are, and their summary."""
    scan, out = folder / "scan", folder / "out"
    kept.folder(lambda new: write_scan(world, new, frames), scan, world, frames)
    words = ["reconstruct", str(scan), "--calibration", str(scan / "calibration.json"), "-o", str(out), "--json"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    summary: dict[str, Any] = json.loads(done.stdout)
    return out, summary


def test_model_c_measures_its_pipe_on_a_coarse_grid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the pixels, a twentieth of the cells: what all of C, and A and B, are held to is deep."""
    monkeypatch.setattr(pipe, "CELL_OF_RADIUS", 1 / 40)
    monkeypatch.setattr(pipe, "SOME", 600)
    world = mirror_fringe_world(travel_mm=22.0).scaled(320)
    out, summary = measured(world, 15, tmp_path)
    with np.load(out / "depth.npz") as depth:
        off, in_sigma = errors(world, depth)
    assert len(off) > 5_000 and np.sqrt(np.mean(off**2)) < 0.02  # 0.009 measured
    assert 0.93 <= np.mean(np.abs(in_sigma) < 2) <= 1.0
    pocket = world.features[0]
    loss = min(summary["defects"], key=lambda one: abs(one["clock_deg"] - pocket.clock_deg))
    assert loss["kind"] == "loss" and abs(loss["depth_mm"] - pocket.depth_mm) < 0.05


@pytest.mark.deep(gate=COARSE)
@pytest.mark.parametrize(
    ("world", "frames", "rms_mm"),
    [
        (series_world(travel_mm=46.0), 25, 0.04),
        (modules_world(travel_mm=56.0), 80, 0.04),
        (mirror_fringe_world(travel_mm=30.0), 20, 0.02),
    ],
    ids=["A", "B", "C"],
)
def test_a_head_of_the_twin_measures_its_pipe(world: World, frames: int, rms_mm: float, tmp_path: Path) -> None:
    out, summary = measured(world, frames, tmp_path)
    assert {one.name for one in out.iterdir()} >= {"depth.npz", "cloud.ply", "mesh.ply", "report.html", "stations.csv"}
    with np.load(out / "depth.npz") as depth:
        off, in_sigma = errors(world, depth)
        middle = depth["z_mm"][:, None] + 0 * depth["radius_mm"]
        about = np.abs(middle - np.median(depth["z_mm"])) < 15.0
        assert np.isfinite(depth["radius_mm"][about]).mean() > 0.96  # the wires of A take 1.5 %
    assert np.sqrt(np.mean(off**2)) < rms_mm
    assert 0.93 <= np.mean(np.abs(in_sigma) < 2) <= 1.0  # B's are too large: see fringe.bore's drift
    true = sorted((one.as_defect(world.radius_mm) for one in world.features), key=lambda one: one["z_mm"])
    found = sorted(summary["defects"], key=lambda one: one["z_mm"])
    assert [one["kind"] for one in found] == [one["kind"] for one in true]
    for got, want in zip(found, true, strict=True):
        assert abs((got["clock_deg"] - want["clock_deg"] + 180) % 360 - 180) < 2.0
        assert abs(got["z_mm"] - want["z_mm"]) < 1.0
        assert abs(got["depth_mm"] - want["depth_mm"]) < max(0.05, 0.2 * want["depth_mm"])


@pytest.mark.deep(gate="tests/wings/fringe/test_pipe.py::test_a_clean_pipe_calibrates_the_projector")
@pytest.mark.parametrize(
    ("make", "place_mm"), [(series_world, 0.2), (mirror_fringe_world, 0.4)], ids=["A", "C"]
)  # measured: 0.08, 0.20
def test_a_clean_pipe_says_where_the_light_comes_from(
    make: Callable[[], World], place_mm: float, tmp_path: Path
) -> None:
    """The head some millimetres aside, all its cameras at once, from a design that is off by more than a millimetre."""
    clean = replace(make(), features=(), texture=False, wobble_deg=0.15, wobble_mm=0.0)
    several = len(clean.cameras) > 1
    rows = ["index,file,light,z_mm,camera,tx_mm,ty_mm"]
    for index, (right, down) in enumerate([(0, 0), (4, 0), (-2, 3.4), (-2, -3.4), (2, 3.4), (2, -3.4)]):
        aside = replace(clean, centre_mm=(-right, -down))
        for camera in range(len(clean.cameras)):
            raw = Renderer(aside, camera).render(aside.pose(0.0), 0.0, 1.0, seed=index)
            assert cv2.imwrite(str(tmp_path / f"{index}-{camera}.png"), to_bgr(raw, "bayer_rggb8"))
            rows.append(f"{index},{index}-{camera}.png,projector,0,{camera},{right},{down}")
    (tmp_path / "frames.csv").write_text("\n".join(rows) + "\n")
    design = clean.calibration().to_dict()
    true = design["pattern"]["projector"]
    off = [at + by for at, by in zip(true["centre_mm"], (1.0, -1.2, 1.5), strict=True)]
    wrong = {**true, "centre_mm": off, "period_mm": 1.004 * true["period_mm"], "phase0": 0.0}
    (tmp_path / "design.json").write_text(json.dumps({**design, "pattern": {"kind": "fringe", "projector": wrong}}))
    head = tmp_path / "head.json"
    words = ["calibrate", "fringe", str(tmp_path), "--camera", str(tmp_path / "design.json"), "-o", str(head), "--json"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    written = json.loads(head.read_text())
    found = written["pattern"]["projector"]
    assert np.abs(np.subtract(found["centre_mm"], true["centre_mm"])).max() < place_mm
    assert np.degrees(np.linalg.norm(np.subtract(found["rotation"][2], true["rotation"][2]))) < 0.03
    assert len(written["cameras"]) == len(clean.cameras)
    assert ("rotation" in written["pipe"]) == several  # how the first camera stands in the pipe is kept
